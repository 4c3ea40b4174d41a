# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes and normals of range images: closed forms, and rendered scenes with exact truth."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.stages.depth import depth_sigma
from stereo_depth_ros.surfaces.mesh import Mesh, mesh_of, normal_image
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.synthetic.projection import SyntheticScanner

WIDTH, HEIGHT = 97, 70
GEOMETRY = Triangulation(110.0, 104.0, 45.5, 37.0, 0.12, 3.5)
SIGMA_PX = 0.1


def range_image(depth_m: F64, sigma_px: float = SIGMA_PX, geometry: Triangulation = GEOMETRY) -> RangeImage:
    """A range image with colors that differ at every pixel."""
    depth = np.asarray(depth_m, np.float32)
    y, x = np.indices(depth.shape)
    color = np.stack((x % 256, y % 256, (3 * x + 5 * y) % 256), axis=2).astype(np.uint8)
    return RangeImage(depth, depth_sigma(depth, geometry, sigma_px), geometry, color)


def rays(shape: tuple[int, int] = (HEIGHT, WIDTH), geometry: Triangulation = GEOMETRY) -> F64:
    """The ray of each pixel, float64 (H, W, 3), with z = 1."""
    y, x = np.indices(shape)
    g = geometry
    return np.stack(((x - g.cx_px) / g.f_px, (y - g.cy_px) / g.fy_px, np.ones(shape)), axis=2)


def plane(normal: tuple[float, float, float], distance_m: float) -> tuple[F64, F64]:
    """Depth of the plane n X = -distance, and its unit normal, which points to the camera."""
    n = np.array(normal) / np.linalg.norm(normal)
    with np.errstate(divide="ignore"):
        depth = -distance_m / (rays() @ n)
    return np.where(depth > 0, depth, np.nan), n


def sphere(center: tuple[float, float, float], radius_m: float) -> tuple[F64, F64]:
    """Depth of a sphere and its normals, NaN beside it."""
    r, c = rays(), np.array(center)
    a, b = np.sum(r * r, axis=2), r @ c
    with np.errstate(invalid="ignore"):
        depth = (b - np.sqrt(b * b - a * (c @ c - radius_m**2))) / a
    return depth, (r * depth[..., None] - c) / radius_m


def noisy(depth_m: F64, seed: int = 3) -> F64:
    """The depth with the noise of its disparities."""
    noise_px = np.random.default_rng(seed).normal(0, SIGMA_PX, depth_m.shape)
    return 1 / (1 / depth_m + noise_px / (GEOMETRY.f_px * GEOMETRY.baseline_m))


def angles_deg(found: F32, expected: F64) -> F64:
    """Angles between unit vectors."""
    return np.degrees(np.arccos(np.clip(np.sum(found * expected, axis=-1), -1, 1)))


def pixels(mesh: Mesh) -> tuple[Any, Any]:
    """Row and column of each vertex."""
    x, y = mesh.texture_px.T.astype(int)
    return y, x


def faces(mesh: Mesh) -> F64:
    """(b - a) x (c - a) of each triangle."""
    a, b, c = (mesh.points_m[mesh.triangles[:, i]].astype(np.float64) for i in range(3))
    return np.cross(b - a, c - a)


