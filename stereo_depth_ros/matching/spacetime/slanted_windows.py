# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Windows in space and time whose disparity is linear in x, y and t, refined by the method of Gauss and Newton.

    d(x, y, t) = d0 + dx (x - x0) + dy (y - y0) + dt (t - t0)

(Zhang, Curless and Seitz, "Spacetime stereo: shape recovery for dynamic scenes", CVPR 2003, equation 7.) The sum over
the window of (I(x, y, t) - g J(x - d(x, y, t), y, t) - o)^2 is minimized over d0, dx, dy, dt and the gain g and the
offset o between the cameras.
"""

from __future__ import annotations

import numba
import numpy as np
from numba import float32, int64, uint8

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.matching.spacetime.correlation import STEPS_PER_PX

__all__ = ["slant_rows"]

UNKNOWNS = 6  # gain, offset, d0, dx, dy, dt; the latter four times the gain
ITERATIONS = 4  # with all pairs, at most
CONVERGED_PX = 0.01  # fewer steps are needed where one is smaller
DAMPING = 1e-3  # share of the diagonal that is added to it
LARGEST_STEP_PX = 1.0
STEEPEST = 1.0  # px per px: a surface that the other camera sees as a line
FASTEST = 2.0  # px per pair
LEAST_GAIN = 0.1


@compiled(allocates=False)
def _sample(row: U8, x: float) -> tuple[float, float]:
    """Value and derivative at x, by the cubic through the derivatives of four pixels (Catmull and Rom 1974)."""
    x = min(max(x, 0.0), row.size - 1.0)
    at = min(int(x), max(row.size - 2, 0))
    f = x - at
    last = row.size - 1
    p, q = np.float64(row[max(at - 1, 0)]), np.float64(row[at])
    r, s = np.float64(row[min(at + 1, last)]), np.float64(row[min(at + 2, last)])
    a, b, c = 1.5 * (q - r) + 0.5 * (s - p), p - 2.5 * q + 2 * r - 0.5 * s, 0.5 * (r - p)
    return ((a * f + b) * f + c) * f + q, (3 * a * f + 2 * b) * f + c


@compiled(allocates=False)
def _normal_equations(
    left: U8, right: U8, y: int, x: int, half: int, begin: int, end: int, slant: F64, A: F64, v: F64
) -> float:
    """Normal equations A q = v over pairs ``begin`` to ``end``; returns sum I^2. Moments along x are summed per row."""
    A[:] = 0
    v[:] = 0
    middle = (len(left) - 1) / 2
    power = 0.0
    for n in range(begin, end):
        t = n - middle
        for j in range(-half, half + 1):
            own, other = left[n, y + half + j], right[n, y + half + j]
            d = slant[0] + slant[2] * j + slant[3] * t
            jj = je = jei = ji = s_j = s_e = s_ei = s_i = ee = eei = eeii = ie = iei = 0.0
            for i in range(-half, half + 1):
                value = np.float64(own[x + half + i])
                J, slope = _sample(other, x + half + i - d - slant[1] * i)
                e = -slope
                ei = e * i
                power += value * value
                jj += J * J
                je += J * e
                jei += J * ei
                ji += J * value
                s_j += J
                s_e += e
                s_ei += ei
                s_i += value
                ee += e * e
                eei += e * ei
                eeii += ei * ei
                ie += e * value
                iei += ei * value
            A[0, 0] += jj
            A[1, 0] += s_j
            A[1, 1] += 2 * half + 1
            v[0] += ji
            v[1] += s_i
            A[2, 0] += je
            A[3, 0] += jei
            A[4, 0] += j * je
            A[5, 0] += t * je
            A[2, 1] += s_e
            A[3, 1] += s_ei
            A[4, 1] += j * s_e
            A[5, 1] += t * s_e
            A[2, 2] += ee
            A[3, 2] += eei
            A[4, 2] += j * ee
            A[5, 2] += t * ee
            A[3, 3] += eeii
            A[4, 3] += j * eei
            A[5, 3] += t * eei
            A[4, 4] += j * j * ee
            A[5, 4] += j * t * ee
            A[5, 5] += t * t * ee
            v[2] += ie
            v[3] += iei
            v[4] += j * ie
            v[5] += t * ie
    return power


@compiled(allocates=False)
def _correlation(A: F64, v: F64, power: float) -> float:
    """Zero-mean normalized correlation of the window with the one that A and v were summed with."""
    n = A[1, 1]
    product = v[0] - A[1, 0] * v[1] / n
    squares = (A[0, 0] - A[1, 0] * A[1, 0] / n) * (power - v[1] * v[1] / n)
    return product / np.sqrt(squares) if squares > 0 else -1.0


@compiled(allocates=False)
def _solve(A: F64, v: F64) -> bool:
    """Solve A q = v in place by Cholesky's factorization of the damped lower triangle; false if there is none."""
    for row in range(UNKNOWNS):
        A[row, row] = A[row, row] * (1 + DAMPING) if row > 1 else A[row, row]
        if A[row, row] <= 0:
            A[row, row] = 1.0  # an unknown without effect, such as dt with one pair
    for row in range(UNKNOWNS):
        for column in range(row + 1):
            total = A[row, column]
            for k in range(column):
                total -= A[row, k] * A[column, k]
            if row == column:
                if total <= 1e-12 * A[row, row]:
                    return False
                A[row, row] = np.sqrt(total)
            else:
                A[row, column] = total / A[column, column]
    for row in range(UNKNOWNS):
        for k in range(row):
            v[row] -= A[row, k] * v[k]
        v[row] /= A[row, row]
    for step in range(UNKNOWNS):
        row = UNKNOWNS - 1 - step
        for k in range(row + 1, UNKNOWNS):
            v[row] -= A[k, row] * v[k]
        v[row] /= A[row, row]
    return True


