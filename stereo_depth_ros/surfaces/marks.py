# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Dots on a printed sheet: their centers in images, and which dot of the sheet each of them is."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import RegistrationError
from stereo_depth_ros.core.types import F64, U8

__all__ = ["DotSheet", "SheetMatch", "find_dots", "match_dots", "plane_of_most"]

_WINDOW_SHARE = 20  # of the longer side of an image: dots are smaller
_DARKER, _DARK = 0.25, 0.08  # than the paper around it, relative: a dot, and what belongs to its border
_FEWEST_PX = 6
_FULL, _ROUND = 0.75, 0.2  # of the ellipse of equal second moments: share that is dark, ratio of the axes
_SCALE_RANGE = 1.8  # factor by which the size of dots, blurred as they are, may be wrong
_FEWEST_DOTS = 6
_AMBIGUOUS = 0.75
_CHUNK = 4096


@dataclass(frozen=True, eq=False)
class DotSheet:
    """A sheet with dots.

    Attributes:
        dots_px: float64 (M, 2), centers in the image of the sheet, px; x right, y down.
        diameter_px: median diameter of the dots.
        size: width and height of the image, px.
    """

    dots_px: F64
    diameter_px: float
    size: tuple[int, int]

    @classmethod
    def of(cls, gray: U8, subject: str = "") -> DotSheet:
        """The sheet of an image, uint8 (H, W), of dots of one size on white.

        Raises:
            RegistrationError: too few dots.
        """
        found = find_dots(gray)
        if len(found):
            median = np.median(found[:, 2])
            found = found[np.abs(found[:, 2] / median - 1) < 0.25]
        if len(found) < _FEWEST_DOTS:
            raise RegistrationError(
                f"shows {len(found)} dots, {_FEWEST_DOTS} are the least",
                subject=subject,
                value=len(found),
                limit=_FEWEST_DOTS,
                remedy="give an image of the sheet, of dark dots of one size on white",
            )
        height, width = gray.shape
        return cls(found[:, :2], float(np.median(found[:, 2])), (width, height))


@dataclass(frozen=True, eq=False)
class SheetMatch:
    """Which dots of the sheet were found.

    Attributes:
        found: int (K,), numbers of the points.
        dots: int (K,), numbers of the dots of the sheet.
        scale: size of a pixel of the sheet in the unit of the points.
    """

    found: npt.NDArray[np.intp]
    dots: npt.NDArray[np.intp]
    scale: float


def find_dots(gray: U8) -> F64:
    """Dark ellipses that are smaller than a twentieth of the image, on a light ground.

    Args:
        gray: uint8 (H, W).

    Returns:
        float64 (N, 3): x and y of the center, weighted by darkness, and the longer diameter, px.
    """
    window = max(gray.shape) // _WINDOW_SHARE | 1
    around = cv2.morphologyEx(gray, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (window, window)))
    dark = (around.astype(np.float32) - gray) / np.maximum(around, 1)
    count, labels, stats, _ = cv2.connectedComponentsWithStats((dark > _DARKER).astype(np.uint8), connectivity=8)
    dots = []
    for number in range(1, count):
        x, y, width, height, area = (int(value) for value in stats[number])
        if area < _FEWEST_PX or max(width, height) >= window:
            continue
        rows, columns = np.nonzero(labels[y : y + height, x : x + width] == number)
        small, large = np.linalg.eigvalsh(np.cov(np.stack((columns, rows))) + np.identity(2) / 12)  # of a pixel
        if area < _FULL * 4 * np.pi * np.sqrt(small * large) or small < (_ROUND * _ROUND) * large:
            continue
        top, left = max(y - 2, 0), max(x - 2, 0)
        patch = dark[top : y + height + 2, left : x + width + 2]
        weight = np.where(patch > _DARK, patch, 0).astype(np.float64)
        row, column = np.indices(weight.shape)
        center = (left + np.sum(weight * column) / weight.sum(), top + np.sum(weight * row) / weight.sum())
        dots.append((*center, 4 * np.sqrt(large)))
    return np.array(dots, np.float64).reshape(-1, 3)


def plane_of_most(points: F64, sigma: F64) -> tuple[F64, float, npt.NDArray[np.intp]]:
    """The plane that most points lie on within three standard deviations, from all triples or many of them.

    Args:
        points: float64 (N, 3), at least 3.
        sigma: float64 (N,), standard deviation of each point across the plane.

    Returns:
        The unit normal n with n X = h, float64 (3,), h above 0, and the numbers of the points on it.
    """
    rng = np.random.default_rng(0)
    triples = points[np.array([rng.choice(len(points), 3, replace=False) for _ in range(500)])]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 0] / lengths[lengths > 0, None]
    off = normals @ points.T - np.sum(normals * triples[lengths > 0, 0], axis=1)[:, None]
    on = np.abs(off[np.argmax(np.sum(np.abs(off) < 3 * sigma, axis=1))]) < 3 * sigma
    for _ in range(5):
        weight = 1 / np.square(sigma[on])
        middle = np.average(points[on], axis=0, weights=weight)
        normal = np.linalg.svd((points[on] - middle) * np.sqrt(weight)[:, None])[2][2]
        on = np.abs((points - middle) @ normal) < 3 * sigma
    distance = float(normal @ middle)
    sign = 1.0 if distance >= 0 else -1.0
    return sign * normal, sign * distance, np.flatnonzero(on)


