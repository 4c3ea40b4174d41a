# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decodes the images of a sequence of patterns to the projector pixel that lights each pixel of a camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stereo_depth_ros.active.structured_light.gray_code import GrayBits, decode_gray
from stereo_depth_ros.active.structured_light.noise import Noise
from stereo_depth_ros.active.structured_light.outliers import mark_outliers
from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.active.structured_light.phase import (
    Wave,
    compensate,
    unwrap_by_code,
    unwrap_by_periods,
    wave_of_images,
)
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F32, U8, Reason

__all__ = ["check_sequence", "decode"]

_OUTSIDE_PX = 0.5  # a coordinate may be beyond the first and last pixel


def decode(sequence: PatternSequence, images: Sequence[U8]) -> ProjectorMap:
    """The projector pixel that lights each pixel of a camera, raw or rectified.

    Gray codes are read by :func:`~stereo_depth_ros.active.structured_light.gray_code.decode_gray`, phases by the
    functions of :mod:`~stereo_depth_ros.active.structured_light.phase`. Where a sequence has both, the Gray code gives
    the period and the phase the place in it.

    Args:
        sequence: what the images show.
        images: uint8 (H, W), gray, one for each pattern, in this order.

    Raises:
        ImageError: another number of images, other shapes, or not gray.
        ConfigError: a sequence that cannot be decoded, see :func:`check_sequence`.
    """
    check_sequence(sequence)
    stack = _stacked(sequence, images)
    noise = Noise.of_images([stack[number] for number in _evenly_lit(sequence)])
    reasons = np.zeros(stack.shape[1:], np.uint8)
    found = {axis: _decode_axis(sequence, axis, stack, noise, reasons) for axis in sequence.axes}
    invalid = reasons != 0
    sigma_of_both = np.zeros(stack.shape[1:], np.float32)
    for coordinate, sigma_px in found.values():
        coordinate[invalid] = np.nan
        sigma_of_both = np.maximum(sigma_of_both, sigma_px)
    sigma_of_both[invalid] = np.nan
    columns, rows = (found[axis][0] if axis in found else None for axis in ("columns", "rows"))
    return ProjectorMap(sequence.size, columns, rows, sigma_of_both, reasons)


def check_sequence(sequence: PatternSequence) -> None:
    """Check that a sequence can be decoded.

    Raises:
        ConfigError: nothing is coded, a bit of a Gray code is missing, a bit has neither its inverse nor white and
            black, bits differ in cells or offsets, or the phases of an axis have fewer than two periods and no Gray
            code.
    """
    if not sequence.axes:
        raise ConfigError(
            "no image has the role gray or phase", limit=("gray", "phase"), remedy="describe the coded images"
        )
    for axis in sequence.axes:
        _check_gray(sequence, axis)
        periods = {sequence.patterns[number].period_px for number in sequence.coded("phase", axis)}
        longest = max(periods, default=0.0)
        if len(periods) == 1 and longest < sequence.length_px(axis) and not sequence.coded("gray", axis):
            raise ConfigError(
                f"the {axis} have phases of one period, {longest:g} px, and no Gray code: the period of a pixel "
                f"remains unknown on {sequence.length_px(axis)} px",
                value=longest,
                limit=sequence.length_px(axis),
                remedy="project another period or a Gray code as well",
                settings=("kind", "periods_px"),
            )