def test_a_slanted_plane_is_closed_and_has_its_normal() -> None:
    depth, normal = plane((0.55, -0.3, -0.8), 1.3)
    image = range_image(depth)
    mesh = mesh_of(image)
    assert len(mesh.points_m) == WIDTH * HEIGHT and mesh.alone == 0
    assert len(mesh.triangles) == 2 * (WIDTH - 1) * (HEIGHT - 1)
    np.testing.assert_allclose(mesh.points_m, (rays() * depth[..., None]).reshape(-1, 3), rtol=1e-6)
    assert angles_deg(mesh.normals, normal).max() < 0.05  # float32 depths
    assert angles_deg(normal_image(image), normal).max() < 0.05
    facing = np.sum(faces(mesh) * mesh.points_m[mesh.triangles[:, 0]], axis=1)
    assert (facing < 0).all()  # counter-clockwise seen from the camera
    y, x = pixels(mesh)
    np.testing.assert_array_equal(mesh.colors, image.color[y, x])


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (1e-5, 2e-5, -1.0), (-0.5, 0.4, -0.7)])
def test_exact_depths_are_closed(normal: tuple[float, float, float]) -> None:
    """Their rounding to float32 is not a step."""
    mesh = mesh_of(range_image(plane(normal, 1.7)[0], sigma_px=0.0))
    assert len(mesh.triangles) == 2 * (WIDTH - 1) * (HEIGHT - 1)


def test_the_floor_stays_at_grazing_angles() -> None:
    """A plane 12 cm below the camera, of which neighbors in a column are up to half a meter apart."""
    below = np.s_[41:, :]
    depth = np.where(np.indices((HEIGHT, WIDTH))[0] > 40, plane((0.0, -1.0, 0.0), 0.12)[0], np.nan)
    mesh = mesh_of(range_image(depth, sigma_px=0.02))
    assert np.nanmax(np.abs(np.diff(depth[below], axis=0))) > 0.5
    assert len(mesh.triangles) == 2 * (WIDTH - 1) * (HEIGHT - 41 - 1)
    cut = mesh_of(range_image(depth, sigma_px=0.02), max_angle_deg=80)
    assert 0 < len(cut.triangles) < len(mesh.triangles)


def test_the_normals_of_a_sphere() -> None:
    depth, normals = sphere((0.1, -0.05, 1.2), 0.33)
    image = range_image(depth)
    mesh = mesh_of(image)
    y, x = pixels(mesh)
    inside = -np.sum(normals[y, x] * rays()[y, x], axis=1) / np.linalg.norm(rays()[y, x], axis=1)
    front = inside > np.cos(np.radians(60))
    assert front.sum() > 1000
    assert angles_deg(mesh.normals, normals[y, x])[front].max() < 4.0  # a triangle is 0.01 m, 1.8 degrees
    assert np.median(angles_deg(mesh.normals, normals[y, x])[front]) < 0.3
    by_planes = angles_deg(normal_image(image)[y, x], normals[y, x])[front]
    assert np.median(by_planes) < 0.6
    assert np.isnan(normal_image(image)[np.isnan(depth)]).all()


def test_planes_average_the_noise() -> None:
    depth, normal = plane((0.3, -0.2, -0.9), 1.1)
    image = range_image(noisy(depth))
    mesh = mesh_of(image)
    assert len(mesh.triangles) > 0.99 * 2 * (WIDTH - 1) * (HEIGHT - 1)
    single = np.median(angles_deg(mesh.normals, normal))
    spread = [np.nanmedian(angles_deg(normal_image(image, radius_px=r), normal)) for r in (2, 4)]
    # sigma of a slope over n x n pixels falls with n^2: 5 x 5, 9 x 9
    assert spread[0] / spread[1] == pytest.approx((9 / 5) ** 2, rel=0.2)
    assert spread[0] < single / 3


def steps(values: list[float], rows: int = 9) -> RangeImage:
    """Columns with these disparities above infinity, px; NaN is not measured."""
    with np.errstate(invalid="ignore"):
        depth = GEOMETRY.f_px * GEOMETRY.baseline_m / np.array(values)
    return range_image(np.tile(depth, (rows, 1)))


def joined_columns(mesh: Mesh) -> set[tuple[int, int]]:
    """Pairs of columns that a triangle has."""
    columns = mesh.texture_px[mesh.triangles, 0].astype(int)
    return {(int(low), int(high)) for low, high in zip(columns.min(axis=1), columns.max(axis=1), strict=True)}


