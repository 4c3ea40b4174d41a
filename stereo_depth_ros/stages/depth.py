# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Disparity to depth, its uncertainty, and 16-bit millimeters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.triangulation import Triangulation, pixel_depth
from stereo_depth_ros.core.types import F32, U8, Reason

__all__ = ["depth_from_disparity", "depth_sigma", "millimeters", "reject_behind"]


def reject_behind(disparity_px: F32, reasons: U8, doffs_px: float) -> None:
    """Reject, in place, pixels that are not in front of the cameras (d <= doffs), with the reason RANGE.

    Args:
        disparity_px: float32 (H, W), NaN where invalid.
        reasons: uint8 (H, W), bits of :class:`Reason`.
        doffs_px: cx_left - cx_right, pixels.
    """
    run_bands(_reject_behind, len(disparity_px), disparity_px, reasons, np.float32(doffs_px), np.uint8(Reason.RANGE))


def depth_from_disparity(disparity_px: F32, triangulation: Triangulation, out: F32 | None = None) -> F32:
    """Depth along Z of the left rectified optical frame.

    Args:
        disparity_px: float32 (H, W), NaN where invalid.
        triangulation: the geometry of the rig.
        out: float32 (H, W) to write into.

    Returns:
        float32 (H, W) in meters, NaN where the disparity is invalid or not above the offset.
    """
    depth_m = np.empty_like(disparity_px) if out is None else out
    f_baseline = np.float32(triangulation.f_px * triangulation.baseline_m)
    run_bands(_depth, len(disparity_px), disparity_px, np.float32(triangulation.doffs_px), f_baseline, depth_m)
    return depth_m


def depth_sigma(depth_m: F32, triangulation: Triangulation, disparity_sigma_px: float | F32) -> F32:
    """Standard deviation of the depth, sigma_Z = Z^2 / (f B) sigma_d, float32 (H, W) in meters, NaN where invalid.

    Args:
        depth_m: float32 (H, W).
        triangulation: the geometry of the rig.
        disparity_sigma_px: sigma_d, of all pixels, or of each one, float32 (H, W).
    """
    scale = np.float32(1 / (triangulation.f_px * triangulation.baseline_m)) * np.asarray(disparity_sigma_px, np.float32)
    sigma_m: F32 = depth_m * depth_m * scale
    return sigma_m


def millimeters(depth_m: F32, out: npt.NDArray[np.uint16] | None = None) -> npt.NDArray[np.uint16]:
    """The depth as REP 118's 16UC1: uint16 (H, W) millimeters, 0 where invalid or beyond 65.535 m."""
    depth_mm = np.empty(depth_m.shape, np.uint16) if out is None else out
    run_bands(_millimeters, len(depth_m), depth_m, depth_mm)
    return depth_mm


_F32 = "float32[:, ::1]"


@compiled(f"void(int64, int64, {_F32}, uint8[:, ::1], float32, uint8)")
def _reject_behind(first: int, last: int, disparity_px: F32, reasons: U8, doffs: np.float32, reason: np.uint8) -> None:
    for y in range(first, last):
        for x in range(disparity_px.shape[1]):
            if disparity_px[y, x] <= doffs:
                disparity_px[y, x] = np.float32(np.nan)
                reasons[y, x] |= reason


@compiled(f"void(int64, int64, {_F32}, float32, float32, {_F32})")
def _depth(first: int, last: int, disparity_px: F32, doffs: np.float32, f_baseline: np.float32, depth_m: F32) -> None:
    for y in range(first, last):
        for x in range(disparity_px.shape[1]):
            depth_m[y, x] = pixel_depth(disparity_px[y, x], doffs, f_baseline)


@compiled(f"void(int64, int64, {_F32}, uint16[:, ::1])")
def _millimeters(first: int, last: int, depth_m: F32, depth_mm: npt.NDArray[np.uint16]) -> None:
    for y in range(first, last):
        for x in range(depth_m.shape[1]):
            mm = depth_m[y, x] * np.float32(1000) + np.float32(0.5)
            depth_mm[y, x] = np.uint16(mm) if mm < np.float32(65536) else np.uint16(0)
