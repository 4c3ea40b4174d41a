# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sub-pixel refinement of matched points by the method of Lucas and Kanade (1981)."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32, F64, U8

__all__ = ["refine_right_points"]

MAX_ITERATIONS = 30


def refine_right_points(
    left: U8,
    right: U8,
    left_xy: F64,
    right_xy: F64,
    *,
    window_px: int,
    max_move_px: float,
    epsilon_px: float = 0.01,
    max_return_px: float | None = None,
) -> tuple[F64, npt.NDArray[np.bool_]]:
    """Moves right points to where the window around them agrees with the window around the left points.

    Args:
        left, right: uint8 (H, W), gray.
        left_xy, right_xy: float64 (N, 2), px.
        window_px: width and height of the window.
        max_move_px: points that move further along x or y are not refined.
        epsilon_px: iteration stops at a smaller step.
        max_return_px: largest distance along x or y from the left point to where tracking back ends; None skips this
            check.

    Returns:
        The moved right points, float64 (N, 2) px, and which of them were refined, bool (N,).
    """
    if not len(left_xy):
        return right_xy, np.ones(0, bool)
    start, guess = left_xy.astype(np.float32), right_xy.astype(np.float32)
    moved, refined = _track(left, right, start, guess, window_px, epsilon_px)
    refined &= _within(moved, guess, max_move_px)
    if max_return_px is not None:
        returned, found_back = _track(right, left, moved, start, window_px, epsilon_px)
        refined &= found_back & _within(returned, start, max_return_px)
    return moved.astype(np.float64), refined


def _track(
    source: U8, target: U8, points: F32, guess: F32, window_px: int, epsilon_px: float
) -> tuple[F32, npt.NDArray[np.bool_]]:
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        points,
        guess.copy(),
        winSize=(window_px, window_px),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, MAX_ITERATIONS, epsilon_px),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return moved, found.ravel() != 0


def _within(points: F32, others: F32, limit_px: float) -> npt.NDArray[np.bool_]:
    near: npt.NDArray[np.bool_] = np.abs(points - others).max(axis=1) <= limit_px
    return near
