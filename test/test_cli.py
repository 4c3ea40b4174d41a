# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Command line: output, files, exit codes."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from ros_domain import own_number
from stereo_bags import PARAMETERS, messages_of, write_odd_bag, write_truth_bag

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.replay import graph_processes as graph_runner

PARAM_ARGUMENTS = [text for name, value in PARAMETERS.items() for text in ("--param", f"{name}:={value}")]


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line()


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cli") / "in.mcap"
    write_truth_bag(path, 2)
    importlib.import_module("stereo_depth_ros.cli.process")
    for matcher in ("sgm", "bm"):
        create_matcher(matcher)
    compile_kernels(lambda *_: None)  # which commands report on stderr otherwise
    return path


def test_process_writes_the_bag_and_the_same_figures_as_table_and_json(run: Run, bag: Path, tmp_path: Path) -> None:
    output, report = tmp_path / "out.mcap", tmp_path / "report.json"
    code, out, err = run("process", bag, "-o", output, *PARAM_ARGUMENTS, "--json", report)
    assert (code, err) == (0, "")
    assert len(messages_of(output, "/disparity")) == 2
    values = json.loads(report.read_text())
    assert values["pairs"] == 2
    assert f"{100 * values['score']['valid_fraction']:.1f} %" in out
    assert f"median {values['score']['median_px']:.3f} px" in out


def test_process_takes_matcher_and_parameter_file(run: Run, bag: Path, tmp_path: Path) -> None:
    params = tmp_path / "p.yaml"
    params.write_text("/**:\n  ros__parameters: {disparity_range: 96, speckle_size: 20}\n")
    output = tmp_path / "out.mcap"
    arguments = ("--matcher", "sgbm", "--params-file", params, "--param", "disparity_range:=48", "--duration", "0.05")
    code, out, _ = run("process", bag, "-o", output, *arguments, "--json", "-")
    assert code == 0
    assert json.loads(out)["pairs"] == 1
    with BagReader(output) as reader:
        message = reader.deserialize(next(reader.messages(["/disparity"])))
    assert message.max_disparity - message.min_disparity == pytest.approx(47, abs=1e-4), "--param wins over the file"


def test_process_takes_its_sections_of_the_file_of_a_robot(run: Run, bag: Path, tmp_path: Path) -> None:
    params, output = tmp_path / "robot.yaml", tmp_path / "out.mcap"
    driver = "driver:\n  ros__parameters: {exposure: 5}\n"
    params.write_text(
        f"{driver}/**:\n  ros__parameters: {{interpolation: 1}}\n"
        "disparity_node:\n  ros__parameters: {disparity_range: 48}\n"
        "front:\n  depth_node:\n    ros__parameters: {a: 1}\n"
    )
    code, _, err = run("process", bag, "-o", output, "--params-file", params, "--duration", "0.05")
    assert (code, err.count("\n")) == (0, 1)
    assert "robot.yaml: parameters without effect: interpolation (rectification is bilinear)" in err
    with BagReader(output) as reader:
        message = reader.deserialize(next(reader.messages(["/disparity"])))
    assert message.max_disparity - message.min_disparity == pytest.approx(47, abs=1e-4)
    params.write_text(driver)
    code, _, err = run("process", bag, "-o", output, "--params-file", params, "--duration", "0.05", "--overwrite")
    assert code == 0
    assert (
        "robot.yaml: nothing for rectify_node, disparity_node, point_cloud_node, depth_node, stereo_depth_node" in err
    )


def test_process_of_pairs_that_are_all_refused_is_one_line(run: Run, bag: Path, tmp_path: Path) -> None:
    code, out, err = run(
        "process", bag, "-o", tmp_path / "o.mcap", "--matcher", "bm", "--param", "disparity_range:=256"
    )
    assert (code, out) == (1, "")
    assert err.startswith("error: ") and err.count("\n") == 1
    assert "no pair could be processed" in err


def test_info_of_a_usable_bag(run: Run, bag: Path) -> None:
    code, out, err = run("info", bag)
    assert (code, err) == (0, "")
    assert "/left/image_raw" in out and "200x150 mono8" in out
    assert out.splitlines()[-1].split() == ["usable", "for", "stereo", "depth", "yes"]
    values = json.loads(run("info", bag, "--json", "-")[1])
    assert values["usable"] is True
    assert values["stereo"]["left_image"] == "/left/image_raw"
    assert values["topics"]["/truth/disparity"]["count"] == 2


