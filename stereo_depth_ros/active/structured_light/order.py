# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether images are a sequence of patterns in its order: what the images show of missing, doubled, exchanged ones."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.structured_light.decoding import decode
from stereo_depth_ros.active.structured_light.noise import Noise
from stereo_depth_ros.active.structured_light.patterns import Pattern, PatternSequence
from stereo_depth_ros.active.structured_light.phase import wave_of_images
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, U8, Reason

__all__ = ["sequence_fault"]

_STRIDE = 8  # of the lines that are looked at
_LEAST_LIT = 0.005  # share of the pixels that the projector lights
_LEAST_LEVELS = 8.0
_TO_SUM = 0.5  # of white - black: an image and its inverse together are white and black
_UNLIKE = 0.2  # share of the pixels where they are not
_BINARY = 0.7  # share of the pixels that are near white or black
_RESOLVED = 0.3  # of white - black: the median difference between a bit and its inverse, where the camera resolves it
# Of the amplitude, times the square root of the steps above 3: the rest of a sinusoid with a gamma of up to 3 is below,
# that of exchanged steps above. Many steps average a gamma out, not below the second figure.
_SINUSOID, _LEAST_SINUSOID = 0.9, 0.45
_SAME = 0.05  # of the amplitude: two images that differ by less are one
_FEW = 4.0  # changes along a line, below which the scene has a say in their number
_MORE = 1.3
_FINEST = 2  # of the bits that are resolved
_JUMPS = 0.35  # of the steps of a code: depth edges are fewer, and one wrong bit makes half of them jumps
_NEAR_PX = 4
_STEP_PX = 5  # of the camera: the steps of narrower cells are not looked at
_DOUBLED = 0.05  # share of the pixels
_OFF_MIDDLE = 0.12  # of white - black, what tells 0 from 1 in an image that is blurred
_DOUBTFUL = 0.5  # share of the pixels
_APART = 0.2  # periods; a Gray code is within a quarter, most of it much nearer, a wrong phase anywhere
_TURNED = 1.1  # times as much change along the other direction
_NAMED = 4  # candidates, of more none is named
# Of the amplitude of a sinusoid relative to white - black, over the pixels: quartile to quartile. That of three steps
# varies with the phase by up to 0.5 with a gamma of 3, that of more steps by 0.1.
_SPREAD_OF_THREE, _SPREAD = 0.75, 0.3


def sequence_fault(sequence: PatternSequence, images: Sequence[U8]) -> str:
    """Why images are not the sequence; empty where nothing speaks against it.

    What is checked where the sequence has it: white is the brightest image and black the darkest; an image of a Gray
    code is as bright as either at every pixel, and an image and its inverse together as both (light adds up); finer
    bits change more often, the coarse ones decode to regions without large jumps, and no two of them are the same; the
    steps of a sinusoid follow it, differ from each other, and give the place that the Gray code or the other periods
    give. One image too few or too many is found by trying which one it is.

    Args:
        sequence: the patterns in their order.
        images: uint8 (H, W) of one camera, in the order of their capture.
    """
    sizes = {image.shape for image in images}
    if len(sizes) > 1:
        return f"the images have {len(sizes)} sizes: {', '.join(f'{w}x{h}' for h, w in sorted(sizes))}"
    count, expected = len(images), len(sequence)
    if count == expected:
        return _Capture(sequence, images).fault()
    text = f"{count} images, the sequence has {expected} patterns"
    if count == expected - 1:
        fitting = [j for j in range(expected) if _fits(_without(sequence, j), images)]
        return text + _probably("missing", sequence, fitting)
    if count == expected + 1:
        fitting = [j for j in range(count) if _fits(sequence, [*images[:j], *images[j + 1 :]])]
        return text + (f": image {fitting[0] + 1} is probably one too many" if fitting else "")
    return text


