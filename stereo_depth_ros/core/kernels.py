# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels: machine code without the interpreter lock, kept on disk."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

__all__ = ["READ_ONLY_U8", "compiled"]


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
    root = Path(__file__).parents[1]
    paths = (path for path in sorted(root.rglob("*.py")) if path.relative_to(root).parts[0] not in ("nodes", "cli"))
    return tuple((str(path.relative_to(root)), path.stat().st_mtime_ns, path.stat().st_size) for path in paths)