@compiled(allocates=False)
def _refine(left: U8, right: U8, y: int, x: int, half: int, slant: F64, A: F64, v: F64) -> bool:
    """Refine d0, dx, dy, dt of the middle pair from d0 alone; false where that fits worse.

    The iterations begin with the middle pairs and twice as many each time, so that a fast motion is followed.
    """
    pairs = len(left)
    start = slant[0]
    power = _normal_equations(left, right, y, x, half, 0, pairs, slant, A, v)
    before = _correlation(A, v, power)
    reach, full = 1.0, 0
    while full < ITERATIONS:
        begin = max(int(np.ceil((pairs - 1) / 2 - reach)), 0)
        full += 1 if begin == 0 else 0
        reach *= 2
        _normal_equations(left, right, y, x, half, begin, pairs - begin, slant, A, v)
        if not _solve(A, v) or v[0] < LEAST_GAIN:
            return False
        slant[0] += min(max(v[2] / v[0], -LARGEST_STEP_PX), LARGEST_STEP_PX)
        change = abs(v[2] / v[0]) + half * (abs(v[3]) + abs(v[4])) / v[0] + abs(v[5] / v[0]) * (pairs - 1) / 2
        for n in range(1, 4):
            slant[n] += v[2 + n] / v[0]
        if change < CONVERGED_PX:  # at the corners of the window
            full = ITERATIONS if begin == 0 else full
        if abs(slant[1]) > STEEPEST or abs(slant[2]) > STEEPEST or abs(slant[3]) > FASTEST:
            return False
    if abs(slant[0] - start) > 2 * LARGEST_STEP_PX:
        return False
    power = _normal_equations(left, right, y, x, half, 0, pairs, slant, A, v)
    return _correlation(A, v, power) >= before


_STACK = uint8[:, :, ::1]


@compiled(numba.void(int64, int64, _STACK, _STACK, int64, int64, int64, float32[:, ::1], uint8[:, ::1]))
def slant_rows(
    first: int,
    last: int,
    left: U8,
    right: U8,
    half: int,
    min_disparity: int,
    max_disparity: int,
    disparity_px: F32,
    reasons: U8,
) -> None:
    """Refine the valid disparities of a band of rows with slanted windows.

    Args:
        first, last: rows.
        left, right: uint8 (pairs, H + 2 half, W + 2 half), the images extended by their border pixels.
        half: of the window.
        min_disparity, max_disparity: the search range, px, which disparities do not leave.
        disparity_px: float32 (H, W), in: the same in all pairs, out: of the newest pair, unchanged where no slant fits
            better.
        reasons: uint8 (H, W), 0 where valid.
    """
    width = disparity_px.shape[1]
    slant, v, A = np.zeros(4), np.zeros(UNKNOWNS), np.zeros((UNKNOWNS, UNKNOWNS))
    for y in range(first, last):
        for x in range(width):
            if reasons[y, x]:
                continue
            slant[:] = 0
            slant[0] = disparity_px[y, x]
            if _refine(left, right, y, x, half, slant, A, v):
                d = slant[0] + slant[3] * (len(left) - 1) / 2
                if min_disparity <= d <= max_disparity and 0 <= x - d <= width - 1:
                    disparity_px[y, x] = np.rint(d * STEPS_PER_PX) / STEPS_PER_PX
