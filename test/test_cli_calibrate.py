# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth calibrate`: files, figures, dropped views, wrong input."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from rendered_boards import FISHEYE, SQUARE_M, chessboard_photographs

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.messages.image import image_message

BOARD = ("--board", "chessboard", "--size", "7x5", "--square", SQUARE_M, "--model", "equidistant")
KEYS = {"rms_left", "rms_right", "rms_stereo", "baseline_m", "epipolar_rms_px", "views_used", "views_dropped"}


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("calibrate", columns=100)


@pytest.fixture(scope="module")
def photographs() -> list[tuple[U8, U8]]:
    """Eight views of the board by both cameras, and one without the board."""
    pairs = list(chessboard_photographs())
    return [*pairs, (np.full_like(pairs[0][0], 90), np.full_like(pairs[0][1], 90))]


@pytest.fixture
def folder(tmp_path: Path, photographs: list[tuple[U8, U8]]) -> Path:
    for number, pair in enumerate(photographs):
        for side, image in zip(("left", "right"), pair, strict=True):
            path = tmp_path / "images" / side / f"{number}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), image)
    return tmp_path / "images"


def check_files(output: Path) -> None:
    rig = StereoRig.from_yaml(output / "left.yaml", output / "right.yaml")
    assert rig.baseline_m == pytest.approx(np.linalg.norm(FISHEYE.rig[3:]), abs=1e-3)
    assert rig.left.K[0, 0] == pytest.approx(FISHEYE.left[0], abs=1.0)
    assert rig.right.distortion_model == "equidistant"
    assert rig.f_px == pytest.approx(125.6, rel=0.05)  # that of the exact cameras
    image = cv2.imread(str(output / "coverage.png"))
    assert image is not None and image.shape[1] > 1000


def test_images_of_a_folder(run: Run, tmp_path: Path, folder: Path) -> None:
    code, out, err = run(folder, *BOARD, "-o", tmp_path / "out", "--json", tmp_path / "r.json")
    assert code == 0, err
    check_files(tmp_path / "out")
    values = json.loads((tmp_path / "r.json").read_text())
    assert values.keys() >= KEYS
    assert (values["views_used"], values["views_dropped"]) == (8, 0)
    assert values["rms_stereo"] < 0.2
    assert values["epipolar_rms_px"] < 0.2
    assert "baseline" in out and "±" in out and "0.png" in out
    assert "warning: no board in 1 of 9 pairs: 8.png" in err
    assert json.loads((tmp_path / "out" / "calibration.json").read_text())["rms_left"] == values["rms_left"]


def test_bag(run: Run, tmp_path: Path, photographs: list[tuple[U8, U8]]) -> None:
    """Every view is recorded three times."""
    types = RosbagsTypes()
    with BagWriter(tmp_path / "board.mcap") as bag:
        for number, pair in enumerate(photographs):
            for again in range(3):
                stamp_ns = (3 * number + again) * 100_000_000
                for side, image in zip(("left", "right"), pair, strict=True):
                    bag.write(f"/{side}/image_raw", image_message(types, image, "mono8", stamp_ns, side), stamp_ns)
    code, out, err = run(tmp_path / "board.mcap", *BOARD, "-o", tmp_path / "out", "--json", "-")
    assert code == 0, err
    check_files(tmp_path / "out")
    values = json.loads(out)
    assert values["views_used"] <= 8
    assert values["pairs"]["total"] == 27


@pytest.mark.parametrize(
    ("arguments", "text", "expected"),
    [
        (("--size", "9"), "board size '9' is not columns x rows: write it as 9x6", 2),
        (("--board", "circles"), "'circles' is not one of chessboard, charuco, aprilgrid", 2),
        (("--model", "fisheye"), "'fisheye' is not one of plumb_bob", 2),
        (("--square", "25"), "25 mm is 0.025", 2),
        (("--size", "8x6"), "but one of 7x5 in", 1),
        (("--json", "nowhere/r.json"), "folder nowhere does not exist", 1),
    ],
)
def test_wrong_input(
    run: Run, tmp_path: Path, folder: Path, arguments: tuple[str, ...], text: str, expected: int
) -> None:
    if text.startswith("but one"):
        for path in folder.glob("*/[1-8].png"):
            path.unlink()
    code, _, err = run(folder, *BOARD, "-o", tmp_path / "out", *arguments)
    assert code == expected
    assert text in " ".join(err.split())
    assert not (tmp_path / "out").exists()


