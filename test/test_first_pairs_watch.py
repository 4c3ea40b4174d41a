# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes whose images do not fit the camera infos: one warning in the log, WARN in /diagnostics, and still depth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from graph_harness import NS_PER_S, Graph, StereoCamera
from sensor_msgs.msg import Image
from std_msgs.msg import Float64MultiArray
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.core.errors import CalibrationError, CameraOrderError
from stereo_depth_ros.nodes.disparity_node import DisparityNode
from stereo_depth_ros.nodes.first_pairs_watch import FIRST_PAIRS, ORDER
from stereo_depth_ros.nodes.replay_node import _check_rig
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode
from stereo_depth_ros.replay.options import ReplayOptions

pytestmark = pytest.mark.graph

SMALL = {"disparity_range": 32, "correlation_window_size": 9}
RAW_AS_RECTIFIED = {f"{side}/image_rect": f"{side}/image_raw" for side in ("left", "right")}
ROWS = "rows of left and right differ by"
Messages = dict[str, Any]


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera(frames=1, width=320, height=240)


def turn(messages: Messages) -> None:
    """The calibration of a rig whose right camera is pitched by a degree."""
    info = messages["right/camera_info"]
    sine, cosine = np.sin(np.radians(1.0)), np.cos(np.radians(1.0))
    R = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    info.r = (info.r.reshape(3, 3) @ R).ravel()


def one_camera(messages: Messages) -> None:
    messages["right/image_raw"].data = messages["left/image_raw"].data


def send(graph: Graph, camera: StereoCamera, *numbers: int, spoil: Callable[[Messages], None] | None = None) -> None:
    """Pairs of these numbers, each as soon as the one before has its disparities."""
    received = graph.listen("disparity", DisparityImage)
    for number in numbers:
        messages = camera.pair(number * NS_PER_S)
        if spoil is not None:
            spoil(messages)
        graph.send(messages)
        graph.wait(lambda: received, f"disparity of pair {number}")
        received.clear()


def warnings(graph: Graph, text: str) -> list[str]:
    return [log.msg for log in graph.logs if log.level == 30 and text in log.msg]


@pytest.mark.parametrize(
    ("node_type", "remaps", "spoil", "text"),
    [
        (DisparityNode, RAW_AS_RECTIFIED, None, ROWS),
        (StereoDepthNode, {}, turn, ROWS),
        (StereoDepthNode, {}, one_camera, "left and right image are identical: both topics show one camera"),
    ],
)
def test_what_does_not_fit_is_said_once(
    camera: StereoCamera, node_type: Any, remaps: Any, spoil: Any, text: str
) -> None:
    with Graph(node_type, parameters=SMALL, remaps=remaps) as graph:
        send(graph, camera, 1, 2, 3, 4, spoil=spoil)
        status = graph.status()
        assert status.level == DiagnosticStatus.WARN and text in status.message
        assert status.message == next(item.value for item in status.values if item.key == FIRST_PAIRS)
        graph.wait(lambda: warnings(graph, text), "warning")
        assert len(warnings(graph, text)) == 1


def test_other_camera_infos_are_examined_again(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        graph.listen("depth/image_rect", Image)  # the node stays awake
        send(graph, camera, 1, 2, 3)
        assert graph.status().level == DiagnosticStatus.OK
        send(graph, camera, 4, 5, spoil=turn)
        assert graph.status().level == DiagnosticStatus.WARN
        send(graph, camera, 6, 7)
        status = graph.status()
        assert (status.level, status.message) == (DiagnosticStatus.OK, "ok")
        assert FIRST_PAIRS not in {item.key for item in status.values}


def test_row_errors_are_left_to_a_calibration_monitor(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        graph.advertise("health/row_error", Float64MultiArray)
        graph.wait(lambda: graph.nodes[0].count_publishers("health/row_error"), "the monitor")
        send(graph, camera, 1, 2, 3, spoil=turn)
        status = graph.status()
        assert status.level == DiagnosticStatus.OK and not warnings(graph, ROWS)
        assert ROWS in next(item.value for item in status.values if item.key == FIRST_PAIRS)


class Ports:
    """The values that nodes have reported."""

    def __init__(self, **values: str) -> None:
        self._values = values

    def reported(self, name: str) -> str:
        return self._values.get(name, "")


def test_replay_refuses_what_the_nodes_report(tmp_path: Path) -> None:
    def check(strict: bool, **values: str) -> None:
        _check_rig(ReplayOptions("a.mcap", strict=strict), Ports(**values))  # type: ignore[arg-type]

    check(True)
    check(False, **{FIRST_PAIRS: "rows differ"})
    with pytest.raises(CalibrationError, match=r"^a\.mcap: rows differ$"):
        check(True, **{FIRST_PAIRS: "rows differ"})
    with pytest.raises(CameraOrderError, match=r"^a\.mcap: swapped$"):
        check(False, **{ORDER: "swapped"})


def test_the_refusal_of_swapped_cameras_is_reported_until_a_pair_passes(camera: StereoCamera) -> None:
    def reported(graph: Graph) -> str:
        return next((item.value for item in graph.status().values if item.key == ORDER), "")

    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        messages = camera.pair(NS_PER_S)
        left, right = messages["left/image_raw"], messages["right/image_raw"]
        left.data, right.data = right.data, left.data
        graph.send(messages)
        graph.wait_error("cameras look swapped")
        assert reported(graph).startswith("cameras look swapped") and not received
        send(graph, camera, 2)
        assert reported(graph) == ""
