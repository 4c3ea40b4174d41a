# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The calibration monitor beside a range sensor of a live graph: what it finds, and what it says is missing."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from graph_harness import NS_PER_S, Graph
from range_bags import FRAMES, LEFT, LEFT_LIDAR, sweep
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header
from stereo_bags import HEIGHT, WIDTH, sequence

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.messages.camera_info import camera_info_message, rectified_camera_info
from stereo_depth_ros.messages.disparity import disparity_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.point_cloud import valued_cloud_message
from stereo_depth_ros.nodes.calibration_monitor import CalibrationMonitor
from stereo_depth_ros.nodes.message_types import RclpyTypes

pytestmark = pytest.mark.graph

TYPES = RclpyTypes()
EVERY = {"health_rate": 0.0, "range_sensor": "/lidar/points"}


@functools.cache
def disparities(index: int) -> F32:
    frame = sequence(FRAMES)[index]
    noise = np.random.default_rng(index).normal(0, 0.1, (HEIGHT, WIDTH))
    return np.where(frame.occluded, np.nan, frame.truth_disparity_px + noise).astype(np.float32)


def messages(number: int, offset_px: float = 0.0, late_ns: int = 0) -> dict[str, Any]:
    """Camera infos, a sweep, and the disparities of the same time."""
    rig, index, stamp_ns = sequence(FRAMES).rig, number % FRAMES, (10 + number) * NS_PER_S
    found: dict[str, Any] = {
        f"{side}/camera_info": camera_info_message(TYPES, camera, stamp_ns)
        for side, camera in (("left", rig.left), ("right", rig.right))
    }
    found["/lidar/points"] = valued_cloud_message(
        TYPES, sweep(index).astype(np.float64), {}, stamp_ns=stamp_ns + late_ns, frame_id="lidar"
    )
    found["disparity"] = disparity_message(
        TYPES,
        disparities(index) + np.float32(offset_px),
        rig,
        min_disparity=0,
        max_disparity=63,
        step_px=1 / 16,
        stamp_ns=stamp_ns,
        frame_id=LEFT,
    )
    return found


def send(graph: Graph, pairs: int, offset_px: float = 0.0, late_ns: int = 0) -> None:
    for number in range(pairs):
        graph.send(messages(number, offset_px, late_ns))
        graph.wait(lambda count=number: graph.counter("sweeps") > count, f"sweep {number}")


def values(graph: Graph) -> dict[str, str]:
    return {item.key: item.value for item in graph.status().values}


def number(text: str) -> tuple[float, float]:
    """Value and standard deviation."""
    value, _, sigma = text.partition(" +- ")
    return float(value), float(sigma)


def write_pose(path: Path, pose: Pose) -> str:
    x, y, z, w = pose.quaternion
    a, b, c = pose.translation_m
    path.write_text(f"parent: {LEFT}\nchild: lidar\ntranslation: [{a}, {b}, {c}]\nquaternion: [{x}, {y}, {z}, {w}]\n")
    return str(path)


def test_a_good_rig_is_ok(tmp_path: Path) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY | pose_parameter(tmp_path, LEFT_LIDAR)) as graph:
        send(graph, 3)
        graph.wait(lambda: graph.counter("disparities compared") == 3, "three comparisons")
        status = graph.status()
        assert (status.level, status.message) == (DiagnosticStatus.OK, "ok")
        found = values(graph)
        assert found["range sensor"] == "/lidar/points sensor_msgs/msg/PointCloud2"
        for name in (
            "baseline scale %",
            "disparity offset px",
            "sensor pitch deg",
            "sensor yaw deg",
            "sensor roll deg",
        ):
            value, sigma = number(found[name])
            assert abs(value) <= 3 * sigma, (name, found[name])
        assert "agree in 3 pairs" in found["range points"]
        assert int(found["range points hidden to the camera"]) > 0
        assert not graph.errors(".")


def pose_parameter(folder: Path, pose: Pose) -> Mapping[str, str]:
    return {"range_sensor_extrinsics": write_pose(folder / "lidar.yaml", pose)}