def test_too_few_views(run: Run, tmp_path: Path, folder: Path) -> None:
    for path in folder.glob("*/[3-7].png"):
        path.unlink()
    code, _, err = run(folder, *BOARD, "-o", tmp_path / "out")
    assert code == 1
    text = " ".join(err.split())
    assert "3 views of the board, at least 5 are required" in text
    assert "(4 pairs examined; no board in 1 of 4 pairs: 8.png)" in text


def test_output_that_is_a_file(run: Run, tmp_path: Path, folder: Path) -> None:
    (tmp_path / "file").write_text("")
    code, _, err = run(folder, *BOARD, "-o", tmp_path / "file")
    assert code == 1
    assert "file: is not a folder: name a folder (--output)" in " ".join(err.split())


def test_missing_input(run: Run, tmp_path: Path) -> None:
    code, _, err = run(tmp_path / "none", *BOARD, "-o", tmp_path / "out")
    assert code == 1
    assert "does not exist: name a folder of images, or a bag" in " ".join(err.split())


def test_a_circular_image_is_named_and_covered_by_what_is_lit(run: Run, tmp_path: Path, folder: Path) -> None:
    rows, columns = np.indices((300, 400))
    dark = np.hypot(columns - 203, rows - 147) > 190
    for path in folder.glob("*/*.png"):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        cv2.imwrite(str(path), np.where(dark, 3, image))
    code, out, err = run(folder, *BOARD, "-o", tmp_path / "out", "--json", tmp_path / "r.json")
    assert code == 0, err
    assert "image circle, left center (203, 147), radius 190 px: the coverage is judged within it" in " ".join(
        out.split()
    )
    check = json.loads((tmp_path / "r.json").read_text())
    assert check["image_circles_px"][1]["radius"] == pytest.approx(190, abs=1)
    assert check["rms_stereo"] < 0.2


def test_damaged_and_odd_images_are_skipped_and_named(run: Run, tmp_path: Path, folder: Path) -> None:
    (folder / "left" / "0.png").write_bytes(b"not an image")
    small = np.full((100, 120), 90, np.uint8)
    cv2.imwrite(str(folder / "right" / "1.png"), small)
    code, out, err = run(folder, *BOARD, "-o", tmp_path / "out", "--json", tmp_path / "r.json")
    assert code == 0, err
    assert "8 examined, 6 used, 0 dropped, 2 skipped" in out
    assert "0.png: skipped, it is not a readable image" in err
    assert "warning: 1.png: skipped, it is 400x300 and 120x100, most images are 400x300" in err
    assert json.loads((tmp_path / "r.json").read_text())["pairs"]["skipped"] == 2
    for number in range(2, 5):
        cv2.imwrite(str(folder / "left" / f"{number}.png"), small)
        cv2.imwrite(str(folder / "right" / f"{number}.png"), small)
    code, _, err = run(folder, *BOARD, "-o", tmp_path / "none")
    assert code == 1
    assert "3 views of the board, at least 5 are required" in err
    assert all(f"{number}.png: skipped" in err for number in range(5))
    for path in folder.glob("left/*.png"):
        path.write_bytes(b"")
    code, _, err = run(folder, *BOARD, "-o", tmp_path / "none")
    assert code == 1
    assert "no pair of images can be read (" in err and "8.png: skipped" in err


@pytest.mark.parametrize("size", ["6x5"])
def test_another_size_is_found_in_the_images(run: Run, tmp_path: Path, folder: Path, size: str) -> None:
    """Also where some images show a smaller board by chance, in one camera only."""
    for path in folder.glob("*/[1-8].png"):
        path.unlink()
    code, _, err = run(folder, *BOARD, "--size", size, "-o", tmp_path / "out")
    assert code == 1
    assert "but one of 7x5 in 1 of 1 images examined again: size counts inner corners, columns x rows: give 7x5" in err
    assert "camera sees" not in err


def test_one_pattern_for_both_cameras(run: Run, tmp_path: Path, folder: Path) -> None:
    for side, letter in (("left", "L"), ("right", "R")):
        for path in (folder / side).iterdir():
            path.rename(folder / f"img{letter}{path.name}")
    code, _, err = run(folder, *BOARD, "--left", "img*.png", "-o", tmp_path / "out")
    assert code == 0, err
    check_files(tmp_path / "out")
