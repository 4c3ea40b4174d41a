# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Block matching: lowest sum of absolute differences over a square window."""

from __future__ import annotations

import functools
from typing import TypeAlias

import numba
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import U8, MatchResult, Reason
from stereo_depth_ros.matching.filters.speckle_filter import I16, I32, SpeckleFilter, disparity_from_x16
from stereo_depth_ros.matching.local_consistency import local_consistency
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair, check_search
from stereo_depth_ros.matching.serial import SerialMatcher

__all__ = ["BlockMatcher"]

Sums: TypeAlias = npt.NDArray[np.uint16] | npt.NDArray[np.uint32]

BORDER = int(Reason.BORDER)
TEXTURE = int(Reason.TEXTURE)
UNIQUENESS = int(Reason.UNIQUENESS)
LEFT_RIGHT = int(Reason.LEFT_RIGHT)


class BlockMatcher(SerialMatcher):
    """Reimplementation of ``cv2.StereoBM`` (Konolige 1998) with bit-identical disparities.

    It is faster, because the sums of one row stay in the cache and use full vectors, and every rejected pixel has a
    reason. Steps: Sobel prefilter in x, clipped to +-``prefilter_cap`` (``prefilter_size`` has no effect); lowest sum
    of absolute differences; texture test; uniqueness test; sub-pixel fit; with ``disp12_max_diff`` above 0 the
    left-right check of OpenCV; speckle filter.

    As in OpenCV, ``uniqueness_ratio`` is a whole percentage, fractions are cut off, and ``speckle_range`` counts steps
    of 1/16 px. Pixels whose window or search leaves an image are BORDER. OpenCV differs for a negative
    ``min_disparity`` in the last half window of columns, which it fills from windows clamped in the right image only,
    and in the left-right check, where it includes such clamped windows at the left edge.

    ``support_px`` is the window; the Sobel prefilter reads one more pixel on all sides.
    """

    name = "bm"
    step_px = 1 / X16_STEPS

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if the search range does not fit in 16-bit disparities."""
        check_search(config)
        super().__init__(config)
        self._speckle_filter = SpeckleFilter(config.speckle_size, config.speckle_range)
        largest_sum = config.correlation_window_size**2 * 2 * config.prefilter_cap
        # The dtype of this empty array selects the kernel: sums in 16 bits are twice as fast.
        self._sum_type: Sums = np.empty(0, np.uint16) if largest_sum < 2**16 else np.empty(0, np.uint32)
        self._filtered: U8 = np.empty((2, 0, 0), np.uint8)
        self._disparity_x16: I16 = np.empty((0, 0), np.int16)

    def _match(self, left: U8, right: U8) -> MatchResult:
        config = self.config
        check_pair(left, right, self)
        disparity_px = np.empty(left.shape, np.float32)
        reasons = np.empty(left.shape, np.uint8)
        if self._disparity_x16.shape != left.shape:
            self._filtered = np.empty((2, *left.shape), np.uint8)
            self._disparity_x16 = np.zeros(left.shape, np.int16)
        rows = left.shape[0]
        run_bands(_prefilter_rows, rows, left, right, config.prefilter_cap, self._filtered)
        search = (config.correlation_window_size // 2, config.min_disparity, config.num_disparities)
        tests = (config.texture_threshold, int(config.uniqueness_ratio), config.disp12_max_diff)
        buffers = (self._sum_type, self._disparity_x16, reasons)
        values = (self._filtered, config.prefilter_cap, *search, *tests, *buffers)
        # Every band starts by summing a whole window height.
        run_bands(_match_rows, rows, *values, min_rows=max(64, 2 * config.correlation_window_size))
        self._speckle_filter(self._disparity_x16, reasons)
        disparity_from_x16(self._disparity_x16, reasons, disparity_px)
        return MatchResult(disparity_px, reasons, self.step_px, functools.partial(local_consistency, disparity_px))


@compiled()
def _sobel_rows(first: int, last: int, image: U8, cap: int, out: U8, side: int) -> None:
    """Horizontal Sobel response clipped to +-cap, plus cap; rows are mirrored at the top and bottom."""
    height, width = image.shape
    low, high = np.int16(-cap), np.int16(cap)
    for y in range(first, last):
        if y == height - 1 and height % 2:  # OpenCV filters rows in pairs and leaves the odd one flat
            out[side, y] = cap
            continue
        above = image[y - 1 if y > 0 else 1]
        here = image[y]
        below = image[y + 1 if y < height - 1 else y - 1]
        out[side, y, 0] = out[side, y, width - 1] = cap
        for x in range(1, width - 1):
            slope = np.int16(np.int16(above[x + 1]) - above[x - 1] + np.int16(below[x + 1]) - below[x - 1])
            slope = np.int16(slope + 2 * (np.int16(here[x + 1]) - here[x - 1]))
            out[side, y, x] = np.uint8(min(max(slope, low), high) + cap)


@compiled(numba.void(numba.int64, numba.int64, READ_ONLY_U8, READ_ONLY_U8, numba.int64, numba.uint8[:, :, ::1]))
def _prefilter_rows(first: int, last: int, left: U8, right: U8, cap: int, out: U8) -> None:
    _sobel_rows(first, last, left, cap, out, 0)
    _sobel_rows(first, last, right, cap, out, 1)


@compiled()
def _slide_columns(sums: Sums, textures: I32, rows: U8, begin: int, max_disparity: int, cap: int) -> None:
    """Add the row that enters to the sums of every column, subtract the one that leaves."""
    cast = sums.dtype.type
    for c in range(textures.size):
        x = begin + c
        a, b = rows[0, x], rows[2, x]
        textures[c] += abs(np.int32(a) - cap) - abs(np.int32(b) - cap)
        column, start = np.uint64(c), np.uint64(x - max_disparity)
        for k in range(np.uint64(sums.shape[1])):
            p, q = rows[1, start + k], rows[3, start + k]
            enters, leaves = np.uint8(max(a, p) - min(a, p)), np.uint8(max(b, q) - min(b, q))
            sums[column, k] = cast(sums[column, k] + cast(enters) - cast(leaves))


@compiled()
def _offset(before: np.int64, here: np.int64, after: np.int64) -> np.int64 | int:
    """Sub-pixel part in 1/256 px, from two lines of opposite slope through the costs."""
    width = after + before - 2 * here + abs(after - before)
    if width == 0:
        return 0
    offset = abs(after - before) * 256 // width
    return offset if after > before else -offset


@compiled()
def _search_row(
    y: int,
    sums: Sums,
    textures: I32,
    first_x: int,
    half: int,
    max_disparity: int,
    texture: int,
    uniqueness: int,
    disparity_x16: I16,
    costs: I32,
    reasons: U8,
) -> None:
    """Slide the window along one row; write the best disparity of each pixel, or the reason against it."""
    cast = sums.dtype.type
    most = cast(-1)
    count = np.uint64(sums.shape[1])
    last = sums.shape[1] - 1
    window = np.zeros(sums.shape[1], sums.dtype)
    texture_sum = 0
    for c in range(textures.size):
        # The column that leaves the window; at the start, the empty column after the last.
        leaves = c - 2 * half - 1 if c > 2 * half else textures.size
        plus, minus = np.uint64(c), np.uint64(leaves)
        best = most
        for k in range(count):
            total = cast(window[k] + sums[plus, k] - sums[minus, k])
            window[k] = total
            best = min(best, total)
        texture_sum += textures[c] - (textures[leaves] if c > 2 * half else 0)
        if c < 2 * half:
            continue
        x = first_x + c - 2 * half
        if texture_sum < texture:
            reasons[y, x] = TEXTURE
            continue
        limit = cast(min(np.int64(most), np.int64(best) * (100 + uniqueness) // 100))
        near, at = cast(0), most
        for k in range(count):
            near = cast(near + cast(window[k] <= limit))
            at = min(at, cast(k) if window[k] == best else most)
        index = np.int64(at)
        after = np.int64(window[index + 1]) if index < last else np.int64(most)
        before = np.int64(window[index - 1]) if index > 0 else np.int64(most)
        inner = 0 < index < last
        others = near - 1 - (index > 0 and before <= limit) - (index < last and after <= limit)
        offset = _offset(before, np.int64(best), after) if inner else 0
        disparity_x16[y, x] = (max_disparity - index) * 256 + offset + 15 >> 4
        costs[x] = best
        reasons[y, x] = UNIQUENESS if uniqueness > 0 and others > 0 else 0


@compiled()
def _check_right(disparity_x16: I16, reasons: U8, costs: I32, y: int, tolerance: int) -> None:
    """Mark pixels of one row whose right pixel prefers a disparity over ``tolerance`` px away, for both roundings."""
    width = disparity_x16.shape[1]
    right_costs = np.full(width, np.int32(2**31 - 1))
    right_x16 = np.zeros(width, np.int16)
    for x in range(width):
        if reasons[y, x] == 0:
            at = x - (disparity_x16[y, x] + 8 >> 4)
            if costs[x] < right_costs[at]:
                right_costs[at] = costs[x]
                right_x16[at] = disparity_x16[y, x]
    for x in range(width):
        if reasons[y, x] == 0:
            disagree = True
            for at in (x - (disparity_x16[y, x] >> 4), x - (disparity_x16[y, x] + 15 >> 4)):
                known = 0 <= at < width and right_costs[at] < 2**31 - 1
                disagree &= known and abs(np.int32(right_x16[at]) - disparity_x16[y, x]) > 16 * tolerance
            if disagree:
                reasons[y, x] = LEFT_RIGHT


@compiled(
    *(
        f"void(int64, int64, uint8[:, :, ::1], {'int64, ' * 7} {sums}[::1], int16[:, ::1], uint8[:, ::1])"
        for sums in ("uint16", "uint32")
    )
)
def _match_rows(
    first: int,
    last: int,
    filtered: U8,
    cap: int,
    half: int,
    min_disparity: int,
    num_disparities: int,
    texture: int,
    uniqueness: int,
    tolerance: int,
    sum_type: Sums,
    disparity_x16: I16,
    reasons: U8,
) -> None:
    """Disparities of a band of rows, or the reason against them.

    ``sums[c, k]`` is the cost of column c and disparity index k over one window height: one row enters, one leaves. A
    window is the sum of such columns over one window width. Index k counts down from the largest disparity, so that it
    increases along the right image. For vectorization, sums keep their narrow type through every operation, inner loops
    write one array each, indices are unsigned (no wrap-around of negative ones), and no view of an array is created per
    pixel (reference counts are atomic).
    """
    height, width = disparity_x16.shape
    max_disparity = min_disparity + num_disparities - 1
    begin = max(0, max_disparity)  # the columns whose whole search lies in the right image
    end = width + min(0, min_disparity)
    sums = np.zeros((end - begin + 1, num_disparities), sum_type.dtype)
    textures = np.zeros(end - begin, np.int32)
    costs = np.empty(width, np.int32)
    rows = np.full((4, width), np.uint8(cap))  # left and right row that enter, left and right row that leave
    reasons[first:last] = BORDER
    first_row = max(first, half)
    for y in range(first_row - 2 * half, min(last, height - half)):
        rows[:2] = filtered[:, y + half]
        if y > first_row:
            rows[2:] = filtered[:, y - half - 1]
        _slide_columns(sums, textures, rows, begin, max_disparity, cap)
        if y >= first_row:
            _search_row(
                y, sums, textures, begin + half, half, max_disparity, texture, uniqueness, disparity_x16, costs, reasons
            )
            if tolerance > 0:
                _check_right(disparity_x16, reasons, costs, y, tolerance)
