# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The health node in a live graph: what it tells of good and of turned cameras, and that its corrections help."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_harness import NS_PER_S, Graph, StereoCamera
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Float64MultiArray

from stereo_depth_ros.calibration.auto_correction import MIN_FRAMES
from stereo_depth_ros.calibration.row_error import match_rows
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8, Frame, StereoPair
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.nodes.calibration_monitor import CalibrationMonitor
from stereo_depth_ros.stages.rectification import Rectifier

pytestmark = pytest.mark.graph

EVERY = {"health_rate": 0.0}


class TurnedCamera:
    """A synthetic stereo camera whose right camera has turned since its calibration."""

    def __init__(self, w_deg: list[float]) -> None:
        self.camera = StereoCamera(frames=2, width=480, height=360)
        self.rig = self.camera.rig
        R, w = self.rig.right.R, np.radians(w_deg)
        turn = R.T @ cv2.Rodrigues(w)[0] @ R  # the raw camera's, of a turn of the rectified one
        self._raw = [(f.pair.left, self._turned(f.pair.right, turn)) for f in self.camera.frames]
        self.sent = 0

    def _turned(self, frame: Frame, turn: Any) -> Frame:
        """Undistorted, turned and distorted again."""
        side = self.rig.right
        maps = cv2.initUndistortRectifyMap(side.K, side.D, None, side.K, (side.width, side.height), cv2.CV_32FC1)
        straight = cv2.remap(frame.pixels, *maps, cv2.INTER_CUBIC)
        y, x = np.mgrid[: side.height, : side.width].astype(np.float64)
        raw = np.column_stack((x.ravel(), y.ravel()))[:, None]
        rays = cv2.undistortPoints(raw, side.K, side.D)[:, 0]
        before = np.column_stack((rays, np.ones(len(rays)))) @ turn @ side.K.T
        at = (before[:, :2] / before[:, 2:]).reshape(side.height, side.width, 2).astype(np.float32)
        return replace(frame, pixels=np.asarray(cv2.remap(straight, at, None, cv2.INTER_CUBIC), np.uint8))

    def rectified(self, rig: StereoRig) -> tuple[U8, U8]:
        """The next pair as a node would rectify it that has been given this rig."""
        left, right = self._raw[self.sent % len(self._raw)]
        pair = Rectifier(rig).rectify(StereoPair(left, right))
        return pair.left, pair.right

    def messages(self, rig: StereoRig) -> dict[str, Any]:
        """The camera infos as calibrated, and the next pair."""
        self.sent += 1
        stamp_ns = self.sent * NS_PER_S // 10
        found = self.camera.infos(stamp_ns)
        for side, pixels in zip(("left", "right"), self.rectified(rig), strict=True):
            frame_id = f"{side}_camera_optical_frame"
            found[f"{side}/image_rect"] = image_message(self.camera.types, pixels, "mono8", stamp_ns, frame_id)
        return found


@pytest.fixture(scope="module")
def straight() -> TurnedCamera:
    return TurnedCamera([0, 0, 0])


@pytest.fixture(scope="module")
def pitched() -> TurnedCamera:
    return TurnedCamera([0.5, 0, 0])


def send(graph: Graph, camera: TurnedCamera, pairs: int, rig: StereoRig | None = None) -> list[dict[str, float]]:
    """Sends pairs one by one; the figures that come back."""
    received = graph.listen("health/row_error", Float64MultiArray)
    for number in range(pairs):
        graph.send(camera.messages(rig or camera.rig))
        graph.wait(lambda count=number: len(received) > count, f"health/row_error of pair {number}")
    graph.stop_listening("health/row_error")
    return [dict(zip(m.layout.dim[0].label.split(","), m.data, strict=True)) for m in received]


