# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels, and running them over bands of image rows on all cores."""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numba

__all__ = ["READ_ONLY_U8", "compiled", "core_count", "run_bands"]

FunctionT = TypeVar("FunctionT", bound=Callable[..., object])

# Images as they come: numpy.frombuffer gives arrays that cannot be written, and writeable ones are accepted as well.
READ_ONLY_U8 = numba.types.Array(numba.uint8, 2, "C", readonly=True)


def compiled(*signatures: Any, allocates: bool = True) -> Callable[[FunctionT], FunctionT]:
    """Decorator: machine code that runs without the interpreter lock, kept on disk between processes.

    Kernels give explicit signatures, so that they are compiled (or read from the disk) when their module is imported
    and never in the first frame. Helpers that only kernels call give none and become part of those kernels.

    Args:
        signatures: of numba.
        allocates: False for functions that make no arrays: then views of arrays are not counted, which would be atomic
            operations across threads, and cost nothing even for every pixel. Such helpers are always inlined; the
            others are left to LLVM, which does better with long ones.
    """

    def decorate(function: FunctionT) -> FunctionT:
        inlined = not signatures and not allocates
        kernel: Any = numba.njit(nogil=True, forceinline=inlined, _nrt=allocates)(function)
        if signatures:
            kernel.enable_caching()
            # Numba looks at the file of the kernel alone; the helpers that become part of it are in others, too.
            kernel._cache._cache_file._source_stamp = _sources_stamp()
            for signature in signatures:
                kernel.compile(signature)
            kernel.disable_compile()
        return kernel  # type: ignore[no-any-return]

    return decorate


@functools.cache
def _sources_stamp() -> tuple[tuple[str, int, int], ...]:
    """Name, time and size of every file that may be part of a kernel: all but nodes and the command line."""
    root = Path(__file__).parent
    paths = (path for path in sorted(root.rglob("*.py")) if path.relative_to(root).parts[0] not in ("nodes", "cli"))
    return tuple((str(path.relative_to(root)), path.stat().st_mtime_ns, path.stat().st_size) for path in paths)


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
