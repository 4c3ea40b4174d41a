# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Large messages arrive with the transport settings, and the settings of the user are kept."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.files import installed_files
from stereo_depth_ros.nodes import transport
from stereo_depth_ros.nodes.transport import prepare_process, profile_path

ROOT = Path(__file__).resolve().parents[1]
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
NEW_PROFILE = "FASTDDS_DEFAULT_PROFILES_FILE"  # the name since Fast DDS 3
OWN_VARIABLES = (PROFILE, NEW_PROFILE, "FASTDDS_BUILTIN_TRANSPORTS", "RMW_IMPLEMENTATION", "SKIP_DEFAULT_XML_FILE")


def clean_environment() -> dict[str, str]:
    """The environment of a user who has set nothing."""
    memory = ("MALLOC_", "GLIBC_TUNABLES", "STEREO_DEPTH_MALLOPT")
    kept = {name: value for name, value in os.environ.items() if name not in OWN_VARIABLES}
    return {name: value for name, value in kept.items() if not name.startswith(memory)}


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nothing set but the malloc of the tests' own process, which stays as it is."""
    with monkeypatch.context() as context:
        context.setattr(os, "environ", {**clean_environment(), "STEREO_DEPTH_MALLOPT": "0"})
        yield


def free_shared_memory(monkeypatch: pytest.MonkeyPatch, folder: Path, mebibytes: int) -> None:
    status = types.SimpleNamespace(f_bavail=mebibytes * 256, f_frsize=4096)
    monkeypatch.setattr(os, "statvfs", lambda path: status)
    monkeypatch.setattr(transport, "SHARED_MEMORY", folder)


def test_profile_is_set_once_and_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    free_shared_memory(monkeypatch, tmp_path, 1024)
    for _ in range(2):
        report = prepare_process()
        assert report.profile.applied
        assert os.environ[PROFILE] == os.environ[NEW_PROFILE] == str(ROOT / "config" / "fastdds.xml")
        assert str(report) == f"transport: Fast DDS profile {profile_path()}; memory: {report.malloc.text}"


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        (PROFILE, "/etc/mine.xml", f"{PROFILE} is '/etc/mine.xml'"),
        (PROFILE, "", f"{PROFILE} is ''"),
        (NEW_PROFILE, "/etc/mine.xml", f"{NEW_PROFILE} is '/etc/mine.xml'"),
        ("FASTDDS_BUILTIN_TRANSPORTS", "LARGE_DATA", "FASTDDS_BUILTIN_TRANSPORTS is LARGE_DATA"),
        ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", "RMW_IMPLEMENTATION is rmw_cyclonedds_cpp: set up shared memory"),
    ],
)
def test_own_choice_is_left_alone(name: str, value: str, reason: str) -> None:
    os.environ[name] = value
    before = dict(os.environ)
    report = prepare_process()
    assert not report.profile.applied
    assert f"not set, {reason}" in str(report)
    assert os.environ == before


