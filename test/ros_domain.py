# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS domains of tests: distinct in the processes of one run, and in several runs on one machine."""

from __future__ import annotations

import functools
import os
import tempfile
import zlib
from pathlib import Path
from typing import IO

__all__ = ["own_number"]

_held: list[IO[bytes]] = []  # until this process ends


@functools.cache
def own_number(count: int) -> int:
    """A number from 0 to ``count - 1`` that no other process on this machine has while this one runs.

    Where all are taken, or files cannot be locked, no other of up to ``count`` processes of this run has it.
    """
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    start = (zlib.crc32(run.encode()) + worker) % count
    return next((number for number in (*range(start, count), *range(start)) if _take(f"{count}_{number}")), start)


def _take(name: str) -> bool:
    """Lock a file of this name; whether it was free."""
    try:
        import fcntl

        path = Path(tempfile.gettempdir()) / f"stereo_depth_ros_tests_{os.getuid()}_{name}.lock"
        file = path.open("wb")
    except (ImportError, OSError):
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return False
    _held.append(file)
    return True
