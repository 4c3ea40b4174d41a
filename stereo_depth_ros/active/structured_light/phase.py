# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Phase shift: phase and modulation of a sinusoid, harmonics of the gamma of a projector, and unwrapping in time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.structured_light.noise import Noise
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8, Reason

__all__ = ["Wave", "compensate", "harmonics", "unwrap_by_code", "unwrap_by_periods", "wave_of_images"]

I64 = npt.NDArray[np.int64]

_SATURATED = 255
_LIT = 5.0  # least modulation, in its standard deviations
_UNLIT = 3.0  # less is the modulation of noise
_ORDERS = 4  # harmonics that are compensated: of N steps those of N, 2 N, ... times the phase
_BINS = 4096  # of the frequencies of phases
_LEAST_PIXELS = 2000
_LEAST_PERIODS = 4.0  # over the projector, so that every phase is there as often as every other
_WITHIN_PERIOD = 0.375  # most that a coarse coordinate may be off, periods
_TURN_FLOOR = 0.003  # standard deviation of a phase without noise, turns
_MEDIAN_COST = (0.455, 1.386, 2.366)  # of squared normal variables: 1, 2, 3 of them
_BEYOND = 0.03  # periods that a coordinate may be before the first or behind the last pixel
_MOST_COST = 25.0
_LEAST_MARGIN = 9.0  # that the next best coordinate is worse

_SHADOW, _TEXTURE, _UNIQUENESS = int(Reason.SHADOW), int(Reason.TEXTURE), int(Reason.UNIQUENESS)
_STACK, _FLOATS, _BYTES = "uint8[:, :, ::1]", "float32[:, ::1]", "uint8[:, ::1]"


@dataclass(frozen=True, eq=False)
class Wave:
    """Phase of a sinusoid in each pixel.

    Attributes:
        period_px: projector px.
        steps: number of images.
        turn: float32 (H, W), phase / 2 pi in [0, 1): the coordinate is period_px (turn + k) with a whole k; NaN where
            the modulation is too weak or a pixel is saturated.
        sigma: float32 (H, W), standard deviation of ``turn``.
    """

    period_px: float
    steps: int
    turn: F32
    sigma: F32


def wave_of_images(
    stack: U8, numbers: Sequence[int], period_px: float, shifts_deg: Sequence[float], noise: Noise, reasons: U8
) -> Wave:
    """The phase by least squares (Bruning et al. 1974): I_k = A + B cos(phase - shift_k).

    The standard deviation of the phase is noise sqrt(2 / N) / B for N equal steps (Surrel 1997, eq. 25), that of other
    shifts follows from the normal equations.

    Args:
        stack: uint8 (N, H, W), the images.
        numbers: of the images of this sinusoid, three or more.
        period_px: projector px.
        shifts_deg: of these images.
        noise: of the gray levels.
        reasons: uint8 (H, W), receives TEXTURE where a pixel is saturated or its modulation weak, and SHADOW where it
            has none.

    Raises:
        ConfigError: the shifts do not determine the phase.
    """
    shifts = np.deg2rad(np.asarray(shifts_deg, np.float64))
    design = np.stack((np.ones_like(shifts), np.cos(shifts), np.sin(shifts)), axis=1)
    if len(shifts) < 3 or np.linalg.cond(design) > 10:
        raise ConfigError(
            f"shifts of {', '.join(f'{shift:g}' for shift in shifts_deg)} deg do not determine the phase of period "
            f"{period_px:g} px",
            value=tuple(shifts_deg),
            limit="three or more, spread over the period",
            remedy="project three or more shifts, such as 0, 120 and 240 deg",
            settings=("steps",),
        )
    weights = np.linalg.pinv(design)[1:]
    gain = 0.5 * float((weights**2).sum())
    variance = np.array([gain * noise.variance, gain * noise.per_level / len(shifts)], np.float32)
    turn, sigma = np.empty((2, *stack.shape[1:]), np.float32)
    images = np.asarray(numbers, np.int64)
    run_bands(_phase_rows, stack.shape[1], stack, images, weights.astype(np.float32), variance, turn, sigma, reasons)
    return Wave(period_px, len(shifts), turn, sigma)