def test_good_rows(straight: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY) as graph:
        figures = send(graph, straight, 4)
        assert figures[0]["row_median_px"] < 0.3
        assert figures[0]["matches"] > 60
        assert math.isnan(figures[0]["pitch_deg"])  # of three pairs something is said
        assert abs(figures[-1]["pitch_deg"]) < 0.05
        assert figures[-1]["pitch_sigma_deg"] > 0
        status = graph.status()
        assert (status.level, status.message) == (DiagnosticStatus.OK, "ok")
        values = {item.key: item.value for item in status.values}
        assert float(values["row error median px"]) < 0.3
        assert "+-" in values["pitch deg"] and "+-" in values["scale"]
        assert not graph.errors(".")


def test_a_turned_camera_is_told(pitched: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY) as graph:
        figures = send(graph, pitched, 4)
        assert figures[-1]["pitch_deg"] == pytest.approx(0.5, abs=0.03)
        shift_px = -pitched.rig.fy_px * math.tan(math.radians(0.5))
        assert figures[-1]["vertical_shift_px"] == pytest.approx(shift_px, abs=0.3)
        status = graph.status()
        assert status.level == DiagnosticStatus.WARN
        assert "the right camera has moved: pitch +0." in status.message
        assert "median row error" in status.message and "limit 1 px" in status.message
        assert graph.publishers("right/camera_info_corrected") == []


def test_it_watches_without_listeners(straight: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY) as graph:
        graph.send(straight.messages(straight.rig))
        graph.wait(lambda: graph.counter("paired") == 1, "a pair")


def test_pairs_are_looked_at_as_often_as_asked(straight: TurnedCamera) -> None:
    """Pairs are 0.1 s apart: of three, the first and the last are 0.2 s apart."""
    with Graph(CalibrationMonitor, parameters={"health_rate": 5.0}) as graph:
        received = graph.listen("health/row_error", Float64MultiArray)
        for number in range(3):
            graph.send(straight.messages(straight.rig))
            graph.wait(lambda count=number: graph.counter("paired") == count + 1, f"pair {number}")
        graph.wait(lambda: len(received) == 2, "two looks")


def test_corrections_bring_the_rows_together(pitched: TurnedCamera) -> None:
    """What is published is rectified with, pair after pair, and is told in the log and to late subscribers."""
    with Graph(CalibrationMonitor, parameters={**EVERY, "auto_correct": True}) as graph:
        infos = graph.listen("right/camera_info_corrected", CameraInfo)
        rig = pitched.rig
        for number in range(14):
            sent = pitched.messages(rig)
            graph.send(sent)
            graph.wait(lambda count=number: len(infos) == count + 1, f"corrected camera info {number}")
            rig = replace(rig, right=camera_from_info(infos[-1], "right"))
        words = "right camera corrected by pitch +0."
        graph.wait(lambda: any(words in log.msg for log in graph.logs), "word in the log")
        np.testing.assert_array_equal(infos[0].k, pitched.rig.right.K.ravel())
        np.testing.assert_array_equal(infos[-1].p, pitched.rig.right.P.ravel())
        assert infos[-1].header.stamp == sent["right/camera_info"].header.stamp
        before, after = (match_rows(*pitched.rectified(each)).median_px for each in (pitched.rig, rig))
        assert before > 1
        assert after < 0.3
        late: list[DiagnosticArray] = []
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        graph._node.create_subscription(DiagnosticArray, "health/correction", late.append, qos)
        graph.wait(lambda: late, "health/correction for a late subscriber")
        (status,) = late[0].status
        values = {item.key: item.value for item in status.values}
        assert float(values["pitch_deg"]) == pytest.approx(0.5, abs=0.05)
        assert status.level == DiagnosticStatus.WARN
        assert int(values["steps"]) >= 1


def of_sensor(info: CameraInfo) -> CameraInfo:
    """The same camera as a region of a larger sensor, binned by 2 and by 3."""
    to_sensor = np.array([[2.0, 0, 64], [0, 3, 37], [0, 0, 1]])
    info.k, info.p = ((to_sensor @ np.reshape(m, (3, -1))).ravel() for m in (info.k, info.p))
    info.binning_x, info.binning_y = 2, 3
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 64, 37, 2 * info.width, 3 * info.height
    info.width, info.height = 2 * info.width + 100, 3 * info.height + 50
    return info


