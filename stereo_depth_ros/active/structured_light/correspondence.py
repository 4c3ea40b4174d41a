# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two views of one projector: points and disparities by equal projector coordinates."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, F64, MatchResult, Reason

__all__ = ["correspondences", "disparity_from_maps"]


def correspondences(left: ProjectorMap, right: ProjectorMap, cell_px: int = 1) -> tuple[F64, F64]:
    """Points that both cameras see in the light of the same cell of the projector; the views need not be rectified.

    Args:
        left, right: maps with columns and rows, of one projector.
        cell_px: width and height of a cell, projector px.

    Returns:
        float64 (N, 2) each: x, y of the center of the pixels of each cell, px.

    Raises:
        ImageError: a map without columns or rows, or of another projector.
    """
    cells, points = zip(*(_centers(each, cell_px) for each in (left, right)), strict=True)
    _, i, j = np.intersect1d(cells[0], cells[1], assume_unique=True, return_indices=True)
    return points[0][i], points[1][j]


def _centers(each: ProjectorMap, cell_px: int) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], F64]:
    if each.column_px is None or each.row_px is None:
        raise ImageError(
            "a map has no rows or no columns, both are needed", remedy="project patterns of columns and of rows"
        )
    y, x = np.nonzero(each.reasons == 0)
    column = np.round(each.column_px[y, x] / cell_px).astype(np.int64)
    row = np.round(each.row_px[y, x] / cell_px).astype(np.int64)
    cells, inverse, counts = np.unique(row * (each.size[0] + 2) + column, return_inverse=True, return_counts=True)
    centers = np.stack([np.bincount(inverse, values) / counts for values in (x, y)], axis=1)
    return cells, centers


def disparity_from_maps(left: ProjectorMap, right: ProjectorMap) -> MatchResult:
    """Disparities of rectified views: the right pixel of the same row that has the projector column of the left one.

    Args:
        left, right: maps of rectified images, with columns.

    Raises:
        ImageError: a map without columns, or other sizes.
    """
    if left.column_px is None or right.column_px is None:
        raise ImageError("a map has no columns", remedy="project patterns of columns")
    disparity_px: F32 = np.full(left.reasons.shape, np.nan, np.float32)
    for row, (codes, other) in enumerate(zip(left.column_px, right.column_px, strict=True)):
        x, x_right = np.nonzero(np.isfinite(codes))[0], np.nonzero(np.isfinite(other))[0]
        if len(x_right) < 2:
            continue
        order = x_right[np.argsort(other[x_right])]
        disparity_px[row, x] = x - np.interp(codes[x], other[order], order, np.nan, np.nan)
    reasons = np.where(np.isfinite(disparity_px), 0, left.reasons).astype(np.uint8)
    reasons[(reasons == 0) & ~np.isfinite(disparity_px)] = Reason.NO_MATCH
    return MatchResult(disparity_px, reasons, 0.0)
