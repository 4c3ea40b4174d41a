# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels of stripe extraction: the noise of a signal, and the sub-pixel place of a stripe in each line."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.light_stripe.profile import StripeReason
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8

__all__ = ["SCALE", "difference_histogram", "extract_lines"]

I32 = npt.NDArray[np.int32]

SCALE = 256  # of weights and signals: 1 gray level
_SATURATED = 250  # JPEG leaves less than 255
_STEPS = 5
_CLOSE = 0.1  # px; a step of Newton's method of a Gaussian of 2 px that begins so near ends within 0.0003 px
_LEAST_COSINE = 0.35  # of the angle between the line and the normal of the stripe: 20 degrees from the line

_NO_STRIPE, _TWO, _SATURATION, _WIDE = (
    np.uint8(reason)
    for reason in (StripeReason.NO_STRIPE, StripeReason.TWO_STRIPES, StripeReason.SATURATED, StripeReason.WIDE)
)
_IMAGE = "Array(uint8, 2, 'C', readonly=True)"


@compiled(allocates=False)
def _signal(image: U8, ambient: U8, weights: I32, y: int, x: int) -> int:
    """The weighted sum of the channels of a pixel, without that of the ambient image where there is one."""
    total = 0
    channels = len(weights)
    for c in range(channels):
        total += weights[c] * image[y, channels * x + c]
    if ambient.shape[0]:
        for c in range(channels):
            total -= weights[c] * ambient[y, channels * x + c]
    return total


@compiled(allocates=False)
def _fill_signal(image: U8, ambient: U8, weights: I32, y: int, first: int, last: int, signal: I32) -> None:
    """The signal of a row; in loops that are vectorized in the two common cases."""
    out = signal[first:last]
    if ambient.shape[0]:
        for k in range(len(out)):
            out[k] = _signal(image, ambient, weights, y, first + k)
    elif len(weights) == 1:
        row, weight = image[y, first:last], weights[0]
        for k in range(len(out)):
            out[k] = weight * np.int32(row[k])
    else:
        pixels, one, two, three = image[y, 3 * first : 3 * last], weights[0], weights[1], weights[2]
        for k in range(len(out)):
            out[k] = (
                one * np.int32(pixels[3 * k]) + two * np.int32(pixels[3 * k + 1]) + three * np.int32(pixels[3 * k + 2])
            )


@compiled(allocates=False)
def _is_clipped(image: U8, weights: I32, y: int, x: int) -> bool:
    """Whether a channel is black or saturated, where noise does not show."""
    found = False
    for c in range(len(weights)):
        level = image[y, len(weights) * x + c]
        found |= weights[c] != 0 and (level == 0 or level >= _SATURATED)
    return found