def _without(sequence: PatternSequence, number: int) -> PatternSequence:
    return dataclasses.replace(sequence, patterns=sequence.patterns[:number] + sequence.patterns[number + 1 :])


def _fits(sequence: PatternSequence, images: Sequence[U8]) -> bool:
    return not _Capture(sequence, images).fault()


def _probably(what: str, sequence: PatternSequence, numbers: Sequence[int]) -> str:
    if not numbers:
        return ""
    names = " or ".join(f"{number + 1} ({sequence.patterns[number]})" for number in numbers[:_NAMED])
    return f": image {names} is probably {what}" if len(numbers) <= _NAMED else ""


class _Capture:
    """The images of a sequence, of which some lines are looked at."""

    def __init__(self, sequence: PatternSequence, images: Sequence[U8]) -> None:
        self._sequence = sequence
        self._patterns = sequence.patterns
        self._lines = {"columns": _rows_of(images), "rows": _columns_of(images)}
        for axis in sequence.axes:
            self._lines[axis] = self._along(axis, images)
        self._white, self._black = sequence.index("white"), sequence.index("black")

    def _along(self, axis: str, images: Sequence[U8]) -> list[U8]:
        """Lines along the coordinate that is coded; of a camera on its side they are those of the other direction."""
        coded = [number for number, pattern in enumerate(self._patterns) if pattern.axis == axis]
        lines = self._lines[axis]
        other = _columns_of(images) if axis == "columns" else _rows_of(images)
        return other if _variation(other, coded) > _TURNED * _variation(lines, coded) else lines

    def fault(self) -> str:
        """The first fault; empty where there is none."""
        return next((text for text in self._faults() if text), "")

    def _faults(self) -> list[str]:
        checks = [self._white_and_black(), self._doubled()]
        for axis in self._sequence.axes:
            if any(checks):
                break
            lit = self._lit(axis)
            if np.count_nonzero(lit) < _LEAST_LIT * lit.size:
                return [f"the {axis} patterns differ in {np.mean(lit):.1%} of the pixels: the projector lights nothing"]
            gray, phase = self._sequence.coded("gray", axis), self._sequence.coded("phase", axis)
            checks += [self._binary(axis, gray, lit), self._order_of_bits(axis, gray, lit)] if gray else []
            checks += [self._sinusoids(axis, phase, lit)] if phase else []
            if phase and not any(checks):
                checks.append(self._places(axis))
        return checks

    def _white_and_black(self) -> str:
        """White is the brightest image, black the darkest but for that of the ambient light."""
        means = [float(lines.mean()) for lines in self._lines["columns"]]
        used = [n for n, pattern in enumerate(self._patterns) if pattern.role not in ("unused", "ambient")]
        for number, sign, word in ((self._white, 1, "brighter"), (self._black, -1, "darker")):
            if number is None:
                continue
            other = max(used, key=lambda n: sign * means[n])
            if sign * (means[other] - means[number]) > 1.0:
                return f"{self._name(other)} is {word} than {self._name(number)}"
        return ""

    def _doubled(self) -> str:
        """Two bits of a Gray code in a row never have an edge at one place."""
        coded = [n for n, pattern in enumerate(self._patterns) if pattern.role == "gray"]
        if self._white is None or self._black is None:
            return ""
        lit = self._lit("columns")
        if not lit.any():
            return ""
        white, black = (self._lines["columns"][n][lit].astype(np.float32) for n in (self._white, self._black))
        swing, before, before_lit = white - black, -1, np.zeros(0, np.float32)
        for number in coded:
            share = (self._lines["columns"][number][lit] - black) / swing
            if before >= 0 and np.mean(np.abs(share - before_lit) > _OFF_MIDDLE) < _DOUBLED:
                halves = np.mean(before_lit > 0.5 + _OFF_MIDDLE), np.mean(before_lit < 0.5 - _OFF_MIDDLE)
                if min(halves) > _DOUBLED and sum(halves) > _BINARY:
                    return f"{self._name(before)} and {self._name(number)} are the same image"
            before, before_lit = number, share
        return ""

    def _lit(self, axis: str) -> npt.NDArray[np.bool_]:
        """Where the projector changes the image."""
        shape = self._lines[axis][0].shape
        lit: npt.NDArray[np.bool_] = self._swing(axis, np.ones(shape, np.bool_)).reshape(shape) > _LEAST_LEVELS
        return lit

    def _swing(self, axis: str, where: npt.NDArray[np.bool_]) -> F32:
        """White minus black, or else the largest difference of the coded images: float32 (N,), gray levels."""
        lines = self._lines[axis]
        if self._white is not None and self._black is not None:
            return np.asarray(lines[self._white][where].astype(np.float32) - lines[self._black][where], np.float32)
        coded = np.stack([lines[n][where] for n, pattern in enumerate(self._patterns) if pattern.axis == axis])
        return np.asarray(coded.max(axis=0).astype(np.float32) - coded.min(axis=0), np.float32)

    def _difference(self, axis: str, number: int, partner: int | None, lit: npt.NDArray[np.bool_]) -> F32:
        """Image minus inverse relative to white minus black, float32 (N,): 1 lit, -1 dark, 0 not resolved."""
        lines = self._lines[axis]
        image = lines[number][lit].astype(np.float32)
        if self._white is None or self._black is None:
            assert partner is not None
            other: F32 = lines[partner][lit].astype(np.float32)
            return np.asarray((image - other) / np.maximum(np.abs(image - other).max(), 1.0), np.float32)
        white, black = (lines[n][lit].astype(np.float32) for n in (self._white, self._black))
        other = lines[partner][lit].astype(np.float32) if partner is not None else white + black - image
        return np.asarray((image - other) / (white - black), np.float32)

    def _binary(self, axis: str, numbers: Sequence[int], lit: npt.NDArray[np.bool_]) -> str:
        """Each image of a Gray code against white and black, and against its inverse."""
        if self._white is None or self._black is None:
            return ""
        lines = self._lines[axis]
        white, black = (lines[n][lit].astype(np.float32) for n in (self._white, self._black))
        partners = _partners(self._patterns, numbers)
        for number in numbers:
            image = lines[number][lit].astype(np.float32)
            partner = partners[number]
            if partner is None:
                continue
            inverse, swing = lines[partner][lit].astype(np.float32), white - black
            alike = np.mean(np.abs(image + inverse - white - black) <= _TO_SUM * swing)
            # Stripes that the camera does not resolve are a gray that need not be the mean of white and black.
            mixed = np.median(np.abs(image - inverse) / swing) < _RESOLVED
            shares = [float(np.mean(np.abs(image - level) < 0.5 * _TO_SUM * swing)) for level in (white, black)]
            binary = min(shares) > _BINARY / 7 and sum(shares) > _BINARY
            if alike < 1 - _UNLIKE and (binary or not mixed):
                return f"{self._name(number)} and {self._name(partner)} are not the inverse of each other"
        return ""

    def _order_of_bits(self, axis: str, numbers: Sequence[int], lit: npt.NDArray[np.bool_]) -> str:
        """Finer bits change more often along the lines, and the code of the coarse ones makes no large jumps."""
        partners = _partners(self._patterns, numbers)
        direct = sorted((n for n in numbers if not self._patterns[n].inverse), key=lambda n: -self._patterns[n].bit)
        if any(partners[n] is None for n in direct) and (self._white is None or self._black is None):
            return ""
        levels: list[tuple[int, F32]] = []
        for number in direct:
            level = np.zeros(lit.shape, np.float32)
            level[lit] = self._difference(axis, number, partners[number], lit)
            if np.median(np.abs(level[lit])) < _RESOLVED:
                break  # this one and the finer ones tell nothing
            levels.append((number, level))
        if len(levels) < 2:
            return ""
        # Light that other surfaces reflect has no fine stripes: the finest ones tell where there is direct light.
        direct_light = lit & np.logical_and.reduce([np.abs(level) > _RESOLVED for _, level in levels[-_FINEST:]])
        code, before = np.zeros(lit.shape, np.int64), (-1, 0.0)
        for length, (number, level) in enumerate(levels, start=1):
            bit = level > 0
            changes = _changes(bit, direct_light & (np.abs(level) > _RESOLVED))
            if before[1] >= _FEW and before[1] > _MORE * changes:
                return (
                    f"{self._name(number)} changes less often than {self._name(before[0])}, {changes:.1f} and "
                    f"{before[1]:.1f} times along a line: their order is probably another one"
                )
            before = number, changes
            code = 2 * code + (bit ^ (code & 1 == 1))
            steps, jumps = _steps(code, direct_light)
            if steps * _STEP_PX > np.count_nonzero(lit) / len(lit):
                break  # a few pixels to a step
            if length > 1 and jumps > max(_JUMPS * steps, 1.0):
                return (
                    f"the {axis} are not in a row with {self._name(number)}: {jumps:.1f} of {steps:.1f} steps along a "
                    "line are jumps; it is probably another image"
                )
        return ""

    def _sinusoids(self, axis: str, numbers: Sequence[int], lit: npt.NDArray[np.bool_]) -> str:
        """Steps that differ from each other, and follow a sinusoid where there are more than three."""
        periods = sorted({self._patterns[n].period_px for n in numbers})
        for period in periods:
            group = [n for n in numbers if self._patterns[n].period_px == period]
            if len(group) < 3:
                continue  # one is missing: there is nothing to compare
            shifts = np.deg2rad([self._patterns[n].shift_deg for n in group])
            design = np.stack((np.ones_like(shifts), np.cos(shifts), np.sin(shifts)), axis=1)
            values = np.stack([self._lines[axis][n][lit].astype(np.float32) for n in group])
            fit = np.linalg.pinv(design) @ values
            amplitude = np.hypot(fit[1], fit[2])
            clear = amplitude > _LEAST_LEVELS / 2
            if not clear.any():
                return f"the images of period {period:g} px do not differ from each other"
            scale = float(np.median(amplitude[clear]))
            for first, second in zip(group, group[1:] + group[:1], strict=True):
                step = np.abs(values[group.index(first)] - values[group.index(second)])[clear]
                if np.median(step) < _SAME * scale:
                    return f"{self._name(first)} and {self._name(second)} are the same image"
            rest = np.sqrt(
                np.mean((values - design @ fit)[:, clear] ** 2, axis=0) * len(group) / max(1, len(group) - 3)
            )
            low, middle, high = np.percentile((amplitude / self._swing(axis, lit))[clear], (25, 50, 75))
            if high - low > (_SPREAD_OF_THREE if len(group) == 3 else _SPREAD) * middle:
                return f"the images of period {period:g} px have no common amplitude: one is probably another image"
            limit = max(_SINUSOID / math.sqrt(max(1, len(group) - 3)), _LEAST_SINUSOID)
            if len(group) > 3 and np.median(rest / amplitude[clear]) > limit:
                return f"the images of period {period:g} px follow no sinusoid: their order is probably another one"
        return ""

    def _places(self, axis: str) -> str:
        """Sinusoids of an axis against its Gray code, or those of several periods against each other."""
        used = [
            n for n, pattern in enumerate(self._patterns) if pattern.axis == axis or n in (self._white, self._black)
        ]
        gray = [n for n in used if self._patterns[n].role != "phase"]
        phase = self._sequence.coded("phase", axis)
        try:
            if not self._sequence.coded("gray", axis):
                found = self._decoded(axis, used)
                lit = (found.reasons & (Reason.SHADOW | Reason.TEXTURE)) == 0
                doubtful = np.count_nonzero((found.reasons[lit] & Reason.UNIQUENESS) != 0)
                if doubtful > _DOUBTFUL * np.count_nonzero(lit):
                    return (
                        f"the periods of the {axis} contradict each other in {doubtful / np.count_nonzero(lit):.0%} of "
                        "the pixels: steps are exchanged, the shifts of the manifest have the wrong sign, or these "
                        "periods and steps are too few for the noise and the gamma of the projector"
                    )
                return ""
            coarse = self._decoded(axis, gray)
        except ConfigError:  # of a sequence without one of its images
            return ""
        place = coarse.column_px if axis == "columns" else coarse.row_px
        assert place is not None
        for period in sorted({self._patterns[n].period_px for n in phase}):
            group = [n for n in phase if self._patterns[n].period_px == period]
            shifts = [self._patterns[n].shift_deg for n in group]
            lines = np.stack([np.ascontiguousarray(self._lines[axis][n]) for n in group])
            reasons = coarse.reasons.copy()
            wave = wave_of_images(lines, range(len(group)), period, shifts, Noise(1.0), reasons)
            apart = (place / period - wave.turn)[reasons == 0]
            apart = np.abs(apart - np.round(apart))
            if apart.size and np.mean(apart > _APART) > _DOUBTFUL:
                return (
                    f"the sinusoid of period {period:g} px is {np.median(apart):.2f} periods off the Gray code of the "
                    f"{axis}: steps are exchanged, or the shifts of the manifest are others"
                )
        return ""

    def _decoded(self, axis: str, numbers: Sequence[int]) -> ProjectorMap:
        patterns = tuple(self._patterns[number] for number in numbers)
        lines = [np.ascontiguousarray(self._lines[axis][number]) for number in numbers]
        return decode(dataclasses.replace(self._sequence, patterns=patterns), lines)

    def _name(self, number: int) -> str:
        return f"image {number + 1} ({self._patterns[number]})"