@pytest.mark.parametrize("middleware", ["", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp"])
def test_fast_dds_by_name_gets_the_profile(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, middleware: str) -> None:
    free_shared_memory(monkeypatch, tmp_path, 1024)
    os.environ["RMW_IMPLEMENTATION"] = middleware
    assert prepare_process().profile.applied


def test_profile_of_the_user_in_the_working_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    free_shared_memory(monkeypatch, tmp_path, 1024)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").touch()
    assert "DEFAULT_FASTRTPS_PROFILES.xml is read" in prepare_process().profile.text
    os.environ["SKIP_DEFAULT_XML_FILE"] = "1"
    assert prepare_process().profile.applied


@pytest.mark.parametrize(("mebibytes", "fits"), [(64, False), (139, False), (141, True)])
def test_small_shared_memory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, mebibytes: int, fits: bool) -> None:
    free_shared_memory(monkeypatch, tmp_path, mebibytes)
    report = prepare_process()
    assert report.profile.applied is fits
    assert (PROFILE in os.environ) is fits
    said = f"{tmp_path} has {mebibytes} MiB free and a process needs 140: free some or enlarge it"
    assert (said in str(report)) is not fits


def test_no_shared_memory_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(transport, "SHARED_MEMORY", tmp_path / "absent")
    assert prepare_process().profile.applied


def test_profile_keeps_udp_beside_shared_memory() -> None:
    elements = [(item.tag.split("}")[1], item.text) for item in ElementTree.parse(profile_path()).iter()]
    assert [text for tag, text in elements if tag == "type"] == ["SHM", "UDPv4"]
    assert ("segment_size", str(128 << 20)) in elements


def test_heartbeat_travels_in_the_message_of_its_piece() -> None:
    """Fast DDS 3 counts the 84 bytes of headers of a piece twice; a heartbeat without room is one more message."""
    texts = [item.text for item in ElementTree.parse(profile_path()).iter()]
    piece = int(texts[texts.index("fastdds.max_message_size") + 1] or 0)
    assert piece <= 65500 - 84
    pieces = [-(-(1280 * 720 * size + 200) // (piece - 168)) for size in (32, 4)]  # of a cloud and a disparity
    assert sum(pieces) < 512  # the queue of a subscriber without a profile


def test_port_of_a_killed_process_counts_as_broken_soon() -> None:
    """Its successor has the same port, and receives nothing before; 1 s is the default of Fast DDS."""
    elements = {item.tag.split("}")[1]: item.text for item in ElementTree.parse(profile_path()).iter()}
    assert int(elements.get("healthy_check_timeout_ms") or 1000) <= 1000


@pytest.mark.parametrize("site", ["lib/python3.12/site-packages", "local/lib/python3.12/dist-packages", "."])
def test_profile_is_found_in_the_prefix(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, site: str) -> None:
    package = tmp_path / site / "stereo_depth_ros"
    shared = tmp_path / "share" / "stereo_depth_ros" / "config" / "fastdds.xml"
    monkeypatch.setattr(installed_files, "__file__", str(package / "transport.py"))
    with pytest.raises(
        ConfigError, match=r".*transport\.py: there is no config/fastdds.xml: install the package again"
    ):
        prepare_process()
    shared.parent.mkdir(parents=True)
    shutil.copy(ROOT / "config" / "fastdds.xml", shared)
    assert profile_path() == shared


MAPPED_BLOCKS = """
import ctypes
from stereo_depth_ros.nodes.transport import prepare_process
report = prepare_process()
class Info(ctypes.Structure):  # glibc's struct mallinfo2
    _fields_ = [(name, ctypes.c_size_t) for name in "arena ordblks smblks hblks hblkhd a b c d e".split()]
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes, libc.mallinfo2.restype = ctypes.c_void_p, [ctypes.c_size_t], Info
before = libc.mallinfo2().hblks
libc.malloc(20 << 20)
print(report.malloc.applied, libc.mallinfo2().hblks - before, report.malloc.text, sep=";")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc only")
@pytest.mark.parametrize(
    ("variable", "line"),
    [
        ({}, "True;0;malloc keeps large buffers"),
        ({"STEREO_DEPTH_MALLOPT": "0"}, "False;1;malloc not set, STEREO_DEPTH_MALLOPT is 0"),
        ({"MALLOC_ARENA_MAX": "2"}, "False;1;malloc not set, MALLOC_ARENA_MAX set"),
        ({"GLIBC_TUNABLES": "glibc.malloc.check=0"}, "False;1;malloc not set, GLIBC_TUNABLES set"),
    ],
)
def test_large_blocks_are_not_mapped_again(variable: dict[str, str], line: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", MAPPED_BLOCKS],
        env={**clean_environment(), **variable, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stdout.strip() == line, done.stderr


@pytest.mark.parametrize(
    ("library", "reason"),
    [
        (types.SimpleNamespace(), "the C library is not glibc"),
        (
            types.SimpleNamespace(gnu_get_libc_version=str, mallopt=lambda name, _: name != -3),
            "refused M_MMAP_THRESHOLD:",
        ),
    ],
)
def test_malloc_that_cannot_be_set(monkeypatch: pytest.MonkeyPatch, library: object, reason: str) -> None:
    del os.environ["STEREO_DEPTH_MALLOPT"]
    monkeypatch.setattr(transport.ctypes, "CDLL", lambda name: library)
    report = prepare_process()
    assert not report.malloc.applied
    assert reason in report.malloc.text


PUBLISHER = """
import array, sys, time
from stereo_depth_ros.nodes.transport import prepare_process
assert prepare_process().profile.applied
import rclpy
from sensor_msgs.msg import PointCloud2
rclpy.init()
node = rclpy.create_node("clouds")
publisher = node.create_publisher(PointCloud2, "points", 5)
deadline = time.monotonic() + 20
while not publisher.get_subscription_count():
    assert time.monotonic() < deadline, "no subscriber within 20 s"
    time.sleep(0.02)
time.sleep(0.5)  # until the subscriber knows the publisher, too
cloud = PointCloud2(width=640, height=480, point_step=32, row_step=640 * 32)
cloud.data = array.array("B", bytes(480 * 640 * 32))
start = time.monotonic()
for number in range(30):
    time.sleep(max(0.0, start + number / 15 - time.monotonic()))
    cloud.header.stamp.sec = number
    publisher.publish(cloud)
time.sleep(1.0)
rclpy.shutdown()
"""

SUBSCRIBER = """
import time
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
rclpy.init()
node = rclpy.create_node("user")
seen = []
def note(cloud):
    seen.append((cloud.header.stamp.sec, len(cloud.data)))
node.create_subscription(PointCloud2, "points", note, qos_profile_sensor_data)
deadline = time.monotonic() + 30
while len(seen) < 30 and time.monotonic() < deadline and (not seen or node.count_publishers("points")):
    rclpy.spin_once(node, timeout_sec=0.1)
print(seen)
rclpy.shutdown()
"""


@pytest.mark.graph
def test_large_clouds_reach_a_best_effort_subscriber_that_sets_nothing() -> None:
    environment = {
        **clean_environment(),
        "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])),
        "ROS_DOMAIN_ID": "71",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    subscriber, publisher = (
        subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for code in (SUBSCRIBER, PUBLISHER)
    )
    try:
        _, publisher_errors = publisher.communicate(timeout=60)
        output, errors = subscriber.communicate(timeout=60)
    finally:
        publisher.kill()
        subscriber.kill()
    assert publisher.returncode == 0, publisher_errors.decode()
    assert subscriber.returncode == 0, errors.decode()
    assert output.decode().strip() == str([(number, 640 * 480 * 32) for number in range(30)])
