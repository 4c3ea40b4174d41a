# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two views of one projector: points and disparities by equal projector coordinates."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8, MatchResult, Reason

__all__ = ["correspondences", "disparity_from_maps"]

I64: TypeAlias = npt.NDArray[np.int64]

_LEAST_PIXELS = 4.0  # of a cell, by default
_LARGEST_CELL_PX = 256
_SLOPE_PX = 2  # camera px to each side, from which slopes of the coordinates are taken
_MOST_SHIFT_PX = 2.0  # from the center of the pixels to that of the cell, sizes of the cell

_STEP_PX = 1 / 16  # stated resolution of the disparities
_MOST_STEP_PX = 8.0  # projector px between neighbors of one surface
_ONE_PLACE_PX = 1.5  # right columns that are one match
_ROWS_PX = 1.5  # projector rows of a match may differ by this, and by
_ROWS_SIGMAS = 3.0
_ROUND_TRIP_PX = 1.5

_NO_MATCH, _LEFT_RIGHT, _UNIQUENESS = int(Reason.NO_MATCH), int(Reason.LEFT_RIGHT), int(Reason.UNIQUENESS)
_FLOATS, _BYTES = "float32[:, ::1]", "uint8[:, ::1]"


def correspondences(left: ProjectorMap, right: ProjectorMap, cell_px: int | None = None) -> tuple[F64, F64]:
    """Points that both cameras see in the light of the same cell of the projector; the views need not be rectified.

    The place of a cell in an image is the center of its pixels, moved by what their coordinates are away from the
    center of the cell, and the slopes of the coordinates there. A cell that is partly hidden gives the same point.

    Args:
        left, right: maps with columns and rows, of one projector.
        cell_px: width and height of a cell, projector px; None is the smallest power of two whose cells have four
            pixels of each camera.

    Returns:
        float64 (N, 2) each: x, y of the same points, px.

    Raises:
        ConfigError: a cell below 1 px.
        ImageError: a map without columns or rows, or of another projector.
    """
    if cell_px is not None and not 1 <= cell_px <= _LARGEST_CELL_PX:
        raise ConfigError(
            f"cell_px = {cell_px} is not 1 to {_LARGEST_CELL_PX}",
            value=cell_px,
            limit=(1, _LARGEST_CELL_PX),
            remedy="set a size in this range",
            settings=("cell_px",),
        )
    _check_projectors(left, right)
    pixels = [_Pixels(each, side) for each, side in ((left, "left"), (right, "right"))]
    size = cell_px or max(each.cell_px() for each in pixels)
    (cells, points), (others, other_points) = (each.centers(size) for each in pixels)
    _, i, j = np.intersect1d(cells, others, assume_unique=True, return_indices=True)
    return points[i], other_points[j]


class _Pixels:
    """The decoded pixels of a map with columns and rows."""

    def __init__(self, each: ProjectorMap, side: str) -> None:
        if each.column_px is None or each.row_px is None:
            raise ImageError(
                f"the map has no {'columns' if each.column_px is None else 'rows'}, both are needed",
                subject=f"{side} view",
                remedy="project patterns of columns and of rows",
            )
        self._maps = (each.column_px, each.row_px)
        self._y, self._x = np.nonzero(each.reasons == 0)
        self._coordinates = [coded[self._y, self._x].astype(np.float64) for coded in self._maps]

    def cell_px(self) -> int:
        size = 1
        while size < _LARGEST_CELL_PX and len(self._x) < _LEAST_PIXELS * len(np.unique(self._cells(size))):
            size *= 2
        return size

    def _cells(self, size: int) -> I64:
        column, row = (np.floor((each + 0.5) / size).astype(np.int64) for each in self._coordinates)
        cells: I64 = (row << 32) + column
        return cells

    def centers(self, size: int) -> tuple[I64, F64]:
        """Numbers of the cells, and the points of their centers, float64 (N, 2)."""
        numbers = self._cells(size)
        cells, members, counts = np.unique(numbers, return_inverse=True, return_counts=True)

        def mean(values: npt.NDArray[np.float64], usable: npt.NDArray[np.bool_] | None = None) -> F64:
            if usable is None:
                return np.bincount(members, values) / counts
            total = np.bincount(members, np.where(usable, values, 0.0))
            return total / np.maximum(np.bincount(members, usable), 1)

        slopes = [[_slope(coded, axis)[self._y, self._x] for axis in (1, 0)] for coded in self._maps]
        usable = np.isfinite(np.sum(slopes, axis=(0, 1)))
        (cx, cy), (rx, ry) = ([mean(values, usable) for values in pair] for pair in slopes)
        center = (size - 1) / 2
        column = mean(self._coordinates[0]) - (cells & 0xFFFFFFFF) * size - center
        row = mean(self._coordinates[1]) - (cells >> 32) * size - center
        with np.errstate(divide="ignore", invalid="ignore"):
            determinant = cx * ry - cy * rx
            shift = np.stack(((ry * column - cy * row) / determinant, (cx * row - rx * column) / determinant), axis=1)
        extent_px = np.sqrt(counts)
        good = np.linalg.norm(shift, axis=1) <= _MOST_SHIFT_PX * extent_px
        points = np.stack((mean(self._x.astype(np.float64)), mean(self._y.astype(np.float64))), axis=1) - shift
        return cells[good], points[good]