def test_corrections_are_of_the_sensor(pitched: TurnedCamera) -> None:
    """Who takes region and binning into account gets the corrected camera; R and K change, and nothing else."""
    with Graph(CalibrationMonitor, parameters={**EVERY, "auto_correct": True}) as graph:
        infos = graph.listen("right/camera_info_corrected", CameraInfo)
        looks = graph.listen("health/row_error", Float64MultiArray)
        corrections = graph.listen("health/correction", DiagnosticArray)
        rig = pitched.rig
        for number in range(14):
            sent = pitched.messages(rig)
            info = of_sensor(sent["right/camera_info"])
            graph.send(sent)
            graph.wait(lambda count=number: len(infos) == len(looks) == count + 1, f"camera info and look {number}")
            if number + 1 < MIN_FRAMES:
                assert infos[-1] == info
            np.testing.assert_allclose(infos[-1].k, info.k, rtol=0.01)
            rig = replace(rig, right=camera_from_info(infos[-1], "right"))
        graph.send({"right/camera_info": info})
        graph.wait(lambda: len(infos) == 15, "camera info after all corrections")
        values = applied(corrections)
        assert float(values["pitch_deg"]) == pytest.approx(0.5, abs=0.05)
        calibrated, corrected = pitched.rig.right, camera_from_info(infos[-1])
        turn = cv2.Rodrigues(np.radians([float(values[f"{axis}_deg"]) for axis in ("pitch", "yaw", "roll")]))[0]
        growth = np.array([[1 + float(values["scale"])], [1 + float(values["scale"])], [1]])
        # As many digits as are told
        np.testing.assert_allclose(corrected.R, turn.T @ calibrated.R, atol=3e-7)
        np.testing.assert_allclose(
            corrected.K, np.where(np.identity(3), growth * calibrated.K, calibrated.K), atol=5e-4
        )
        assert match_rows(*pitched.rectified(replace(pitched.rig, right=corrected))).median_px < 0.3
        infos[-1].k, infos[-1].r = info.k, info.r
        assert infos[-1] == info


def applied(corrections: list[DiagnosticArray]) -> dict[str, str]:
    """The figures of the newest correction."""
    return {item.key: item.value for item in corrections[-1].status[0].values}


def test_corrections_that_nobody_takes_are_told(pitched: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters={**EVERY, "auto_correct": True}) as graph:
        send(graph, pitched, 1)
        assert "nobody subscribes to /right/camera_info_corrected: remap" in graph.status().message


def test_corrections_have_a_limit(pitched: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters={**EVERY, "auto_correct": True, "correction_limit": 0.2}) as graph:
        infos = graph.listen("right/camera_info_corrected", CameraInfo)
        send(graph, pitched, 7)
        graph.wait(lambda: len(infos) == 7, "camera infos")
        np.testing.assert_array_equal(infos[-1].r, pitched.rig.right.R.ravel())
        assert "not corrected: the right camera has rotated by 0.5" in graph.status().message


def test_pictures_without_features(straight: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY) as graph:
        messages = straight.messages(straight.rig)
        for side in ("left", "right"):
            messages[f"{side}/image_rect"].data = bytes(len(messages[f"{side}/image_rect"].data))
        graph.send(messages)
        graph.wait(lambda: graph.counter("pairs with too few features") == 1, "a pair that shows nothing")
        assert graph.status().level == DiagnosticStatus.OK


def test_equal_topics_are_refused() -> None:
    with pytest.raises(TopicError, match="remap them to different topics"):
        Graph(CalibrationMonitor, remaps={"left/image_rect": "/same", "right/image_rect": "/same"})
