# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Registration of range images: rendered corners with exact poses and noise of known standard deviation."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rendered_corner import BACK, CORNER, FLOOR, SPHERE, motion, rendered

from stereo_depth_ros import PipelineConfig, StereoPair, StereoPipeline
from stereo_depth_ros.core.errors import ConfigError, RegistrationError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.surfaces.mesh import mesh_of, normal_image
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.registration import OrientedImage, OrientedPoints, Registration, moved_by, register

TARGET = motion((2.0, -3.0, 1.0), (0.05, -0.02, 0.03))
SOURCE = motion((-4.0, 5.0, -3.0), (-0.08, 0.06, 0.1))
TRUTH = TARGET.inverse() @ SOURCE


def error_of(found: Pose, truth: Pose = TRUTH) -> F64:
    """The motion from the truth to the pose that was found, float64 (6,): rotation vector and translation."""
    apart = found @ truth.inverse()
    return np.concatenate((np.asarray(cv2.Rodrigues(apart.rotation)[0]).ravel(), apart.translation_m))


def oriented(pose: Pose, seed: int | None = None, **scene: Any) -> OrientedImage:
    return OrientedImage.of(rendered(pose, seed, **scene))


def registered(seed: int, start: Pose, **scene: Any) -> Registration:
    return register(oriented(SOURCE, 2 * seed, **scene), oriented(TARGET, 2 * seed + 1, **scene), start)


def test_poses_without_noise_are_exact() -> None:
    found = register(
        oriented(SOURCE), oriented(TARGET), moved_by(TRUTH, np.array([0.01, -0.02, 0.02, 0.02, 0.0, 0.03]))
    )
    assert np.abs(error_of(found.pose)).max() < 3e-4  # a fiftieth of a pixel
    assert found.inlier_share > 0.98


def test_the_covariance_is_that_of_the_errors() -> None:
    """Over seeds: each component within three of its standard deviations, and the squared Mahalanobis distance 6."""
    errors, distances = [], []
    for seed in range(60):
        found = registered(seed, moved_by(TRUTH, np.array([0.01, -0.02, 0.02, 0.02, -0.01, 0.03])))
        error = error_of(found.pose)
        errors.append(error / np.sqrt(np.diag(found.covariance)))
        distances.append(error @ np.linalg.solve(found.covariance, error))
        assert found.residual_rms == pytest.approx(1, abs=0.05)
        assert found.inlier_share > 0.9
    assert np.mean(np.abs(errors).max(axis=1) < 3) >= 0.95
    assert np.mean(distances) == pytest.approx(6, abs=1.34)  # three standard deviations of the mean of 60


@pytest.mark.parametrize(
    ("rotation_deg", "translation_m"),
    [
        ((10, 0, 0), (0, 0, 0)),
        ((0, -10, 0), (0, 0, 0)),
        ((0, 0, 10), (0, 0, 0)),
        ((0, 0, 0), (0.18, 0, 0)),  # 10 % of the median depth
        ((0, 0, 0), (0, -0.18, 0)),
        ((0, 0, 0), (0, 0, 0.18)),
        ((-6, 6, -5), (0.1, 0.1, -0.1)),
        ((6, 6, 5), (-0.1, -0.1, -0.1)),
    ],
)
@pytest.mark.parametrize("points", [False, True])
def test_starts_that_are_far_away(
    rotation_deg: tuple[float, ...], translation_m: tuple[float, ...], points: bool
) -> None:
    wrong = motion(rotation_deg, translation_m)
    image = rendered(TARGET, 1)
    target = OrientedImage.of(image)
    found = register(oriented(SOURCE, 2), as_points(image) if points else target, wrong @ TRUTH)
    sigma = np.sqrt(np.diag(found.covariance))
    assert (np.abs(error_of(found.pose)) < 5 * sigma).all()
    assert sigma[:3].max() < np.radians(0.1) and sigma[3:].max() < 0.003


def as_points(image: RangeImage) -> OrientedPoints:
    """The pixels of a range image, without their order."""
    normals = normal_image(image)
    used = np.isfinite(normals[:, :, 2])
    points = image.points()[used]
    cosine = np.abs(np.sum(points * normals[used], axis=1)) / points[:, 2]
    order = np.random.default_rng(5).permutation(len(points))
    return OrientedPoints(points[order], normals[used][order], (cosine * image.sigma_m[used])[order])


