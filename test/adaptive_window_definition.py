# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptive windows by their definition in plain numpy, and pairs to try them on."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.matching.window import adaptive_window_kernel

__all__ = ["Estimate", "grown_window", "warped_pair"]


def warped_pair(height: int, width: int, disparity: Any, seed: int = 1) -> tuple[U8, U8]:
    """Smooth texture and the left image of which each pixel has ``disparity``."""
    rng = np.random.default_rng(seed)
    right = cv2.GaussianBlur(rng.uniform(0, 255, (height, width)).astype(np.float32), (0, 0), 1.6)
    right = cv2.normalize(right, None, 0, 255, cv2.NORM_MINMAX)
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    left = cv2.remap(right, x - np.float32(disparity), y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.clip(np.rint(left), 0, 255).astype(np.uint8), np.rint(right).astype(np.uint8)


class Estimate(NamedTuple):
    """What a window says: its increment of the disparity, the inverse variance, and how unlikely its pixels are."""

    increment: float
    precision: float
    surprise: float


def window_estimate(maps: list[F64], y: int, x: int, center: float, extent: list[int]) -> Estimate | None:
    """The estimate from its definition; None where the window cannot be taken."""
    left, right, before = maps
    height, width = left.shape
    rows = np.arange(y - extent[0], y + extent[1] + 1)
    columns = np.arange(x - extent[2], x + extent[3] + 1)
    at = columns - center
    if rows[0] < 0 or rows[-1] >= height or columns[0] < 0 or columns[-1] >= width:
        return None
    # Central differences on both sides of the position are needed.
    if np.floor(at[0]) < 1 or np.floor(at[-1]) > width - 3:
        return None
    near = before[np.ix_(rows, columns)]
    if np.isnan(near).any():
        return None
    slope = np.gradient(right, axis=1)
    grid = np.arange(width)
    there = np.array([np.interp(at, grid, right[row]) for row in rows])
    gradient = np.array([np.interp(at, grid, slope[row]) for row in rows])
    distance = np.hypot(rows[:, None] - y, columns - x)
    spread = np.mean(np.divide((near - center) ** 2, distance, out=np.zeros_like(distance), where=distance > 0))
    variance = adaptive_window_kernel.NOISE_POWER + np.mean(gradient**2) * spread * np.rint(distance)
    weight = 1 / variance
    difference = there - left[np.ix_(rows, columns)]
    difference = difference - np.average(difference, weights=weight)
    gradient = gradient - np.average(gradient, weights=weight)
    precision = float(np.sum(weight * gradient**2))
    increment = float(np.sum(weight * difference * gradient)) / precision
    remainder = difference - increment * gradient
    return Estimate(increment, precision, float(np.mean(remainder**2 / variance + np.log(variance))))


def grown_window(maps: list[F64], y: int, x: int, center: float) -> tuple[Estimate | None, list[int]]:
    """The window that grows around one pixel, and its extents up, down, left and right."""
    extent = [1, 1, 1, 1]
    here = window_estimate(maps, y, x, center, extent)
    closed: set[int] = set()
    while here is not None:
        grown: dict[int, Estimate] = {}
        for side in range(4):
            if side in closed or extent[side] == adaptive_window_kernel.REACH:
                continue
            trial = list(extent)
            trial[side] += 1
            found = window_estimate(maps, y, x, center, trial)
            if found is None or found.precision < here.precision:
                closed.add(side)
            else:
                grown[side] = found
        if not grown:
            break
        best = max(grown, key=lambda side: grown[side].precision)
        here = grown[best]
        extent[best] += 1
    return here, extent