def _slope(coordinate: F32, axis: int) -> F64:
    """Change of a coordinate for each pixel along an axis of the image, float64 (H, W), NaN at borders and gaps."""
    slope = np.full(coordinate.shape, np.nan)
    before, inner, after = (slice(None, -2 * _SLOPE_PX), slice(_SLOPE_PX, -_SLOPE_PX), slice(2 * _SLOPE_PX, None))
    place = (slice(None),) * axis
    slope[(*place, inner)] = (coordinate[(*place, after)] - coordinate[(*place, before)]) / (2 * _SLOPE_PX)
    return slope


def _check_projectors(left: ProjectorMap, right: ProjectorMap) -> None:
    if left.size != right.size:
        raise ImageError(
            f"the left map is of a projector of {left.size[0]}x{left.size[1]} px, the right one of "
            f"{right.size[0]}x{right.size[1]} px",
            value=right.size,
            limit=left.size,
            remedy="decode both views with one manifest",
        )


def disparity_from_maps(left: ProjectorMap, right: ProjectorMap) -> MatchResult:
    """Disparities of rectified views: the right pixel of the same row that has the projector column of the left one.

    The right column is interpolated between two neighbors whose projector columns enclose that of the left pixel;
    neighbors that differ by more than 8 projector px are not of one surface. The projector columns of a row need not
    increase. Where several places have the column, the projector rows decide, if they are coded.

    Reasons: those of the left map; NO_MATCH where no place has the column, UNIQUENESS where several have it, LEFT_RIGHT
    where the right pixel found has another left one. The standard deviation of a disparity is that of both coordinates
    over the slope of the right one; the confidence is 1 / (1 + s^2), s in px.

    Args:
        left, right: maps of the rectified images of one size, with columns.

    Raises:
        ImageError: a map without columns, other sizes, or of another projector.
    """
    _check_projectors(left, right)
    for side, each in (("left", left), ("right", right)):
        if each.column_px is None:
            raise ImageError("the map has no columns", subject=f"{side} view", remedy="project patterns of columns")
    if left.reasons.shape != right.reasons.shape:
        raise ImageError(
            f"the left map is {left.reasons.shape}, the right one {right.reasons.shape}",
            value=right.reasons.shape,
            limit=left.reasons.shape,
            remedy="rectify both views with one rig",
        )
    height, width = left.reasons.shape
    disparity_px, sigma_px = np.empty((2, height, width), np.float32)
    reasons = left.reasons.copy()
    has_rows = left.row_px is not None and right.row_px is not None
    maps = [
        array
        for each in (left, right)
        for array in (each.column_px, each.row_px if has_rows else each.column_px, each.sigma_px)
    ]
    run_bands(_match_rows, height, left.size[0], has_rows, *maps, disparity_px, sigma_px, reasons)
    confidence = (1 / (1 + sigma_px**2)).astype(np.float32)
    return MatchResult(disparity_px, reasons, _STEP_PX, confidence, sigma_px=sigma_px)


