# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is given on the command line has an effect, or is refused at the start with exit code 2 and one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import CommandLine
from stereo_bags import write_truth_bag

from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.cli.given import given_parameters
from stereo_depth_ros.config import CONFIGS, parameter_infos
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.rig import StereoRig


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag, two camera files, and a folder in place of a dataset."""
    folder = tmp_path_factory.mktemp("given")
    rig: StereoRig = write_truth_bag(folder / "in.mcap", 2).rig
    write_camera(folder / "left.yaml", rig.left, "left")
    write_camera(folder / "right.yaml", rig.right, "right")
    (folder / "images").mkdir()
    return folder


BM = ["--matcher", "bm"]
PROCESS, REPLAY = ["process", "in.mcap", "-o", "out.mcap"], ["replay", "in.mcap", "-o", "out.mcap"]
CALIBRATE = ["calibrate", "images", "--size", "9x6", "--square", "0.02", "-o", "out"]
RECTIFY = ["rectify", "l.png", "r.png", "-o", "out"]
EVALUATE = ["evaluate", "in.mcap", *BM]
RIG = ["rig", "left.yaml"]
MIDDLEBURY = ["convert", "middlebury", "images", "o.mcap"]
FOCAL = ["--focal-px", "500", "--baseline-m", "0.1"]


def p(*texts: str) -> list[str]:
    return [part for text in texts for part in ("-p", text)]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        # options that contradict each other
        (
            [*PROCESS, *BM, *p("stereo_algorithm:=1")],
            "--matcher bm and --param stereo_algorithm:=1, which is sgbm",
        ),
        ([*REPLAY, *BM, *p("stereo_algorithm:=2")], "which is sgm, contradict each other: give one of them"),
        ([*PROCESS, *p("speckle_size:=1", "speckle_size:=2")], "parameter speckle_size is given twice, as 1 and as 2"),
        ([*PROCESS, *p("sgm_P1:=90", "sgm_P2:=80")], "sgm_P2 = 80 is not above sgm_P1 = 90: raise it"),
        ([*PROCESS, *p("sgm_P2:=5")], "sgm_P2 = 5 is not above sgm_P1 = 9"),
        ([*REPLAY, *p("sgm_P1:=90", "sgm_P2:=80")], "sgm_P2 = 80 is not above sgm_P1 = 90"),
        ([*PROCESS, "--matcher", "sgbm", *p("P1:=300.0", "P2:=200.0")], "P2 = 200 is not above P1 = 300"),
        ([*REPLAY, "--auto-correct", *p("auto_correct:=false")], "--auto-correct and --param auto_correct:=false"),
        ([*EVALUATE, *BM], "--matcher bm is given twice: give it once"),
        ([*EVALUATE, *p("stereo_algorithm:=0")], "stereo_algorithm has no effect: the matchers are those of --matcher"),
        (["doctor", "in.mcap", "--live"], "both BAG and --live are given: give a BAG, or --live"),
        (["doctor"], "neither BAG nor --live is given"),
        (["rectify", "l.png", "r.png", "-o", "out"], "neither --camera-info nor --uncalibrated is given"),
        ([*RECTIFY, "--uncalibrated", "--method", "opencv"], "--method opencv needs a calibration"),
        # options without effect
        ([*RECTIFY, "--rig", "left.yaml", "--alpha", "0.5"], "--alpha has no effect without --method: add --method"),
        ([*RECTIFY, "--uncalibrated", "--alpha", "0"], "--alpha has no effect without --method"),
        (["doctor", "in.mcap", "--seconds", "5"], "--seconds has no effect with a bag: leave it out"),
        (["doctor", "in.mcap", "--left-namespace", "a"], "--left-namespace has no effect with a bag"),
        (["doctor", "in.mcap", "--right-namespace", "right"], "--right-namespace has no effect with a bag"),
        (["doctor", "--live", "--left", "/a", "--left-namespace", "b"], "--left-namespace has no effect beside --left"),
        (["doctor", "--live", "--right", "/a", "--right-namespace", "b"], "has no effect beside --right, which is"),
        ([*REPLAY, "--realtime", "--in-flight", "2"], "--in-flight has no effect with --realtime"),
        (
            [*CALIBRATE, "--marker", "0.01"],
            "--marker has no effect with --board chessboard: leave it out, or add",
        ),
        ([*CALIBRATE, "--dictionary", "DICT_4X4_50"], "--dictionary has no effect with --board chessboard"),
        (
            [*CALIBRATE, "--board", "charuco", "--spacing", "0.3"],
            "--spacing has no effect with --board charuco",
        ),
        ([*CALIBRATE, "--board", "aprilgrid", "--marker", "0.01"], "--marker has no effect with --board aprilgrid"),
        ([*RIG, "--left", "/left"], "--left has no effect with camera files: leave it out, or give a bag"),
        (["rig", "left.yaml", "right.yaml", "--right", "/r"], "--right has no effect with camera files"),
        (
            [*MIDDLEBURY, "--focal-px", "5"],
            "--focal-px has no effect without --baseline-m",
        ),
        (
            [*MIDDLEBURY, "--baseline-m", "5"],
            "has no effect without --focal-px: give both",
        ),
        (
            [*MIDDLEBURY, *FOCAL, "--calibration", "c"],
            "--calibration has no effect beside",
        ),
        (
            [*MIDDLEBURY, "--calibration", "c", "--doffs", "1"],
            "--doffs has no effect besi",
        ),
        # parameters without effect
        (
            [*PROCESS, *BM, *p("sgm_P1:=20")],
            "sgm_P1 has no effect: the matcher is bm, which does not use it: ",
        ),
        ([*PROCESS, *p("P1:=100.0")], "or choose sgbm by --matcher"),
        ([*REPLAY, *p("onnx_model:=a")], "or choose onnx by --matcher"),
        ([*EVALUATE, "--matcher", "sgm", *p("iterations:=3")], "the matcher is bm and sgm, which does not use it"),
        (
            [*EVALUATE, *p("depth_encoding:=16UC1")],
            "a parameter of the depth image, which this command does not",
        ),
        ([*EVALUATE, *p("queue_size:=9")], "it is a parameter of the pairing"),
        (
            [*PROCESS, *p("health_rate:=1.0")],
            "it is a parameter of calibration_monitor, which this",
        ),
        ([*REPLAY, *p("health_rate:=1.0")], "add --health or --auto-correct"),
        ([*REPLAY, "--health", *p("correction_limit:=0.5")], "used only where auto_correct is true"),
        ([*REPLAY, "--health", *p("reference_yaw:=0.5")], "used only where correct_yaw is true"),
        ([*PROCESS, *p("board_size:=9x6")], "it is a parameter of calibration_node"),
        (
            [*PROCESS, *p("image_transport:=compressed")],
            "no effect: the bag holds one kind of images",
        ),
        ([*PROCESS, *BM, *p("prefilter_size:=7")], "prefilter_size has no effect: the Sobel prefilter has no window"),
        ([*PROCESS, *p("disparity_sigma_px:=0.5")], "no output contains the uncertainty"),
        ([*PROCESS, *p("approximate_sync_tolerance_seconds:=0.01")], "add --param approximate_sync:=true"),
        (
            [*PROCESS, "--matcher", "window", *p("window_cost:=ncc", "max_difference:=9")],
            "only where window_cost is sad",
        ),
        ([*RIG, *p("speckle_size:=9")], "it is a parameter of the matchers, which this command does not run"),
        # names of files for folders, and other suffixes
        (
            [*RECTIFY[:-1], "out.png", "--uncalibrated"],
            "--output out.png is the name of a file, a folder is",
        ),
        ([*CALIBRATE[:-1], "cal.yaml"], "--output cal.yaml is the name of a file"),
        ([*EVALUATE, "--plots", "a.PNG"], "--plots a.PNG is the name of a file"),
        ([*EVALUATE, "--csv", "-"], "--csv - names no file"),
        (["demo", "--output-dir", "a.mcap"], "--output-dir a.mcap is the name of a file"),
        ([*RIG, "--plot", "a.jpg"], "--plot a.jpg does not end in .png, plots are written as PNG: name it a.png"),
        ([*RIG, "--plot", "a.txt"], "--plot a.txt does not end in .png"),
        ([*RIG, "--plot", "plot"], "name it plot.png"),
    ],
)
def test_refused(
    command_line: CommandLine, files: Path, arguments: list[str], text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    before = sorted(files.iterdir())
    code, out, err = command_line()(*arguments)
    assert text in err
    assert (code, out) == (2, "")
    assert err.startswith("error: ") and err.count("\n") == 1
    assert sorted(files.iterdir()) == before


def test_what_has_an_effect_is_taken() -> None:
    assert given_parameters(["stereo_algorithm:=0"], "bm") == {"stereo_algorithm": 0}
    assert given_parameters(["speckle_size:=5", "speckle_size:=5"]) == {"speckle_size": 5}
    tolerance = "approximate_sync_tolerance_seconds:=0.01"
    assert given_parameters([tolerance, "approximate_sync:=true"])["approximate_sync"] is True
    assert [*given_parameters([tolerance], file={"approximate_sync": True})] == [tolerance.partition(":=")[0]]
    assert [*given_parameters(["P1:=1.0"], file={"stereo_algorithm": 1, "sgm_P1": 3})] == ["P1"]
    assert [*given_parameters(["iterations:=3"], ["bm", "diffusion"], stages=["matching"])] == ["iterations"]


@pytest.mark.parametrize("matcher", MATCHERS)
def test_every_parameter_of_a_matcher_is_taken_with_it_only(matcher: str) -> None:
    for info in parameter_infos(CONFIGS["matching"]):
        if info.name in ("stereo_algorithm", "prefilter_size", "max_difference"):
            continue
        text = f"{info.name}:={str(info.default).lower() or 'x'}"
        if info.name in MATCHERS[matcher].parameters:
            needed = ["sgm_cost:=onnx"] if matcher == "sgm" and info.name.startswith("onnx_") else []
            names = [info.name, *(each.partition(":=")[0] for each in needed), "stereo_algorithm"]
            assert [*given_parameters([text, *needed], matcher)] == names
        else:
            with pytest.raises(ConfigError, match="does not use it"):
                given_parameters([text], matcher)
