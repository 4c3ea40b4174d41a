# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Removes the shared memory of Fast DDS that processes left behind when they were killed."""

from __future__ import annotations

import importlib.util
import os
import re
from contextlib import suppress
from pathlib import Path

__all__ = ["remove_dead_segments"]

# Fast DDS 2.x and 3.x; the lock file of a segment has its name and _el.
_LOCK = re.compile(r"(fastrtps|fastdds)_[0-9a-f]{16}_el")


def remove_dead_segments(folder: Path) -> int:
    """Remove the segments of this user whose owner has ended.

    The owner holds the lock of the lock file from before it makes the segment until it ends, whatever ends it; Fast DDS
    itself decides by this lock. The names of segments are random and not used again: what has lost its owner has none
    for ever. Ports of Fast DDS are not touched. They are small, and a process that needs one takes over what is left.

    Args:
        folder: where segments are, /dev/shm.

    Returns:
        Bytes freed; 0 where the system has no flock or the folder does not exist.
    """
    if importlib.util.find_spec("fcntl") is None:
        return 0
    freed = 0
    with suppress(FileNotFoundError), os.scandir(folder) as entries:
        for entry in entries:
            if _LOCK.fullmatch(entry.name):
                with suppress(OSError):  # locked, or removed by another process meanwhile
                    freed += _remove_if_dead(Path(entry.path))
    return freed


def _remove_if_dead(lock: Path) -> int:
    """Remove the segment of a lock file; its size in memory, 0 where it is another user's.

    Raises:
        OSError: the lock is taken, or a file is not there.
    """
    import fcntl

    segment = lock.with_name(lock.name.removesuffix("_el"))
    status = segment.lstat()  # while there is none, its owner may be about to take the lock
    if {status.st_uid, lock.lstat().st_uid} != {os.getuid()}:
        return 0
    descriptor = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        segment.unlink()
        lock.unlink()
    finally:
        os.close(descriptor)
    return status.st_blocks * 512