def test_errors_of_offset_and_pose_are_warnings(tmp_path: Path) -> None:
    turn = Pose(np.asarray(cv2.Rodrigues(np.radians([0.0, 0.9, 0.0]))[0], np.float64), np.zeros(3))
    with Graph(CalibrationMonitor, parameters=EVERY | pose_parameter(tmp_path, turn @ LEFT_LIDAR)) as graph:
        send(graph, 3, offset_px=0.6)
        graph.wait(lambda: graph.counter("disparities compared") == 3, "three comparisons")
        status, found = graph.status(), values(graph)
        assert status.level == DiagnosticStatus.WARN
        offset, sigma = number(found["disparity offset px"])
        assert abs(offset - 0.6) <= 3 * sigma
        yaw, sigma = number(found["sensor yaw deg"])
        assert abs(yaw + 0.9) <= 3 * sigma
        assert "disparities are too large by +0." in status.message
        assert "limit 0.25 px" in status.message
        assert "calibrate them again" in status.message
        assert "the range sensor is turned against its transform: " in status.message
        assert "yaw -0." in status.message
        assert "limit 0.2 deg" in status.message


def test_a_missing_transform_names_both_frames_until_it_comes() -> None:
    with Graph(CalibrationMonitor, parameters=EVERY) as graph:
        send(graph, 3)
        graph.wait(lambda: graph.status().level == DiagnosticStatus.WARN, "a warning")
        assert f"no transform from 'lidar' to '{LEFT}', no transforms are known" in graph.status().message
        (x, y, z, w), (a, b, c) = map(float, LEFT_LIDAR.quaternion), map(float, LEFT_LIDAR.translation_m)
        transform = Transform(translation=Vector3(x=a, y=b, z=c), rotation=Quaternion(x=x, y=y, z=z, w=w))
        stamped = TransformStamped(header=Header(frame_id=LEFT), child_frame_id="lidar", transform=transform)
        graph.nodes[0]._range._sweeps.transforms.receive(SimpleNamespace(transforms=[stamped]), "/tf_static")
        send(graph, 4)
        graph.wait(lambda: graph.counter("disparities compared") > 0, "a comparison")
        assert graph.status().level == DiagnosticStatus.OK


def test_sweeps_of_another_time_are_counted_and_not_compared(tmp_path: Path) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY | pose_parameter(tmp_path, LEFT_LIDAR)) as graph:
        send(graph, 5, late_ns=NS_PER_S * 7)  # beyond the last image
        graph.wait(lambda: graph.counter("disparities without a sweep in time") >= 1, "one that is left out")
        assert graph.counter("disparities compared") == 0


def test_scans_and_depth_images_are_found_by_their_type(tmp_path: Path) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY | pose_parameter(tmp_path, LEFT_LIDAR)) as graph:
        scan = LaserScan(header=Header(frame_id="laser"), angle_increment=0.01, range_max=9.0, ranges=[2.0] * 40)
        graph.send({"/lidar/points": scan})
        graph.wait(lambda: graph.counter("sweeps") == 1, "a scan")
        assert values(graph)["range sensor"] == "/lidar/points sensor_msgs/msg/LaserScan"
    with Graph(CalibrationMonitor, parameters=EVERY) as graph:
        rig = sequence(FRAMES).rig
        depth = image_message(TYPES, sequence(FRAMES)[0].truth_depth_m, "32FC1", NS_PER_S, LEFT)
        info = rectified_camera_info(TYPES, rig.left, NS_PER_S)
        graph.advertise("/lidar/points", type(depth))
        graph.send({"/lidar/camera_info": info})
        graph.wait(lambda: graph.nodes[0]._range._sweeps.sensor._camera is not None, "the camera info")
        graph.send({"/lidar/points": depth})
        graph.wait(lambda: graph.counter("sweeps") == 1, "a depth image")


def test_other_topics_and_files_are_refused(tmp_path: Path) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY) as graph:
        graph.advertise("/lidar/points", Header)
        assert "/lidar/points: is std_msgs/msg/Header, not a range sensor" in graph.wait_error("not a range sensor")
    (tmp_path / "pose.yaml").write_text("translation: [1, 2, 3]\n")
    with (
        pytest.raises(CalibrationError, match="lacks the key 'quaternion'"),
        Graph(CalibrationMonitor, parameters=EVERY | {"range_sensor_extrinsics": str(tmp_path / "pose.yaml")}),
    ):
        pass
