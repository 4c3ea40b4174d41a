# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels, and running them over bands of image rows on all cores."""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

__all__ = ["core_count", "run_bands"]


def core_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: what taskset and containers leave us
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(core_count() - 1, 1), thread_name_prefix="bands")


# A forked child has the pool object but none of its threads.
os.register_at_fork(after_in_child=_pool.cache_clear)


def run_bands(kernel: Callable[..., None], rows: int, *args: object, min_rows: int = 64) -> None:
    """Calls ``kernel(first_row, last_row, *args)`` for bands that together cover rows 0 to ``rows``, last exclusive.

    One band a core, of at least ``min_rows`` rows (the whole when there are fewer); the calling thread works too.
    Returns when all bands are done. Numba's own ``parallel=True`` is not used: its workqueue layer must not be entered
    by two Python threads at once, and its OpenMP layer is not everywhere.

    Args:
        kernel: releases the interpreter lock, or bands run one after the other.
        rows: 0 calls nothing.

    Raises:
        Exception: the first that a band raised, after all bands have ended.
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
        # A band that no thread has begun is done here: no waiting behind other callers, no deadlock when nested.
        _collect(call if future.cancel() else future.result, errors)
    if errors:
        raise errors[0]


def _collect(call: Callable[[], None], errors: list[BaseException]) -> None:
    try:
        call()
    except BaseException as error:  # re-raised once no band touches the buffers any more
        errors.append(error)
