# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth rectify`: with and without a calibration, images, JSON, wrong input."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run

from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

WIDTH, HEIGHT = 320, 240
SCENE = SyntheticSequence(1, WIDTH, HEIGHT)


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("rectify", columns=100)


@pytest.fixture(scope="module")
def raw() -> StereoPair:
    return SCENE[0].pair


@pytest.fixture
def pair(raw: StereoPair, tmp_path: Path) -> tuple[Path, Path]:
    """A raw pair of two distorted, verged cameras, and their calibration beside it in rig/."""
    paths = tmp_path / "l.png", tmp_path / "r.png"
    for path, image in zip(paths, (raw.left, raw.right), strict=True):
        cv2.imwrite(str(path), image.pixels)
    (tmp_path / "rig").mkdir()
    write_camera(tmp_path / "rig" / "left.yaml", SCENE.rig.left, "left")
    write_camera(tmp_path / "rig" / "right.yaml", SCENE.rig.right, "right")
    return paths


def test_by_the_calibration(run: Run, tmp_path: Path, raw: StereoPair, pair: tuple[Path, Path]) -> None:
    code, out, err = run(*pair, "--rig", tmp_path / "rig", "-o", tmp_path / "out", "--json", tmp_path / "r.json")
    assert (code, err) == (0, "")
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["metric"] is True
    assert result["before"]["median_px"] > 1.5
    assert result["after"]["median_px"] < 0.3
    assert "in meters" in out
    left = cv2.imread(str(tmp_path / "out" / "left.png"), cv2.IMREAD_GRAYSCALE)
    assert left is not None
    np.testing.assert_array_equal(left, Rectifier(SCENE.rig).rectify_left(raw.left.pixels))
    rows = cv2.imread(str(tmp_path / "out" / "rows.png"))
    assert rows is not None and rows.shape[1] > 2 * WIDTH
    assert not (tmp_path / "out" / "left.yaml").exists()


@pytest.mark.parametrize("method", ["textbook", "opencv"])
def test_method_computes_new_rectification(run: Run, tmp_path: Path, pair: tuple[Path, Path], method: str) -> None:
    arguments = ("--rig", tmp_path / "rig", "--method", method, "--alpha", "0.5")
    code, out, err = run(*pair, *arguments, "-o", tmp_path / "out", "--json", "-")
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert result["method"] == method
    assert result["after"]["median_px"] < 0.3
    rig = StereoRig.from_yaml(tmp_path / "out" / "left.yaml", tmp_path / "out" / "right.yaml")
    assert rig.baseline_m == pytest.approx(SCENE.rig.baseline_m, rel=1e-6)
    assert result["common_area"]["width"] < WIDTH


def test_without_a_calibration(run: Run, tmp_path: Path, pair: tuple[Path, Path]) -> None:
    """Distortion is removed with K and D of the cameras; the rectification is from the images."""
    arguments = ("--uncalibrated", "--rig", tmp_path / "rig", "-o", tmp_path / "out", "--json", "-")
    code, out, err = run(*pair, *arguments)
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert result["metric"] is False
    assert result["distortion_removed"] is True
    assert result["after"]["median_px"] < 0.5
    assert result["midlines_left"]["angle_deg"] == pytest.approx(90, abs=1e-6)
    assert np.linalg.svd(np.array(result["F"]), compute_uv=False)[2] < 1e-12


def test_lenses_without_calibration_are_assumed_undistorted(run: Run, tmp_path: Path, pair: tuple[Path, Path]) -> None:
    code, out, err = run(*pair, "--uncalibrated", "-o", tmp_path / "out")
    assert code == 0
    assert "not in meters" in out
    assert "warning: the lenses are assumed to have no distortion" in err


def test_wrong_input(run: Run, tmp_path: Path, pair: tuple[Path, Path]) -> None:
    out = ("-o", tmp_path / "out")
    flat = tmp_path / "flat.png"
    cv2.imwrite(str(flat), np.full((HEIGHT, WIDTH), 99, np.uint8))
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.full((100, 100), 99, np.uint8))
    for arguments, text, expected in (
        (pair, "neither --camera-info nor --uncalibrated is given", 2),
        ((*pair, "--uncalibrated", "--method", "opencv"), "--method opencv needs a calibration", 2),
        ((*pair, "--rig", tmp_path / "rig", "--method", "bouguet"), "'bouguet' is not one of textbook, opencv", 2),
        ((pair[0], tmp_path / "none.png", "--uncalibrated"), "none.png", 1),
        ((flat, flat, "--uncalibrated"), "0 different matches of 0", 1),
        ((small, small, "--rig", tmp_path / "rig"), "the image is 100x100, its camera info is for 320x240", 1),
        ((pair[0], small, "--uncalibrated"), "matches", 1),
    ):
        code, _, err = run(*arguments, *out)
        assert code == expected, arguments
        assert text in " ".join(err.split()), arguments
    assert not (tmp_path / "out").exists()


def test_one_file_with_both_images(run: Run, tmp_path: Path, pair: tuple[Path, Path]) -> None:
    both, outputs = tmp_path / "both.png", ("left.png", "right.png", "rows.png")
    cv2.imwrite(str(both), np.concatenate([cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in pair], axis=1))
    rig = ("--rig", tmp_path / "rig", "-o")
    assert run(both, "--side-by-side", *rig, tmp_path / "one")[0] == run(*pair, *rig, tmp_path / "two")[0] == 0
    for name in outputs:
        one, two = (cv2.imread(str(tmp_path / place / name)) for place in ("one", "two"))
        np.testing.assert_array_equal(one, two)
    code, _, err = run(*pair, "--side-by-side", *rig, tmp_path / "out")
    assert code == 2 and f"{pair[1]} has no effect with --side-by-side, both images are in {pair[0]}" in err
    code, _, err = run(both, *rig, tmp_path / "out")
    assert code == 2 and "the image of the right camera is missing: " in err and "--side-by-side" in err
    code, _, err = run(both, both, *rig, tmp_path / "out")
    assert code == 1 and "the image is 640x240, its camera info is for 320x240: it looks like both images" in err
    assert err.endswith("(--side-by-side)\n")
    cv2.imwrite(str(both), np.zeros((6, 9), np.uint8))
    code, _, err = run(both, "--side-by-side", *rig, tmp_path / "out")
    assert code == 1 and "both.png: is 9x6, an odd width has no two halves" in err
