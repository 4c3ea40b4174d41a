# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Starts the nodes of the graph as processes, monitors them, and stops them."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

from stereo_depth_ros.config.ros_yaml import node_parameters
from stereo_depth_ros.config.values import PIPELINE_NODES
from stereo_depth_ros.core.errors import GraphError

__all__ = ["SHAPES", "GraphProcesses", "require_ros"]

SHAPES: Mapping[str, tuple[str, ...]] = {
    "fused": ("stereo_depth_node",),
    "separate": ("rectify_node", "disparity_node", "point_cloud_node", "depth_node"),
}
_MONITOR, _VIEWS = "calibration_monitor", "view_node"
_READ_RAW_IMAGES = (
    "stereo_depth_node",
    "rectify_node",
)  # the other nodes subscribe to their outputs, which are never compressed
_STOP_TIMEOUT_S = 5.0  # for each of SIGINT, SIGTERM and SIGKILL
_TAIL_LINES = 12


class GraphProcesses:
    """The nodes of one shape of the graph, which run inside the ``with`` block.

    Args:
        shape: "fused" or "separate".
        parameters: ROS parameters of every node of the shape; ``image_transport`` of those that read raw images.
        log_dir: folder of the log files, one per node; created when missing.
        params_file: ROS parameter file, of which every node takes its own sections; ``parameters`` override it.
        monitor: "report" also runs the calibration monitor; "correct" rectifies with the camera infos that it corrects.
        views: also run the view node.
        env: environment variables in addition to those of this process.

    Raises:
        GraphError: unknown shape.
        ConfigError: not a parameter file.
    """

    def __init__(
        self,
        shape: str,
        parameters: Mapping[str, bool | int | float | str],
        log_dir: Path,
        params_file: Path | None = None,
        monitor: Literal["", "report", "correct"] = "",
        *,
        views: bool = False,
        env: Mapping[str, str] | None = None,
    ) -> None:
        if shape not in SHAPES:
            raise GraphError(
                f"shape {shape!r} is not one of {', '.join(SHAPES)}",
                value=shape,
                limit=tuple(SHAPES),
                remedy="choose one of them",
                settings=("shape",),
            )
        self.shape = shape
        self._nodes = (*SHAPES[shape], *([_MONITOR] if monitor else []), *([_VIEWS] if views else []))
        self._correct = monitor == "correct"
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
        """Check that all nodes are running.

        Raises:
            GraphError: a node has exited; with its exit code and the end of its log.
        """
        for node, process in self._processes.items():
            code = process.poll()
            if code is not None:
                raise GraphError(
                    f"exited with code {code}",
                    subject=node,
                    value=code,
                    remedy=f"see the end of its log:\n{self._tail(node)}",
                )

    @property
    def numbers(self) -> dict[str, int]:
        """Process ID by node name."""
        return {node: process.pid for node, process in self._processes.items()}

    def log_lengths(self) -> tuple[int, ...]:
        """Size of each log file in bytes; it grows while the nodes start."""
        return tuple(self.log(node).stat().st_size for node in self._processes)

    def stop(self) -> dict[str, int]:
        """Stop all nodes with SIGINT, then SIGTERM, then SIGKILL, waiting five seconds after each.

        Returns:
            Exit code by node name; 0 is a clean shutdown, -N a termination by signal N.
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
                start_new_session=True,  # Ctrl-C reaches only the replay, which then stops the nodes
            )

    def _command(self, node: str) -> list[str]:
        command = [sys.executable, "-m", f"stereo_depth_ros.nodes.{node}", "--ros-args"]
        # All as -p: ROS lets a section of the file that names the node override -p.
        for name, value in {**self._own_parameters(node), **self._parameters}.items():
            if name != "image_transport" or node in _READ_RAW_IMAGES:
                command += ["-p", f"{name}:={json.dumps(value)}"]
        if self._correct and node == _MONITOR:
            command += ["-p", "auto_correct:=true"]
        if self._correct and node in _READ_RAW_IMAGES:
            command += ["-r", "right/camera_info:=right/camera_info_corrected"]
        return command

    def _own_parameters(self, node: str) -> dict[str, Any]:
        """What the node takes from the parameter file; the fused node also takes the sections of the separate ones."""
        names = PIPELINE_NODES if node in SHAPES["fused"] else (node,)
        return node_parameters(self._params_file, *names) if self._params_file else {}

    def _tail(self, node: str) -> str:
        return "\n".join(self.log(node).read_text(errors="replace").splitlines()[-_TAIL_LINES:])


def require_ros() -> None:
    """Check that rclpy and the message packages are installed.

    Raises:
        GraphError: a package is missing.
    """
    missing = [name for name in ("rclpy", "sensor_msgs", "stereo_msgs") if importlib.util.find_spec(name) is None]
    if missing:
        raise GraphError(
            f"{', '.join(missing)} not found for {sys.executable}",
            value=missing,
            remedy="source /opt/ros/jazzy/setup.bash where ROS 2 is installed, or pip install 'stereo_depth_ros[ros]'; "
            "processing offline needs no ROS",
        )


def _wait(processes: list[subprocess.Popen[bytes]], timeout_s: float) -> None:
    end = time.monotonic() + timeout_s
    for process in processes:
        try:
            process.wait(max(0.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            return
