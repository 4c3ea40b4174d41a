# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parallel execution of kernels over bands of image rows."""

from __future__ import annotations

import functools
import itertools
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import TypeAlias

__all__ = ["core_count", "run_bands"]

_Queue: TypeAlias = "SimpleQueue[tuple[Future[None], Callable[[], None]]]"


def core_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: respects taskset and containers
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def _queue() -> _Queue:
    """Bands for the other cores, and their threads.

    A ThreadPoolExecutor that is interrupted while it starts a thread is waited for at the end of the process, for ever.
    """
    queue: _Queue = SimpleQueue()
    for number in range(max(core_count() - 1, 1)):
        threading.Thread(target=_work, args=(queue,), name=f"bands_{number}", daemon=True).start()
    return queue


# A forked child has the queue but none of its threads.
os.register_at_fork(after_in_child=_queue.cache_clear)


def _work(queue: _Queue) -> None:
    while True:
        future, call = queue.get()
        if future.set_running_or_notify_cancel():
            try:
                future.set_result(call())
            except BaseException as error:  # run_bands raises it
                future.set_exception(error)
        del future, call  # they hold the images


def _submit(call: Callable[[], None]) -> Future[None]:
    future: Future[None] = Future()
    _queue().put((future, call))
    return future


def run_bands(kernel: Callable[..., None], rows: int, *args: object, min_rows: int = 64) -> None:
    """Calls ``kernel(first_row, last_row, *args)`` for bands that together cover rows 0 to ``rows``, last exclusive.

    One band per core, of at least ``min_rows`` rows (a single band if there are fewer); the calling thread works too.
    Returns when all bands are done. Numba's ``parallel=True`` is not used: its workqueue layer is not thread-safe, and
    its OpenMP layer is not available everywhere.

    Args:
        kernel: must release the GIL, otherwise the bands run one after the other.
        rows: with 0 nothing is called.

    Raises:
        Exception: the first one raised by a band, after all bands have ended.
    """
    if rows <= 0:
        return
    bands = max(1, min(core_count(), rows // min_rows))
    edges = [rows * band // bands for band in range(bands + 1)]
    calls = [functools.partial(kernel, first, last, *args) for first, last in itertools.pairwise(edges)]
    others = [(_submit(call), call) for call in calls[1:]]
    errors: list[BaseException] = []
    _collect(calls[0], errors)
    for future, call in others:
        # Bands not yet started run here: no waiting for other callers, no deadlock when nested.
        _collect(call if future.cancel() else future.result, errors)
    if errors:
        raise errors[0]


def _collect(call: Callable[[], None], errors: list[BaseException]) -> None:
    try:
        call()
    except BaseException as error:  # re-raised when no band uses the buffers any more
        errors.append(error)
