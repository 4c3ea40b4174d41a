# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Starts the nodes of the graph as processes, watches them, and stops them."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Literal

from stereo_depth_ros.core.errors import GraphError

__all__ = ["SHAPES", "GraphProcesses", "require_ros"]

SHAPES: Mapping[str, tuple[str, ...]] = {
    "fused": ("stereo_depth_node",),
    "separate": ("rectify_node", "disparity_node", "point_cloud_node", "depth_node"),
}
_HEALTH_NODE = "calibration_monitor"
_READ_RAW_IMAGES = ("stereo_depth_node", "rectify_node")  # the others get what these publish, which is never compressed
_STOP_TIMEOUT_S = 5.0  # for each of SIGINT, SIGTERM and SIGKILL
_TAIL_LINES = 12


class GraphProcesses:
    """The nodes of one shape of the graph, running while the ``with`` block lasts.

    Args:
        shape: "fused" or "separate".
        parameters: ROS parameters for every node of the shape; ``image_transport`` goes to those that read raw images.
        params_file: a ROS parameter file for every node; ``parameters`` wins over it.
        health: "watch" runs health_node beside them; "correct" has it publish the camera infos to rectify with, too.
        env: environment variables on top of this process's own.
        log_dir: folder for one log file a node; made when missing.

    Raises:
        GraphError: unknown shape.
    """

    def __init__(
        self,
        shape: str,
        parameters: Mapping[str, bool | int | float | str],
        log_dir: Path,
        params_file: Path | None = None,
        health: Literal["", "watch", "correct"] = "",
        env: Mapping[str, str] | None = None,
    ) -> None:
        if shape not in SHAPES:
            raise GraphError(f"shape {shape!r} is none of {', '.join(SHAPES)}: take one of them")
        self.shape = shape
        self._nodes = (*SHAPES[shape], _HEALTH_NODE) if health else SHAPES[shape]
        self._correct = health == "correct"
        self._parameters = dict(parameters)
        self._params_file = params_file
        self._env = {**os.environ, **(env or {})}
        self._log_dir = log_dir
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> GraphProcesses:
        self._log_dir.mkdir(parents=True, exist_ok=True)
        try:
            for node in self._nodes:
                self._processes[node] = self._start(node)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def check(self) -> None:
        """Raise where a node has ended.

        Raises:
            GraphError: names the node, its exit code and the end of its log.
        """
        for node, process in self._processes.items():
            code = process.poll()
            if code is not None:
                raise GraphError(f"{node} ended with exit code {code}; the end of its log:\n{self._tail(node)}")

    @property
    def numbers(self) -> dict[str, int]:
        """Number of the process by name of the node."""
        return {node: process.pid for node, process in self._processes.items()}

    def log_lengths(self) -> tuple[int, ...]:
        """Bytes that each node has logged so far: they grow while the nodes start."""
        return tuple(self.log(node).stat().st_size for node in self._processes)

    def stop(self) -> dict[str, int]:
        """End all nodes: SIGINT, then SIGTERM, then SIGKILL, five seconds each.

        Returns:
            Exit code per node; 0 is a clean shutdown, -N an end by signal N.
        """
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            running = [process for process in self._processes.values() if process.poll() is None]
            for process in running:
                process.send_signal(number)
            _wait(running, _STOP_TIMEOUT_S)
        return {node: process.wait() for node, process in self._processes.items()}

    def log(self, node: str) -> Path:
        """Log file of a node."""
        return self._log_dir / f"{node}.log"

    def _start(self, node: str) -> subprocess.Popen[bytes]:
        with self.log(node).open("wb") as log:
            return subprocess.Popen(
                self._command(node),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._env,
                start_new_session=True,  # Ctrl-C reaches the replay first, which then stops the nodes in order
            )

    def _command(self, node: str) -> list[str]:
        command = [sys.executable, "-m", f"stereo_depth_ros.nodes.{node}", "--ros-args"]
        if self._params_file is not None:
            command += ["--params-file", str(self._params_file)]
        for name, value in self._parameters.items():
            if name != "image_transport" or node in _READ_RAW_IMAGES:
                command += ["-p", f"{name}:={_ros_text(value)}"]
        if self._correct and node == _HEALTH_NODE:
            command += ["-p", "auto_correct:=true"]
        if self._correct and node in _READ_RAW_IMAGES:
            command += ["-r", "right/camera_info:=right/camera_info_corrected"]
        return command

    def _tail(self, node: str) -> str:
        return "\n".join(self.log(node).read_text(errors="replace").splitlines()[-_TAIL_LINES:])


def require_ros() -> None:
    """Raise where rclpy or the message packages are not installed.

    Raises:
        GraphError: names what is missing and how to get it.
    """
    missing = [name for name in ("rclpy", "sensor_msgs", "stereo_msgs") if importlib.util.find_spec(name) is None]
    if missing:
        raise GraphError(
            f"{', '.join(missing)} not found for {sys.executable}: source /opt/ros/jazzy/setup.bash where ROS 2 is "
            "installed, or pip install 'stereo_depth_ros[ros]'; `stereo-depth process` needs no ROS"
        )


def _wait(processes: list[subprocess.Popen[bytes]], timeout_s: float) -> None:
    end = time.monotonic() + timeout_s
    for process in processes:
        try:
            process.wait(max(0.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            return


def _ros_text(value: bool | int | float | str) -> str:
    """A parameter value as the command line of ROS takes it: YAML, with a dot in every double."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value!r}" if isinstance(value, float) else str(value)
