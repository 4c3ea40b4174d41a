# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hole filling with the planes of the surrounding surfaces, chosen by edges of the image and by occlusion."""

from __future__ import annotations

import numba
import numpy as np

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import F32, U8, U16
from stereo_depth_ros.matching.filters.hole_filling import fill_holes

__all__ = ["PlaneFilling"]

# A plane is fitted to every fifth pixel of 31 x 31. First to what differs from the disparity of the center by up to
# 1 px and 0.15 px for each pixel of distance, then twice to what differs from the plane by up to 1 px.
RADIUS, STRIDE, FITS = 15, 5, 2
TOLERANCE_PX, TOLERANCE_SLOPE = np.float32(1), np.float32(0.15)
LEAST_SAMPLES = 6
TILE = 16  # px, whose pixels share planes that pass within REUSE_PX of their disparities
SHARED, REUSE_PX = 4, np.float32(0.5)
RIDGE = np.float32(250)  # px^2, pulls the slope to 0 where few samples determine it

# The score of a proposal; its weight is exp(-score).
GRAY_LEVELS = np.float32(20)  # of differences along the ray, that count 1
DISTANCE_PX = np.float32(30)
UNMATCHED = np.float32(1)  # the right pixel that would be the same point has no match, although both cameras see it
CONTRADICTED = np.float32(1000)  # more than any other: the right pixel is the match of something behind
STEP_PX = np.float32(1)
OCCLUSION_MARGIN_PX = np.float32(3)
QUANTILE, OCCLUDED_QUANTILE = np.float32(0.5), np.float32(0.2)

# Directions of the rays: the first four end above or to the left, the others at the opposite side.
DY = np.array([0, -1, -1, -1, 0, 1, 1, 1])
DX = np.array([-1, -1, 0, 1, 1, 1, 0, -1])
RAYS, BACK, ONWARD = 8, 0, 4
PER_STEP = (np.hypot(DY, DX) / DISTANCE_PX).astype(np.float32)
PER_GRAY_LEVEL = np.float32(1 / GRAY_LEVELS)
WEIGHT_STEPS = 16  # of the table, for each 1 of the score
WEIGHTS = np.exp(-np.arange(8 * WEIGHT_STEPS + 1) / WEIGHT_STEPS).astype(np.float32)
LARGEST = 65535  # of steps and sums of differences
INFINITE = np.float32(np.inf)
NAN = np.float32(np.nan)


