# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Color stripes of a de Bruijn sequence: the pattern as an image, and the color changes of a pattern that is given.

Zhang, Curless and Seitz, "Rapid shape acquisition using color structured light and multi-pass dynamic programming"
(3DPVT 2002): the colors p are three bits, red, green and blue, and the next color is p[j + 1] = p[j] xor d[j]. The
changes d are a de Bruijn sequence, so that a few of them in a row are found at one place of the pattern only.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F64, U8

__all__ = ["CHANGES", "I8", "StripePattern", "de_bruijn", "read_stripes", "stripe_pattern"]

I8 = npt.NDArray[np.int8]

# Bits that change from a stripe to the next, red 4, green 2, blue 1. Green and blue, whose spectra overlap most in
# projectors and cameras, never change together, which leaves five changes.
CHANGES = (1, 2, 4, 5, 6)
_FIRST_COLOR = 4
_SHORTEST_PX = 2
_LONGEST_WINDOW = 8
_MIN_CONTRAST = 64  # of a channel of a pattern, gray levels
_UNDECIDED = 0.15  # around the middle of the range of a channel
_LEVEL = np.array([4, 2, 1])


@dataclass(frozen=True, eq=False)
class StripePattern:
    """The places where the color of a pattern changes, and how.

    Attributes:
        size: width, height of the pattern, px.
        axis: "columns" of vertical stripes, "rows" of horizontal ones: the coordinate that the pattern codes.
        edges_px: float64 (N,), columns or rows of the changes, increasing; pixel centers have integer coordinates, so
            that a change between the pixels 1 and 2 is at 1.5.
        changes: int8 (N, 3), the change of red, green and blue: 1 rises, -1 falls, 0 stays.
        window: any so many successive changes are found once in the pattern.
    """

    size: tuple[int, int]
    axis: str
    edges_px: F64
    changes: I8
    window: int

    @property
    def length_px(self) -> int:
        """Number of columns or rows that are coded."""
        return self.size[0] if self.axis == "columns" else self.size[1]

    def turned(self) -> StripePattern:
        """The pattern rotated by half a turn."""
        edges_px = (self.length_px - 1 - self.edges_px)[::-1].copy()
        return dataclasses.replace(self, edges_px=edges_px, changes=-self.changes[::-1])


