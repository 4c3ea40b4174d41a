# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The calibration monitor in a live graph: good and turned cameras, corrections and their effect."""

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
        turn = R.T @ cv2.Rodrigues(w)[0] @ R  # of the raw camera, for a rotation of the rectified one
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
        """The next pair as a node with this rig rectifies it."""
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
    """Sends pairs one by one; the figures received."""
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
        assert math.isnan(figures[0]["pitch_deg"])  # estimated from the third pair on
        assert abs(figures[-1]["pitch_deg"]) < 0.05
        assert figures[-1]["pitch_sigma_deg"] > 0
        status = graph.status()
        assert (status.level, status.message) == (DiagnosticStatus.OK, "ok")
        values = {item.key: item.value for item in status.values}
        assert float(values["row error median px"]) < 0.3
        assert "+-" in values["pitch deg"] and "+-" in values["scale"]
        assert not graph.errors(".")


def test_a_turned_camera_is_reported(pitched: TurnedCamera) -> None:
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


def test_it_monitors_without_subscribers(straight: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY) as graph:
        graph.send(straight.messages(straight.rig))
        graph.wait(lambda: graph.counter("paired") == 1, "a pair")


def test_pairs_are_examined_at_the_given_rate(straight: TurnedCamera) -> None:
    """Pairs are 0.1 s apart: of three, the first and the last are 0.2 s apart."""
    with Graph(CalibrationMonitor, parameters={"health_rate": 5.0}) as graph:
        received = graph.listen("health/row_error", Float64MultiArray)
        for number in range(3):
            graph.send(straight.messages(straight.rig))
            graph.wait(lambda count=number: graph.counter("paired") == count + 1, f"pair {number}")
        graph.wait(lambda: len(received) == 2, "two pairs")


def test_corrections_align_the_rows(pitched: TurnedCamera) -> None:
    """The published camera info rectifies the next pair; the log and late subscribers receive the correction."""
    with Graph(CalibrationMonitor, parameters={**EVERY, "auto_correct": True}) as graph:
        infos = graph.listen("right/camera_info_corrected", CameraInfo)
        rig = pitched.rig
        for number in range(14):
            sent = pitched.messages(rig)
            graph.send(sent)
            graph.wait(lambda count=number: len(infos) == count + 1, f"corrected camera info {number}")
            rig = replace(rig, right=camera_from_info(infos[-1], "right"))
        text = "right camera corrected by pitch +0."
        graph.wait(lambda: any(text in log.msg for log in graph.logs), "correction in the log")
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
    """With region and binning it is the corrected camera; R and K change, and nothing else."""
    with Graph(CalibrationMonitor, parameters={**EVERY, "auto_correct": True}) as graph:
        infos = graph.listen("right/camera_info_corrected", CameraInfo)
        figures = graph.listen("health/row_error", Float64MultiArray)
        corrections = graph.listen("health/correction", DiagnosticArray)
        rig = pitched.rig
        for number in range(14):
            sent = pitched.messages(rig)
            info = of_sensor(sent["right/camera_info"])
            graph.send(sent)
            graph.wait(lambda count=number: len(infos) == len(figures) == count + 1, f"messages of pair {number}")
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
        # The digits of the message
        np.testing.assert_allclose(corrected.R, turn.T @ calibrated.R, atol=3e-7)
        np.testing.assert_allclose(
            corrected.K, np.where(np.identity(3), growth * calibrated.K, calibrated.K), atol=5e-4
        )
        assert match_rows(*pitched.rectified(replace(pitched.rig, right=corrected))).median_px < 0.3
        infos[-1].k, infos[-1].r = info.k, info.r
        assert infos[-1] == info


def calibrated_again(info: CameraInfo) -> CameraInfo:
    """A calibration of the same camera with another focal length and rotation."""
    info.k = info.k * np.array([1.01, 1, 1, 1, 1.01, 1, 1, 1, 1])
    info.r = (cv2.Rodrigues(np.array([0.0, 0.01, 0.0]))[0] @ info.r.reshape(3, 3)).ravel()
    return info


def shifted_roi(info: CameraInfo) -> CameraInfo:
    """A region of the same size on a larger sensor."""
    info.roi.width, info.roi.height, info.roi.x_offset = info.width, info.height, 8
    info.width += 16
    return info


def test_a_correction_ends_with_its_camera(pitched: TurnedCamera) -> None:
    """The camera info of another calibration, region or binning is published unchanged, before any pair of it."""
    with Graph(CalibrationMonitor, parameters={**EVERY, "auto_correct": True}) as graph:
        infos = graph.listen("right/camera_info_corrected", CameraInfo)
        for change in (calibrated_again, shifted_roi, of_sensor):
            infos.clear()
            for number in range(MIN_FRAMES + 1):
                sent = pitched.messages(pitched.rig)
                graph.send(sent)
                graph.wait(lambda count=number: len(infos) == count + 1, f"corrected camera info {number}")
            graph.send({"right/camera_info": sent["right/camera_info"]})
            graph.wait(lambda: len(infos) == MIN_FRAMES + 2, "camera info after a correction")
            assert infos[-1] != sent["right/camera_info"], "corrected"
            other = change(pitched.messages(pitched.rig)["right/camera_info"])
            graph.send({"right/camera_info": other})
            graph.wait(lambda: len(infos) == MIN_FRAMES + 3, "camera info of another camera")
            assert infos[-1] == other, change.__name__


def applied(corrections: list[DiagnosticArray]) -> dict[str, str]:
    """The figures of the newest correction."""
    return {item.key: item.value for item in corrections[-1].status[0].values}


def test_corrections_without_a_subscriber_are_reported(pitched: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters={**EVERY, "auto_correct": True}) as graph:
        send(graph, pitched, 1)
        assert "/right/camera_info_corrected has no subscriber: remap" in graph.status().message


def test_corrections_have_a_limit(pitched: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters={**EVERY, "auto_correct": True, "correction_limit": 0.2}) as graph:
        infos = graph.listen("right/camera_info_corrected", CameraInfo)
        send(graph, pitched, 7)
        graph.wait(lambda: len(infos) == 7, "camera infos")
        np.testing.assert_array_equal(infos[-1].r, pitched.rig.right.R.ravel())
        assert "not corrected: the right camera has rotated by 0.5" in graph.status().message


def test_images_without_features(straight: TurnedCamera) -> None:
    with Graph(CalibrationMonitor, parameters=EVERY) as graph:
        messages = straight.messages(straight.rig)
        for side in ("left", "right"):
            messages[f"{side}/image_rect"].data = bytes(len(messages[f"{side}/image_rect"].data))
        graph.send(messages)
        graph.wait(lambda: graph.counter("pairs with too few features") == 1, "a pair without features")
        assert graph.status().level == DiagnosticStatus.OK


def test_equal_topics_are_refused() -> None:
    with pytest.raises(TopicError, match="remap them to different topics"):
        Graph(CalibrationMonitor, remaps={"left/image_rect": "/same", "right/image_rect": "/same"})
