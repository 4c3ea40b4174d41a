# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS domains of tests: distinct in the processes of one run, and likely to be so in several runs on one machine."""

from __future__ import annotations

import os
import zlib

__all__ = ["own_number"]


def own_number(count: int) -> int:
    """A number from 0 to ``count - 1`` that no other of up to ``count`` processes of this run has."""
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    return (zlib.crc32(run.encode()) + worker) % count
