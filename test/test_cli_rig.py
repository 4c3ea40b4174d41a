# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth rig`: tables, JSON, plot, wrong input."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run

from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.plots.depth_error import depth_error_plot

RIG = StereoRig.from_rectified(400.0, 420.0, 330.0, 318.0, 205.0, 0.125, (640, 430))


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("rig", columns=90)


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    write_camera(tmp_path / "left.yaml", RIG.left, "left")
    write_camera(tmp_path / "right.yaml", RIG.right, "right")
    return tmp_path / "left.yaml"


def test_tables_json_and_plot(run: Run, tmp_path: Path, rig_file: Path) -> None:
    plot, report = tmp_path / "e.png", tmp_path / "r.json"
    code, out, err = run(rig_file, "--nearest", "0.5", "--plot", plot, "--json", report)
    assert (code, err) == (0, "")
    result = json.loads(report.read_text())
    assert result["rig"]["baseline_m"] == pytest.approx(0.125)
    assert result["recommended"] == {"nearest_m": 0.5, "min_disparity": 12, "disparity_range": 112}
    own = result["limits"][1]
    assert own["farthest_m"] == pytest.approx(10)
    assert own["search_end_m"] is None
    assert [row["depth_m"] for row in result["depths"]] == list(range(1, 11))
    assert result["depths"][4]["sigma_m"] == pytest.approx(0.125, rel=1e-6)
    for text in ("field of view", "rectified", "error 5 %", "--param min_disparity:=12 --param disparity_range:=112"):
        assert text in out
    assert result["plot"] == str(plot)
    drawn = cv2.imread(str(plot))
    assert drawn is not None and drawn.std() > 10


def test_search_and_noise_that_are_set(run: Run, rig_file: Path) -> None:
    given = ("--param", "disparity_range:=64", "--param", "disparity_sigma_px:=0.1", "--max-error", "2")
    code, out, err = run(rig_file, *given, "--json", "-")
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert result["search"] == {"min_disparity": 0, "disparity_range": 64}
    assert result["limits"][1]["nearest_m"] == pytest.approx(50 / (63 - 12))
    assert result["limits"][1]["farthest_m"] == pytest.approx(0.02 * 50 / 0.1)


def test_depth_error_above_the_limit_at_the_nearest_depth(run: Run, rig_file: Path) -> None:
    code, _, err = run(rig_file, "--nearest", "3", "--max-error", "0.5")
    assert code == 0
    assert "warning: at the nearest depth" in err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--nearest", "0.01"), "the images are 640 px wide"),
        (("--max-error", "0"), "max_error = 0 is not above 0"),
        (("--param", "disparity_range:=7"), "disparity_range = 7 is outside"),
        (("--matcher", "none"), "none"),
    ],
)
def test_wrong_values(run: Run, rig_file: Path, arguments: tuple[str, str], text: str) -> None:
    code, _, err = run(rig_file, *arguments)
    assert code == 2
    assert text in " ".join(err.split())


def test_files_that_are_not_a_rig(run: Run, rig_file: Path) -> None:
    right = rig_file.with_name("right.yaml")
    good = right.read_text()
    right.write_text(good.replace(repr(float(RIG.right.P[0, 3])), repr(1000 * float(RIG.right.P[0, 3]))))
    code, _, err = run(rig_file)
    assert code == 1
    assert "probably written in millimeters" in " ".join(err.split())
    right.unlink()
    code, _, err = run(rig_file)
    assert code == 1
    assert "there is no right.yaml in its folder" in " ".join(err.split())


def test_plot_has_a_line_for_each_baseline() -> None:
    depths = np.linspace(0.1, 10, 50)
    lines = {"60 mm": depths**2 * 0.01, "120 mm": depths**2 * 0.005}
    both = depth_error_plot(depths, lines, dict.fromkeys(lines, 0.5), 0.05, "title")
    one = depth_error_plot(depths, {"60 mm": lines["60 mm"]}, {"60 mm": 0.5}, 0.05, "title")
    assert both.shape == one.shape
    assert np.count_nonzero((both != one).any(axis=2)) > 300