@pytest.mark.parametrize(
    ("values", "open_at"),
    [
        ([20, 20, 20, 20, 15, 15, 15, 15], {3}),
        ([20, 20, 20.4, 20], set()),  # below 3 sqrt(2) sigma
        ([20, 20, 20.44, 20.44], {1}),  # above, and there is no slope to compare with
        ([20, 20, 20, 20.55, 20.55, 20.55], set()),  # below 3 sqrt(3.5) sigma from the slope
        ([20, 20, 20, 20.58, 20.58, 20.58], {2}),
        ([20, 19, 18, 17, 16, 15, 14], set()),  # a slanted surface
        ([20, 19, 18, 17, 16, 11, 10, 9, 8, 7], {4}),  # two with a step between them
        ([20, 20, 20, 19, 18, 17, 16], set()),  # an edge between two planes
        ([20, 20, 20, 20, 17.5, 15, 15, 15, 15], {3, 4}),  # a pixel between two surfaces
        ([20, 20, 20, 20, 19, 15, 15, 15, 15], {3, 4}),
        ([20, 20, 20, np.nan, 20, 20], {2, 3}),
    ],
)
def test_which_pixels_are_joined(values: list[float], open_at: set[int]) -> None:
    for order in (1, -1):
        expected = {(n, n + 1) for n in range(len(values) - 1)} - {(n, n + 1) for n in open_at}
        if order < 0:
            expected = {(len(values) - 1 - high, len(values) - 1 - low) for low, high in expected}
        across = joined_columns(mesh_of(steps(values[::order])))
        assert across == expected
        down = np.ascontiguousarray(steps(values[::order]).depth_m.T)
        mesh = mesh_of(range_image(down))
        rows = mesh.texture_px[mesh.triangles, 1].astype(int)
        assert {*zip(rows.min(axis=1).tolist(), rows.max(axis=1).tolist(), strict=True)} == expected


def test_the_shorter_diagonal_is_taken() -> None:
    """Of four pixels one is farther; the diagonal joins the other two."""
    for corner in range(4):
        depth = np.full((2, 2), 2.0)
        depth[divmod(corner, 2)] = 2.05
        mesh = mesh_of(range_image(depth, sigma_px=1.0))
        (shared,) = [{*map(tuple, mesh.texture_px[[a, b]].astype(int))} for a, b in diagonals(mesh)]
        falling = {(0, 0), (1, 1)}
        assert shared == (falling if corner in (1, 2) else {(1, 0), (0, 1)})


def diagonals(mesh: Mesh) -> list[tuple[int, int]]:
    """Vertices that both triangles have."""
    first, second = ({*triangle.tolist()} for triangle in mesh.triangles)
    low, high = sorted(first & second)
    return [(low, high)]


@pytest.mark.parametrize(("missing", "present"), [(n, 1) for n in range(4)])
def test_three_pixels_have_one_triangle(missing: int, present: int) -> None:
    depth = np.full((2, 2), 2.0)
    depth[divmod(missing, 2)] = np.nan
    mesh = mesh_of(range_image(depth))
    assert len(mesh.triangles) == present and len(mesh.points_m) == 3
    np.testing.assert_allclose(mesh.normals, [[0, 0, -1]] * 3, atol=1e-6)


@functools.cache
def rendered() -> tuple[RangeImage, Any]:
    """The table-top scene from its truth, and the primitive of each pixel."""
    scanner = SyntheticScanner(160, 120, (64, 48))
    truth = scanner.truth()
    return range_image(truth.depth_m, 0.05, Triangulation.from_rig(scanner.rig)), truth.surface


def bridges(mesh: Mesh) -> int:
    """Triangles across two surfaces of the rendered scene that are farther apart than the noise tells."""
    image, surface = rendered()
    y, x = pixels(mesh)
    of = surface[y, x][mesh.triangles]
    depth, sigma = (array[y, x][mesh.triangles] for array in (image.depth_m, image.sigma_m))
    apart = depth.max(axis=1) - depth.min(axis=1) > 6 * sigma.max(axis=1)
    return int(np.count_nonzero((of != of[:, :1]).any(axis=1) & apart))


