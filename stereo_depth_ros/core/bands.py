# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parallel execution of kernels over bands of image rows."""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

__all__ = ["core_count", "run_bands"]


def core_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: respects taskset and containers
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(core_count() - 1, 1), thread_name_prefix="bands")


# A forked child has the pool object but none of its threads.
os.register_at_fork(after_in_child=_pool.cache_clear)


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
    others = [(_pool().submit(call), call) for call in calls[1:]]
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