def _check_gray(sequence: PatternSequence, axis: str) -> None:
    patterns = [sequence.patterns[number] for number in sequence.coded("gray", axis)]
    if not patterns:
        return
    if len({(pattern.cell_px, pattern.offset_px) for pattern in patterns}) > 1:
        raise ConfigError(
            f"the bits of the {axis} have different cell_px or offset_px", remedy="write the same for all of them"
        )
    bits = {pattern.bit for pattern in patterns}
    first = patterns[0]
    codes = (sequence.length_px(axis) + first.offset_px - 1) // first.cell_px
    needed = range(min(bits), max(max(bits) + 1, codes.bit_length()))
    if missing := sorted(set(needed) - bits):
        raise ConfigError(
            f"bit {missing[-1]} of the Gray code of {axis} is missing, {sequence.length_px(axis)} px have bits "
            f"{needed[0]} to {needed[-1]}",
            value=missing,
            limit=tuple(needed),
            remedy="describe the image of each of them",
        )
    alone = bits - {p.bit for p in patterns if p.inverse} | bits - {p.bit for p in patterns if not p.inverse}
    if alone and (sequence.index("white") is None or sequence.dark is None):
        raise ConfigError(
            f"bit {max(alone)} of the Gray code of {axis} has no inverse, and white or black is missing",
            value=sorted(alone),
            remedy="capture white and black, or each bit and its inverse",
        )


def _stacked(sequence: PatternSequence, images: Sequence[U8]) -> U8:
    if len(images) != len(sequence):
        raise ImageError(
            f"there are {len(images)} images, the sequence has {len(sequence)}",
            value=len(images),
            limit=len(sequence),
            remedy="capture one for each pattern, or correct the manifest",
        )
    for number, image in enumerate(images, start=1):
        if image.dtype != np.uint8 or image.ndim != 2 or image.shape != images[0].shape or not image.size:
            raise ImageError(
                f"is {image.dtype} of shape {image.shape}, the first one {images[0].dtype} of {images[0].shape}; all "
                "must be uint8 (H, W) of one size",
                subject=f"image {number}",
                value=(str(image.dtype), image.shape),
                limit=("uint8", images[0].shape),
                remedy="convert it to gray, and capture all of them with the same camera settings",
            )
    return np.stack(images)


def _evenly_lit(sequence: PatternSequence) -> list[int]:
    """Images of which the noise is estimated: white and black, or else the longest period."""
    even = [number for number in (sequence.index("white"), sequence.dark) if number is not None]
    coded = [n for axis in sequence.axes for role in ("phase", "gray") for n in sequence.coded(role, axis)]
    return even or [max(coded, key=lambda n: (sequence.patterns[n].period_px, sequence.patterns[n].bit))]


def _decode_axis(sequence: PatternSequence, axis: str, stack: U8, noise: Noise, reasons: U8) -> tuple[F32, F32]:
    """Coordinate and standard deviation of one axis; reasons are added, coordinates without are not yet removed."""
    length_px = sequence.length_px(axis)
    gray, waves = sequence.coded("gray", axis), _waves(sequence, axis, stack, noise, reasons)
    if gray:
        patterns = {number: sequence.patterns[number] for number in gray}
        bits = GrayBits.of_patterns(patterns, sequence.index("white"), sequence.dark, length_px)
        found, sigma_px = decode_gray(stack, bits, noise, reasons)
        for wave in sorted(waves, key=lambda wave: -wave.period_px):
            found, sigma_px = unwrap_by_code(wave, found, sigma_px, reasons)
    else:
        found, sigma_px = unwrap_by_periods(waves, length_px, reasons)
    if waves:
        outside = (found < -_OUTSIDE_PX - 3 * sigma_px) | (found > length_px - 1 + _OUTSIDE_PX + 3 * sigma_px)
        reasons[outside] |= np.uint8(Reason.UNIQUENESS)
        mark_outliers(found, 0.5 * min(wave.period_px for wave in waves), reasons)
    return found, sigma_px


def _waves(sequence: PatternSequence, axis: str, stack: U8, noise: Noise, reasons: U8) -> list[Wave]:
    groups: dict[float, list[int]] = {}
    for number in sequence.coded("phase", axis):
        groups.setdefault(sequence.patterns[number].period_px, []).append(number)
    waves = [
        wave_of_images(stack, numbers, period, [sequence.patterns[n].shift_deg for n in numbers], noise, reasons)
        for period, numbers in groups.items()
    ]
    compensate(waves, sequence.length_px(axis))
    return waves
