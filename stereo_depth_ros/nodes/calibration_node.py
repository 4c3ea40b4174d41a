# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibrates a live pair of cameras: collects views of a board, reports what is missing, solves, saves, commits."""

from __future__ import annotations

import functools
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.srv import SetCameraInfo

from stereo_depth_ros.calibration.board_options import create_board, parse_board_size
from stereo_depth_ros.calibration.calibration_files import calibration_files, save_calibration
from stereo_depth_ros.calibration.calibration_result import StereoCalibration
from stereo_depth_ros.calibration.live_calibration import LiveCalibration, ViewStatus
from stereo_depth_ros.config import CalibrationConfig, PairingConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, OutputError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.types import U8, Frame
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.files.own_folder import OwnFolder
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.interface import RAW_IMAGES, NodeInterface
from stereo_depth_ros.nodes.log import log_info
from stereo_depth_ros.nodes.pair_input import PairInput
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.nodes.triggers import add_trigger
from stereo_depth_ros.plots.coverage import coverage_plot
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.operator_overlay import operator_overlay

__all__ = ["CalibrationNode", "main"]

SIDES = ("left", "right")
COMMIT_TIMEOUT_S = 5.0  # for a driver to appear, and again for its response
_IMAGE = "coverage.png"
_SEE_LOG = "read the log of the driver"


