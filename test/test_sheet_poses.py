# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Dots of a printed sheet, the poses of views that show them, and what stands on the sheet as a closed surface."""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np
import pytest
from range_views import area_and_volume, edge_uses
from sheet_views import (
    BLOCK,
    CX,
    CY,
    DIAMETER_PX,
    DOTS_PX,
    FX,
    FY,
    METERS_PER_PX,
    SHEET_SIZE,
    dots_m,
    poses_around,
    sheet_image,
    view,
)
from sheet_views import seen as seen_at

from stereo_depth_ros.core.errors import ConfigError, RegistrationError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.surfaces.marks import DotSheet, find_dots, match_dots, plane_of_most
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.sheet_poses import SheetPoses, rigid_pose, sheet_poses
from stereo_depth_ros.surfaces.solid import Box, SolidVolume

COUNT = 5
POSES = poses_around(COUNT)
SHEET = DotSheet.of(sheet_image())


@functools.cache
def images() -> list[RangeImage]:
    return [view(pose, seed) for seed, pose in enumerate(POSES)]


@functools.cache
def found_poses() -> SheetPoses:
    return sheet_poses(images(), SHEET)


def error_of(found: Pose, truth: Pose) -> F64:
    apart = found @ truth.inverse()
    return np.concatenate((np.asarray(cv2.Rodrigues(apart.rotation)[0]).ravel(), apart.translation_m))


def test_the_dots_of_the_sheet_are_found() -> None:
    assert SHEET.size == SHEET_SIZE
    assert SHEET.diameter_px == pytest.approx(DIAMETER_PX, rel=0.1)
    order = [int(np.argmin(np.linalg.norm(SHEET.dots_px - dot, axis=1))) for dot in DOTS_PX]
    assert sorted(order) == [*range(len(DOTS_PX))]
    assert np.abs(SHEET.dots_px[order] - DOTS_PX).max() < 0.1


def test_centers_in_images_are_exact_to_a_tenth_of_a_pixel() -> None:
    for image, pose in zip(images(), POSES, strict=True):
        p = pose.inverse().apply(dots_m())
        pixels = np.stack((FX * p[:, 0] / p[:, 2] + CX, FY * p[:, 1] / p[:, 2] + CY), axis=1)
        depth, _ = seen_at(pose, pixels[:, 0], pixels[:, 1])
        free = np.abs(depth - p[:, 2]) < 1e-6  # not behind the block
        found = find_dots(np.ascontiguousarray(image.color[:, :, 0]))
        off = np.array([np.linalg.norm(found[:, :2] - pixel, axis=1).min() for pixel in pixels])
        assert np.mean(off[free] < 0.15) > 0.85 and np.median(off[free]) < 0.1


def test_dots_are_identified_with_hidden_and_false_ones() -> None:
    rng = np.random.default_rng(3)
    kept = rng.permutation(len(SHEET.dots_px))[:9]
    turn = 0.002 * np.exp(1j * 2.1)
    z = (SHEET.dots_px[kept] @ np.array([1, 1j])) * turn + (0.3 - 0.1j)
    false = rng.uniform(-1, 1, (8, 2)) + np.array([0.3, 0.1])
    points = np.concatenate((np.stack((z.real, z.imag), axis=1) + rng.normal(0, 0.001, (9, 2)), false))
    match = match_dots(points, np.full(len(points), 0.002 * DIAMETER_PX), SHEET)
    right = {(n, int(dot)) for n, dot in enumerate(kept)}
    assert right <= {*zip(match.found.tolist(), match.dots.tolist(), strict=True)} and len(match.found) <= 10
    assert match.scale == pytest.approx(0.002, rel=0.01)


def test_sheets_that_fit_in_several_turns_are_refused() -> None:
    square = np.array([(x, y) for x in (100, 200, 300, 400) for y in (60, 160, 260, 360) if (x, y) != (200, 160)])
    sheet = DotSheet(square.astype(float), DIAMETER_PX, SHEET_SIZE)
    with pytest.raises(RegistrationError, match="the dots fit the sheet in several turns"):
        match_dots(square * 0.001, np.full(len(square), 0.001 * DIAMETER_PX), sheet)
    with pytest.raises(RegistrationError, match="of 5 dark dots fit those of the sheet, 6 are the least"):
        match_dots(0.001 * SHEET.dots_px[:5], np.full(5, 0.001 * DIAMETER_PX), SHEET)
    with pytest.raises(RegistrationError, match=r"blank.png: shows 0 dots, 6 are the least"):
        DotSheet.of(np.full((300, 400), 255, np.uint8), "blank.png")