def match_dots(points: F64, diameters: F64, sheet: DotSheet, subject: str = "") -> SheetMatch:
    """Which dots of a sheet points in its plane are: the turn, shift and scale that most of them agree with.

    All pairs of points are laid on all pairs of dots. Points that are no dots of the sheet, and dots that are hidden,
    do no harm.

    Args:
        points: float64 (N, 2), in a plane, of any unit, x right and y down as in the image of the sheet.
        diameters: float64 (N,), of the dots, in the same unit.
        sheet: the sheet.
        subject: of errors.

    Raises:
        RegistrationError: fewer than six dots fit, or another turn fits about as well.
    """
    z, dots = points @ np.array([1, 1j]), sheet.dots_px @ np.array([1, 1j])
    turns, counts, shifts = _hypotheses(z, dots, diameters, sheet)
    best = int(np.argmax(counts)) if len(counts) else -1
    if best < 0 or counts[best] < _FEWEST_DOTS:
        raise _too_few(int(counts[best]) if best >= 0 else 0, len(points), subject)
    turn = turns[best]
    other = np.abs(np.angle(turns / turn)) > np.radians(10)
    if np.max(counts, where=other, initial=0) > _AMBIGUOUS * counts[best]:
        raise RegistrationError(
            f"the dots fit the sheet in several turns: {int(counts[best])} and {int(counts[other].max())} of them",
            subject=subject,
            value=int(counts[best]),
            limit=_AMBIGUOUS,
            remedy="use a sheet without symmetry, or show more of its dots",
        )
    shift = shifts[best]
    found = chosen = np.zeros(0, np.intp)
    for _ in range(5):
        off = np.abs(turn * z[:, None] + shift - dots)
        nearest = np.argmin(off, axis=1)
        mutual = np.argmin(off, axis=0)[nearest] == np.arange(len(z))
        found = np.flatnonzero(mutual & (off[np.arange(len(z)), nearest] < sheet.diameter_px))
        chosen = nearest[found]
        if len(found) < _FEWEST_DOTS:
            raise _too_few(len(found), len(points), subject)
        ones = np.stack((z[found], np.ones(len(found))), axis=1)
        turn, shift = np.linalg.lstsq(ones, dots[chosen], rcond=None)[0]
    return SheetMatch(found, chosen, 1 / float(np.abs(turn)))


def _hypotheses(
    z: npt.NDArray[np.complex128], dots: npt.NDArray[np.complex128], diameters: F64, sheet: DotSheet
) -> tuple[npt.NDArray[np.complex128], npt.NDArray[np.intp], npt.NDArray[np.complex128]]:
    """Turn with scale, number of points that fit, and shift, of all pairs of points on all pairs of dots."""
    i, j = np.triu_indices(len(z), 1)
    k, m = (index.ravel() for index in np.indices((len(dots), len(dots))))
    far = np.abs(dots[k] - dots[m]) > 4 * sheet.diameter_px  # short ones tell no direction
    k, m = k[far], m[far]
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = (dots[m] - dots[k])[None] / (z[j] - z[i])[:, None]
    expected = sheet.diameter_px / np.median(diameters)
    row, column = np.nonzero(np.abs(np.log(np.abs(turns) / expected)) < np.log(_SCALE_RANGE))
    turns = turns[row, column]
    shifts = dots[k[column]] - turns * z[i[row]]
    counts = np.zeros(len(turns), np.intp)
    for first in range(0, len(turns), _CHUNK):
        some = slice(first, first + _CHUNK)
        moved = turns[some, None] * z + shifts[some, None]
        off = np.full(moved.shape, np.inf)
        for dot in dots:
            np.minimum(off, np.abs(moved - dot), out=off)
        counts[some] = np.sum(off < sheet.diameter_px, axis=1)
    return turns, counts, shifts


def _too_few(count: int, of: int, subject: str) -> RegistrationError:
    return RegistrationError(
        f"{count} of {of} dark dots fit those of the sheet, {_FEWEST_DOTS} are the least",
        subject=subject,
        value=count,
        limit=_FEWEST_DOTS,
        remedy="show the sheet sharp and lit, with a depth, and give the image of this sheet",
    )
