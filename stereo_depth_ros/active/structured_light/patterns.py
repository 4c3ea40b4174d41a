# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sequences of projected patterns: what each image of a capture shows, rendered at any size, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64, U8

__all__ = ["AXES", "KINDS", "ROLES", "Pattern", "PatternSequence"]

AXES = ("columns", "rows")
ROLES = ("ambient", "white", "black", "gray", "phase", "unused")
KINDS = ("gray", "phase", "gray+phase")

MAX_SIZE_PX = 16384  # of a projector
MAX_BITS = 16
MAX_PATTERNS = 1000

_KEYS: Mapping[str, tuple[str, ...]] = {
    "gray": ("axis", "bit", "inverse", "cell_px", "offset_px"),
    "phase": ("axis", "period_px", "shift_deg"),
}
_NEEDED: Mapping[str, tuple[str, ...]] = {"gray": ("axis", "bit"), "phase": ("axis", "period_px", "shift_deg")}
_FIRST_PERIOD_PX = 16.0
_LEAST_STEPS = 3
_FINEST_PERIOD_PX = 3.0


@dataclass(frozen=True)
class Pattern:
    """What one image of a sequence shows.

    Attributes:
        role: "ambient" (the projector is off), "white", "black", "gray" (a bit of a Gray code), "phase" (a step of a
            sinusoid), "unused" (an image of a foreign capture that is not needed).
        axis: "columns" or "rows", the projector coordinate that a gray or phase pattern codes.
        bit: of the Gray code, 0 is the finest one; lit where the bit is 1.
        inverse: lit where the bit is 0.
        cell_px: projector px that have one code.
        offset_px: added to the coordinate c: the code is that of floor((c + offset_px) / cell_px).
        period_px: of the sinusoid, projector px.
        shift_deg: of the sinusoid, toward larger coordinates: (1 + cos(2 pi c / period_px - shift)) / 2.
    """

    role: str
    axis: str = ""
    bit: int = 0
    inverse: bool = False
    cell_px: int = 1
    offset_px: int = 0
    period_px: float = 0.0
    shift_deg: float = 0.0

    def __post_init__(self) -> None:
        _check_choice("role", self.role, ROLES)
        if self.role in _KEYS:
            _check_choice("axis", self.axis, AXES)
        if self.role == "gray":
            _check_whole("bit", self.bit, 0, MAX_BITS - 1)
            _check_whole("cell_px", self.cell_px, 1, MAX_SIZE_PX)
            _check_whole("offset_px", self.offset_px, 0, 2**MAX_BITS)
            if not isinstance(self.inverse, bool):
                raise ConfigError(
                    f"inverse = {quoted(self.inverse)} is not true or false",
                    value=self.inverse,
                    limit=(True, False),
                    remedy="write one of them, without quotes",
                )
        if self.role == "phase":
            _check_number("period_px", self.period_px, _FINEST_PERIOD_PX, 2.0 * MAX_SIZE_PX)
            _check_number("shift_deg", self.shift_deg, -3600.0, 3600.0)

    def __str__(self) -> str:
        if self.role == "gray":
            return f"Gray code bit {self.bit} of {self.axis}{', inverse' * self.inverse}"
        if self.role == "phase":
            return f"phase of {self.axis}, period {self.period_px:g} px, shift {self.shift_deg:g} deg"
        return self.role

    def render(self, size: tuple[int, int]) -> U8:
        """The pattern for a projector of ``size`` (width, height): uint8 (height, width)."""
        width, height = size
        if self.role not in _KEYS:
            return np.full((height, width), 255 if self.role == "white" else 0, np.uint8)
        line = self.line(width if self.axis == "columns" else height)
        values = np.round(255.0 * line).astype(np.uint8)
        image = np.empty((height, width), np.uint8)
        image[:] = values if self.axis == "columns" else values[:, None]
        return image

    def line(self, count: int) -> F64:
        """Light at the coordinates 0 to ``count`` - 1 of a gray or phase pattern, float64 (count,) in 0..1."""
        coordinate = np.arange(count)
        if self.role == "phase":
            wave: F64 = 0.5 + 0.5 * np.cos(2 * np.pi * coordinate / self.period_px - np.deg2rad(self.shift_deg))
            return wave
        value = (coordinate + self.offset_px) // self.cell_px
        lit = ((value ^ (value >> 1)) >> self.bit) & 1
        return (lit ^ int(self.inverse)).astype(np.float64)

    def to_json(self) -> dict[str, Any]:
        """The pattern as plain data, without what is the default."""
        shown = ("role", *_KEYS.get(self.role, ()))
        return {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name in shown
            and (field.name in _NEEDED.get(self.role, ("role",)) or getattr(self, field.name) != field.default)
        }

    @staticmethod
    def from_json(values: object) -> Pattern:
        """The pattern of plain data, see :meth:`to_json`.

        Raises:
            ConfigError: an unknown role or key, a missing key, or a value out of range.
        """
        if not isinstance(values, Mapping) or "role" not in values:
            raise ConfigError(
                f"{quoted(values)} is not an image, which has a role",
                limit=ROLES,
                remedy=f"write {{'role': ...}} with one of {', '.join(ROLES)}",
            )
        role = values["role"]
        _check_choice("role", role, ROLES)
        known = ("role", *_KEYS.get(role, ()))
        if unknown := [key for key in values if key not in known]:
            raise ConfigError(
                f"key {quoted(unknown[0])} does not belong to role {role}",
                value=unknown[0],
                limit=known,
                remedy=f"its keys are {', '.join(known)}",
            )
        if missing := [key for key in _NEEDED.get(role, ()) if key not in values]:
            raise ConfigError(
                f"role {role} lacks the key {missing[0]!r}", value=missing[0], limit=known, remedy="add it"
            )
        return Pattern(**values)


