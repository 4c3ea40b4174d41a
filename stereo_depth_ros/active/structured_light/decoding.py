# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decodes the images of a sequence of patterns to the projector pixel that lights each pixel of a camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stereo_depth_ros.active.structured_light.patterns import Pattern, PatternSequence
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, F64, U8, Reason

__all__ = ["decode"]

_LEAST_LEVELS = 10
_SHADOW = np.uint8(Reason.SHADOW)


def decode(sequence: PatternSequence, images: Sequence[U8]) -> ProjectorMap:
    """The projector pixel that lights each pixel of a camera.

    Args:
        sequence: what the images show.
        images: uint8 (H, W), one for each pattern, in this order.

    Raises:
        ImageError: another number of images, or other shapes.
    """
    if len(images) != len(sequence):
        raise ImageError(
            f"{len(images)} images, the sequence has {len(sequence)}",
            value=len(images),
            limit=len(sequence),
            remedy="capture all of them, or correct the manifest",
        )
    stack = np.stack(images).astype(np.float32)
    sigma_px = np.zeros(stack.shape[1:], np.float32)
    reasons = np.zeros(stack.shape[1:], np.uint8)
    coordinates = {axis: _axis(sequence, axis, stack, sigma_px, reasons) for axis in sequence.axes}
    for coordinate in coordinates.values():
        coordinate[reasons != 0] = np.nan
    sigma_px[reasons != 0] = np.nan
    return ProjectorMap(sequence.size, coordinates.get("columns"), coordinates.get("rows"), sigma_px, reasons)


def _axis(sequence: PatternSequence, axis: str, stack: F32, sigma_px: F32, reasons: U8) -> F32:
    gray = sequence.coded("gray", axis)
    coarse, cell_px = _gray(sequence, gray, stack, reasons) if gray else (None, 0.0)
    groups: dict[float, list[int]] = {}
    for number in sequence.coded("phase", axis):
        groups.setdefault(sequence.patterns[number].period_px, []).append(number)
    turns = {period: _phase(sequence, numbers, stack, reasons) for period, numbers in sorted(groups.items())}
    if not turns:
        assert coarse is not None
        sigma_px[:] = np.maximum(sigma_px, cell_px / np.sqrt(12))
        outside = (coarse < -0.5) | (coarse > sequence.length_px(axis) - 0.5)
        reasons[outside] |= np.uint8(Reason.UNIQUENESS)
        return coarse.astype(np.float32)
    sigma_px[:] = np.maximum(sigma_px, min(turns) / 100)
    if coarse is None:
        coarse = _unwrapped(turns, sequence.length_px(axis))
    period, turn = next(iter(turns.items()))
    found: F32 = (period * (turn + np.round(coarse / period - turn))).astype(np.float32)
    return found


def _gray(sequence: PatternSequence, numbers: list[int], stack: F32, reasons: U8) -> tuple[F64, float]:
    white, black = sequence.index("white"), sequence.index("black")
    direct = {sequence.patterns[n].bit: n for n in numbers if not sequence.patterns[n].inverse}
    inverse = {sequence.patterns[n].bit: n for n in numbers if sequence.patterns[n].inverse}
    value = np.zeros(stack.shape[1:], np.int64)
    first: Pattern = sequence.patterns[numbers[0]]
    for bit in sorted(direct, reverse=True):
        lit = stack[direct[bit]]
        if bit in inverse:
            unlit = stack[inverse[bit]]
        else:
            assert white is not None and black is not None
            unlit = stack[white] + stack[black] - lit
        value = 2 * value + ((lit > unlit) ^ (value & 1 == 1))
    if white is not None and black is not None:
        reasons[stack[white] - stack[black] < _LEAST_LEVELS] |= _SHADOW
    cell_px = first.cell_px * 2 ** min(direct)
    return (value + 0.5) * cell_px - 0.5 - first.offset_px, float(cell_px)


def _phase(sequence: PatternSequence, numbers: list[int], stack: F32, reasons: U8) -> F64:
    shifts = np.deg2rad([sequence.patterns[n].shift_deg for n in numbers])
    design = np.stack((np.ones_like(shifts), np.cos(shifts), np.sin(shifts)), axis=1)
    _, cosine, sine = np.tensordot(np.linalg.pinv(design), stack[numbers], axes=1)
    reasons[np.hypot(cosine, sine) < _LEAST_LEVELS / 2] |= _SHADOW
    turn: F64 = np.arctan2(sine, cosine) / (2 * np.pi)
    return turn


def _unwrapped(turns: dict[float, F64], length_px: int) -> F64:
    """The coordinate that all periods agree best on."""
    (first, turn), *others = turns.items()
    best = np.zeros_like(turn)
    best_cost = np.full_like(turn, np.inf)
    for k in range(-1, int(length_px / first) + 2):
        coordinate = first * (turn + k)
        cost = np.zeros_like(turn)
        for period, other in others:
            rest = coordinate / period - other
            cost += (rest - np.round(rest)) ** 2
        better = (cost < best_cost) & (coordinate > -first / 2) & (coordinate < length_px + first / 2)
        best[better], best_cost[better] = coordinate[better], cost[better]
    return best
