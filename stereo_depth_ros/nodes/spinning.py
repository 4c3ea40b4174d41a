# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Spins a node whose frames overlap: the thread that received a frame works on it, another one receives the next."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rclpy.executors import Executor

__all__ = ["spin_overlapped"]


def spin_overlapped(executor: Executor, run_one: Callable[[], bool], threads: int) -> None:
    """Spin until the context is shut down; callbacks run one after the other, in changing threads.

    Args:
        executor: of the node.
        run_one: works on a frame that a callback has queued; whether there was one.
        threads: one more than the frames under way at the same time.

    Raises:
        Exception: the first one that a callback raised; ExternalShutdownException after a shutdown.
    """
    spinning = threading.Lock()
    errors: list[BaseException] = []

    def spin() -> None:
        while not errors:
            try:
                if run_one():
                    continue
                with spinning:
                    if not errors:
                        executor.spin_once()
            except BaseException as error:  # raised again by the caller
                errors.append(error)

    for _ in range(threads - 1):
        threading.Thread(target=spin, daemon=True).start()
    spin()
    raise errors[0]