class PlaneFilling:
    """Fills every hole from the surfaces around it.

    From each pixel of a hole rays go in eight directions to the nearest disparities. A plane is fitted to the surface
    that a ray meets, robustly, and proposes its disparity at the pixel. The result is the weighted median of the
    proposals (as the interpolation of Zbontar and LeCun 2016, with the planes of Bleyer and Gelautz 2005). A weight
    falls with the length of the ray and with the sum of absolute differences of the image along it, as surfaces rarely
    continue across edges.

    The right image contradicts a proposal if the surface would hide what was matched there: a pixel x of disparity d is
    at x - d, and if a smaller disparity has been found for that right pixel, nothing can be before it. Such proposals
    count only where there is no other. Between a surface on the left and a nearer one on the right, as many pixels are
    occluded as their disparities differ: there the lower quintile of the proposals is taken, the background.

    Buffers are kept between images of one size. The result does not depend on the number of cores.

    Args:
        step_px: resolution to which disparities are rounded.
    """

    def __init__(self, step_px: float) -> None:
        self._steps_per_px = np.float32(1 / step_px)
        self._steps: U16 = np.empty((2, 0, 0, RAYS // 2), np.uint16)

    def __call__(self, disparity_px: F32, reasons: U8, left: U8) -> None:
        """Fill all holes, in place. An empty map is unchanged.

        Args:
            disparity_px: float32 (H, W), px, NaN where invalid.
            reasons: uint8 (H, W), becomes 0 everywhere.
            left: uint8 (H, W), the image that the disparities belong to.
        """
        height, width = disparity_px.shape
        if self._steps.shape[1:3] != disparity_px.shape:
            self._steps = np.zeros((2, height, width, RAYS // 2), np.uint16)
            self._differences = np.zeros_like(self._steps)
            self._planes = np.zeros((height, width, 3), np.float32)
            self._right = np.empty_like(disparity_px)
            self._beside = np.empty(disparity_px.shape, np.uint8)
            self._limits = np.empty((height, 2), np.float32)
            self._scratch = np.empty((height, 3, RAYS), np.float32)
        fitted = (self._planes, self._right, self._beside, self._limits)
        run_bands(_fit_tiles, -(-height // TILE), disparity_px, *fitted, min_rows=8)
        low, high = self._limits[:, 0].min(), self._limits[:, 1].max()
        if low > high:
            return
        rays = (self._steps, self._differences)
        run_bands(_trace_rays, 2, disparity_px, left, *rays, min_rows=1)
        given = (*rays, self._planes, self._right, self._scratch, low, high, self._steps_per_px)
        run_bands(_fill_rows, height, *given, disparity_px)
        if np.isnan(disparity_px).any():  # pixels whose rays meet nothing
            fill_holes(disparity_px, reasons)
        reasons[:] = 0


@compiled(
    numba.void(
        *(numba.int64, numba.int64, numba.float32[:, ::1], READ_ONLY_U8),
        *(numba.uint16[:, :, :, ::1], numba.uint16[:, :, :, ::1]),
    ),
    allocates=False,
)
def _trace_rays(first: int, last: int, disparity_px: F32, left: U8, steps: U16, differences: U16) -> None:
    """For each pixel of a hole the steps to the nearest disparity along each ray, 0 without one, and the differences.

    Args:
        first, last: the scans to make: 0 forwards, 1 backwards.
        disparity_px: float32 (H, W), NaN where invalid.
        left: uint8 (H, W).
        steps: uint16 (2, H, W, 4), written in holes.
        differences: uint16 (2, H, W, 4), sum of the absolute differences of gray levels of successive pixels.
    """
    height, width = disparity_px.shape
    for scan in range(first, last):
        for row in range(height):
            y = row if scan == 0 else height - 1 - row
            for column in range(width):
                x = column if scan == 0 else width - 1 - column
                if not np.isnan(disparity_px[y, x]):
                    continue
                for n in range(RAYS // 2):
                    j, i = y + DY[scan * RAYS // 2 + n], x + DX[scan * RAYS // 2 + n]
                    number, total = 0, 0
                    if 0 <= j < height and 0 <= i < width:
                        known = not np.isnan(disparity_px[j, i])
                        before = 0 if known else int(np.int64(steps[scan, j, i, n]))
                        if known or before > 0:
                            number = before + 1
                            total = int(abs(np.int64(left[y, x]) - np.int64(left[j, i])))
                            total += 0 if known else int(np.int64(differences[scan, j, i, n]))
                    steps[scan, y, x, n] = min(number, LARGEST)
                    differences[scan, y, x, n] = min(total, LARGEST)


@compiled(
    "void(int64, int64, float32[:, ::1], float32[:, :, ::1], float32[:, ::1], uint8[:, ::1], float32[:, ::1])",
    allocates=False,
)
def _fit_tiles(first: int, last: int, disparity_px: F32, planes: F32, right: F32, beside: U8, limits: F32) -> None:
    """Planes of the pixels beside holes, and the largest disparity of each right pixel.

    Args:
        first, last: rows of tiles.
        disparity_px: float32 (H, W), NaN where invalid.
        planes: float32 (H, W, 3), written beside holes: disparity at the pixel, its change per column and per row.
        right: float32 (H, W), NaN where no left pixel has its match.
        beside: uint8 (H, W), written: 1 where a disparity has a hole among its eight neighbors.
        limits: float32 (H, 2), written: the smallest and the largest disparity of each row, inf and -inf without any.
    """
    height, width = disparity_px.shape
    for top in range(first * TILE, min(last * TILE, height), TILE):
        bottom = min(top + TILE, height)
        for y in range(top, bottom):
            _project_row(disparity_px[y], right[y], limits[y])
            _mark_beside(disparity_px, y, beside[y])
        for begin in range(0, width, TILE):
            _fit_tile(disparity_px, beside, top, bottom, begin, min(begin + TILE, width), planes)


@compiled(allocates=False)
def _project_row(disparity_px: F32, right: F32, limits: F32) -> None:
    right[:] = NAN
    low, high = INFINITE, -INFINITE
    for x in range(right.size):
        d = disparity_px[x]
        if not np.isnan(d):
            low, high = min(low, d), max(high, d)
            at = x - np.int64(np.rint(d))
            if 0 <= at < right.size and not right[at] >= d:
                right[at] = d
    limits[0], limits[1] = low, high


@compiled(allocates=False)
def _mark_beside(disparity_px: F32, y: int, beside: U8) -> None:
    beside[:] = 0
    for j in range(max(y - 1, 0), min(y + 2, len(disparity_px))):
        _mark_holes(disparity_px[j], beside)
        _mark_holes(disparity_px[j, 1:], beside[:-1])
        _mark_holes(disparity_px[j, :-1], beside[1:])
    for x in range(beside.size):
        beside[x] &= np.uint8(disparity_px[y, x] == disparity_px[y, x])


@compiled(allocates=False)
def _mark_holes(disparity_px: F32, marks: U8) -> None:
    for x in range(marks.size):
        marks[x] |= np.uint8(disparity_px[x] != disparity_px[x])


@compiled(allocates=False)
def _fit_tile(disparity_px: F32, beside: U8, top: int, bottom: int, begin: int, end: int, planes: F32) -> None:
    """Planes of one tile: of the last few pixels that had one fitted, the first that fits, or a new one."""
    fitted = 0
    ys, xs = (0, 0, 0, 0), (0, 0, 0, 0)
    for y in range(top, bottom):
        for x in range(begin, end):
            if not beside[y, x]:
                continue
            d = disparity_px[y, x]
            plane = planes[y, x]
            found = False
            for n in range(min(fitted, SHARED)):
                other = planes[ys[n], xs[n]]
                at = other[0] + other[1] * np.float32(x - xs[n]) + other[2] * np.float32(y - ys[n])
                if abs(at - d) <= REUSE_PX:
                    plane[0], plane[1], plane[2] = at, other[1], other[2]
                    found = True
                    break
            if not found:
                _fit_plane(disparity_px, y, x, plane)
                ys, xs = (y, ys[0], ys[1], ys[2]), (x, xs[0], xs[1], xs[2])
                fitted += 1


@compiled(allocates=False)
def _fit_plane(disparity_px: F32, y: int, x: int, plane: F32) -> None:
    height, width = disparity_px.shape
    center = disparity_px[y, x]
    at = along = down = np.float32(0)  # of the differences from the center
    for fit in range(FITS):
        count = si = sj = sii = sij = sjj = sd = sid = sjd = np.float32(0)
        slack = TOLERANCE_SLOPE if fit == 0 else np.float32(0)
        for j in range(-RADIUS, RADIUS + 1, STRIDE):
            if 0 <= y + j < height:
                for i in range(-RADIUS, RADIUS + 1, STRIDE):
                    if 0 <= x + i < width:
                        fi, fj = np.float32(i), np.float32(j)
                        d = disparity_px[y + j, x + i] - center
                        off = abs(d - (at + along * fi + down * fj))
                        fits = off <= TOLERANCE_PX + slack * (abs(fi) + abs(fj))
                        one, d = (np.float32(1), d) if fits else (np.float32(0), np.float32(0))
                        count += one
                        si += one * fi
                        sj += one * fj
                        sii += one * fi * fi
                        sij += one * fi * fj
                        sjj += one * fj * fj
                        sd += d
                        sid += fi * d
                        sjd += fj * d
        if count < LEAST_SAMPLES:
            at = along = down = np.float32(0)
            break
        a, b, c = sii + RIDGE - si * si / count, sij - si * sj / count, sjj + RIDGE - sj * sj / count
        p, q = sid - si * sd / count, sjd - sj * sd / count
        determinant = a * c - b * b
        along, down = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        at = (sd - along * si - down * sj) / count
    plane[0], plane[1], plane[2] = center + at, along, down


@compiled(
    "void(int64, int64, uint16[:, :, :, ::1], uint16[:, :, :, ::1], float32[:, :, ::1], float32[:, ::1],"
    " float32[:, :, ::1], float32, float32, float32, float32[:, ::1])",
    allocates=False,
)
def _fill_rows(
    first: int,
    last: int,
    steps: U16,
    differences: U16,
    planes: F32,
    right: F32,
    scratch: F32,
    low: np.float32,
    high: np.float32,
    steps_per_px: np.float32,
    disparity_px: F32,
) -> None:
    width = disparity_px.shape[1]
    for y in range(first, last):
        proposed, scores, slopes = scratch[y, 0], scratch[y, 1], scratch[y, 2]
        for x in range(width):
            if not np.isnan(disparity_px[y, x]):
                continue
            least = INFINITE
            for n in range(RAYS):
                proposed[n], scores[n] = INFINITE, INFINITE
                number = np.int64(steps[n // (RAYS // 2), y, x, n % (RAYS // 2)])
                if number > 0:
                    total = differences[n // (RAYS // 2), y, x, n % (RAYS // 2)]
                    j, i = number * DY[n], number * DX[n]
                    plane = planes[y + j, x + i]
                    d = min(max(plane[0] - plane[1] * np.float32(i) - plane[2] * np.float32(j), low), high)
                    score = np.float32(total) * PER_GRAY_LEVEL + np.float32(number) * PER_STEP[n]
                    at = x - np.int64(np.rint(d))
                    if 0 <= at < width:
                        there = right[y, at]
                        score += CONTRADICTED if there < d - STEP_PX else np.float32(0)
                        score += UNMATCHED if np.isnan(there) else np.float32(0)
                    proposed[n], scores[n], slopes[n] = d, score, plane[1]
                    least = min(least, score)
            if least < INFINITE:
                step, reach = proposed[ONWARD] - proposed[BACK], np.float32(steps[1, y, x, 0])
                occluded = STEP_PX < step < INFINITE and reach <= step + OCCLUSION_MARGIN_PX
                quantile = OCCLUDED_QUANTILE if occluded else QUANTILE
                best = _weighted_quantile(proposed, scores, least, quantile)
                disparity_px[y, x] = np.rint(proposed[best] * steps_per_px) / steps_per_px
                if x + 1 < width and np.isnan(disparity_px[y, x + 1]):  # two by two, to halve the time
                    d = min(max(proposed[best] + slopes[best], low), high)
                    disparity_px[y, x + 1] = np.rint(d * steps_per_px) / steps_per_px


@compiled(allocates=False)
def _weighted_quantile(values: F32, scores: F32, least: np.float32, quantile: np.float32) -> int:
    """The smallest of the values whose weight, with that of all below, is the share ``quantile``; overwrites scores."""
    total = np.float32(0)
    for n in range(RAYS):
        at = min((scores[n] - least) * np.float32(WEIGHT_STEPS), np.float32(WEIGHTS.size - 1))
        scores[n] = WEIGHTS[np.int64(at)]
        total += scores[n]
    best, lowest = 0, INFINITE
    for n in range(RAYS):
        below = np.float32(0)
        for m in range(RAYS):
            below += scores[m] if values[m] <= values[n] else np.float32(0)
        if below >= quantile * total and values[n] < lowest:
            best, lowest = n, values[n]
    return best