@dataclass(frozen=True)
class PatternSequence:
    """The patterns of a capture in their order.

    Attributes:
        size: width and height of the projector, px.
        patterns: what each image shows.

    Raises:
        ConfigError: a size out of range, no patterns, too many, or a pattern twice.
    """

    size: tuple[int, int]
    patterns: tuple[Pattern, ...]

    def __post_init__(self) -> None:
        _check_size(self.size)
        if not 0 < len(self.patterns) <= MAX_PATTERNS:
            raise ConfigError(
                f"a sequence has {len(self.patterns)} images, 1 to {MAX_PATTERNS} are possible",
                value=len(self.patterns),
                limit=(1, MAX_PATTERNS),
                remedy="list the images",
            )
        seen: dict[Pattern, int] = {}
        for number, pattern in enumerate(self.patterns):
            if pattern.role != "unused" and seen.setdefault(pattern, number) != number:
                raise ConfigError(
                    f"images {seen[pattern] + 1} and {number + 1} are both {pattern}",
                    value=str(pattern),
                    remedy='give one of them the role "unused"',
                )

    def __len__(self) -> int:
        return len(self.patterns)

    def index(self, role: str) -> int | None:
        """Number of the image with this role (ambient, white, black), from 0; None where there is none."""
        return next((number for number, pattern in enumerate(self.patterns) if pattern.role == role), None)

    @property
    def dark(self) -> int | None:
        """Number of the black image, from 0, or else of the ambient one; None where there is neither."""
        black = self.index("black")
        return self.index("ambient") if black is None else black

    def coded(self, role: str, axis: str) -> list[int]:
        """Numbers of the images of a role, gray or phase, and an axis, from 0."""
        return [n for n, pattern in enumerate(self.patterns) if (pattern.role, pattern.axis) == (role, axis)]

    def length_px(self, axis: str) -> int:
        """Number of coordinates of an axis: width of the projector for columns, height for rows."""
        return self.size[AXES.index(axis)]

    @property
    def axes(self) -> tuple[str, ...]:
        """The coordinates that are coded."""
        return tuple(axis for axis in AXES if any(pattern.axis == axis for pattern in self.patterns))

    def render(self) -> Iterator[U8]:
        """The patterns, uint8 (height, width) each."""
        return (pattern.render(self.size) for pattern in self.patterns)

    def to_json(self) -> dict[str, Any]:
        """The sequence as plain data, the content of the manifest patterns.json."""
        return {
            "projector": {"width": self.size[0], "height": self.size[1]},
            "images": [pattern.to_json() for pattern in self.patterns],
        }

    @staticmethod
    def from_json(values: object) -> PatternSequence:
        """The sequence of plain data, see :meth:`to_json`.

        Raises:
            ConfigError: a missing or unknown key, or a value out of range; the subject names the image.
        """
        if not isinstance(values, Mapping):
            raise ConfigError("is not a mapping with the keys projector and images", remedy="write both")
        for key in ("projector", "images"):
            if key not in values:
                raise ConfigError(f"lacks the key {key!r}", value=key, remedy="add it")
        projector, images = values["projector"], values["images"]
        if not isinstance(projector, Mapping) or {*projector} != {"width", "height"}:
            raise ConfigError("projector does not have the keys width and height", remedy="write both, in px")
        if not isinstance(images, Sequence) or isinstance(images, str):
            raise ConfigError("images is not a list", remedy="list the images in the order of their files")
        if len(images) > MAX_PATTERNS:
            raise ConfigError(
                f"a sequence has {len(images)} images, 1 to {MAX_PATTERNS} are possible",
                value=len(images),
                limit=(1, MAX_PATTERNS),
                remedy="list the images",
            )
        return PatternSequence(
            (projector["width"], projector["height"]),
            tuple(_numbered(number, image) for number, image in enumerate(images, start=1)),
        )

    @staticmethod
    def of_kind(
        kind: str,
        size: tuple[int, int],
        *,
        rows: bool = False,
        periods_px: Sequence[float] = (),
        steps: int = 4,
    ) -> PatternSequence:
        """The sequence of a kind: white, black, then the patterns of the columns and, if wanted, of the rows.

        Args:
            kind: "gray", each bit followed by its inverse, the coarsest first; "phase", sinusoids of several periods;
                "gray+phase", sinusoids of one period, and the Gray code down to half of it.
            size: width and height of the projector, px.
            rows: code the rows too.
            periods_px: of the sinusoids; by default 16 px, for phase alone in addition the whole axis and a period in
                between.
            steps: images of each period, 3 or more.

        Raises:
            ConfigError: an unknown kind, or a value out of range.
        """
        _check_choice("kind", kind, KINDS)
        _check_size(size)
        _check_whole("steps", steps, _LEAST_STEPS, 64)
        patterns = [Pattern("white"), Pattern("black")]
        for axis, length in zip(AXES if rows else AXES[:1], size, strict=False):
            periods = periods_px or (_FIRST_PERIOD_PX,)
            if kind == "phase" and not periods_px:
                periods = (_FIRST_PERIOD_PX, round(math.sqrt(_FIRST_PERIOD_PX * length)), float(length))
            if "gray" in kind:
                finest = int(math.log2(min(periods) / 2)) if kind == "gray+phase" else 0
                bits = max((length - 1).bit_length(), finest + 1)
                patterns += [
                    Pattern("gray", axis, bit, inverse)
                    for bit in range(bits - 1, finest - 1, -1)
                    for inverse in (False, True)
                ]
            if "phase" in kind:
                patterns += [
                    Pattern("phase", axis, period_px=float(period), shift_deg=360.0 * step / steps)
                    for period in periods
                    for step in range(steps)
                ]
        return PatternSequence(size, tuple(patterns))


def _numbered(number: int, image: object) -> Pattern:
    try:
        return Pattern.from_json(image)
    except ConfigError as error:
        raise error.about(f"image {number}") from error


def _check_size(size: tuple[int, int]) -> None:
    for name, value in zip(("width", "height"), size, strict=True):
        _check_whole(name, value, 1, MAX_SIZE_PX)


def _check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ConfigError(
            f"{name} = {quoted(value)} is not one of {', '.join(choices)}",
            value=value,
            limit=choices,
            remedy="use one of them",
            settings=(name,),
        )


def _check_whole(name: str, value: object, low: int, high: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ConfigError(
            f"{name} = {quoted(value)} is not a whole number of {low} to {high}",
            value=value,
            limit=(low, high),
            remedy="write such a number",
            settings=(name,),
        )


def _check_number(name: str, value: object, low: float, high: float) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ConfigError(
            f"{name} = {quoted(value)} is not a number of {low:g} to {high:g}",
            value=value,
            limit=(low, high),
            remedy="write such a number",
            settings=(name,),
        )
