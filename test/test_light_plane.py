# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Light plane: the formula of its depth, triangulation with distortion, reasons, depth range, its file."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from light_stripe_images import BOARD_PLANE, board_camera

from stereo_depth_ros.active.light_stripe.extraction import StripeExtractor
from stereo_depth_ros.active.light_stripe.light_plane import (
    LightPlane,
    profile_points,
    search_range,
    stripe_depth,
    triangulate,
)
from stereo_depth_ros.active.light_stripe.plane_file import check_same_camera, read_plane, write_plane
from stereo_depth_ros.active.light_stripe.profile import StripeProfile, StripeReason
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64, Frame
from stereo_depth_ros.synthetic.light_stripe import PLANE, SyntheticStripe

EXACT = LightPlane.exact(BOARD_PLANE[:3], float(BOARD_PLANE[3]))


def points_on(plane: LightPlane, count: int = 40) -> F64:
    """Random points of a plane before the camera."""
    random = np.random.default_rng(3)
    points = np.column_stack((random.uniform(-0.05, 0.05, (count, 2)), random.uniform(0.4, 0.7, count)))
    A, B, C = plane.normal
    points[:, 0] = -(B * points[:, 1] + C * points[:, 2] + plane.d_m) / A
    return points


def places(columns: F64) -> StripeProfile:
    """A vertical profile at known places."""
    found = np.isfinite(columns)
    values = columns.astype(np.float32)
    sigma = np.where(found, np.float32(0.1), np.float32(np.nan))
    reasons = np.where(found, 0, StripeReason.NO_STRIPE).astype(np.uint8)
    return StripeProfile(values, sigma, np.full(len(values), 99, np.float32), sigma, reasons, True)


def test_depth_is_the_formula() -> None:
    """Z = -D f / (A x + B y + C f), by hand: plane X + Z = 1, x = f: X = Z = 1 / 2."""
    plane = LightPlane.exact([2.0, 0.0, 2.0], -2.0)
    assert stripe_depth(np.array([500.0]), np.array([70.0]), 500.0, plane) == pytest.approx(0.5)
    assert plane.d_m == pytest.approx(-np.sqrt(0.5))
    points = points_on(EXACT)
    x, y = 640 * points[:, 0] / points[:, 2], 640 * points[:, 1] / points[:, 2]
    np.testing.assert_allclose(stripe_depth(x, y, 640.0, EXACT), points[:, 2], rtol=1e-12)


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_points_are_recovered_through_distortion_and_oblong_pixels(model: str) -> None:
    base = board_camera()
    K = base.K * np.array([[1.0], [1.31], [1.0]])  # fy is 1.31 fx
    D = base.D if model == "plumb_bob" else np.array([-0.03, 0.01, -0.008, 0.002])
    camera = CameraModel(base.width, base.height, model, K, D, np.identity(3), base.P)
    points = points_on(EXACT)
    project = cv2.projectPoints if model == "plumb_bob" else cv2.fisheye.projectPoints
    pixels = project(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, D)[0].reshape(-1, 2)
    np.testing.assert_allclose(triangulate(pixels, camera, EXACT), points, atol=1e-6)
    np.testing.assert_allclose(EXACT.distances(points), 0, atol=1e-12)


def test_nothing_is_triangulated_behind_the_camera() -> None:
    behind = LightPlane.exact([0.0, 0.0, 1.0], 0.5)
    assert np.isnan(triangulate(np.array([[200.0, 150.0]]), board_camera(), behind)).all()
    assert triangulate(np.zeros((0, 2)), board_camera(), EXACT).shape == (0, 3)


def test_grazing_rays_and_depths_out_of_range_have_reasons() -> None:
    camera = board_camera()
    columns = np.linspace(-150.0, 390.0, camera.height)
    columns[:5] = np.nan
    config = LightStripeConfig(stripe_min_depth=0.3, stripe_max_depth=0.9, min_plane_angle=3.0)
    found = profile_points(places(columns), camera, EXACT, config)
    assert found.profile.reasons[:5].tolist() == [StripeReason.NO_STRIPE] * 5
    counts = found.profile.reason_counts()
    assert counts["GRAZING"] > 3
    assert counts["RANGE"] > 20
    assert len(found.points_m) == len(found.lines) == np.count_nonzero(found.profile.reasons == 0) > 20
    assert (found.points_m[:, 2] >= 0.3).all()
    assert (found.points_m[:, 2] <= 0.9).all()
    np.testing.assert_array_equal(found.lines, found.profile.valid_lines)


def test_sigma_is_that_of_random_places() -> None:
    camera, random = board_camera(), np.random.default_rng(5)
    pixels = np.column_stack((np.full(4000, 180.0) + 0.1 * random.normal(size=4000), np.full(4000, 120.0)))
    spread = triangulate(pixels, camera, EXACT).std(axis=0)
    columns = np.full(camera.height, 180.0)
    found = profile_points(places(columns), camera, EXACT, LightStripeConfig())
    at = int(np.flatnonzero(found.lines == 120)[0])
    assert found.sigma_m[at] == pytest.approx(np.linalg.norm(spread), rel=0.05)