@compiled(f"void({_IMAGE}, {_IMAGE}, int32[::1], int64, int64[::1])")
def difference_histogram(image: U8, ambient: U8, weights: I32, step: int, histogram: npt.NDArray[np.int64]) -> None:
    """Counts the absolute second differences of the signal along every ``step``-th row, in quarters of a gray level.

    Pixels with a black or saturated channel are left out.
    """
    width = image.shape[1] // len(weights)
    signal = np.empty(width, np.int32)
    for y in range(step // 2, image.shape[0], step):
        _fill_signal(image, ambient, weights, y, 0, width, signal)
        for x in range(1, width - 1):
            if _is_clipped(image, weights, y, x):
                continue
            difference = abs(signal[x - 1] - 2 * signal[x] + signal[x + 1])
            histogram[min(difference // (SCALE // 4), histogram.shape[0] - 1)] += 1


@compiled(allocates=False)
def _responses(sums: I32, first: int, last: int, half: int, responses: I32) -> int:
    """How much a window of 2 ``half`` + 1 pixels exceeds the brighter of the two windows beside it: 0 at an edge.

    Returns the largest one.
    """
    size = 2 * half + 1
    out = responses[first:last]
    e0, e1 = sums[first - half - size :], sums[first - half :]
    e2, e3 = sums[first + half + 1 :], sums[first + half + 1 + size :]
    largest = np.int32(-(2**31))
    for k in range(len(out)):
        inner = e2[k] - e1[k]
        found = np.int32(inner - max(e1[k] - e0[k], e3[k] - e2[k]))
        out[k] = found
        largest = max(largest, found)
    return largest  # type: ignore[return-value]


@compiled(allocates=False)
def _place_of(responses: I32, first: int, last: int, value: int) -> int:
    """Place of the first response of a value, the middle of equal ones side by side."""
    start = first
    while start < last - 1 and responses[start] != value:
        start += 1
    end = start
    while end < last - 1 and responses[end + 1] == value:
        end += 1
    return (start + end) // 2


@compiled(allocates=False)
def _largest(responses: I32, first: int, last: int) -> int:
    """The largest response; 0 in an empty range."""
    largest = np.int32(0)
    values = responses[first : max(first, last)]
    for k in range(len(values)):
        largest = max(largest, values[k])
    return largest  # type: ignore[return-value]


@compiled(allocates=False)
def _center_of_mass(signal: I32, low: int, high: int, sums: I32, start: int, half: int) -> tuple[float, float, float]:
    """Center of mass of the signal above the straight line through the means of both flanks.

    The window of twice the stripe's width is centered at the result, its outer pixels count by the share inside.

    Returns:
        The center, px; its standard deviation for a noise of one, sqrt(sum (x - center)^2) over the sum of the signal,
        and that of the slope; the sum of the signal.
    """
    size = 2 * half + 1
    before = (sums[start - size] - sums[start - 2 * size]) / size
    after = (sums[start + 1 + 2 * size] - sums[start + 1 + size]) / size
    slope = (after - before) / (3.0 * size + 1.0)
    base, center, spread, mass = 0.5 * (before + after), float(start), math.inf, 0.0
    for _ in range(_STEPS):
        mass, moment, squares = 0.0, 0.0, 0.0
        for x in range(max(int(center) - size - 1, low), min(int(center) + size + 3, high)):
            offset = x - center
            share = min(max(size + 0.5 - abs(offset), 0.0), 1.0)
            height = share * max(signal[x] - base - slope * (x - start), 0.0)
            mass += height
            moment += height * offset
            squares += share * offset * offset
        if mass <= 0.0:
            return math.nan, math.inf, 0.0
        center += moment / mass
        tilted = squares * math.sqrt(2.0 / size) / (3.0 * size + 1.0)  # by the noise of the slope
        spread = math.sqrt(squares + tilted * tilted) / mass
        if abs(center - start) > size:
            return math.nan, math.inf, 0.0
        if abs(moment / mass) < 1e-3:
            break
    return center, spread, mass


@compiled(allocates=False)
def _fill_window(image: U8, ambient: U8, weights: I32, y: int, column: int, window: F64) -> None:
    """The signal around a pixel; the border is repeated outside of the image."""
    radius = window.shape[0] // 2
    for j in range(window.shape[0]):
        row = min(max(y + j - radius, 0), image.shape[0] - 1)
        for i in range(window.shape[1]):
            x = min(max(column + i - radius, 0), image.shape[1] // len(weights) - 1)
            window[j, i] = _signal(image, ambient, weights, row, x)


@compiled(allocates=False)
def _fill_filters(fraction: float, sigma: float, filters: F64) -> None:
    """A Gaussian and its first two derivatives at a place beside the middle of the filters."""
    radius, count = filters.shape[1] // 2, filters.shape[1]
    total, mean = 0.0, 0.0
    for i in range(count):
        u = i - radius - fraction
        filters[0, i] = math.exp(-0.5 * (u / sigma) * (u / sigma))
        total += filters[0, i]
        mean += filters[0, i] * u
    mean /= total
    variance, fourth = 0.0, 0.0
    for i in range(count):
        filters[0, i] /= total
        variance += filters[0, i] * (i - radius - fraction - mean) ** 2
    for i in range(count):
        fourth += filters[0, i] * ((i - radius - fraction - mean) ** 2 - variance) ** 2
    for i in range(count):
        u = i - radius - fraction - mean
        filters[1, i] = filters[0, i] * u / variance
        filters[2, i] = 2.0 * filters[0, i] * (u * u - variance) / fourth


@compiled(allocates=False)
def _ridge(
    image: U8,
    ambient: U8,
    weights: I32,
    sigma: float,
    y: int,
    middle: int,
    start: float,
    window: F64,
    along: F64,
    across: F64,
) -> tuple[float, float]:
    """Steger's ridge nearest to a place, continued along its tangent to a row.

    The derivatives are taken at the place itself, after each step: from a whole pixel the step is off by up to 0.02 px.

    Args:
        y: the row.
        middle: the row itself, or near the upper and lower border the nearest one whose window is in the image.
        start: a place in the row ``middle``, px.
        window, along, across: buffers, float64 (n, n), (3, n) and (3, n); ``across`` has the filters of the columns.

    Returns:
        The place, px, NaN where there is no bright ridge, infinite where it is nearly along the row; and the largest
        second derivative, negative, times the cosine of the angle between the row and the normal.
    """
    count = window.shape[0]
    place, loaded = start, -1
    for _ in range(2 * _STEPS):
        column = math.floor(place + 0.5)
        if column != loaded:
            _fill_window(image, ambient, weights, middle, column, window)
            loaded = column
        _fill_filters(place - column, sigma, along)
        rx, ry, rxx, rxy, ryy = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(count):
            smooth, first, second = 0.0, 0.0, 0.0
            for i in range(count):
                smooth += along[0, i] * window[j, i]
                first += along[1, i] * window[j, i]
                second += along[2, i] * window[j, i]
            rx += across[0, j] * first
            ry += across[1, j] * smooth
            rxx += across[0, j] * second
            rxy += across[1, j] * first
            ryy += across[2, j] * smooth
        half_difference = 0.5 * (rxx - ryy)
        curvature = 0.5 * (rxx + ryy) - math.sqrt(half_difference * half_difference + rxy * rxy)
        if curvature >= 0.0:
            return math.nan, 0.0
        nx, ny = curvature - ryy, rxy
        if abs(curvature - rxx) > abs(nx):
            nx, ny = rxy, curvature - rxx
        length = math.hypot(nx, ny)
        nx, ny = nx / length, ny / length
        if abs(nx) < _LEAST_COSINE:
            return math.inf, 0.0
        offset = -(rx * nx + ry * ny) / (curvature * nx)  # t n, then along (-ny, nx) to the row: t / nx
        place += min(max(offset, -1.0), 1.0)
        if abs(offset) < _CLOSE:
            beyond = y - middle  # rows from the window to one near the border of the image
            return place - beyond * ny / nx, curvature * abs(nx) / (1.0 + abs(beyond) / sigma)
        if not abs(place - start) < count:
            break
    return math.nan, 0.0


@compiled(allocates=False)
def _full_width(signal: I32, low: int, high: int, center: float, reach: int) -> float:
    """Width of the signal at half its height, px; ``low`` to ``high`` - 1 are known.

    The height is that above the higher of the lowest signals to the left and to the right, within ``reach`` pixels.
    """
    top = min(max(math.floor(center + 0.5), low), high - 1)
    before, after = signal[top], signal[top]
    for k in range(1, reach + 1):
        before = min(before, signal[max(top - k, low)])
        after = min(after, signal[min(top + k, high - 1)])
    half = 0.5 * (signal[top] + max(before, after))
    left, right = top, top
    while left > low and signal[left] >= half:
        left -= 1
    while right < high - 1 and signal[right] >= half:
        right += 1
    width = float(right - left)
    if signal[left] < half and signal[left + 1] > signal[left]:
        width -= (half - signal[left]) / (signal[left + 1] - signal[left])
    if signal[right] < half and signal[right - 1] > signal[right]:
        width -= (half - signal[right]) / (signal[right - 1] - signal[right])
    return width


@compiled(allocates=False)
def _is_saturated(image: U8, weights: I32, y: int, x: int) -> bool:
    """Whether all channels that count are saturated; one that is not still shows where the stripe is brightest."""
    found = True
    for c in range(len(weights)):
        found &= weights[c] <= 0 or image[y, len(weights) * x + c] >= _SATURATED
    return found


@compiled(allocates=False)
def _saturated_run(image: U8, weights: I32, y: int, center: float, half: int) -> int:
    """Length of the run of saturated pixels at a stripe, px."""
    middle, width = math.floor(center + 0.5), image.shape[1] // len(weights)
    for x in range(max(middle - half, 0), min(middle + half + 1, width)):
        if _is_saturated(image, weights, y, x):
            first, last = x, x
            while first > 0 and _is_saturated(image, weights, y, first - 1):
                first -= 1
            while last < width - 1 and _is_saturated(image, weights, y, last + 1):
                last += 1
            return last - first + 1
    return 0


@compiled(
    f"void(int64, int64, {_IMAGE}, {_IMAGE}, int32[::1], int32[:, ::1], float64, int64, int64, float64, float64, "
    "float64, boolean, float32[::1], float32[::1], float32[::1], float32[::1], uint8[::1])"
)
def extract_lines(
    first: int,
    last: int,
    image: U8,
    ambient: U8,
    weights: I32,
    search: I32,
    sigma: float,
    radius: int,
    half: int,
    least: float,
    second_share: float,
    noise: float,
    ridge: bool,
    position_px: F32,
    sigma_px: F32,
    level: F32,
    width_px: F32,
    reasons: U8,
) -> None:
    """Finds the stripe in the rows ``first`` to ``last - 1``.

    Args:
        first, last: range of rows.
        image: uint8 (H, C W), the channels of a pixel side by side.
        ambient: uint8 of the same shape, or (0, 1) where there is none.
        weights: int32 (C,), of the channels, in units of 1 / SCALE.
        search: int32 (H, 2), first and last column, excluded, where a stripe may be.
        sigma: standard deviation of the Gaussian of the derivatives, px.
        radius: of their filters, px.
        half: half the expected width of the stripe, px: windows have 2 ``half`` + 1.
        least: contrast of a stripe, mean over the window, in units of the signal.
        second_share: contrast of a second stripe, as a share of that of the first one, from which both are doubtful.
        noise: standard deviation of the signal of a pixel, in units of the signal.
        ridge: Steger's ridge; else the center of mass.
        position_px, sigma_px, level, width_px: float32 (H,), output, see :class:`StripeProfile`.
        reasons: uint8 (H,), output.
    """
    size, count = 2 * half + 1, 2 * radius + 1
    reach = 2 * size + 2  # of the windows
    width = image.shape[1] // len(weights)
    signal, responses, sums = np.empty(width, np.int32), np.empty(width, np.int32), np.zeros(width + 1, np.int32)
    window, along, across = np.empty((count, count)), np.empty((3, count)), np.empty((3, count))
    _fill_filters(0.0, sigma, across)
    gain = 0.0  # standard deviation of the first derivative across the stripe, for a noise of one
    for i in range(count):
        for j in range(count):
            gain += (across[1, i] * across[0, j]) ** 2
    gain = math.sqrt(gain)
    for y in range(first, last):
        position_px[y] = sigma_px[y] = level[y] = width_px[y] = np.nan
        start, end = max(search[y, 0], reach), min(search[y, 1], width - reach)
        low, high = start - reach, end + reach
        reasons[y] = _NO_STRIPE
        if end - start < size:
            continue
        _fill_signal(image, ambient, weights, y, low, high, signal)
        total = np.int32(0)
        sums[low] = 0
        for x in range(low, high):
            total += signal[x]
            sums[x + 1] = total
        response = _responses(sums, start, end, half, responses)
        if response < least * size:
            wide = min(reach, (high - low) // 6 - 1)
            if wide > half:
                response = _responses(sums, low + 3 * wide + 1, high - 3 * wide - 1, wide, responses)
                if response >= least * (2 * wide + 1):
                    peak = _place_of(responses, low + 3 * wide + 1, high - 3 * wide - 1, response)
                    saturated = _saturated_run(image, weights, y, peak, size) > size
                    reasons[y] = _SATURATION if saturated else _WIDE
            continue
        peak = _place_of(responses, start, end, response)
        if _saturated_run(image, weights, y, peak, size) > size:
            reasons[y] = _SATURATION
            continue
        second = max(
            _largest(responses, start, peak - 2 * size), _largest(responses, min(peak + 2 * size + 1, end), end)
        )
        if second >= max(second_share * response, least * size):
            reasons[y] = _TWO
            continue
        place, spread, mass = _center_of_mass(signal, low, high, sums, peak, half)
        if not mass > 0.0:
            continue
        level[y] = signal[math.floor(place + 0.5)] / SCALE
        width_px[y] = _full_width(signal, low, high, place, 4 * size)
        if width_px[y] > 3 * size:
            reasons[y] = _WIDE
            continue
        position_px[y], sigma_px[y], reasons[y] = place, spread * noise, 0
    if ridge:
        for step in range(first, last):  # rows near the border last: they start from the nearest row of the middle
            y = step + radius if step + radius < last else first + last - 1 - step
            if reasons[y]:
                continue
            middle = min(max(y, radius), max(image.shape[0] - 1 - radius, radius))
            start_px = position_px[middle] if first <= middle < last else position_px[y]
            place, curvature = math.nan, 0.0
            if not math.isnan(start_px):
                place, curvature = _ridge(image, ambient, weights, sigma, y, middle, start_px, window, along, across)
            if abs(place - position_px[y]) <= size:  # not NaN
                position_px[y], sigma_px[y] = place, noise * gain / -curvature
            else:
                reasons[y] = _WIDE if math.isinf(place) else _NO_STRIPE
                position_px[y] = sigma_px[y] = np.nan