def test_vertices_of_a_mesh() -> None:
    """A mesh in a frame of its own, without noise; points that are not finite are left out."""
    mesh = mesh_of(rendered(TARGET))
    world = motion((30, 80, -50), (3, -2, 5))
    points = world.apply(mesh.points_m.astype(np.float64)).astype(np.float32)
    normals = (mesh.normals @ world.rotation.T).astype(np.float32)
    points[::50] = np.nan
    target = OrientedPoints(points, normals, OrientedPoints.of(mesh, 1e-4).sigma_m)
    found = register(oriented(SOURCE, 3), target, world @ moved_by(TRUTH, np.full(6, 0.02)))
    error = error_of(world.inverse() @ found.pose)
    assert np.abs(error[:3]).max() < np.radians(0.15) and np.abs(error[3:]).max() < 0.004


def test_half_of_the_images_overlaps() -> None:
    aside = motion((0, 28, 0), (0.1, 0.0, 0.0))
    truth = TARGET.inverse() @ SOURCE @ aside
    source = oriented(SOURCE @ aside, 4)
    found = register(source, oriented(TARGET, 5), moved_by(truth, np.array([0.02, -0.03, 0.02, 0.03, 0.02, -0.03])))
    assert found.corresponding < 0.55 * np.isfinite(source.normals[:, :, 2]).sum()
    assert (np.abs(error_of(found.pose, truth)) < 3.5 * np.sqrt(np.diag(found.covariance))).all()


@pytest.mark.parametrize("seed", [None, 7])
@pytest.mark.parametrize(
    ("planes", "spheres", "motions", "turns"),
    [
        ((BACK,), (), 2, 1),
        ((BACK, FLOOR), (), 1, 0),
        ((), (((0.1, 0.05, 1.6), 0.6),), 0, 3),
    ],
)
def test_what_the_surfaces_do_not_determine_is_named(
    planes: Any, spheres: Any, motions: int, turns: int, seed: int | None
) -> None:
    scene = {"planes": planes, "spheres": spheres}
    start = moved_by(TRUTH, np.array([0.005, -0.01, 0.004, 0.005, -0.01, 0.02]))
    with pytest.raises(RegistrationError, match="the surfaces do not determine") as raised:
        register(oriented(SOURCE, seed, **scene), oriented(TARGET, seed and seed + 1, **scene), start)
    assert raised.value.problem.count("the motion along") == motions
    assert raised.value.problem.count("the turn about") == turns
    assert raised.value.remedy


def test_the_named_direction_is_that_of_the_edge() -> None:
    scene: dict[str, Any] = {"planes": (BACK, FLOOR), "spheres": ()}
    with pytest.raises(RegistrationError) as raised:
        register(oriented(SOURCE, 1, **scene), oriented(TARGET, 2, **scene), TRUTH)
    edge = TARGET.rotation.T @ np.cross(BACK[0], FLOOR[0])
    edge /= np.linalg.norm(edge)
    found = np.array([float(part) for part in raised.value.problem.split("(")[1].split(")")[0].split(",")])
    assert abs(found @ edge) > 0.99


@pytest.mark.parametrize(
    "wrong",
    [
        motion((0, 180, 0), (0, 0, 0)),
        motion((0, 0, 0), (0, 0, 30)),
        motion((0, 60, 0), (0, 0, 0)),
        motion((0, 0, 90), (0, 0, 0)),
    ],
)
def test_starts_that_are_too_far_away_are_refused(wrong: Pose) -> None:
    with pytest.raises(RegistrationError) as raised:
        register(oriented(SOURCE, 1), oriented(TARGET, 2), wrong @ TRUTH)
    assert raised.value.value is not None and raised.value.limit is not None and raised.value.remedy