@pytest.mark.parametrize("direction", ["vertical", "horizontal"])
def test_the_search_range_is_that_of_the_depths(direction: str) -> None:
    camera, vertical = board_camera(), direction == "vertical"
    plane = EXACT if vertical else LightPlane.exact([0.06, 0.9, 0.4], -0.25)
    config = LightStripeConfig(stripe_direction=direction, stripe_min_depth=0.4, stripe_max_depth=0.8)
    ranges = search_range(camera, plane, config)
    assert ranges is not None
    assert len(ranges) == (camera.height if vertical else camera.width)
    for line in (10, 77, 200):
        along = np.arange(camera.width if vertical else camera.height, dtype=float)
        across = np.full(len(along), float(line))
        pixels = np.stack((along, across) if vertical else (across, along), axis=1)
        depth = triangulate(pixels, camera, plane)[:, 2]
        with np.errstate(invalid="ignore"):
            inside = np.flatnonzero((depth >= 0.4) & (depth <= 0.8))
        first, last = ranges[line]
        assert inside[0] - 20 <= first <= inside[0]
        assert inside[-1] < last <= inside[-1] + 21
    assert search_range(camera, plane, LightStripeConfig()) is None


def test_rms_of_synthetic_points_is_near_the_limit_of_the_noise() -> None:
    """On flat, evenly colored surfaces, off the borders: at most twice what the noise of the image allows."""
    scanner = SyntheticStripe(320, 240, sigma_m=0.0045)
    plane = LightPlane.exact(PLANE[:3], float(PLANE[3]))
    for method in ("ridge", "center"):
        config = LightStripeConfig(stripe_method=method)
        profile = StripeExtractor(config).extract(Frame(scanner.capture()[0], 0, "", "rgb8"))
        found = profile_points(profile, scanner.rig.left, plane, config)
        on_board = (found.lines > 50) & (found.lines < 90)
        pixels = np.column_stack((profile.position_px[found.lines], found.lines))[on_board].astype(float)
        error = found.points_m[on_board, 2] - scanner.depth_m(pixels)
        assert len(error) > 30
        assert np.sqrt(np.square(error).mean()) < 2 * np.sqrt(np.square(found.sigma_m[on_board]).mean())


def test_a_moved_plane_holds_the_moved_points() -> None:
    points, motion = points_on(EXACT), np.identity(4)
    motion[:3, :3] = cv2.Rodrigues(np.array([0.2, -0.4, 0.1]))[0]
    motion[:3, 3] = 0.1, -0.05, 0.2
    moved = EXACT.moved(motion)
    np.testing.assert_allclose(moved.distances(points @ motion[:3, :3].T + motion[:3, 3]), 0, atol=1e-12)
    assert np.linalg.norm(moved.normal) == pytest.approx(1)


def test_a_plane_is_read_as_it_was_written(tmp_path: Path) -> None:
    plane = LightPlane(EXACT.normal, EXACT.d_m, np.array([0.1, 0.2, 0.3]), EXACT.tilt_axes, 1e-4, (2e-4, 3e-4))
    write_plane(tmp_path / "laser.yaml", plane, board_camera())
    read, camera = read_plane(tmp_path / "laser.yaml")
    for name in ("normal", "d_m", "center_m", "tilt_axes", "offset_sigma_m", "tilt_sigma"):
        np.testing.assert_allclose(getattr(read, name), getattr(plane, name), rtol=1e-12)
    np.testing.assert_array_equal(camera.K, board_camera().K)
    np.testing.assert_array_equal(camera.D, board_camera().D)
    check_same_camera(board_camera(), camera, "camera_info")
    other = SyntheticStripe(64, 48).rig.left
    with pytest.raises(CalibrationError, match=r"the camera is 64x48.*, the light plane was calibrated with 400x300"):
        check_same_camera(other, camera, "camera_info")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "lacks the key 'light_plane'"),
        ("a: [", "is not plain YAML"),
        ("light_plane: {normal: [0, 0, 0], d_m: 1}", "normal is 0"),
        ("light_plane: {normal: [1, 0], d_m: 1}", "normal has 2 values, not 3"),
        ("light_plane: {normal: [1, 0, .nan], d_m: 1}", "not a number"),
        ("light_plane: {normal: [1, 0, 0], d_m: 1}", "lacks the key 'camera'"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "laser.yaml"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=problem) as found:
        read_plane(path)
    assert str(path) in str(found.value)
    with pytest.raises(CalibrationError, match=r"absent\.yaml"):
        read_plane(tmp_path / "absent.yaml")