@compiled(
    f"void(int64, int64, {_STACK}, int64[::1], {_FLOATS}, float32[::1], {_FLOATS}, {_FLOATS}, {_BYTES})",
    allocates=False,
)
def _phase_rows(
    first: int,
    last: int,
    stack: U8,
    images: I64,
    weights: F32,
    variance: F32,
    turn: F32,
    sigma: F32,
    reasons: U8,
) -> None:
    per_turn = np.float32(1.0 / (2.0 * np.pi))
    for y in range(first, last):
        for x in range(turn.shape[1]):
            cosine, sine, total, largest = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.uint8(0)
            for k in range(images.size):
                level = stack[images[k], y, x]
                largest = max(largest, level)
                total += np.float32(level)
                cosine += weights[0, k] * np.float32(level)
                sine += weights[1, k] * np.float32(level)
            modulation = np.sqrt(cosine * cosine + sine * sine)
            deviation = np.sqrt(variance[0] + variance[1] * total)
            if largest >= _SATURATED:
                reasons[y, x] |= _TEXTURE
            elif modulation < _UNLIT * deviation:
                reasons[y, x] |= _SHADOW
            elif modulation < _LIT * deviation:
                reasons[y, x] |= _TEXTURE
            else:
                found = np.arctan2(sine, cosine) * per_turn
                turn[y, x] = found - np.floor(found)
                sigma[y, x] = deviation / modulation * per_turn
                continue
            turn[y, x], sigma[y, x] = np.nan, np.nan


def harmonics(wave: Wave) -> F64:
    """Harmonics of the error of a phase, from how often each phase occurs.

    A projector with a gamma projects harmonics of the sinusoid. N steps alias those of order N - 1, N + 1, ... into an
    error of the phase that repeats N times a period. Over many periods every phase is as frequent as every other, so
    that the frequencies of the measured phases tell how they are distorted (Guo, He and Chen 2004). Here, with the
    true phase p + sum_h a_h sin(h N p) + b_h cos(h N p), the density of the measured phase p is
    1 + sum_h h N (a_h cos(h N p) - b_h sin(h N p)), and the means of cos(h N p) and sin(h N p) give a_h and b_h.

    Args:
        wave: of many periods.

    Returns:
        float64 (4, 2): a_h and b_h in turns, h = 1 to 4; 0 where there are too few pixels, or where the phases are
        those of a few pixels of a period, again and again, which have harmonics of every order.
    """
    turn = wave.turn[np.isfinite(wave.turn)]
    none = np.zeros((_ORDERS, 2))
    if turn.size < _LEAST_PIXELS:
        return none
    counts = np.bincount((turn * _BINS).astype(np.int64) % _BINS, minlength=_BINS)
    phases = 2 * np.pi * (np.arange(_BINS) + 0.5) / _BINS
    orders = wave.steps * np.arange(1, 2 * _ORDERS + 1)
    means = np.exp(1j * orders[:, None] * phases) @ counts / counts.sum()
    size = np.abs(means)
    density = 1 + 2 * np.real(np.conj(means[:_ORDERS]) @ np.exp(1j * orders[:_ORDERS, None] * phases))
    if size[_ORDERS:].max() > 0.5 * size[0] or density.min() <= 0:
        return none
    found = 2 * means[:_ORDERS] / (2 * np.pi * orders[:_ORDERS])
    return np.stack((found.real, -found.imag), axis=1)


