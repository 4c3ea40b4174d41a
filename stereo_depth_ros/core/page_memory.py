# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays that begin with a page of memory, so that vectors of their rows cover few cache lines."""

from __future__ import annotations

import math
from mmap import PAGESIZE
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

__all__ = ["on_pages"]


def on_pages(shape: tuple[int, ...], dtype: DTypeLike, fill: int = 0) -> Any:
    """A page-aligned array of one value."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.empty(size + PAGESIZE, np.uint8)
    begin = -memory.ctypes.data % PAGESIZE
    array = memory[begin : begin + size].view(dtype).reshape(shape)
    array[...] = fill
    return array
