# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shared memory of killed processes is removed at the next start; that of others is not touched."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from stereo_depth_ros.nodes import shared_memory
from stereo_depth_ros.nodes.shared_memory import remove_dead_segments

ROOT = Path(__file__).resolve().parents[1]
NAMES = ["fastrtps_0141718bcd887c5f", "fastdds_0be0ba7f2f07e886"]  # Fast DDS 2.14 and 3.2
SIZE = 64 << 10


def make_segment(folder: Path, name: str, size: int = SIZE) -> list[str]:
    """Names of the segment and its lock file."""
    (folder / name).write_bytes(b"1" * size)
    (folder / f"{name}_el").touch()
    return [name, f"{name}_el"]


@contextmanager
def locked(path: Path) -> Iterator[None]:
    with path.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("name", NAMES)
def test_segment_of_a_dead_process_is_removed(tmp_path: Path, name: str) -> None:
    make_segment(tmp_path, name)
    assert remove_dead_segments(tmp_path) == SIZE
    assert names(tmp_path) == []
    assert remove_dead_segments(tmp_path) == 0


@pytest.mark.parametrize("name", NAMES)
def test_segment_of_a_live_process_stays(tmp_path: Path, name: str) -> None:
    files = make_segment(tmp_path, name)
    with locked(tmp_path / files[1]):
        assert remove_dead_segments(tmp_path) == 0
        assert names(tmp_path) == sorted(files)
    assert remove_dead_segments(tmp_path) == SIZE


def test_segment_of_another_user_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = make_segment(tmp_path, NAMES[0])
    other = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: other)
    assert remove_dead_segments(tmp_path) == 0
    assert names(tmp_path) == sorted(files)


def test_a_process_that_has_its_lock_file_and_no_segment_yet_keeps_it(tmp_path: Path) -> None:
    lock = tmp_path / f"{NAMES[0]}_el"
    lock.touch()
    assert remove_dead_segments(tmp_path) == 0
    assert lock.exists()


@pytest.mark.parametrize(
    "name", ["fastrtps_port7001", "sem.fastrtps_port7001_mutex", "fastrtps_port22663", "other_0141718bcd887c5f", "mine"]
)
def test_other_files_stay(tmp_path: Path, name: str) -> None:
    files = make_segment(tmp_path, name)
    assert remove_dead_segments(tmp_path) == 0
    assert names(tmp_path) == sorted(files)


def test_a_link_is_not_followed(tmp_path: Path) -> None:
    folder = tmp_path / "shm"
    folder.mkdir()
    target = tmp_path / "target"
    target.touch()
    (folder / NAMES[0]).touch()
    (folder / f"{NAMES[0]}_el").symlink_to(target)
    assert remove_dead_segments(folder) == 0
    assert len(names(folder)) == 2


def test_two_processes_that_start_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The other one has removed the files between the look and the lock."""
    files = make_segment(tmp_path, NAMES[0])
    make_segment(tmp_path, NAMES[1])
    flock = fcntl.flock

    def remove_first(descriptor: int, operation: int) -> None:
        for name in files:
            (tmp_path / name).unlink(missing_ok=True)
        flock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", remove_first)
    assert remove_dead_segments(tmp_path) == SIZE
    assert names(tmp_path) == []


def test_no_folder(tmp_path: Path) -> None:
    assert remove_dead_segments(tmp_path / "absent") == 0


def test_no_flock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_segment(tmp_path, NAMES[0])
    monkeypatch.setattr(shared_memory.importlib.util, "find_spec", lambda name: None)
    assert remove_dead_segments(tmp_path) == 0


# In a mount namespace with a /dev/shm of its own: what is left there is of the first process only.
KILLED_AND_STARTED_AGAIN = """
import pathlib, subprocess, sys
from stereo_depth_ros.nodes.transport import prepare_process
owner = "import os, rclpy; rclpy.init(); node = rclpy.create_node('owner'); os.kill(os.getpid(), 9)"
def left():
    return sum(path.name.endswith("_el") and "port" not in path.name for path in pathlib.Path("/dev/shm").iterdir())
subprocess.run([sys.executable, "-c", owner])
before = left()
report = prepare_process()
print(before, left(), report.freed_bytes >> 20, report, flush=True)
"""


@pytest.mark.graph
def test_a_node_that_was_killed_leaves_nothing_for_the_next_start() -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    own_folder = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-ec"]
    if subprocess.run([*own_folder, "mount -t tmpfs shm /dev/shm"], capture_output=True).returncode:
        pytest.skip("this system does not let a user make a mount namespace")
    script = 'mount -t tmpfs -o size=600m shm /dev/shm; exec "$0" -c "$1"'
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "PYTHONPATH": path, "FASTRTPS_DEFAULT_PROFILES_FILE": str(ROOT / "config/fastdds.xml")}
    environment |= {"FASTDDS_DEFAULT_PROFILES_FILE": environment["FASTRTPS_DEFAULT_PROFILES_FILE"]}
    done = subprocess.run(
        [*own_folder, script, sys.executable, KILLED_AND_STARTED_AGAIN],
        env=environment | {"ROS_DOMAIN_ID": "72", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    counts = done.stdout.splitlines()[-1].split(maxsplit=3)
    assert int(counts[0]) > 0 and counts[1] == "0", done.stdout + done.stderr
    assert 130 <= int(counts[2]) <= 140
    assert f"removed {counts[2]} MiB of shared memory" in counts[3]
