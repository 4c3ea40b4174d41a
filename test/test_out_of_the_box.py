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
from typing import IO

import pytest
from ros_domain import own_number

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

# Publishes a frame at its time, or when the outputs of the frame before have arrived, if that is later: a loaded
# machine slows the camera down, and no queue overflows. It reads from stdin what the user prints.
CAMERA = """
import collections, json, os, select, sys, time
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
arrived, rest = collections.defaultdict(list), ""

def publish(number):
    for topic, message in messages.items():
        message.header.stamp.sec = number
        publishers[topic].publish(message)

def has_arrived(number, timeout_s):
    global rest
    deadline = time.monotonic() + timeout_s
    while len(arrived[number]) < 2 and (left_s := deadline - time.monotonic()) > 0:
        if select.select([0], [], [], left_s)[0]:
            data = os.read(0, 65536).decode()
            assert data, "the user has ended"
            *lines, rest = (rest + data).split("\\n")
            for line in lines:
                stamp, topic, size = line.split()
                arrived[int(stamp)].append([topic, int(size)])
    return len(arrived[number]) == 2

number, deadline = 0, time.monotonic() + 90
while not has_arrived(number, timeout_s=number):  # until all have discovered each other
    assert time.monotonic() < deadline, f"no cloud and disparity of {number} pairs within 90 s"
    publish(number := number + 1)
start = time.monotonic()
for number in range(1000, 1000 + frames):
    time.sleep(max(0.0, start + (number - 1000) / rate_hz - time.monotonic()))
    publish(number)
    assert has_arrived(number, 20.0), f"of frame {number - 1000}, only {arrived[number]} arrived within 20 s"
print(json.dumps([sorted(arrived[number]) for number in range(1000, 1000 + frames)]))
node.destroy_node()
rclpy.shutdown()
"""

FAST = ("--ros-args", "-p", "stereo_algorithm:=0")  # so that a busy machine too keeps up with the rates
USER = """
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

rclpy.init()
node = rclpy.create_node("user")
def note_cloud(cloud):
    print(cloud.header.stamp.sec, "points2", len(cloud.data), flush=True)
def note_disparity(disparity):
    print(disparity.header.stamp.sec, "disparity", len(disparity.image.data), flush=True)
node.create_subscription(PointCloud2, "points2", note_cloud, qos_profile_sensor_data)
node.create_subscription(DisparityImage, "disparity", note_disparity, qos_profile_sensor_data)
rclpy.spin(node)
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
def running(*arguments: str, log: Path, domain: int, stdin: IO[str] | None = None) -> Iterator[subprocess.Popen[str]]:
    """A Python process with stdout in a pipe and stderr in ``log``."""
    with log.open("w") as errors:
        process = subprocess.Popen(
            [sys.executable, *arguments],
            env=environment(domain),
            text=True,
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=errors,
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
    domain = 90 + 2 * own_number(5) + (width == 1280)
    logs = {name: tmp_path / f"{name}.log" for name in ("node", "user", "camera")}
    camera_arguments = [str(number) for number in (width, height, rate_hz, frames)]
    with (
        running("-m", "stereo_depth_ros.nodes.stereo_depth_node", *FAST, log=logs["node"], domain=domain) as node,
        running("-c", USER, log=logs["user"], domain=domain) as user,
        running("-c", CAMERA, *camera_arguments, log=logs["camera"], domain=domain, stdin=user.stdout) as camera,
    ):
        arrived, _ = camera.communicate(timeout=180)
        node.send_signal(signal.SIGINT)
        node.communicate(timeout=20)
    said = "\n".join(f"{name}: {path.read_text()}" for name, path in logs.items())
    assert (camera.returncode, node.returncode) == (0, 0), said
    points = width * height
    assert json.loads(arrived.splitlines()[-1]) == [[["disparity", 4 * points], ["points2", 32 * points]]] * frames, (
        said
    )
