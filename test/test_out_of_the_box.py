# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Default settings: every frame of a camera becomes a cloud and a disparity at a best-effort subscriber."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytestmark = pytest.mark.graph

ROOT = Path(__file__).resolve().parents[1]
OWN_SETTINGS = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_BUILTIN_TRANSPORTS",
    "RMW_IMPLEMENTATION",
    "SKIP_DEFAULT_XML_FILE",
    "MALLOC_",
    "GLIBC_TUNABLES",
    "STEREO_DEPTH_MALLOPT",
)

CAMERA = """
import sys, time
from stereo_depth_ros.nodes.transport import prepare_process
assert prepare_process().profile.applied
import rclpy
from sensor_msgs.msg import CameraInfo, Image
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.synthetic.sequence import SyntheticSequence
from stereo_depth_ros.nodes.message_types import RclpyTypes

width, height, rate_hz, frames = map(int, sys.argv[1:])
scene, types = SyntheticSequence(1, width, height), RclpyTypes()
pair, messages = scene[0].pair, {}
for side, camera in (("left", scene.rig.left), ("right", scene.rig.right)):
    messages[f"{side}/camera_info"] = camera_info_message(types, camera, 0)
for side, frame in (("left", pair.left), ("right", pair.right)):
    messages[f"{side}/image_raw"] = image_message(types, frame.pixels, "mono8", 0, frame.frame_id)

rclpy.init()
node = rclpy.create_node("camera")
publishers = {topic: node.create_publisher(type(message), topic, 10) for topic, message in messages.items()}
deadline = time.monotonic() + 40
while not all(publisher.get_subscription_count() for publisher in publishers.values()):
    assert time.monotonic() < deadline, "the node has not subscribed within 40 s"
    time.sleep(0.02)
time.sleep(1.0)  # until the node has discovered the camera too
start = time.monotonic()
for number in range(1, frames + 1):
    time.sleep(max(0.0, start + number / rate_hz - time.monotonic()))
    for topic, message in messages.items():
        message.header.stamp.sec = number
        publishers[topic].publish(message)
time.sleep(1.0)
node.destroy_node()
rclpy.shutdown()
"""

FAST = ("--ros-args", "-p", "stereo_algorithm:=0")  # so that a busy machine too keeps up with the rates
USER = """
import json, sys, time
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

frames = int(sys.argv[1])
rclpy.init()
node = rclpy.create_node("user")
seen = {"points2": [], "disparity": []}
def note_cloud(cloud):
    seen["points2"].append((cloud.header.stamp.sec, len(cloud.data)))
def note_disparity(disparity):
    seen["disparity"].append((disparity.header.stamp.sec, len(disparity.image.data)))
node.create_subscription(PointCloud2, "points2", note_cloud, qos_profile_sensor_data)
node.create_subscription(DisparityImage, "disparity", note_disparity, qos_profile_sensor_data)
count, deadline = 0, time.monotonic() + 60
while count < 2 * frames and time.monotonic() < deadline:
    rclpy.spin_once(node, timeout_sec=0.1)
    if count != sum(map(len, seen.values())):
        count, deadline = sum(map(len, seen.values())), time.monotonic() + 5
print(json.dumps(seen))
node.destroy_node()
rclpy.shutdown()
"""


def environment(domain: int) -> dict[str, str]:
    """That of a user who has set nothing, in a ROS domain of these tests."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(OWN_SETTINGS)}
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return {
        **kept,
        "PYTHONPATH": path,
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }


@contextmanager
def running(*arguments: str, log: Path, domain: int) -> Iterator[subprocess.Popen[str]]:
    """A Python process with stdout in a pipe and stderr in ``log``."""
    with log.open("w") as errors:
        process = subprocess.Popen(
            [sys.executable, *arguments], env=environment(domain), text=True, stdout=subprocess.PIPE, stderr=errors
        )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("width", "height", "rate_hz", "frames"), [(640, 480, 15, 30), (1280, 720, 5, 15)], ids=["vga_15_hz", "hd_5_hz"]
)
def test_every_frame_arrives(width: int, height: int, rate_hz: int, frames: int, tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    # A domain for each case: what the processes of another one left in shared memory is not found again.
    domain = 90 + (os.getpid() + (width == 1280) * 5) % 10
    logs = {name: tmp_path / f"{name}.log" for name in ("node", "user", "camera")}
    camera_arguments = [str(number) for number in (width, height, rate_hz, frames)]
    with (
        running("-m", "stereo_depth_ros.nodes.stereo_depth_node", *FAST, log=logs["node"], domain=domain) as node,
        running("-c", USER, str(frames), log=logs["user"], domain=domain) as user,
        running("-c", CAMERA, *camera_arguments, log=logs["camera"], domain=domain) as camera,
    ):
        camera.communicate(timeout=100)
        seen, _ = user.communicate(timeout=100)
        node.send_signal(signal.SIGINT)
        node.communicate(timeout=20)
    said = "\n".join(f"{name}: {path.read_text()}" for name, path in logs.items())
    assert (camera.returncode, user.returncode, node.returncode) == (0, 0, 0), said
    points = width * height
    assert json.loads(seen) == {
        "points2": [[number, 32 * points] for number in range(1, frames + 1)],
        "disparity": [[number, 4 * points] for number in range(1, frames + 1)],
    }, said