def compensate(waves: Sequence[Wave], length_px: int) -> None:
    """Compensate the gamma of the projector in the phases of one axis, see :func:`harmonics`.

    Sinusoids of few periods have the harmonics of those of many, since the gamma is that of the projector.

    Args:
        waves: changed in place.
        length_px: number of coordinates of the axis.
    """
    known = {id(wave): harmonics(wave) for wave in waves if length_px >= _LEAST_PERIODS * wave.period_px}
    for wave in waves:
        same = [known[id(other)] for other in waves if other.steps == wave.steps and id(other) in known]
        if same and any(found.any() for found in same):
            error = known[id(wave)] if id(wave) in known else np.mean(same, axis=0)
            phases = 2 * np.pi * wave.steps * (np.arange(_BINS + 1)) / _BINS
            table = sum(a * np.sin(h * phases) + b * np.cos(h * phases) for h, (a, b) in enumerate(error, start=1))
            run_bands(_add_table, len(wave.turn), np.asarray(table, np.float32), wave.turn)


@compiled(f"void(int64, int64, float32[::1], {_FLOATS})", allocates=False)
def _add_table(first: int, last: int, table: F32, turn: F32) -> None:
    for y in range(first, last):
        for x in range(turn.shape[1]):
            if turn[y, x] == turn[y, x]:
                place = turn[y, x] * np.float32(table.size - 1)
                k = min(int(place), table.size - 2)
                part = place - np.float32(k)
                turn[y, x] += table[k] + part * (table[k + 1] - table[k])


def unwrap_by_code(wave: Wave, coarse: F32, coarse_sigma: F32, reasons: U8) -> tuple[F32, F32]:
    """The coordinate of the period in which a coarse coordinate lies.

    Args:
        wave: its phase.
        coarse, coarse_sigma: float32 (H, W), coordinate and standard deviation, such as that of a Gray code.
        reasons: uint8 (H, W), receives UNIQUENESS where the period is doubtful.

    Returns:
        Coordinate and its standard deviation, float32 (H, W), projector px; NaN where there is none.
    """
    found, sigma = np.empty((2, *coarse.shape), np.float32)
    run_bands(
        _nearest_period, len(found), wave.period_px, wave.turn, wave.sigma, coarse, coarse_sigma, found, sigma, reasons
    )
    return found, sigma


@compiled(
    f"void(int64, int64, float64, {_FLOATS}, {_FLOATS}, {_FLOATS}, {_FLOATS}, {_FLOATS}, {_FLOATS}, {_BYTES})",
    allocates=False,
)
def _nearest_period(
    first: int,
    last: int,
    period_px: float,
    turn: F32,
    turn_sigma: F32,
    coarse: F32,
    coarse_sigma: F32,
    found: F32,
    sigma: F32,
    reasons: U8,
) -> None:
    for y in range(first, last):
        for x in range(turn.shape[1]):
            found[y, x], sigma[y, x] = np.nan, np.nan
            if np.isnan(turn[y, x]) or np.isnan(coarse[y, x]):
                continue
            apart = coarse[y, x] / period_px - turn[y, x]
            k = np.floor(apart + 0.5)
            if abs(apart - k) > _WITHIN_PERIOD or 6.0 * coarse_sigma[y, x] > period_px:
                reasons[y, x] |= _UNIQUENESS
                continue
            found[y, x] = period_px * (turn[y, x] + k)
            sigma[y, x] = period_px * np.sqrt(turn_sigma[y, x] ** 2 + _TURN_FLOOR**2)


