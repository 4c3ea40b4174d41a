# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth calibrate-projector`: folders of rendered poses, files, and wrong input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from known_projector import BESIDE, COLUMNS, ROWS, SQUARE_M, poses

from stereo_depth_ros.active.structured_light.manifest import MANIFEST, manifest_text
from stereo_depth_ros.active.structured_light.patterns import Pattern, PatternSequence
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.diagnosis.checks.rig import check_pair, check_shown
from stereo_depth_ros.diagnosis.finding import Level
from stereo_depth_ros.stages.rectification import Rectifier

BOARD = ("--size", f"{COLUMNS}x{ROWS}", "--square", SQUARE_M)
SIZE = BESIDE.projector_size
_GRAY = [
    Pattern("gray", axis, bit, inverse)
    for axis, bits in (("columns", 9), ("rows", 9))
    for bit in range(bits - 1, -1, -1)
    for inverse in (False, True)
]
OPENCV = PatternSequence(SIZE, (*_GRAY, Pattern("white"), Pattern("black")))


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("calibrate-projector", columns=120)


@pytest.fixture(scope="module")
def captures() -> list[list[U8]]:
    """Five poses under OpenCV's Gray code, with white and black at the end."""
    return [BESIDE.captures(pose, OPENCV) for pose in poses(BESIDE, 5, seed=6)]


def write(folder: Path, images: list[U8]) -> None:
    folder.mkdir(parents=True)
    for number, image in enumerate(images):
        assert cv2.imwrite(str(folder / f"{number}.png"), image)  # 10.png follows 9.png


@pytest.fixture
def folder(tmp_path: Path, captures: list[list[U8]]) -> Path:
    for number, images in enumerate(captures):
        write(tmp_path / "board" / f"pose{number}", images)
    return tmp_path / "board"


def test_poses_without_a_manifest_in_the_order_of_opencv(run: Run, tmp_path: Path, folder: Path) -> None:
    out = tmp_path / "out"
    code, text, err = run(folder, *BOARD, "--projector-size", "400x300", "-o", out, "--json", tmp_path / "r.json")
    assert code == 0, err
    assert "5 examined, 5 used, 0 dropped" in text and "projector" in text
    values = json.loads((tmp_path / "r.json").read_text())
    assert values["rms_camera"] < 0.15 and values["rms_projector"] < 0.25
    assert (values["projector_width"], values["projector_height"]) == SIZE
    np.testing.assert_allclose(np.diag(values["projector_K_px"])[:2], BESIDE.projector[:2], rtol=0.01)
    np.testing.assert_allclose(np.array(values["projector_K_px"])[:2, 2], BESIDE.projector[2:4], atol=4)
    np.testing.assert_allclose(values["T_m"], BESIDE.rig[3:], atol=0.005)
    assert values["corners"]["seen"] == 5 * COLUMNS * ROWS
    assert json.loads((out / "calibration.json").read_text())["T_m"] == values["T_m"]
    assert "projector 400x300, 5 poses used" in (out / "calibration.txt").read_text()
    image = cv2.imread(str(out / "coverage.png"))
    assert image is not None and image.shape[1] > 1000
    assert (out / "right.yaml").read_text().startswith("# A projector of 400x300 px as a camera of 320x240 px")
    rig = StereoRig.from_yaml(out / "left.yaml", out / "right.yaml")
    assert rig.baseline_m == pytest.approx(np.linalg.norm(BESIDE.rig[3:]), abs=0.005)
    findings = [*check_pair(rig.left, rig.right), check_shown(Rectifier(rig).shown)]
    assert {finding.level for finding in findings} == {Level.OK}


def test_the_rig_command_reads_the_files(command_line: CommandLine, tmp_path: Path, folder: Path) -> None:
    calibrate, rig = command_line("calibrate-projector", columns=120), command_line("rig", columns=120)
    (folder / MANIFEST).write_text(manifest_text(OPENCV))
    code, _, err = calibrate(folder, *BOARD, "-o", tmp_path / "out")
    assert code == 0, err
    code, text, err = rig(tmp_path / "out", "--json", "-")
    assert code == 0, err
    assert json.loads(text)["rig"]["baseline_m"] == pytest.approx(np.linalg.norm(BESIDE.rig[3:]), abs=0.005)


