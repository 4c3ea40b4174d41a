# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A light stripe seen by two cameras: points from its disparities, alone or combined with those of the light plane."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.active.light_stripe.light_plane import LightPlane, ProfilePoints, stripe_depth
from stereo_depth_ros.active.light_stripe.profile import StripeProfile, StripeReason
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64

__all__ = ["combined_depth", "stereo_points"]

_STEP_PX = 0.5  # of the derivative of the depth on the plane


def stereo_points(
    left: StripeProfile,
    right: StripeProfile,
    triangulation: Triangulation,
    config: LightStripeConfig,
    plane: LightPlane | None = None,
) -> ProfilePoints:
    """The points of a stripe in a rectified pair: one stripe a row gives one disparity a row.

    Args:
        left, right: profiles of the rectified images, one place a row.
        triangulation: geometry of the rig.
        config: depth range, least angle between ray and plane, largest difference of both methods.
        plane: the light plane in the left rectified frame, combined with the disparities by :func:`combined_depth`;
            rows that only the left camera sees are then on it. None uses the disparities alone.

    Returns:
        The points in the left rectified frame; ``profile`` is the left one, with the reasons of the right one where
        only that lacks the stripe.

    Raises:
        ConfigError: the profiles are not those of rows.
    """
    if not (left.vertical and right.vertical):
        raise ConfigError(
            "two cameras need a vertical stripe: along a row it has no disparity",
            value="horizontal",
            limit="vertical",
            remedy="turn the laser, or use one camera",
            settings=("stripe_direction",),
        )
    t, profile, both = triangulation, left, right.reasons == 0
    if plane is None:
        only = (left.reasons == 0) & ~both
        profile = profile.rejected(only, StripeReason.NO_STRIPE)
        profile.reasons[only] = right.reasons[only]
    lines = profile.valid_lines
    x_px, sigma_left = (values[lines].astype(np.float64) for values in (left.position_px, left.sigma_px))
    x_right, sigma_right = (values[lines].astype(np.float64) for values in (right.position_px, right.sigma_px))
    d_px = x_px - x_right - t.doffs_px
    f_baseline = t.f_px * t.baseline_m
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(d_px > 0, f_baseline / d_px, np.nan)
        slope = -np.square(depth) / f_baseline  # dZ / dx_left = -dZ / dx_right
        sigma = np.abs(slope) * np.hypot(sigma_left, sigma_right)
    # as of a camera with square pixels
    rays = np.column_stack(((x_px - t.cx_px) / t.f_px, (lines - t.cy_px) / t.fy_px, np.ones(len(lines))))
    refused = []
    if plane is not None:
        on_plane = stripe_depth(rays[:, 0] * t.f_px, rays[:, 1] * t.f_px, t.f_px, plane)
        moved = stripe_depth(rays[:, 0] * t.f_px + _STEP_PX, rays[:, 1] * t.f_px, t.f_px, plane)
        across = rays @ plane.normal
        shift = plane.sigma_m(rays * on_plane[:, None]) / np.abs(across)  # of the depth by the errors of the plane
        plane_slope = (moved - on_plane) / _STEP_PX
        sines = np.abs(across) / np.linalg.norm(rays, axis=1)
        refused.append((~(sines >= np.sin(np.radians(config.min_plane_angle))), StripeReason.GRAZING))
        with np.errstate(divide="ignore", invalid="ignore"):
            apart = np.abs(f_baseline / on_plane - d_px) > config.max_stripe_difference
        refused.append((apart & (right.reasons[lines] == 0), StripeReason.DISAGREEMENT))
        depth, sigma = combined_depth(on_plane, depth, plane_slope, slope, sigma_left, sigma_right, shift)
    with np.errstate(invalid="ignore"):
        outside = ~((depth > 0) & (depth >= config.stripe_min_depth) & (depth <= (config.stripe_max_depth or np.inf)))
    refused.append((outside, StripeReason.RANGE))
    for lost, reason in refused:
        every = np.zeros(len(profile.reasons), bool)
        every[lines[lost]] = True
        profile = profile.rejected(every, reason)
    kept = profile.reasons[lines] == 0
    points_m = rays * depth[:, None]
    sigma_m = sigma * np.linalg.norm(rays, axis=1)
    level = profile.level[lines].astype(np.float64)
    return ProfilePoints(profile, lines[kept], points_m[kept], sigma_m[kept], level[kept])


def combined_depth(
    on_plane: F64,
    by_disparity: F64,
    plane_slope: F64,
    slope: F64,
    sigma_left: F64,
    sigma_right: F64,
    plane_sigma: F64,
) -> tuple[F64, F64]:
    """Best linear unbiased depth of both methods, whose errors share the place in the left image.

    The covariance of the two depths follows from the standard deviations of both places and of the plane; the weights
    are C^-1 1 / (1^T C^-1 1) (Aitken 1935), limited to 0..1.

    Args:
        on_plane, by_disparity: float64 (N,), depths, meters; without a disparity the second is NaN.
        plane_slope, slope: float64 (N,), their derivatives by the place in the left image, meters per px.
        sigma_left, sigma_right: float64 (N,), standard deviations of the places, px.
        plane_sigma: float64 (N,), standard deviation of the first depth by that of the plane, meters.

    Returns:
        Depth and its standard deviation, float64 (N,), meters.
    """
    var_plane = np.square(plane_slope * sigma_left) + np.square(plane_sigma)
    var_disparity = np.square(slope) * (np.square(sigma_left) + np.square(sigma_right))
    shared = plane_slope * slope * np.square(sigma_left)
    total = var_plane + var_disparity - 2 * shared
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.clip(np.where(total > 0, (var_plane - shared) / total, 0.5), 0, 1)  # of the disparity
    alone = ~np.isfinite(by_disparity)
    weight[alone] = 0
    other, var_other = np.where(alone, on_plane, by_disparity), np.where(alone, 0, var_disparity)
    depth = on_plane + weight * (other - on_plane)
    variance = np.square(1 - weight) * var_plane + np.square(weight) * var_other
    variance += np.where(alone, 0, 2 * weight * (1 - weight) * shared)
    return depth, np.sqrt(np.clip(variance, 0, None))