def test_info_of_a_bag_without_pairs_reports_the_problem(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "lonely.mcap"
    write_odd_bag(path, 2, without_right=(0, 1))
    code, out, err = run("info", path)
    assert code == 1
    assert out.splitlines()[-1].split() == ["usable", "for", "stereo", "depth", "no"]
    assert "problem: " in err


def test_known_errors_are_one_line_and_exit_code_1(run: Run, bag: Path, tmp_path: Path) -> None:
    code, out, err = run("info", tmp_path / "none.mcap")
    assert (code, out) == (1, "")
    assert err.startswith("error: ") and "none.mcap: does not exist" in err and err.count("\n") == 1
    assert "in.mcap: would overwrite an input: write to another file" in run("process", bag, "-o", bag)[2]
    assert "does not end in .mcap" in run("process", bag, "-o", tmp_path / "o.bag")[2]
    assert "did you mean 'speckle_size'" in run("process", bag, "-o", tmp_path / "o.mcap", "-p", "speckle_siz:=3")[2]
    assert "p.json: cannot be written: folder " in run("parameters", "--json", tmp_path / "none" / "p.json")[2]


def test_wrong_usage_is_exit_code_2(run: Run, bag: Path) -> None:
    assert run("process", bag)[0] == 2
    assert run("replay", bag, "-o", "x.mcap", "--loop", "0")[0] == 2
    assert run("convert", "nothing")[0] == 2


def test_replay_without_ros_names_the_remedy(
    run: Run, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(graph_runner.importlib.util, "find_spec", lambda name: None)
    code, _, err = run("replay", bag, "-o", tmp_path / "o.mcap")
    assert code == 1
    assert "rclpy, sensor_msgs, stereo_msgs not found" in err
    assert "pip install 'stereo_depth_ros[ros]'" in err


def test_parameters_lists_every_one(run: Run) -> None:
    code, out, _ = run("parameters", "--json", "-")
    assert code == 0
    names = {item["name"] for item in json.loads(out)}
    assert {"disparity_range", "approximate_sync", "use_color", "depth_encoding"} <= names
    assert "disparity_range" in run("parameters")[1]


def test_brackets_in_names_are_printed(run: Run, bag: Path, tmp_path: Path) -> None:
    """They are not markup of rich."""
    code, _, err = run("synthesize", tmp_path / "[red]a.mcap", "--frames", "1", "--width", "64", "--height", "48")
    assert code == 0 and "[red]a.mcap" in err
    code, out, err = run("process", bag, "-o", tmp_path / "[b].mcap", *PARAM_ARGUMENTS)
    assert code == 0, err
    assert "[b].mcap" in out.replace("\n", "")


def test_synthesize_and_convert_write_bags(run: Run, tmp_path: Path) -> None:
    made = tmp_path / "room.mcap"
    code, _, err = run("synthesize", made, "--frames", "1", "--width", "64", "--height", "48")
    assert code == 0 and "1 pairs written" in err
    assert len(messages_of(made, "/truth/disparity")) == 1
    code, _, err = run("synthesize", made, "--frames", "1", "--width", "64", "--height", "48")
    assert code == 1 and "room.mcap: already exists" in err
    code, _, err = run("convert", "kitti", tmp_path, tmp_path / "k.mcap")
    assert code == 1 and "is not a KITTI folder" in err


@pytest.mark.real_data
def test_convert_euroc_makes_a_bag_that_info_finds_usable(run: Run, stereo_data: Path, tmp_path: Path) -> None:
    bag = tmp_path / "v1.mcap"
    code, _, err = run("convert", "euroc", stereo_data / "euroc" / "V1_01_micro", bag)
    assert code == 0, err
    code, out, _ = run("info", bag)
    assert code == 0
    assert "24 with equal stamps" in out and "baseline 110.1 mm" in out


def test_convert_images_reports_skipped_images(run: Run, tmp_path: Path) -> None:
    rig = StereoRig.from_rectified(50.5, 51.5, 20.25, 23.5, 14.0, 0.2, (44, 30))
    for side, camera, numbers in (("left", rig.left, (1, 2, 3)), ("right", rig.right, (2, 3, 4))):
        write_camera(tmp_path / f"{side}.yaml", camera, side)
        for number in numbers:
            cv2.imwrite(str(tmp_path / f"{side}{number}.png"), np.zeros((30, 44), np.uint8))
    code, _, err = run("convert", "images", tmp_path, tmp_path / "i.mcap")
    text = " ".join(err.split())
    assert code == 0
    assert "2 pairs written" in text and "2 images skipped" in text
    assert "left1.png: skipped, it has no right image" in text and "right4.png: skipped, it has no left image" in text


@pytest.mark.parametrize("command", ["info", "replay", "process", "demo", "parameters", "synthesize", "convert kitti"])
def test_help_of_every_command_has_an_example(run: Run, command: str) -> None:
    code, out, _ = run(*command.split(), "--help")
    assert code == 0
    assert f"stereo-depth {command}" in out.split("Options:")[0].split("\n", 1)[1]


@pytest.mark.graph
def test_demo_plays_the_sample_bag_and_names_bag_and_image(
    run: Run, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(20 + 5 * own_number(10) + 4))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr("stereo_depth_ros.cli.demo._sample_bag", lambda: bag)
    code, out, err = run("demo", "--output-dir", tmp_path / "out")
    assert code == 0, err
    assert len(messages_of(tmp_path / "out" / "demo.mcap", "/points2")) == 2
    image = cv2.imread(str(tmp_path / "out" / "demo.png"))
    assert image.shape[1] > 2 * 600
    for text in (
        "pairs read",
        "valid pixels",
        "error against truth",
        "pairs per second",
        "p95 ms",
        ": match",
        "demo.png",
    ):
        assert text in out