def test_a_given_camera_a_manifest_of_its_own_and_poses_that_cannot_be_used(
    run: Run, tmp_path: Path, folder: Path, captures: list[list[U8]]
) -> None:
    """White and black first; one pose incomplete, one without the board."""
    sequence = PatternSequence(SIZE, (*OPENCV.patterns[-2:], *OPENCV.patterns[:-2]))
    for number, images in enumerate(captures[:3]):
        shutil.rmtree(folder / f"pose{number}")
        write(folder / f"pose{number}", [*images[-2:], *images[:-2]])
    (folder / "pose3" / "0.png").unlink()
    shutil.rmtree(folder / "pose4")
    write(folder / "pose4", [cv2.resize(pattern, (320, 240)) // 2 + 20 for pattern in sequence.render()])
    (tmp_path / "manifest.json").write_text(manifest_text(sequence))
    write_camera(tmp_path / "camera.yaml", BESIDE.models[0], "camera")
    options = ("--camera", tmp_path / "camera.yaml", "--patterns", tmp_path / "manifest.json")
    code, text, err = run(folder, *BOARD, *options, "-o", tmp_path / "out", "--json", "-")
    assert code == 0, err
    values = json.loads(text)
    assert values["camera_known"] and values["camera"]["fx"] == {"value": 301.0, "sigma": 0.0}
    np.testing.assert_allclose(values["T_m"], BESIDE.rig[3:], atol=0.01)
    assert "warning: pose3: skipped, 37 images, the sequence has 38 patterns" in err
    assert "warning: no board in 1 of 5 poses: pose4" in err
    assert values["poses"] == {"total": 5, "without": 1, "skipped": 1}


def check_refused(run: Run, out: Path, arguments: tuple[object, ...], text: str, expected: int = 1) -> None:
    code, _, err = run(*arguments, "-o", out)
    assert code == expected, err
    assert text in " ".join(err.split())
    assert "Traceback" not in err and not out.exists()


def test_wrong_input(run: Run, tmp_path: Path, folder: Path) -> None:
    out, size = tmp_path / "out", ("--projector-size", "400x300")
    check_refused(run, out, (folder, *BOARD), "there is no patterns.json in it or beside it", 2)
    check_refused(run, out, (folder / "pose0", *BOARD, *size), "holds images, that is one pose, and no folders")
    check_refused(run, out, (tmp_path / "none", *BOARD, *size), "does not exist: name the folder that holds a folder")
    for number in (1, 2, 3, 4):
        shutil.rmtree(folder / f"pose{number}")
    check_refused(run, out, (folder, *BOARD, *size), "1 pose of the board, at least 3 are required")
    other = (folder, "--size", "8x6", "--square", "0.04", *size)
    check_refused(run, out, other, "no board of 8x6 inner corners in 1 poses, but one of 7x5 in 1 of 1 images")
    check_refused(run, out, (folder, *BOARD, *size, "--square", "40"), "40 mm is 0.04", 2)
    check_refused(
        run,
        out,
        (folder, *BOARD, "--projector-size", "1024x768"),
        "pose0: skipped, 38 images, the sequence has 42 patterns",
    )
    columns = PatternSequence(SIZE, OPENCV.patterns[:18])
    (folder / MANIFEST).write_text(manifest_text(columns))
    check_refused(run, out, (folder, *BOARD), "pose0: the patterns do not code rows, a projector is calibrated by")
    (folder / MANIFEST).write_text("{")
    check_refused(run, out, (folder, *BOARD), "patterns.json: is not JSON")
    (tmp_path / "rig.yaml").write_text("image_width: 3\n")
    check_refused(run, out, (folder, *BOARD, *size, "--camera", tmp_path / "rig.yaml"), "rig.yaml: ")
    given = ("--patterns", folder / MANIFEST, *size)
    check_refused(run, out, (folder, *BOARD, *given), "--projector-size has no effect with --patterns", 2)
