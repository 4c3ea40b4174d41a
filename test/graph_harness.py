# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Support of the graph tests: nodes in this or another process, a synthetic camera, waits with a timeout."""

from __future__ import annotations

import functools
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pytest
from ros_domain import own_number

rclpy = pytest.importorskip("rclpy", reason="graph tests need ROS 2")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue, SetParametersResult  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from rclpy.signals import SignalHandlerOptions  # noqa: E402

from stereo_depth_ros.core.rig import StereoRig  # noqa: E402
from stereo_depth_ros.core.types import U8  # noqa: E402
from stereo_depth_ros.messages.camera_info import camera_info_message  # noqa: E402
from stereo_depth_ros.messages.image import image_message  # noqa: E402
from stereo_depth_ros.nodes.message_types import RclpyTypes  # noqa: E402
from stereo_depth_ros.synthetic.sequence import SyntheticFrame, SyntheticSequence  # noqa: E402

__all__ = ["NS_PER_S", "Graph", "NodeProcess", "StereoCamera", "image_pixels", "parameter_value", "ros_arguments"]

NS_PER_S = 10**9
TIMEOUT_S = 15.0
ROOT = Path(__file__).resolve().parents[1]
# A separate domain: no interference with other nodes on this machine.
ENVIRONMENT = {"ROS_DOMAIN_ID": str(70 + own_number(20)), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def ros_arguments(
    parameters: Mapping[str, Any] | None = None, remaps: Mapping[str, str] | None = None, files: Iterable[Path] = ()
) -> list[str]:
    """The command line of parameters, remappings and parameter files."""
    values = {
        name: str(value).lower() if isinstance(value, bool) else value for name, value in (parameters or {}).items()
    }
    arguments = [part for name, value in values.items() for part in ("-p", f"{name}:={value}")]
    arguments += [part for old, new in (remaps or {}).items() for part in ("-r", f"{old}:={new}")]
    arguments += [part for path in files for part in ("--params-file", str(path))]
    return ["--ros-args", *arguments] if arguments else []


@functools.cache
def _rendered(frames: int, width: int, height: int) -> tuple[StereoRig, list[SyntheticFrame]]:
    sequence = SyntheticSequence(frames, width, height)
    return sequence.rig, sequence[:]


class StereoCamera:
    """Messages of a synthetic stereo camera: small, verged, distorted, and with the truth."""

    def __init__(self, frames: int = 3, width: int = 200, height: int = 120) -> None:
        self.types = RclpyTypes()
        self.rig, self.frames = _rendered(frames, width, height)

    def infos(self, stamp_ns: int) -> dict[str, Any]:
        """Both camera infos, by topic."""
        cameras = {"left": self.rig.left, "right": self.rig.right}
        return {
            f"{side}/camera_info": camera_info_message(self.types, camera, stamp_ns) for side, camera in cameras.items()
        }

    def images(self, stamp_ns: int, index: int = 0, encoding: str = "mono8") -> dict[str, Any]:
        """Both raw images, by topic."""
        pair = self.frames[index].pair
        messages = {}
        for side, frame in (("left", pair.left), ("right", pair.right)):
            pixels = frame.pixels if encoding == "mono8" else colored(frame.pixels)
            messages[f"{side}/image_raw"] = image_message(self.types, pixels, encoding, stamp_ns, frame.frame_id)
        return messages

    def pair(self, stamp_ns: int, index: int = 0, encoding: str = "mono8") -> dict[str, Any]:
        """Both camera infos and both raw images, by topic."""
        return {**self.infos(stamp_ns), **self.images(stamp_ns, index, encoding)}


def colored(pixels: U8) -> U8:
    """uint8 (H, W, 3) in which every channel is another function of the gray value."""
    return np.ascontiguousarray(np.stack([pixels, 255 - pixels, pixels // 2], axis=-1))


class Graph:
    """Nodes and a test node in this process, spun together by the waits of the test.

    An exception of a callback ends the test, as it would end the node.

    Args:
        node_types: classes of the nodes.
        parameters, remaps, files: of all of them; files are parameter files.
    """

    def __init__(
        self,
        *node_types: Callable[[], Any],
        parameters: Mapping[str, Any] | None = None,
        remaps: Mapping[str, str] | None = None,
        files: Iterable[Path] = (),
    ) -> None:
        os.environ.update(ENVIRONMENT)
        rclpy.init(args=ros_arguments(parameters, remaps, files), signal_handler_options=SignalHandlerOptions.NO)
        self._executor = SingleThreadedExecutor()
        self._node = rclpy.create_node("graph_test", use_global_arguments=False, enable_rosout=False)
        self._publishers: dict[str, Any] = {}
        self._subscriptions: dict[str, Any] = {}
        self.nodes: list[Any] = []
        try:
            self._executor.add_node(self._node)
            self.logs = self.listen("/rosout", Log, depth=100, latched=True)  # what is logged before the link is there
            self.diagnostics = self.listen("/diagnostics", DiagnosticArray, depth=100)
            for node_type in node_types:
                self.nodes.append(node_type())
                self._executor.add_node(self.nodes[-1])
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Graph:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Destroys the nodes and shuts rclpy down."""
        self._executor.shutdown()
        for node in (*self.nodes, self._node):
            node.destroy_node()
        rclpy.try_shutdown()

    def spin(self, seconds: float) -> None:
        """Spins for a while, to see that a message does not arrive."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def wait(self, condition: Callable[[], Any], what: str, timeout_s: float = TIMEOUT_S) -> None:
        """Spins until ``condition``; fails with ``what`` and the last log lines after the timeout."""
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end:
                pytest.fail(f"within {timeout_s:g} s: no {what}; log: {[log.msg for log in self.logs[-5:]]}")
            self._executor.spin_once(timeout_sec=0.05)

    def listen(self, topic: str, kind: Any, depth: int = 10, reliable: bool = True, latched: bool = False) -> list[Any]:
        """Subscribes; the list of messages received."""
        received: list[Any] = []
        qos = _qos(depth, reliable)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self._subscriptions[topic] = self._node.create_subscription(kind, topic, received.append, qos)
        return received

    def stop_listening(self, topic: str) -> None:
        """Unsubscribes."""
        self._node.destroy_subscription(self._subscriptions.pop(topic))

    def advertise(self, topic: str, kind: Any, reliable: bool = True, qos: QoSProfile | None = None) -> Any:
        """A publisher of the test node; the same one for the same topic."""
        if topic not in self._publishers:
            self._publishers[topic] = self._node.create_publisher(kind, topic, qos or _qos(10, reliable))
        return self._publishers[topic]

    def withdraw(self, topic: str) -> None:
        """Destroys the publisher."""
        self._node.destroy_publisher(self._publishers.pop(topic))

    def send(self, messages: Mapping[str, Any], subscribers: int = 1) -> None:
        """Publishes by topic, in this order, once every topic has that many subscribers."""
        publishers = {topic: self.advertise(topic, type(message)) for topic, message in messages.items()}
        self.wait(
            lambda: all(publisher.get_subscription_count() >= subscribers for publisher in publishers.values()),
            f"{subscribers} subscription(s) of each of {', '.join(publishers)}",
        )
        for topic, message in messages.items():
            publishers[topic].publish(message)

    def subscriptions(self, *topics: str) -> list[int]:
        """Number of subscriptions of each topic."""
        return [self._node.count_subscribers(topic) for topic in topics]

    def publishers(self, topic: str) -> list[Any]:
        """Endpoint infos of the publishers of a topic."""
        return list(self._node.get_publishers_info_by_topic(topic))

    def subscribers(self, topic: str) -> list[Any]:
        """Endpoint infos of the subscriptions of a topic."""
        return list(self._node.get_subscriptions_info_by_topic(topic))

    def errors(self, pattern: str) -> list[str]:
        """Logged errors that match."""
        return [log.msg for log in self.logs if log.level >= 40 and re.search(pattern, log.msg)]

    def wait_error(self, pattern: str) -> str:
        """The first logged error that matches."""
        self.wait(lambda: self.errors(pattern), f"error in the log that matches {pattern!r}")
        return self.errors(pattern)[0]

    def status(self, node: Any = None) -> DiagnosticStatus:
        """The current diagnostics of a node."""
        node = node or self.nodes[0]
        name = node.get_fully_qualified_name()
        self.diagnostics.clear()
        node.diagnostics.publish()
        self.wait(lambda: any(m.status[0].name == name for m in self.diagnostics), f"diagnostics of {name}")
        return next(m.status[0] for m in reversed(self.diagnostics) if m.status[0].name == name)

    def counter(self, name: str, node: Any = None) -> int:
        """A counter on /diagnostics, 0 where it is missing."""
        values = {item.key: item.value for item in self.status(node).values}
        return int(values.get(name, "0"))

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """The response of a service."""
        client = self._node.create_client(kind, name)
        self.wait(client.service_is_ready, f"service {name}")
        future = client.call_async(request)
        self.wait(future.done, f"response of {name}")
        self._node.destroy_client(client)
        return future.result()

    def set_parameter(self, name: str, value: Any, node: str = "stereo_depth_node") -> SetParametersResult:
        """Sets one through the service, as `ros2 param set` does."""
        request = SetParameters.Request(parameters=[Parameter(name=name, value=parameter_value(value))])
        return self.call(SetParameters, f"/{node}/set_parameters", request).results[0]


def _qos(depth: int, reliable: bool) -> QoSProfile:
    reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=depth, reliability=reliability)


def parameter_value(value: Any) -> ParameterValue:
    """The message of a value of type bool, int, float or str."""
    kinds = {
        bool: ("bool_value", ParameterType.PARAMETER_BOOL),
        int: ("integer_value", ParameterType.PARAMETER_INTEGER),
        float: ("double_value", ParameterType.PARAMETER_DOUBLE),
        str: ("string_value", ParameterType.PARAMETER_STRING),
    }
    field, kind = kinds[type(value)]
    return ParameterValue(type=kind, **{field: value})


class NodeProcess:
    """A node in a separate process, with its output in a file.

    Args:
        node: module of the node.
        arguments: its command line, see :func:`ros_arguments`.
        folder: where the output goes.
    """

    def __init__(self, node: str, arguments: list[str], folder: Path) -> None:
        self.node = node
        self._log = folder / f"{node}-{time.monotonic_ns()}.log"
        path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", f"stereo_depth_ros.nodes.{node}", *arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **ENVIRONMENT, "PYTHONPATH": path},
            )

    @property
    def number(self) -> int:
        """Number of the process."""
        return self._process.pid

    @property
    def text(self) -> str:
        """Its output so far."""
        return self._log.read_text(encoding="utf-8", errors="replace")

    def wait_ready(self, timeout_s: float = 60.0) -> None:
        """Waits for its line `ready`."""
        end = time.monotonic() + timeout_s
        while "ready" not in self.text:
            if not self.running or time.monotonic() > end:
                pytest.fail(f"{self.node} is not ready within {timeout_s:g} s: {self.text}")
            time.sleep(0.05)

    def signal(self, number: signal.Signals) -> None:
        """Sends it a signal."""
        self._process.send_signal(number)

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def exit_code(self, timeout_s: float = 60.0) -> int:
        """Waits for its end."""
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{self.node} has not ended within {timeout_s:g} s: {self.text}")

    def kill(self) -> None:
        """Ends it, whatever it does."""
        self._process.kill()
        self._process.wait()


def image_pixels(message: Any) -> Any:
    """The pixels of an Image without row padding, (H, W) or (H, W, C): uint8, uint16 or float32."""
    name = message.encoding.rstrip("0123456789")
    dtype = "<u2" if "16" in message.encoding else "<f4" if message.encoding == "32FC1" else "u1"
    channels = {"rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4}.get(name, 1)
    assert message.step == message.width * channels * np.dtype(dtype).itemsize
    shape = (message.height, message.width, channels)[: 2 if channels == 1 else 3]
    return np.frombuffer(message.data, dtype).reshape(shape)