def stripe_pattern(size: tuple[int, int], stripe_px: int | None = None, window: int = 3) -> U8:
    """The pattern: vertical stripes of equal width, the last one cut off by the border.

    Args:
        size: width, height of the projector, px.
        stripe_px: width of a stripe, px; by default the smallest one for which the changes suffice, at least 2 px.
        window: any so many successive changes of color are found once in the pattern, 2 to 5. There are then up to
            5**window + window stripes.

    Returns:
        uint8 (height, width, 3), RGB, values 0 and 255.

    Raises:
        ConfigError: a size without pixels, or more stripes than there are changes for.
    """
    width, height = size
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise ConfigError(
            f"the pattern has {width}x{height} px, 1 to 16384 each are possible",
            value=size,
            limit=(1, 16384),
            remedy="give the size of the projector",
            settings=("size",),
        )
    if not 2 <= window <= 5:
        raise ConfigError(
            f"window = {window} is not in 2..5",
            value=window,
            limit=(2, 5),
            remedy="use 3, and 4 for more than 128 stripes",
            settings=("window",),
        )
    most = len(CHANGES) ** window + window
    width_px = max(_SHORTEST_PX, -(-width // most)) if stripe_px is None else stripe_px
    stripes = -(-width // width_px) if width_px >= 1 else most + 1
    if stripes > most:
        raise ConfigError(
            f"stripe_px = {width_px} gives {stripes} stripes for {width} columns, a window of {window} changes {most}"
            if width_px >= 1
            else f"stripe_px = {width_px} is below 1",
            value=width_px,
            limit=-(-width // most),
            remedy=f"use stripes of at least {-(-width // most)} px, or a longer window",
            settings=("stripe_px", "window"),
        )
    colors = np.bitwise_xor.accumulate(np.r_[_FIRST_COLOR, np.take(CHANGES, de_bruijn(len(CHANGES), window))])
    columns = colors[np.arange(width) // width_px]
    row = np.where(columns[:, None] & _LEVEL, np.uint8(255), np.uint8(0))
    return np.ascontiguousarray(np.broadcast_to(row, (height, width, 3)))


def de_bruijn(symbols: int, window: int) -> npt.NDArray[np.int64]:
    """A sequence in which each word of ``window`` symbols is found exactly once.

    An Eulerian path through the graph whose nodes are the words of ``window - 1`` symbols (de Bruijn 1946), found by
    Hierholzer's algorithm. The order of the edges differs from node to node, so that every part of the sequence has all
    symbols.

    Returns:
        int64 (symbols**window + window - 1,), values 0 to symbols - 1.
    """
    nodes = symbols ** (window - 1)
    used = [0] * nodes
    stack, path = [0], []
    while stack:
        node = stack[-1]
        if used[node] == symbols:
            path.append(stack.pop())
        else:
            symbol = (used[node] + node) % symbols
            used[node] += 1
            stack.append((node * symbols + symbol) % nodes)
    path.reverse()
    return np.array([0] * (window - 2) + [node % symbols for node in path], np.int64)


def read_stripes(pattern: npt.NDArray[Any]) -> StripePattern:
    """The color changes of a pattern, also of one made elsewhere.

    A change is where a channel crosses the middle of its range, between two pixels; changes of several channels closer
    than half of the narrowest stripe are one.

    Args:
        pattern: uint8 (H, W, 3), RGB, vertical or horizontal stripes; noise and blurred borders of the stripes are
            fine.

    Raises:
        ImageError: not such an image, or changes of color whose order does not tell them apart.
    """
    if not isinstance(pattern, np.ndarray) or pattern.dtype != np.uint8 or pattern.ndim != 3 or pattern.shape[2] != 3:
        raise ImageError(
            f"the pattern is {getattr(pattern, 'dtype', type(pattern).__name__)} {getattr(pattern, 'shape', '')}, "
            "uint8 (H, W, 3) is needed",
            subject="stripe pattern",
            value=getattr(pattern, "shape", None),
            limit="uint8 (H, W, 3)",
            remedy="read the pattern as a color image",
        )
    if not pattern.size:
        raise _not_a_code("it has no pixels", pattern.shape)
    axis, row = "columns", np.median(pattern, axis=0)
    if np.abs(pattern - row).mean() > _MIN_CONTRAST / 4:
        axis, row = "rows", np.median(pattern, axis=1)
        if np.abs(pattern - row[:, None]).mean() > _MIN_CONTRAST / 4:
            raise _not_a_code("both its rows and its columns differ", pattern.shape)
    columns, channels, signs = [], [], []
    for channel in range(3):
        values = row[:, channel]
        low, high = np.percentile(values, (2, 98))
        if high - low < _MIN_CONTRAST:
            continue
        share = (values - low) / (high - low)
        clear = np.flatnonzero(np.abs(share - 0.5) > _UNDECIDED)  # a stripe of this channel, not the border of one
        last, first = clear[:-1], clear[1:]
        turns = (share[last] > 0.5) != (share[first] > 0.5)
        last, first = last[turns], first[turns]
        columns.append(last + (0.5 - share[last]) * (first - last) / (share[first] - share[last]))
        channels.append(np.full(last.size, channel))
        signs.append(np.where(share[first] > 0.5, 1, -1))
    if not any(part.size > 1 for part in columns):
        raise _not_a_code("its colors do not change", pattern.shape)
    column, channel_of, sign = (np.concatenate(part) for part in (columns, channels, signs))
    order = np.argsort(column, kind="stable")
    column, channel_of, sign = column[order], channel_of[order], sign[order]
    narrowest = min(np.diff(part).min() for part in columns if part.size > 1)
    starts = np.r_[True, np.diff(column) > narrowest / 2 - 1e-6]
    number = np.cumsum(starts) - 1
    edges = np.bincount(number, column) / np.bincount(number)
    changes = np.zeros((edges.size, 3), np.int8)
    changes[number, channel_of] = sign
    size = (pattern.shape[1], pattern.shape[0])
    return StripePattern(size, axis, edges, changes, _unique_window(changes, pattern.shape))


def _unique_window(changes: I8, shape: tuple[int, ...]) -> int:
    """The smallest number of successive changes that are found once."""
    code = (changes.astype(np.int64) + 1) @ np.array([9, 3, 1])
    for window in range(1, min(_LONGEST_WINDOW, code.size) + 1):
        words = np.lib.stride_tricks.sliding_window_view(code, window)
        if np.unique(words, axis=0).shape[0] == words.shape[0]:
            return window
    raise _not_a_code(f"{_LONGEST_WINDOW} successive changes of its colors are found at two places", shape)


def _not_a_code(problem: str, shape: tuple[int, ...]) -> ImageError:
    return ImageError(
        f"the pattern is not a code of color stripes, {problem}",
        subject="stripe pattern",
        value=shape,
        limit="vertical or horizontal stripes",
        remedy="use a pattern of stereo-depth patterns --kind stripes, or another de Bruijn pattern",
    )
