# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration files in place of camera infos: every command, the nodes, URLs, and `convert calibration`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import camera_file_texts as texts
import numpy as np
import pytest
from camera_file_texts import truth
from command_line import CommandLine
from stereo_bags import PARAMETERS, sequence, write_truth_bag

from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.camera_files.urls import camera_info_paths
from stereo_depth_ros.cli.camera_info import _expanded
from stereo_depth_ros.config import CameraInfoConfig, PairingConfig, PipelineConfig
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.datasets.rig_files import read_rig
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.offline.pairs import read_pairs

RIG = sequence(1).rig
SETTINGS = [item for name, value in PARAMETERS.items() for item in ("--param", f"{name}:={value}")]


def bare(bag: Path, target: Path) -> Path:
    """The bag without its camera infos."""
    with BagReader(bag) as reader, BagWriter(target) as writer:
        for message in reader.messages():
            if not message.topic.endswith("camera_info"):
                writer.write_raw(message.topic, message.msgtype, message.data, message.log_time_ns)
    return target


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with camera infos, one without, and the files of the same calibration."""
    folder = tmp_path_factory.mktemp("files")
    write_truth_bag(folder / "infos.mcap", 1)
    bare(folder / "infos.mcap", folder / "bare.mcap")
    write_camera(folder / "left.yaml", RIG.left, "left")
    write_camera(folder / "right.yaml", RIG.right, "right")
    return folder


def messages(bag: Path) -> dict[str, bytes]:
    with BagReader(bag) as reader:
        return {message.topic: message.data for message in reader.messages()}


def test_process_gives_the_outputs_of_the_camera_infos(folder: Path, tmp_path: Path, command_line: CommandLine) -> None:
    process, given = command_line("process"), ("--camera-info", folder / "left.yaml", folder / "right.yaml")
    assert process(folder / "infos.mcap", "-o", tmp_path / "infos.mcap", *SETTINGS)[0] == 0
    assert process(folder / "bare.mcap", "-o", tmp_path / "bare.mcap", *given, *SETTINGS)[0] == 0
    expected = messages(tmp_path / "infos.mcap")
    assert messages(tmp_path / "bare.mcap") == expected and "/left/camera_info" in expected
    code, _, text = process(folder / "bare.mcap", "-o", tmp_path / "left.mcap", *SETTINGS)
    assert code == 1 and "give calibration files (--camera-info)" in text
    code, _, text = process(folder / "bare.mcap", "-o", folder / "bare.mcap", *given, "--overwrite")
    assert code == 1 and "bare.mcap" in text


def test_files_replace_the_camera_infos_of_a_bag(folder: Path, tmp_path: Path) -> None:
    files = [folder / "left.yaml", tmp_path / "right.yaml"]
    twice = RIG.right.P.copy()
    twice[0, 3] *= 2
    write_camera(files[1], replace(RIG.right, P=twice), "right")
    (_, rig), *_ = read_pairs(folder / "infos.mcap", camera_files=files)
    assert rig.baseline_m == pytest.approx(2 * RIG.baseline_m)
    assert (rig.topics, rig.frame_id) == ((str(files[0]), str(files[1])), RIG.frame_id)
    info = inspect_bag(folder / "infos.mcap", camera_files=files)
    assert info.rig is not None and info.rig.baseline_m == rig.baseline_m
    setup = survey_bag(BagSelection(folder / "infos.mcap", camera_files=tuple(files)))
    assert [camera.infos[0].p[3] for camera in (setup.left, setup.right)] == [0, twice[0, 3]]
    assert len(setup.right.infos) == 1


def test_one_file_for_both_cameras_and_the_size_of_the_images(folder: Path, tmp_path: Path) -> None:
    """Intrinsics and extrinsics of OpenCV have no size: that of the images counts."""
    true = truth("plumb_bob 5")
    entries = {**texts.opencv_intrinsics(true), **texts.opencv_extrinsics(true, rectified=False)}
    path = tmp_path / "stereo.yml"
    path.write_text(texts.opencv_yaml(entries))
    with BagPairs(BagSelection(folder / "bare.mcap", camera_files=(path,)), PairingConfig()) as pairs:
        (pair,) = pairs.pairs()
        assert pairs.topics.left_info == f"{path}: M1"
    info = inspect_bag(folder / "bare.mcap", camera_files=[path])
    assert info.usable and info.rig is not None and (info.rig.width, info.rig.height) == (200, 150)
    assert pair.info_topics == info.rig.topics
    (tmp_path / "camchain.yaml").write_text(texts.camchain(true, "radtan"))
    info = inspect_bag(folder / "bare.mcap", camera_files=[tmp_path / "camchain.yaml"])
    assert [str(problem) for problem in info.problems] == [
        "/left/image_raw: the image is 200x150, its camera info is for 640x400: calibrate at this resolution, or set "
        "binning and roi of the camera info"
    ]


@pytest.mark.parametrize("command", ["info", "doctor", "evaluate"])
def test_other_commands(folder: Path, command_line: CommandLine, command: str) -> None:
    more = ("--matcher", "bm", *SETTINGS) if command == "evaluate" else ()
    run, bag = command_line(command), folder / "bare.mcap"
    code, out, _ = run("--camera-info", folder / "left.yaml", folder / "right.yaml", bag, *more, "--json", "-")
    found = json.loads(out)
    assert code in (0, 3)
    if command == "info":
        assert found["rig"]["baseline_m"] == pytest.approx(RIG.baseline_m)
    code, _, text = run(bag, *more)
    assert code == 1
    code, _, text = run(bag, "--camera-info", folder / "none.yaml", *more)
    assert (code, text.count("\n")) == (1, 1) and text.startswith(f"error: {folder / 'none.yaml'}: does not exist: ")


def test_options_that_contradict_each_other(folder: Path, tmp_path: Path, command_line: CommandLine) -> None:
    code, _, text = command_line("doctor")("--live", "--camera-info", folder / "left.yaml")
    assert code == 2 and "--camera-info has no effect with --live: set the parameters of the nodes" in text
    (tmp_path / "scene").mkdir()
    evaluate = command_line("evaluate")
    code, _, text = evaluate(tmp_path / "scene", "--matcher", "bm", "--camera-info", folder / "left.yaml")
    assert code == 2 and "--camera-info has no effect with a folder" in text
    given = ("--camera-info", folder / "left.yaml", "--param", "left_camera_info_url:=x.yaml")
    code, _, text = command_line("process")(folder / "bare.mcap", "-o", tmp_path / "o.mcap", *given)
    assert code == 2 and "--camera-info and --param left_camera_info_url contradict each other" in text


@pytest.mark.parametrize(
    ("given", "parsed"),
    [
        ("--camera-info l.yaml r.yaml bag", "--camera-info l.yaml --camera-info r.yaml bag"),
        ("bag --camera-info l.yml r.YML -o x", "bag --camera-info l.yml --camera-info r.YML -o x"),
        ("--camera-info=l.txt r.txt", "--camera-info=l.txt --camera-info r.txt"),
        ("--camera-info l.yaml --camera-info r.yaml", "--camera-info l.yaml --camera-info r.yaml"),
        ("--camera-info both.json bag.mcap", "--camera-info both.json bag.mcap"),
        ("--rig a.yaml b.yaml c.yaml", "--rig a.yaml --rig b.yaml c.yaml"),
        ("--params-file a.yaml b.yaml", "--params-file a.yaml b.yaml"),
        ("--camera-info", "--camera-info"),
    ],
)
def test_the_second_file_follows_the_first(given: str, parsed: str) -> None:
    assert _expanded(given.split()) == parsed.split()


def test_convert_calibration(tmp_path: Path, command_line: CommandLine) -> None:
    true, convert = truth("equidistant"), command_line("convert", "calibration")
    (tmp_path / "camchain.yaml").write_text(texts.camchain(true, "equi"))
    code, _, text = convert(tmp_path / "camchain.yaml", "-o", tmp_path / "out")
    assert code == 0 and "equidistant, 640x400, baseline 0.120307 m of" in text
    rig, expected = read_rig([tmp_path / "out"]), read_rig([tmp_path / "camchain.yaml"])
    for camera, other in ((rig.left, expected.left), (rig.right, expected.right)):
        for name in ("K", "D", "R", "P"):
            np.testing.assert_array_equal(getattr(camera, name), getattr(other, name))
    code, _, text = convert(tmp_path / "camchain.yaml", "-o", tmp_path / "out")
    assert code == 1 and "already exists" in text
    assert convert(tmp_path / "camchain.yaml", "-o", tmp_path / "out", "--overwrite")[0] == 0
    code, _, text = convert(tmp_path / "out" / "left.yaml", "-o", tmp_path / "out", "--overwrite")
    assert code == 1 and "left.yaml" in text
    true = truth("plumb_bob 5")
    entries = {**texts.opencv_intrinsics(true), **texts.opencv_extrinsics(true, rectified=True)}
    (tmp_path / "stereo.yml").write_text(texts.opencv_yaml(entries))
    code, _, text = convert(tmp_path / "stereo.yml", "-o", tmp_path / "sized")
    assert code == 1 and "does not state the size of the images" in text and "(--size)" in text
    assert convert(tmp_path / "stereo.yml", "-o", tmp_path / "sized", "--size", "640x400")[0] == 0
    assert read_rig([tmp_path / "sized"]).width == 640
    for size, status, match in (("640", 2, "size '640' is not a width and"), ("320x200", 1, "the image is 320x200")):
        code, _, text = convert(tmp_path / "camchain.yaml", "-o", tmp_path / "no", "--size", size)
        assert code == status and match in text


def test_urls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    index = tmp_path / "install" / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "my_robot").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'install'}")
    monkeypatch.setenv("ROS_HOME", "/ros")
    for url, path in (
        ("file:///a/b.yaml", "/a/b.yaml"),
        ("FILE:///a/${NAME}.yaml", "/a/left.yaml"),
        ("package://my_robot/config/l.yaml", f"{tmp_path}/install/share/my_robot/config/l.yaml"),
        ("file://${ROS_HOME}/camera_info/${NAME}.yaml", "/ros/camera_info/left.yaml"),
        ("c/l.yaml", "c/l.yaml"),
    ):
        assert camera_info_paths(url, "") == (Path(path),)
    assert camera_info_paths("", "") == ()
    assert camera_info_paths("${NAME}.yaml", "${NAME}.yaml") == (Path("left.yaml"), Path("right.yaml"))
    monkeypatch.delenv("ROS_HOME")
    assert camera_info_paths("${ROS_HOME}/x.yaml", "") == (Path.home() / ".ros" / "x.yaml",)
    for urls, match in (
        (("", "r.yaml"), "right_camera_info_url is set and left_camera_info_url is not"),
        (("flash:///x", ""), "'flash:///x' is not a URL of a file"),
        (("http://x/y.yaml", ""), "is not a URL of a file"),
        (("file://x.yaml", ""), "is not a URL of a file"),
        (("${HOME}/x.yaml", ""), "is not a URL of a file"),
        (("package://other/x.yaml", ""), "there is no package 'other' in AMENT_PREFIX_PATH"),
        (("package://my_robot", ""), "lacks the package or the path"),
    ):
        with pytest.raises(ConfigError, match=match) as caught:
            camera_info_paths(*urls)
        assert caught.value.settings and caught.value.remedy


@pytest.mark.graph
def test_a_node_reads_files_and_subscribes_to_no_camera_infos(folder: Path) -> None:
    pytest.importorskip("rclpy", reason="the nodes need ROS 2")
    from graph_harness import Graph, image_pixels
    from sensor_msgs.msg import Image

    from stereo_depth_ros.messages.image import image_message
    from stereo_depth_ros.nodes.calibration_monitor import CalibrationMonitor
    from stereo_depth_ros.nodes.message_types import RclpyTypes
    from stereo_depth_ros.nodes.rectify_node import RectifyNode
    from stereo_depth_ros.stages.rectification import Rectifier

    frame = next(iter(sequence(1))).pair.left
    parameters = {
        "left_camera_info_url": f"file://{folder}/${{NAME}}.yaml",
        "right_camera_info_url": str(folder / "right.yaml"),
    }
    with Graph(RectifyNode, parameters=parameters) as graph:
        received = graph.listen("left/image_rect", Image)
        for stamp_ns in (5, 6):
            graph.send({"left/image_raw": image_message(RclpyTypes(), frame.pixels, "mono8", stamp_ns, "a_frame")})
        graph.wait(lambda: len(received) == 2, "rectified images without camera infos")
        (node,) = graph.nodes
        assert not node.get_subscriptions_info_by_topic("/left/camera_info")
        assert f"calibration of {folder}/left.yaml and {folder}/right.yaml" in node.readiness()[0]
        expected = Rectifier(RIG).rectify_left(frame.pixels)
        np.testing.assert_array_equal(image_pixels(received[0]), expected)
        assert received[0].header.frame_id == "a_frame"
    with pytest.raises(ConfigError, match="auto_correct corrects camera infos of topics, not those of the file"):
        Graph(CalibrationMonitor, parameters={**parameters, "auto_correct": True})
    with pytest.raises(CalibrationError, match=r"none\.yaml: does not exist") as caught:
        Graph(RectifyNode, parameters={"left_camera_info_url": "none.yaml"})
    assert caught.value.settings == ("left_camera_info_url", "right_camera_info_url")


@pytest.mark.graph
def test_the_replay_publishes_the_camera_infos_of_files(folder: Path) -> None:
    pytest.importorskip("rclpy", reason="the nodes need ROS 2")
    from stereo_depth_ros.nodes.replay_node import selected
    from stereo_depth_ros.replay.options import ReplayOptions

    config = PipelineConfig(camera_info=CameraInfoConfig(left_camera_info_url=str(folder)))
    selection = selected(ReplayOptions(bag=str(folder / "bare.mcap")), config)
    with BagPairs(selection, config.pairing) as pairs:
        rig = next(pairs.pairs()).rig(RosbagsTypes())
    assert isinstance(rig, StereoRig) and rig.baseline_m == RIG.baseline_m and rig.frame_id == RIG.frame_id
