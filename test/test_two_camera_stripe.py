# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A light stripe seen by two cameras: disparities alone, combined with the light plane, disagreement, occlusion."""

from __future__ import annotations

import functools
from typing import Any

import cv2
import numpy as np
import pytest

from stereo_depth_ros.active.light_stripe.light_plane import LightPlane
from stereo_depth_ros.active.light_stripe.profile import StripeProfile, StripeReason
from stereo_depth_ros.active.light_stripe.scanner import ScannedProfile, StereoStripeScanner
from stereo_depth_ros.active.light_stripe.two_cameras import combined_depth, stereo_points
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64, U8, Frame, StereoPair
from stereo_depth_ros.synthetic.light_stripe import PLANE, SyntheticStripe

EXACT = LightPlane.exact(PLANE[:3], float(PLANE[3]))


@functools.cache
def scanner() -> SyntheticStripe:
    return SyntheticStripe(320, 240, sigma_m=0.0045)


@functools.cache
def images() -> tuple[U8, U8]:
    return scanner().capture()


def scanned(plane: LightPlane | None, **settings: Any) -> ScannedProfile:
    config = LightStripeConfig(stripe_channel="green", **settings)
    pair = StereoPair(*(Frame(image, 5, side, "rgb8") for side, image in zip(("left", "right"), images(), strict=True)))
    return StereoStripeScanner(scanner().rig, config, plane=plane).scan(pair)


def depth_errors(profile: ScannedProfile) -> F64:
    """Of the points on the board, off its borders: depth in the raw left frame against the truth at that pixel."""
    left = scanner().rig.left
    lines = profile.found.lines
    raw = profile.found.points_m @ left.R  # R^T X
    pixels = cv2.projectPoints(raw, np.zeros(3), np.zeros(3), left.K, left.D)[0][:, 0]
    error = raw[:, 2] - scanner().depth_m(pixels)
    return np.asarray(error[(lines > 50) & (lines < 85)])


def test_disparities_need_no_light_plane() -> None:
    profile = scanned(None)
    errors = depth_errors(profile)
    assert len(errors) > 25
    assert float(np.median(np.abs(errors))) < 0.003  # the disparity is exact to 0.05 px
    assert float(np.median(profile.found.sigma_m)) < 0.002
    assert profile.frame_id == "left"


def test_plane_and_disparities_together_are_at_least_as_exact() -> None:
    stereo, both = scanned(None), scanned(EXACT)
    assert np.median(both.found.sigma_m) < np.median(stereo.found.sigma_m)
    assert float(np.sqrt(np.mean(depth_errors(both) ** 2))) < float(np.sqrt(np.mean(depth_errors(stereo) ** 2)))


def test_a_wrong_plane_is_flagged() -> None:
    shifted = LightPlane.exact(PLANE[:3], float(PLANE[3]) + 0.01)
    profile = scanned(shifted)
    counts = profile.found.profile.reason_counts()
    assert counts["DISAGREEMENT"] > 0.8 * len(scanned(None).found.lines)
    assert scanned(shifted, max_stripe_difference=100.0).found.profile.reason_counts()["DISAGREEMENT"] == 0


def profile_of(places: list[float], sigma: float = 0.1) -> StripeProfile:
    values = np.array(places, np.float32)
    found = np.isfinite(values)
    reasons = np.where(found, 0, StripeReason.SATURATED).astype(np.uint8)
    sigmas = np.where(found, np.float32(sigma), np.float32(np.nan))
    return StripeProfile(values, sigmas, np.full(len(values), 50, np.float32), sigmas, reasons, True)


def test_disparity_gives_depth_and_bad_rows_keep_their_reasons() -> None:
    """Z = f B / (d - doffs): 500 * 0.1 / (20 - 10) = 5 m."""
    geometry = Triangulation(500.0, 600.0, 320.0, 240.0, 0.1, 10.0)
    left, right = profile_of([300, 310, np.nan, 300]), profile_of([280, np.nan, 250, 295])
    found = stereo_points(left, right, geometry, LightStripeConfig())
    np.testing.assert_allclose(found.points_m, [[(300 - 320) / 500 * 5, -240 / 600 * 5, 5]])
    assert found.profile.reasons.tolist() == [0, StripeReason.SATURATED, StripeReason.SATURATED, StripeReason.RANGE]
    depth_sigma = 5**2 / 50 * np.hypot(0.1, 0.1)
    assert found.sigma_m[0] == pytest.approx(depth_sigma * np.linalg.norm(found.points_m[0] / 5), rel=1e-6)
    np.testing.assert_array_equal(found.lines, [0])
    plane = LightPlane.exact([0.0, 0.0, 1.0], -5.05)  # the second row has only the light plane, Z = 5.05 m
    both = stereo_points(left, right, geometry, LightStripeConfig(), plane)
    np.testing.assert_array_equal(both.lines, [0, 1])
    assert 5 < both.points_m[0, 2] <= 5.05
    assert both.points_m[1, 2] == pytest.approx(5.05)


def test_combined_depths_have_the_least_variance() -> None:
    """Against the definition, for simulated errors: no other weight gives a smaller spread."""
    random, count = np.random.default_rng(0), 200_000
    left, right, offset = (random.normal(size=count) for _ in range(3))
    plane_slope, slope, sigma_left, sigma_right, plane_sigma = 0.02, -0.05, 0.1, 0.3, 0.001
    on_plane = 1 + plane_slope * sigma_left * left + plane_sigma * offset
    by_disparity = 1 + slope * (sigma_left * left - sigma_right * right)
    each = (np.full(count, value) for value in (plane_slope, slope, sigma_left, sigma_right, plane_sigma))
    depth, sigma = combined_depth(on_plane, by_disparity, *each)
    assert depth.std() == pytest.approx(sigma[0], rel=0.01)
    spreads = [((1 - w) * on_plane + w * by_disparity).std() for w in np.linspace(0, 1, 101)]
    assert depth.std() == pytest.approx(min(spreads), rel=1e-3)
    alone, sigma = combined_depth(*(np.array([v]) for v in (2.0, np.nan, 0.1, np.nan, 0.2, np.nan, 0.0)))
    assert (alone[0], sigma[0]) == pytest.approx((2.0, 0.02))


def test_horizontal_stripes_are_refused() -> None:
    with pytest.raises(ConfigError, match="two cameras need a vertical stripe"):
        scanned(None, stripe_direction="horizontal")