@pytest.mark.parametrize("seed", [None, 1])
def test_no_triangle_bridges_a_step_and_surfaces_are_closed(seed: int | None) -> None:
    """From the truth, and with the noise that is declared."""
    image, surface = rendered()
    noise = 0 if seed is None else np.random.default_rng(seed).normal(0, 1, image.depth_m.shape)
    used = dataclasses.replace(image, depth_m=(image.depth_m + noise * image.sigma_m).astype(np.float32))
    mesh = mesh_of(used)
    assert bridges(mesh) == 0
    assert bridges(mesh_of(used, edge_sigmas=1e6)) > 500
    whole = (surface[:-1, :-1] == surface[1:, 1:]) & (surface[1:, :-1] == surface[:-1, 1:])  # squares of one surface
    whole &= (surface[:-1, :-1] == surface[1:, :-1]) & (surface[1:, 1:] >= 0)
    y, x = pixels(mesh)
    corners = surface[y, x][mesh.triangles]
    within = (corners == corners[:, :1]).all(axis=1) & whole[
        y[mesh.triangles].min(axis=1), x[mesh.triangles].min(axis=1)
    ]
    assert within.sum() > 0.995 * 2 * whole.sum()
    np.testing.assert_array_equal(mesh.points_m[:, 2], used.depth_m[y, x])
    off = np.abs(mesh.points_m[:, 2] - image.depth_m[y, x]) / image.sigma_m[y, x]
    assert np.mean(off < 3) > 0.99


def test_nothing_measured_has_no_triangle() -> None:
    for shape in ((1, 1), (1, 8), (8, 1), (5, 7)):
        mesh = mesh_of(range_image(np.full(shape, np.nan)))
        assert mesh.points_m.shape == (0, 3) and mesh.triangles.shape == (0, 3) and mesh.alone == 0
        assert mesh.colors.shape == (0, 3)
        assert np.isnan(normal_image(range_image(np.full(shape, np.nan)))).all()
    row = mesh_of(range_image(np.full((1, 8), 2.0)))
    assert len(row.points_m) == 0 and row.alone == 8


def test_depths_that_are_none_are_left_out() -> None:
    depth = np.full((6, 7), 2.0)
    depth[0, 0], depth[2, 3], depth[5, 6] = 0.0, np.inf, -1.0
    image = range_image(depth)
    sigma = image.sigma_m.copy()
    sigma[5, 0] = np.nan
    mesh = mesh_of(dataclasses.replace(image, sigma_m=sigma))
    assert len(mesh.points_m) == 42 - 4
    assert np.isfinite(mesh.points_m).all() and np.isfinite(mesh.normals).all()
    assert np.isnan(image.points()[2, 3]).all()


def test_arguments_that_do_not_fit_are_refused() -> None:
    image = range_image(np.full((6, 7), 2.0))
    with pytest.raises(ImageError, match=r"sigma_m has shape \(6, 6\), the depth has \(6, 7\)"):
        dataclasses.replace(image, sigma_m=image.sigma_m[:, :6])
    with pytest.raises(ImageError, match="depth_m is float64, a range image has float32"):
        dataclasses.replace(image, depth_m=image.depth_m.astype(np.float64))
    with pytest.raises(ImageError, match="the depth has shape"):
        dataclasses.replace(image, depth_m=image.depth_m[0])
    for name, value in (("edge_sigmas", 0.0), ("edge_sigmas", np.nan), ("max_angle_deg", 91.0)):
        with pytest.raises(ConfigError, match=name):
            mesh_of(image, **{name: value})
    with pytest.raises(ConfigError, match="radius_px = 0"):
        normal_image(image, radius_px=0)