class CalibrationNode(StereoNode):
    """The image calibration/image shows the views taken so far, and what to do next.

    ~/calibrate solves with the views taken, ~/save writes the files of `stereo-depth calibrate`, ~/commit
    sends the camera infos to {left,right}/set_camera_info of the drivers. Boards are detected in a separate thread;
    pairs that arrive meanwhile are skipped.
    """

    interface = NodeInterface(
        "calibration_node",
        configs=(PairingConfig, CalibrationConfig),
        inputs=RAW_IMAGES,
        outputs={"calibration/image": "sensor_msgs/msg/Image"},
        services={f"~/{name}": "std_srvs/srv/Trigger" for name in ("calibrate", "save", "commit")},
        clients={f"{side}/set_camera_info": "sensor_msgs/srv/SetCameraInfo" for side in SIDES},
        lazy=False,
    )

    def __init__(self) -> None:
        # first, because a node that cannot start is destroyed too
        self._newest: queue.Queue[tuple[Any, Any] | None] = queue.Queue(1)
        self._worker = threading.Thread(target=self._work, name="board", daemon=True)
        super().__init__()
        self.refuse_equal_topics("left/image_raw", "right/image_raw")
        config = self.parameters.get(CalibrationConfig)
        board = create_board(
            config.board,
            parse_board_size(config.board_size),
            config.board_square,
            marker_m=config.board_marker or None,
            dictionary=config.board_dictionary,
            spacing=config.board_spacing,
        )
        self._folder = OwnFolder(config.calibration_folder, "calibration_folder")
        self._live = LiveCalibration(board, config.lens_model, config.max_board_motion)
        self._lock = threading.Lock()  # of the live calibration
        self._overlay = self.add_output("calibration/image")
        self._pairs = PairInput(self, "left/image_raw", "right/image_raw", self._on_pair)
        self.add_input("left/image_raw", self._pairs.add_left)
        self.add_input("right/image_raw", self._pairs.add_right)
        for name, act in (("~/calibrate", self._calibrate), ("~/save", self._save), ("~/commit", self._commit)):
            add_trigger(self, name, functools.partial(self._locked, act))
        self._worker.start()
        self._report("waiting for images")

    def destroy_node(self) -> None:
        """Ends the thread, then the node."""
        self._replace_newest(None)
        if self._worker.is_alive():
            self._worker.join()
        super().destroy_node()

    def _on_pair(self, left: Any, right: Any) -> None:
        self._replace_newest((left, right))

    def _replace_newest(self, item: tuple[Any, Any] | None) -> None:
        """Replaces a pair that is still waiting."""
        while True:
            try:
                self._newest.put_nowait(item)
                return
            except queue.Full:
                try:
                    self._newest.get_nowait()
                    self.diagnostics.counters["pairs skipped"] += 1
                except queue.Empty:
                    pass

    def _work(self) -> None:
        while (pair := self._newest.get()) is not None:
            with self.diagnostics.catch():
                self._look(*pair)

    def _look(self, left: Any, right: Any) -> None:
        pair = self._pairs.decode(left, right)
        grays = to_gray(pair.left), to_gray(pair.right)
        with self._lock, self.diagnostics.timed("detect the board"):
            self._live.max_motion_px = self.parameters.get(CalibrationConfig).max_board_motion
            look = self._live.add(f"{stamp_ns(left.header) / 1e9:.3f} s", *grays)
            self._report(look.value)
            if look is ViewStatus.ADDED:
                advice = "; ".join(self._live.advice) or "enough views: call ~/calibrate"
                log_info(self.get_logger(), f"view {len(self._live.views)} taken; {advice}")
            if self._overlay.wanted:
                self._publish_overlay(pair.left, grays[0], look)

    def _publish_overlay(self, frame: Frame, gray: U8, look: ViewStatus) -> None:
        live = self._live
        taken = [view.left.image_px for view in live.views]
        seen = live.seen.image_px if live.seen is not None else None
        image = operator_overlay(gray, taken, seen, live.coverage, look.value, live.advice)
        self._overlay.publish(image_message(self.types, image, "bgr8", frame.stamp_ns, frame.frame_id))

    def _report(self, outcome: str) -> None:
        """On /diagnostics."""
        coverage = self._live.coverage
        self.diagnostics.facts = {
            "views": str(len(self._live.views)),
            **{f"coverage {name}": f"{getattr(coverage, name):.2f}" for name in ("x", "y", "size", "skew")},
            "missing": "; ".join(self._live.advice) or "nothing: call ~/calibrate",
            "newest pair": outcome,
            "calibrated": "no" if self._live.result is None else _summary(self._live.result),
        }

    def _locked(self, act: Callable[[], str]) -> str:
        with self._lock:
            return act()

    def _calibrate(self) -> str:
        result = self._live.calibrate()
        self._report("calibrated")
        dropped = "".join(f"; {view.name} dropped: {view.reason}" for view in result.dropped)
        better = "".join(f"; to improve it: {text}" for text in self._live.advice)
        return f"{_summary(result)}{dropped}{better}"

    def _save(self) -> str:
        result, overwrite = self._result(), self.parameters.get(CalibrationConfig).overwrite
        names = [*(path.name for path in calibration_files(Path())), _IMAGE]
        folder = self._folder.place(names, overwrite=overwrite)
        image = folder / _IMAGE
        try:
            check_outputs([folder / name for name in names], overwrite=overwrite)
        except OutputError as error:
            error.settings = ("calibration_folder", "overwrite")
            raise
        save_calibration(result, folder, overwrite=overwrite)
        save_png(image, coverage_plot(result), overwrite=overwrite)
        return f"left.yaml, right.yaml, calibration.json, .txt and coverage.png written to {folder}"

    def _commit(self) -> str:
        """Uses a second node, because this one is blocked in the service call.

        Nothing is sent before both drivers are found.
        """
        rig = self._result().rig
        node = rclpy.create_node(f"{self.get_name()}_commit", context=self.context, use_global_arguments=False)
        executor = SingleThreadedExecutor(context=self.context)
        executor.add_node(node)
        try:
            clients = [self._client(node, self.resolve_service_name(name)) for name in self.interface.clients]
            self._send(executor, clients[0], rig.left)
            try:
                self._send(executor, clients[1], rig.right)
            except CalibrationError as error:
                raise CalibrationError(
                    f"{error.problem}; the left driver has already accepted its new CameraInfo",
                    subject=error.subject,
                    remedy=f"{error.remedy}, and call ~/commit again before you use the cameras",
                ) from error
        finally:
            executor.shutdown()
            node.destroy_node()
        return "both drivers have accepted their camera infos"

    def _client(self, node: Any, service: str) -> Any:
        client = node.create_client(SetCameraInfo, service)
        if not client.wait_for_service(COMMIT_TIMEOUT_S):
            raise CalibrationError(
                f"no service within {COMMIT_TIMEOUT_S:g} s, nothing was committed",
                subject=service,
                limit=COMMIT_TIMEOUT_S,
                remedy="start the camera driver, remap the service, or use the files of ~/save",
            )
        return client

    def _send(self, executor: Any, client: Any, camera: CameraModel) -> None:
        service = client.srv_name
        info = camera_info_message(self.types, camera, self.get_clock().now().nanoseconds)
        future, end = client.call_async(SetCameraInfo.Request(camera_info=info)), time.monotonic() + COMMIT_TIMEOUT_S
        while not future.done() and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
        if not future.done():
            raise CalibrationError(
                f"no response within {COMMIT_TIMEOUT_S:g} s", subject=service, limit=COMMIT_TIMEOUT_S, remedy=_SEE_LOG
            )
        if not future.result().success:
            raise CalibrationError(f"refused, {future.result().status_message}", subject=service, remedy=_SEE_LOG)

    def _result(self) -> StereoCalibration:
        if self._live.result is None:
            raise CalibrationError("there is no calibration yet", remedy="call ~/calibrate first")
        return self._live.result


def _summary(result: StereoCalibration) -> str:
    return (
        f"rms {result.rms_stereo_px:.3f} px, rows {result.epipolar_rms_px:.3f} px, baseline "
        f"{1e3 * result.baseline_m:.2f} mm, {len(result.views)} views"
    )


def main() -> int:
    """Run the node."""
    return run(CalibrationNode)


if __name__ == "__main__":
    raise SystemExit(main())