def unwrap_by_periods(waves: Sequence[Wave], length_px: int, reasons: U8) -> tuple[F32, F32]:
    """The coordinate on which sinusoids of several periods agree best, from all of them.

    Of the coordinates that the shortest period allows, the one with the smallest weighted squares of the distances to
    those of the other periods. Periods in a ratio, such as 16, 128 and 1024 px, are unwrapped by it as well as close
    ones whose beat is longer than the projector, such as 42, 45 and 48 px (temporal unwrapping, Huntley and Saldner
    1993; heterodyne, Reich, Ritter and Thesing 1997).

    Args:
        waves: of one axis, of different periods.
        length_px: number of coordinates of the axis.
        reasons: uint8 (H, W), receives UNIQUENESS where the periods do not agree, or on several coordinates.

    Returns:
        Coordinate and its standard deviation, float32 (H, W), projector px; NaN where there is none.
    """
    ordered = sorted(waves, key=lambda wave: wave.period_px)
    turns, sigmas = (np.stack([getattr(w, name) for w in ordered], axis=2) for name in ("turn", "sigma"))
    periods = np.array([wave.period_px for wave in ordered], np.float32)
    found, sigma, cost, margin = np.empty((4, *turns.shape[:2]), np.float32)
    run_bands(_best_period, len(found), periods, float(length_px), turns, sigmas, found, sigma, cost, margin)
    known = np.isfinite(cost)
    if len(ordered) > 1 and known.any():
        # what else than noise makes the periods differ, such as what remains of the gamma
        scale = max(1.0, float(np.median(cost[known])) / _MEDIAN_COST[min(len(ordered) - 1, len(_MEDIAN_COST)) - 1])
        doubtful = known & ((cost > _MOST_COST * scale) | (margin < _LEAST_MARGIN * scale))
        reasons[doubtful] |= np.uint8(_UNIQUENESS)
        found[doubtful] = sigma[doubtful] = np.nan
        sigma *= np.float32(math.sqrt(scale))
    return found, sigma


@compiled(allocates=False)
def _add_costs(rest: float, step: float, weight: float, costs: F32) -> None:
    """Add the weighted squares of the distances of rest, rest + step, ... to whole numbers."""
    for k in range(costs.size):
        apart = rest + np.float32(k) * step
        apart -= np.floor(apart + np.float32(0.5))
        costs[k] += apart * apart * weight


@compiled(
    f"void(int64, int64, float32[::1], float64, float32[:, :, ::1], float32[:, :, ::1], {_FLOATS}, {_FLOATS}, "
    f"{_FLOATS}, {_FLOATS})"
)
def _best_period(
    first: int,
    last: int,
    periods: F32,
    length_px: float,
    turns: F32,
    sigmas: F32,
    found: F32,
    sigma: F32,
    cost: F32,
    margin: F32,
) -> None:
    count, period, half, one = periods.size, periods[0], np.float32(0.5), np.float32(1.0)
    floor = np.float32(_TURN_FLOOR * _TURN_FLOOR)
    beyond = half + np.float32(_BEYOND) * period
    costs = np.empty(int(length_px / period) + 4, np.float32)
    for y in range(first, last):
        for x in range(found.shape[1]):
            found[y, x], sigma[y, x], cost[y, x], margin[y, x] = np.nan, np.nan, np.nan, np.nan
            usable = True
            for i in range(count):
                usable &= turns[y, x, i] == turns[y, x, i]
            if not usable:
                continue
            own = sigmas[y, x, 0] * sigmas[y, x, 0] + floor
            start = int(np.ceil(-beyond / period - turns[y, x, 0]))
            places = int(np.floor((np.float32(length_px - 1) + beyond) / period - turns[y, x, 0])) + 1 - start
            costs[:places] = np.float32(0.0)
            for i in range(1, count):
                ratio = period / periods[i]
                weight = one / (sigmas[y, x, i] * sigmas[y, x, i] + floor + ratio * ratio * own)
                _add_costs((turns[y, x, 0] + np.float32(start)) * ratio - turns[y, x, i], ratio, weight, costs[:places])
            best, second, at = np.float32(np.inf), np.float32(np.inf), start
            for k in range(places):
                if costs[k] < best:
                    second, best, at = best, costs[k], start + k
                elif costs[k] < second:
                    second = costs[k]
            if best == np.float32(np.inf):
                continue
            place = period * (turns[y, x, 0] + np.float32(at))
            weights = np.float32(0.0)
            mean = np.float32(0.0)
            for i in range(count):
                turn = place / periods[i] - turns[y, x, i]
                deviation = periods[i] * (np.floor(turn + half) - turn)
                weight = np.float32(1.0) / (periods[i] * periods[i] * (sigmas[y, x, i] * sigmas[y, x, i] + floor))
                weights += weight
                mean += weight * deviation
            found[y, x] = place + mean / weights
            sigma[y, x] = np.float32(1.0) / np.sqrt(weights)
            cost[y, x] = best
            margin[y, x] = second - best