def test_the_plane_of_most_points() -> None:
    rng = np.random.default_rng(1)
    normal = np.array([0.2, 0.6, 0.7]) / np.linalg.norm([0.2, 0.6, 0.7])
    across = np.linalg.svd(normal[None])[2][1:]
    points = rng.uniform(-1, 1, (30, 2)) @ across + 0.5 * normal
    points[20:] += rng.uniform(0.1, 0.5, (10, 1)) * normal
    points[:20] += rng.normal(0, 0.001, (20, 1)) * normal
    found, distance, on = plane_of_most(points, np.full(30, 0.001))
    assert found @ normal > 0.99999 and distance == pytest.approx(0.5, abs=0.002)
    assert {*on.tolist()} <= {*range(20)} and len(on) >= 18


def test_rigid_poses() -> None:
    truth = poses_around(3)[2]
    points = np.random.default_rng(2).normal(0, 1, (7, 3))
    np.testing.assert_allclose(rigid_pose(points, truth.apply(points)).matrix, truth.matrix, atol=1e-12)


def test_poses_and_dots_are_those_of_the_scene() -> None:
    found = found_poses()
    assert found.views == tuple(range(COUNT)) and not found.refused
    off = np.array([error_of(pose, truth) for pose, truth in zip(found.poses, POSES, strict=True)])
    assert np.abs(off[:, :3]).max() < np.radians(0.2) and np.abs(off[:, 3:]).max() < 0.0012
    sigmas = np.sqrt(np.array([np.diag(covariance) for covariance in found.covariances]))
    assert sigmas[:, 3:].max() < 0.001 and (sigmas > 0).all()
    order = [int(np.argmin(np.linalg.norm(DOTS_PX - dot, axis=1))) for dot in SHEET.dots_px]
    known = np.isfinite(found.dots_m[:, 0])
    assert known.sum() >= 14
    assert np.linalg.norm(found.dots_m - dots_m()[order], axis=1)[known].max() < 0.0006
    assert found.reprojection_px < 0.2
    assert found.flatness_m < 0.0003 and found.spread_m < 0.001
    np.testing.assert_allclose(found.size_m, np.array(SHEET_SIZE) * METERS_PER_PX, rtol=0.005)


def test_a_view_without_the_sheet_is_named() -> None:
    blank = dataclasses.replace(images()[1], color=np.full_like(images()[1].color, 200))
    found = sheet_poses([images()[0], blank, images()[2]], SHEET, ["a.png", "b.png", "c.png"])
    assert found.views == (0, 2)
    assert str(found.refused[0]).startswith("b.png: 0 dark dots with a depth")
    with pytest.raises(RegistrationError, match=r"1 of 2 views show the sheet, 2 are the least; b\.png"):
        sheet_poses([images()[0], blank], SHEET, ["a.png", "b.png"])


def test_a_block_becomes_a_closed_solid() -> None:
    """All sides are seen but the one that it stands on."""
    low = 0.003
    half = np.array(SHEET_SIZE) * METERS_PER_PX / 2
    volume = SolidVolume(0.0025, Box(np.array([*-half, low]), np.array([*half, 0.055])))
    for image, pose in zip(images(), POSES, strict=True):
        volume.integrate(image, pose)
    solid = volume.solid()
    assert edge_uses(solid.mesh)[:2] == ({2}, True)
    sides = BLOCK[1] - BLOCK[0]
    area, content = area_and_volume(solid.mesh)
    assert content == pytest.approx(sides[0] * sides[1] * (sides[2] - low), rel=0.05)
    lowest, highest = solid.mesh.points_m.min(axis=0), solid.mesh.points_m.max(axis=0)
    np.testing.assert_allclose(lowest, [*BLOCK[0][:2], low], atol=0.0015)
    np.testing.assert_allclose(highest, BLOCK[1], atol=0.0015)
    base = sides[0] * sides[1] / area
    assert 1 - solid.measured_share == pytest.approx(base, abs=0.08)
    bottom = solid.mesh.points_m[:, 2] < low + 1e-5
    assert np.isnan(solid.mesh.sigma_m[bottom]).all()
    assert (np.abs(solid.mesh.colors[bottom].astype(int) - 170) < 40).all()  # that of the sides


def test_solids_that_cannot_be_are_refused() -> None:
    box = Box(np.array([-1.0, -1.0, 0.003]), np.array([1.0, 1.0, 1.0]))
    with pytest.raises(ConfigError, match=r"a box of 2 x 2 x 0\.997 m does not fit into 64 MiB of memory") as raised:
        SolidVolume(0.002, box, most_bytes=2**26)
    assert raised.value.settings == ("voxel", "memory")
