# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Corner detection (SIFT, ORB, FAST), descriptors and their distances; pixel centers are whole numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32, F64, U8

__all__ = ["detect_fast", "detect_orb", "detect_sift", "mutual_best", "squared_distances", "squared_distances_of_pairs"]

Indices: TypeAlias = npt.NDArray[np.intp]

SIFT_SHIFT_PX = 0.25  # OpenCV halves the positions found in the doubled image without regard to pixel centers
SIFT_LENGTH, ORB_BITS = 128, 256
PAIRS_PER_BLOCK = 2**16  # of descriptors: bounds the memory


def detect_sift(image: U8, count: int, contrast_threshold: float = 0.04) -> tuple[F64, F32]:
    """The strongest SIFT features (Lowe 2004) of a gray image, uint8 (H, W).

    A corner with several orientations appears once for each of them.

    Returns:
        Positions, float64 (N, 2) px, and descriptors, float32 (N, 128) of whole numbers.
    """
    keypoints, descriptors = cv2.SIFT.create(count, contrastThreshold=contrast_threshold).detectAndCompute(image, None)
    if not keypoints:
        return np.empty((0, 2)), np.empty((0, SIFT_LENGTH), np.float32)
    return _positions(keypoints) - SIFT_SHIFT_PX, descriptors


def detect_orb(image: U8, count: int, fast_threshold: int) -> tuple[F64, F32]:
    """The strongest ORB features (Rublee et al. 2011) of a gray image, uint8 (H, W).

    Returns:
        Positions, float64 (N, 2) px, and descriptors, float32 (N, 256) of bits 0 and 1.
    """
    return _with_bits(*cv2.ORB.create(count, fastThreshold=fast_threshold).detectAndCompute(image, None))


def detect_fast(image: U8, threshold: int, cells: tuple[int, int], per_cell: int) -> tuple[F64, F32]:
    """The strongest FAST corners (Rosten and Drummond 2006) of each cell of a gray image, with ORB descriptors.

    Args:
        image: uint8 (H, W).
        threshold: of the gray difference to the circle around a corner.
        cells: rows and columns of the grid of cells.
        per_cell: largest number of corners of a cell.

    Returns:
        As of :func:`detect_orb`.
    """
    keypoints = cv2.FastFeatureDetector.create(threshold).detect(image)
    return _with_bits(*cv2.ORB.create().compute(image, _strongest(keypoints, image.shape, cells, per_cell)))


def squared_distances(left: F32, right: F32) -> F32:
    """Squared Euclidean distances of all pairs of descriptors, float32 (N, M); of bits the Hamming distances.

    Exact: sums of these whole numbers are below 2^24.
    """
    squared: F32 = (-2 * left) @ right.T
    squared += np.einsum("ij,ij->i", left, left)[:, None]
    squared += np.einsum("ij,ij->i", right, right)
    return squared


def squared_distances_of_pairs(left: F32, right: F32, i: Indices, j: Indices) -> F64:
    """The same of the pairs (i, j) only, float64 (P,)."""
    squared = np.empty(len(i))
    for begin in range(0, len(i), PAIRS_PER_BLOCK):
        block = slice(begin, begin + PAIRS_PER_BLOCK)
        difference = left[i[block]] - right[j[block]]
        squared[block] = np.einsum("ij,ij->i", difference, difference)
    return squared


def mutual_best(cost: F32, ratio: float) -> tuple[Indices, Indices]:
    """Pairs of a row and a column that are each other's minimum, the row's below ``ratio`` times its second best.

    Args:
        cost: float32 (N, M), M >= 2; infinite for pairs that cannot match; the same afterwards.
        ratio: 0..1 (Lowe's ratio test).
    """
    rows, best = np.arange(len(cost)), cost.argmin(axis=1)
    least = cost[rows, best]
    cost[rows, best] = np.inf
    second = cost.min(axis=1)
    cost[rows, best] = least
    # Few are left for the search of the first minimum of a column, which is slow along the rows.
    chosen = np.flatnonzero((least < ratio * second) & (least == cost.min(axis=0)[best]))
    chosen = chosen[cost.T[best[chosen]].argmin(axis=1) == chosen]
    return rows[chosen], best[chosen]


def _positions(keypoints: Sequence[Any]) -> F64:
    return np.array(cv2.KeyPoint.convert(keypoints), np.float64)


def _with_bits(keypoints: Sequence[Any], descriptors: U8) -> tuple[F64, F32]:
    if not keypoints:
        return np.empty((0, 2)), np.empty((0, ORB_BITS), np.float32)
    return _positions(keypoints), np.unpackbits(descriptors, axis=1).astype(np.float32)


def _strongest(keypoints: Sequence[Any], shape: tuple[int, ...], cells: tuple[int, int], per_cell: int) -> list[Any]:
    if not keypoints:
        return []
    xy, response = np.array(cv2.KeyPoint.convert(keypoints)), np.array([each.response for each in keypoints])
    row, column = (xy[:, ::-1] * cells // shape[:2]).astype(np.intp).T
    cell = row * cells[1] + column
    order = np.lexsort((-response, cell))
    rank = np.arange(len(order)) - np.searchsorted(cell[order], cell[order])
    return [keypoints[k] for k in order[rank < per_cell]]
