# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files for the benchmarks of KITTI, Middlebury and ETH3D: their names, and that the readers find what was computed."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from stereo_depth_ros.cli.main import app
from stereo_depth_ros.core.errors import BagError, ConfigError, OutputError
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.datasets.disparity_maps import read_disparity_map
from stereo_depth_ros.datasets.kitti import read_truth
from stereo_depth_ros.evaluation.submission import find_submitted
from stereo_depth_ros.matching import create_matcher

HEIGHT, WIDTH, SHIFT = 50, 150, 9
CALIBRATION = "cam0=[500 0 75; 0 500 25; 0 0 1]\ndoffs=0\nbaseline=100\nwidth=150\nheight=50\nndisp={}\n"
OF_MIDDLEBURY = "isint=0\nvmin=2\nvmax=40\n"


def pair() -> tuple[U8, U8]:
    texture = np.random.default_rng(2).integers(0, 256, (HEIGHT, WIDTH + SHIFT), np.uint8)
    return np.ascontiguousarray(texture[:, :WIDTH]), np.ascontiguousarray(texture[:, SHIFT:])


def write_pair(left: Path, right: Path) -> None:
    for path, pixels in zip((left, right), pair(), strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), pixels)


def expected(count: int) -> F32:
    return create_matcher("sgm", num_disparities=count).match(*pair()).disparity_px


def run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, ["evaluate", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize(
    ("sides", "written"), [(("image_2", "image_3"), "disp_0/000007_10.png"), (("image_0", "image_1"), "000007_10.png")]
)
def test_kitti(sides: tuple[str, str], written: str, tmp_path: Path) -> None:
    for frame in ("000007_10.png", "000007_11.png"):  # the second one is not evaluated
        write_pair(*(tmp_path / "testing" / side / frame for side in sides))
    out = tmp_path / "out"
    output = run(tmp_path, "--matcher", "sgm", "--submission", out)
    assert "1 files of 1 pairs" in output
    assert [path.relative_to(out).as_posix() for path in out.rglob("*.*")] == [written]
    found, truth = read_truth(out / written), expected(64)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(truth))
    assert np.isnan(truth).any() and np.nanmax(np.abs(found - truth)) <= 0.5 / 256
    assert abs(float(np.nanmedian(found)) - SHIFT) < 0.1


@pytest.mark.parametrize("of_middlebury", [True, False])
def test_middlebury_and_eth3d(of_middlebury: bool, tmp_path: Path) -> None:
    scene = tmp_path / "testH" / "Room"
    write_pair(scene / "im0.png", scene / "im1.png")
    count, used = (37, 48) if of_middlebury else (WIDTH, 64)  # that of ETH3D says nothing
    (scene / "calib.txt").write_text(CALIBRATION.format(count) + (OF_MIDDLEBURY if of_middlebury else ""), "utf-8")
    out = tmp_path / "out"
    run(tmp_path, "--matcher", "sgm", "--submission", out)
    names = ("testH/Room/disp0sgm.pfm", "testH/Room/timesgm.txt")
    if not of_middlebury:
        names = ("low_res_two_view/Room.pfm", "low_res_two_view/Room.txt")
    assert {path.relative_to(out).as_posix() for path in out.rglob("*.*")} == set(names)
    found, truth = read_disparity_map(out / names[0]), expected(used)
    np.testing.assert_array_equal(found, np.where(np.isnan(truth), np.float32(np.inf), truth))
    kind, seconds = (
        (out / names[1]).read_text("utf-8").split() if not of_middlebury else ("", (out / names[1]).read_text())
    )
    assert kind == ("" if of_middlebury else "runtime") and 0 < float(seconds) < 60


def test_pairs_with_truth_are_evaluated_too_and_their_truth_gives_no_range(tmp_path: Path) -> None:
    scene = tmp_path / "trainingQ" / "Room"
    write_pair(scene / "im0.png", scene / "im1.png")
    (scene / "calib.txt").write_text(CALIBRATION.format(70) + OF_MIDDLEBURY, "utf-8")
    truth = np.full((HEIGHT, WIDTH), SHIFT, np.float32)
    assert cv2.imwrite(str(scene / "disp0.pfm"), truth)
    out = tmp_path / "out"
    output = run(scene, "--matcher", "sgm", "--submission", out, "--json", tmp_path / "scores.json")
    assert "Room" in output and (tmp_path / "scores.json").exists()
    found = read_disparity_map(out / "trainingQ/Room/disp0sgm.pfm")
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected(80)))  # not 32
    dense = tmp_path / "dense"
    run(scene, "--matcher", "sgm", "--param", "fill_holes:=true", "--submission", dense)
    assert np.isfinite(read_disparity_map(dense / "trainingQ/Room/disp0sgm.pfm")).all()


def test_what_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"holds no pair of KITTI stereo, Middlebury or ETH3D"):
        find_submitted(tmp_path)
    write_pair(tmp_path / "image_2" / "000001_10.png", tmp_path / "image_3" / "000001_10.png")
    given = ["evaluate", str(tmp_path), "--matcher", "sgm", "--submission", str(tmp_path / "o")]
    two = CliRunner().invoke(app, [*given, "--matcher", "bm"])
    assert isinstance(two.exception, ConfigError) and "--submission takes one matcher, 2 are given" in str(
        two.exception
    )
    run(*given[1:])
    again = CliRunner().invoke(app, given)
    assert isinstance(again.exception, OutputError) and "exists" in str(again.exception)
    run(*given[1:], "--overwrite")