def test_standard_deviations_that_are_too_small_show() -> None:
    image = rendered(SOURCE, 1), rendered(TARGET, 2)
    source, target = (OrientedImage(dataclasses.replace(i, sigma_m=i.sigma_m / 2), normal_image(i)) for i in image)
    found = register(source, target, TRUTH)
    assert found.residual_rms == pytest.approx(2, abs=0.1)
    honest = register(oriented(SOURCE, 1), oriented(TARGET, 2), TRUTH)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), np.sqrt(np.diag(honest.covariance)), rtol=0.1)


def test_input_that_does_not_fit_is_refused() -> None:
    source, target = oriented(SOURCE), oriented(TARGET)
    with pytest.raises(ConfigError, match="is not finite"):
        register(source, target, Pose(np.identity(3), np.array([0, np.nan, 0])))
    nothing = dataclasses.replace(source.image, depth_m=np.full_like(source.image.depth_m, np.nan))
    with pytest.raises(RegistrationError, match="0 of 17936 pixels of the source have a depth and a normal"):
        register(OrientedImage.of(nothing), target, TRUTH)
    few = OrientedPoints(np.zeros((9, 3), np.float32), np.ones((9, 3), np.float32), np.ones(9, np.float32))
    with pytest.raises(RegistrationError, match="9 of 9 points of the target are finite"):
        register(source, few, TRUTH)


def test_a_moved_sphere_between_fixed_walls_is_an_outlier() -> None:
    """What has moved between both images does not bend the pose."""
    moved = (((SPHERE[0][0] + 0.1, SPHERE[0][1], SPHERE[0][2]), SPHERE[1]),)
    source = oriented(SOURCE, 1, planes=CORNER, spheres=moved)
    found = register(source, oriented(TARGET, 2), moved_by(TRUTH, np.array([0.01, -0.02, 0.02, 0.02, -0.01, 0.03])))
    assert (np.abs(error_of(found.pose)) < 5 * np.sqrt(np.diag(found.covariance))).all()
    assert found.inlier_share < 0.95


@pytest.mark.real_data
def test_a_street_from_poses_that_are_wrong(stereo_data: Path) -> None:
    """Two pairs in motion: starts wrong by 0.1 m and 0.5 degrees end alike, with the rotation that features tell."""
    folder = stereo_data / "kitti_odometry" / "seqA_1226x370"
    dataset = KittiDataset(folder)
    pipeline = StereoPipeline(PipelineConfig(), dataset.rig)
    images = []
    for frame in itertools.islice(dataset, 2):
        whole = RangeImage.of(pipeline.process(StereoPair(frame.left, frame.right)))
        near = np.where(whole.depth_m < 40, whole.depth_m, np.float32(np.nan))[::3, ::3]
        t = whole.triangulation
        geometry = Triangulation(t.f_px / 3, t.fy_px / 3, t.cx_px / 3, t.cy_px / 3, t.baseline_m, t.doffs_px / 3)
        images.append((whole, RangeImage(near.copy(), whole.sigma_m[::3, ::3], geometry, whole.color[::3, ::3])))
    target, source = (OrientedImage.of(small) for _, small in images)
    truth, off = Pose(np.identity(3), np.array([0.0, 0.0, 0.8])), np.array([0.005, -0.006, 0.004, 0.06, -0.05, 0.06])
    found = [register(source, target, moved_by(truth, sign * off)).pose for sign in (1, -1)]
    assert np.abs(error_of(*found)).max() < 0.001  # a tenth of the difference of the starts, or less
    K = np.array([[t.f_px, 0, t.cx_px], [0, t.fy_px, t.cy_px], [0, 0, 1]])
    first, second = (whole.color for whole, _ in images)
    corners = cv2.goodFeaturesToTrack(first, 1000, 0.005, 8)
    seen, tracked, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, None, winSize=(15, 15), maxLevel=5)
    kept = tracked.ravel() > 0
    E, inliers = cv2.findEssentialMat(corners[kept], seen[kept], K, cv2.RANSAC, 0.999, 0.5)
    R = cv2.recoverPose(E, corners[kept], seen[kept], K, mask=inliers)[1]
    turned = error_of(found[0], Pose(np.ascontiguousarray(R.T), found[0].translation_m))[:3]
    assert np.degrees(np.linalg.norm(turned)) < 0.1
