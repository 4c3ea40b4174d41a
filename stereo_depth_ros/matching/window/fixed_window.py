# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Area correlation with square windows."""

from __future__ import annotations

from typing import TypeAlias

import numba
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.matching.filters.speckle_filter import I16
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair, check_search
from stereo_depth_ros.matching.selection.float_costs import I64, finish, median_filter, select_row
from stereo_depth_ros.matching.serial import SerialMatcher

__all__ = ["WindowMatcher"]

U32: TypeAlias = npt.NDArray[np.uint32]

COSTS = ("sad", "ssd", "zsad", "zssd", "ncc", "zncc")
SAD, SSD, ZSAD, ZSSD, NCC, ZNCC = range(6)
NO_BOUND = 255  # the largest possible gray-level difference


class WindowMatcher(SerialMatcher):
    """Area correlation over a square window of odd side ``correlation_window_size`` (Scharstein and Szeliski 2002).

    Lowest ``window_cost`` of the left window I and the right window J (means over the window are Im, Jm; n pixels):
    sad = sum |I - J| / n, ssd = sum (I - J)^2 / n, zsad and zssd the same of I - Im and J - Jm,
    ncc = 1 - sum I J / sqrt(sum I^2 sum J^2), zncc the same of I - Im and J - Jm. Windows are cropped at the edges of
    both images. A window without contrast has no correlation; a left pixel without any correlation is TEXTURE.
    ``max_difference`` above 0 truncates |I - J| of a pixel in sad, which limits the effect of outliers.

    With ``vertical_search`` = v, the cost of a disparity is the minimum over right windows -v..v rows away; the best
    row offset is not reported. The left-right check (``disp12_max_diff`` above 0) then tests whether another pixel of
    the left row claims the same column in any row.

    After winner, uniqueness and left-right check, the disparities are median filtered with the size of the window, as
    the errors of a window are correlated over about its side. Running sums make the time independent of the window
    size, except for zsad, whose absolute values depend on the means, and for the median (linear in the side).
    ``speckle_range`` is in px.

    ``support_px`` is the window.
    """

    name = "window"
    step_px = 1 / X16_STEPS

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if the search range does not fit in 16 bits, or another cost than sad is truncated."""
        check_search(config)
        if config.max_difference and config.window_cost != "sad":
            raise ConfigError(
                f"max_difference = {config.max_difference} truncates sad, not {config.window_cost}",
                value=config.max_difference,
                limit=0,
                remedy="use the cost sad, or no truncation",
                settings=("max_difference", "window_cost"),
            )
        super().__init__(config)

    def _match(self, left: U8, right: U8) -> MatchResult:
        config = self.config
        check_pair(left, right, self)
        disparity_x16 = np.zeros(left.shape, np.int16)
        reasons = np.empty(left.shape, np.uint8)
        side = config.correlation_window_size
        images = (left, right)
        search = (side // 2, config.vertical_search, config.min_disparity, config.num_disparities)
        checks = (config.uniqueness_ratio, config.disp12_max_diff)
        cost = (COSTS.index(config.window_cost), config.max_difference or NO_BOUND)
        values = (*images, *cost, *search, *checks, disparity_x16, reasons)
        # Every band starts by summing a whole window height.
        run_bands(_match_rows, left.shape[0], *values, min_rows=max(64, 2 * side))
        disparity_x16 = median_filter(disparity_x16, reasons, side)
        return finish(disparity_x16, reasons, config, self.step_px)


@compiled()
def _add_row(pairs: U32, singles: I64, a: U8, b: U8, kind: int, bound: int, max_disparity: int, sign: int) -> None:
    """Add one row to (or subtract it from) the sums over the window height of every column and disparity."""
    width, count = pairs.shape
    limit = np.uint32(bound)
    factor = np.uint32(sign)  # modulo 2^32: -1 subtracts
    for x in range(width):
        here, there = np.int64(a[x]), np.int64(b[x])
        singles[0, x] += sign * here
        singles[1, x] += sign * here * here
        singles[2, x] += sign * there
        singles[3, x] += sign * there * there
    if kind == ZSAD:
        return
    for x in range(width):
        low, high = max(0, max_disparity - x), min(count, width - x + max_disparity)
        value = np.uint32(a[x])
        for k in range(low, high):
            other = np.uint32(b[x - max_disparity + k])
            term = min(max(value, other) - min(value, other), limit) if kind == SAD else value * other
            pairs[x, k] = np.uint32(pairs[x, k] + np.uint32(factor * np.uint32(term)))


@compiled()
def _dissimilarity(kind: int, n: int, pair: np.int64, a: int, aa: int, b: int, bb: int) -> float:
    """Cost of two windows of ``n`` pixels from the sum of |I - J| (sad, zsad) or I J, and of I, I^2, J, J^2."""
    if kind in (SAD, ZSAD):
        return pair / n
    if kind == SSD:
        return (aa + bb - 2 * pair) / n
    if kind == ZSSD:
        return (n * (aa + bb - 2 * pair) - (a - b) * (a - b)) / (n * n)
    if kind == ZNCC:
        pair, aa, bb = n * pair - a * b, n * aa - a * a, n * bb - b * b
    power = np.float64(aa) * np.float64(bb)
    return max(0.0, 1 - pair / np.sqrt(power)) if power > 0 else np.inf


@compiled()
def _cost_row(pairs: U32, prefix: I64, kind: int, rows: int, half: int, max_disparity: int, costs: F32) -> None:
    """Lower ``costs`` (W, D) of one row to those of windows of height ``rows``; all costs except zsad."""
    width, count = pairs.shape
    window = np.zeros(count, np.uint32)
    for x in range(-half, width):
        enters, leaves = x + half, x - half - 1
        if enters < width:
            for k in range(count):
                window[k] = np.uint32(window[k] + pairs[enters, k])
        if leaves >= 0:
            for k in range(count):
                window[k] = np.uint32(window[k] - pairs[leaves, k])
        if x < 0:
            continue
        for k in range(max(0, max_disparity - x), min(count, width - x + max_disparity)):
            d = max_disparity - k
            begin, end = max(x - half, 0, d), min(x + half + 1, width, width + d)
            a, aa = prefix[0, end] - prefix[0, begin], prefix[1, end] - prefix[1, begin]
            b, bb = prefix[2, end - d] - prefix[2, begin - d], prefix[3, end - d] - prefix[3, begin - d]
            cost = _dissimilarity(kind, rows * (end - begin), np.int64(window[k]), a, aa, b, bb)
            costs[x, k] = min(costs[x, k], np.float32(cost))


@compiled()
def _zsad_row(
    left: U8, right: U8, y: int, offset: int, prefix: I64, rows: int, half: int, max_disparity: int, costs: F32
) -> None:
    """As :func:`_cost_row` for zsad, summed separately for every window."""
    height, width = left.shape
    count = costs.shape[1]
    shift, total = np.empty(count, np.float32), np.empty(count, np.float32)
    for x in range(width):
        low, high = max(0, max_disparity - x), min(count, width - x + max_disparity)
        total[:] = 0
        for k in range(low, high):
            d = max_disparity - k
            begin, end = max(x - half, 0, d), min(x + half + 1, width, width + d)
            difference = prefix[0, end] - prefix[0, begin] - prefix[2, end - d] + prefix[2, begin - d]
            shift[k] = difference / (rows * (end - begin))
        for row in range(max(0, y - half, -offset), min(height, y + half + 1, height - offset)):
            for column in range(max(0, x - half), min(width, x + half + 1)):
                value, start = np.float32(left[row, column]), column - max_disparity
                for k in range(max(low, -start), min(high, width - start)):
                    total[k] += abs(value - np.float32(right[row + offset, start + k]) - shift[k])
        for k in range(low, high):
            d = max_disparity - k
            begin, end = max(x - half, 0, d), min(x + half + 1, width, width + d)
            costs[x, k] = min(costs[x, k], total[k] / np.float32(rows * (end - begin)))


@compiled(
    numba.void(
        *(numba.int64, numba.int64, READ_ONLY_U8, READ_ONLY_U8, *(numba.int64,) * 6, numba.float64, numba.int64),
        *(numba.int16[:, ::1], numba.uint8[:, ::1]),
    )
)
def _match_rows(
    first: int,
    last: int,
    left: U8,
    right: U8,
    kind: int,
    bound: int,
    half: int,
    vertical: int,
    min_disparity: int,
    count: int,
    uniqueness: float,
    tolerance: int,
    disparity_x16: I16,
    reasons: U8,
) -> None:
    """Disparities of a band of rows, or the reason against them; sums are integers, independent of their order."""
    height, width = left.shape
    max_disparity = min_disparity + count - 1
    offsets = 2 * vertical + 1
    pairs = np.zeros((offsets, width, count), np.uint32)
    singles = np.zeros((offsets, 4, width), np.int64)
    rows = np.zeros(offsets, np.int64)
    prefix = np.zeros((4, width + 1), np.int64)
    costs = np.empty((width, count), np.float32)
    parabola = kind != SAD and kind != ZSAD
    for y in range(first - 2 * half, last):
        costs[:] = np.inf
        for v in range(offsets):
            offset = v - vertical
            for row, sign in ((y + half, 1), (y - half - 1, -1)):
                known = 0 <= row < height and 0 <= row + offset < height
                if known and (sign > 0 or y > first):
                    _add_row(pairs[v], singles[v], left[row], right[row + offset], kind, bound, max_disparity, sign)
                    rows[v] += sign
            if y < first or rows[v] == 0:
                continue
            for term in range(4):
                prefix[term, 1:] = np.cumsum(singles[v, term])
            if kind == ZSAD:
                _zsad_row(left, right, y, offset, prefix, rows[v], half, max_disparity, costs)
            else:
                _cost_row(pairs[v], prefix, kind, rows[v], half, max_disparity, costs)
        if y >= first:
            select_row(y, costs, max_disparity, parabola, uniqueness, tolerance, disparity_x16, reasons)
