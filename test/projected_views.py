# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images of projected patterns by closed forms: a camera that sees a given projector pixel in each of its pixels."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.structured_light.patterns import Pattern, PatternSequence

F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]


@dataclass
class ProjectedView:
    """A camera whose pixels see the projector coordinates ``column`` and ``row``, float64 (H, W); NaN in shadow."""

    column: F64
    row: F64
    gamma: float = 1.0
    ambient: float = 12.0
    albedo: F64 | float = 150.0
    noise: float = 0.7
    shot: float = 0.0  # variance for each gray level
    blur_px: float = 0.8  # projector px, half width of a pixel's footprint
    seed: int = 3
    reflected: F64 | float = 0.0  # of the mean light of a pattern
    random: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)

    def image(self, pattern: Pattern, size: tuple[int, int]) -> U8:
        """uint8 (H, W)."""
        light = np.where(np.isfinite(self.column), self._light(pattern, size), 0.0)
        mean = float(np.mean((pattern.render(size) / 255.0) ** self.gamma))
        levels = self.ambient + self.albedo * light + self.reflected * mean
        return np.clip(np.rint(levels + self.noise * self.random.standard_normal(levels.shape)), 0, 255).astype(
            np.uint8
        )

    def images(self, sequence: PatternSequence) -> list[U8]:
        return [self.image(pattern, sequence.size) for pattern in sequence.patterns]

    def _light(self, pattern: Pattern, size: tuple[int, int]) -> F64:
        if pattern.role not in ("gray", "phase"):
            return np.full(self.column.shape, 1.0 if pattern.role == "white" else 0.0)
        along = pattern.axis == "columns"
        line = np.round(255 * pattern.line(size[0] if along else size[1])) / 255
        coordinate = np.nan_to_num(self.column if along else self.row)
        # the mean over the footprint of the pixel: the difference of two values of the integral of the line
        edges = np.arange(len(line) + 1) - 0.5
        integral = np.concatenate(([0.0], np.cumsum(line**self.gamma)))
        low, high = (np.interp(coordinate + side * self.blur_px, edges, integral) for side in (-1, 1))
        covered = np.minimum(coordinate + self.blur_px, edges[-1]) - np.maximum(coordinate - self.blur_px, edges[0])
        return np.asarray((high - low) / np.maximum(covered, 1e-9))


def slanted_view(width: int = 160, height: int = 120, **settings: object) -> ProjectedView:
    """A slanted plane that fills the image of a projector of 200x150 px."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    depth = 1 + 0.0007 * x - 0.0004 * y
    column = 9.3 + (1.13 * x + 0.11 * y) / depth
    row = 6.1 + (1.07 * y - 0.04 * x + 6) / depth
    return ProjectedView(column, row, **settings)  # type: ignore[arg-type]