def _partners(patterns: Sequence[Pattern], numbers: Sequence[int]) -> dict[int, int | None]:
    """The inverse of each image of a Gray code, where there is one."""
    by_bit = {(patterns[n].bit, patterns[n].inverse): n for n in numbers}
    return {n: by_bit.get((patterns[n].bit, not patterns[n].inverse)) for n in numbers}


def _rows_of(images: Sequence[U8]) -> list[U8]:
    return [image[_STRIDE // 2 :: _STRIDE] for image in images]


def _columns_of(images: Sequence[U8]) -> list[U8]:
    return [image[:, _STRIDE // 2 :: _STRIDE].T for image in images]


def _variation(lines: Sequence[U8], numbers: Sequence[int]) -> float:
    """Mean change along the lines of what differs between images that follow each other."""
    pairs = itertools.pairwise(numbers)
    changes = [np.abs(np.diff(lines[i].astype(np.int16) - lines[j], axis=1)).mean() for i, j in pairs if lines[i].size]
    return float(np.mean(changes)) if changes else 0.0


def _steps(code: npt.NDArray[np.int64], clear: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Changes of a code along a line between clear pixels near each other, and those by more than 1; their means."""
    steps = jumps = 0
    rows = np.nonzero(clear.any(axis=1))[0]
    for row in rows:
        at = np.nonzero(clear[row])[0]
        change = np.abs(np.diff(code[row, at]))[np.diff(at) <= _NEAR_PX]
        steps, jumps = steps + int(np.count_nonzero(change)), jumps + int(np.count_nonzero(change > 1))
    count = max(1, len(rows))
    return steps / count, jumps / count


def _changes(bit: npt.NDArray[np.bool_], clear: npt.NDArray[np.bool_]) -> float:
    """Changes of a bit along a line, between pixels where it is clear; the mean of the lines that have any."""
    rows = np.nonzero(clear.any(axis=1))[0]
    changes = [np.count_nonzero(np.diff(bit[row, clear[row]])) for row in rows]
    return float(np.mean(changes)) if changes else 0.0