@compiled(allocates=False)
def _index_row(column: F32, heads: I64, following: I64) -> None:
    """Lists of the pixels x of a row by projector column: from x to x + 1 the column passes through that of the list.

    A pair of neighbors is in the list of the projector column in its middle; lists two around cover all of it.
    """
    heads[:] = -1
    for x in range(column.size - 1):
        a, b = column[x], column[x + 1]
        if abs(a - b) <= _MOST_STEP_PX:  # false for NaN
            k = min(max(int(0.5 * (a + b) / _MOST_STEP_PX + 1.0), 0), heads.size - 1)
            following[x] = heads[k]
            heads[k] = x


@compiled(allocates=False)
def _find(
    value: float,
    row: float,
    tolerance: float,
    column: F32,
    rows: F32,
    has_rows: bool,
    heads: I64,
    following: I64,
) -> tuple[int, float, float]:
    """Number of places with the column ``value``, the first of them, and its slope, projector px for each px."""
    k = int(value / _MOST_STEP_PX + 1.0)
    places, found, slope, nearest = 0, 0.0, 1.0, 0.0
    for bucket in range(max(k - 1, 0), min(k + 2, heads.size)):
        x = heads[bucket]
        while x >= 0:
            a, b = float(column[x]), float(column[x + 1])
            if min(a, b) <= value <= max(a, b):
                part = (value - a) / (b - a) if a != b else 0.5
                there = float(rows[x]) + part * (float(rows[x + 1]) - float(rows[x]))
                if not has_rows or abs(there - row) <= tolerance:
                    place = x + part
                    if places == 0 or abs(place - found) <= _ONE_PLACE_PX:
                        if places == 0 or abs(b - a) > nearest:
                            found, slope, nearest = place, b - a, abs(b - a)
                        places = max(places, 1)
                    else:
                        places += 1
            x = following[x]
    return places, found, slope


@compiled(
    f"void(int64, int64, int64, boolean, {_FLOATS}, {_FLOATS}, {_FLOATS}, {_FLOATS}, {_FLOATS}, {_FLOATS}, {_FLOATS}, "
    f"{_FLOATS}, {_BYTES})"
)
def _match_rows(
    first: int,
    last: int,
    projector_width: int,
    has_rows: bool,
    left: F32,
    left_rows: F32,
    left_sigma: F32,
    right: F32,
    right_rows: F32,
    right_sigma: F32,
    disparity_px: F32,
    sigma_px: F32,
    reasons: U8,
) -> None:
    width = left.shape[1]
    count = int(projector_width / _MOST_STEP_PX) + 4
    heads, left_heads = np.empty(count, np.int64), np.empty(count, np.int64)
    following, left_following = np.empty(width, np.int64), np.empty(width, np.int64)
    for y in range(first, last):
        _index_row(right[y], heads, following)
        _index_row(left[y], left_heads, left_following)
        for x in range(width):
            disparity_px[y, x], sigma_px[y, x] = np.nan, np.nan
            if reasons[y, x]:
                continue
            sigma = float(left_sigma[y, x])
            tolerance = _ROWS_PX + _ROWS_SIGMAS * sigma
            value, row = float(left[y, x]), float(left_rows[y, x])
            places, found, slope = _find(value, row, tolerance, right[y], right_rows[y], has_rows, heads, following)
            if places != 1:
                reasons[y, x] |= _NO_MATCH if places == 0 else _UNIQUENESS
                continue
            near = int(found + 0.5)
            other = float(right_sigma[y, near])
            back, at, _ = _find(
                float(right[y, near]),
                float(right_rows[y, near]),
                tolerance,
                left[y],
                left_rows[y],
                has_rows,
                left_heads,
                left_following,
            )
            if back > 1 or (back == 1 and abs(at - x - (near - found)) > _ROUND_TRIP_PX):
                reasons[y, x] |= _LEFT_RIGHT
                continue
            disparity_px[y, x] = x - found
            sigma_px[y, x] = np.sqrt((sigma * sigma + other * other) / max(slope * slope, 1e-6))
