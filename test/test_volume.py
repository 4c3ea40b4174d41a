# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fused surfaces: closed forms of marching cubes, shapes seen from all around, empty space, holes, pieces, memory."""

from __future__ import annotations

import functools
from itertools import product

import numpy as np
import pytest
from range_views import (
    Depth,
    area_and_volume,
    around,
    ball,
    box,
    edge_uses,
    euler,
    looking_at,
    nearest,
    plane,
    view,
)

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.surfaces.marching_cubes import CORNERS, EDGES, cube_tables
from stereo_depth_ros.surfaces.mesh_repair import hole_loops
from stereo_depth_ros.surfaces.volume import SurfaceVolume

BALL = (0.13, -0.07, 0.21)


def filled(values: F64, voxel_m: float = 0.1) -> SurfaceVolume:
    """A volume with given distances, float64 (8 a, 8 b, 8 c) by z, y, x, all of weight 4."""
    volume = SurfaceVolume(voxel_m)
    blocks = [*product(*(range(n // 8) for n in values.shape))]
    assert len(blocks) <= len(volume._coordinates)
    volume._coordinates[: len(blocks)] = [block[::-1] for block in blocks]
    volume._count[0] = len(blocks)
    volume._weight[: len(blocks)] = 4.0
    volume._make_table()
    for number, (z, y, x) in enumerate(blocks):
        part = values[8 * z : 8 * z + 8, 8 * y : 8 * y + 8, 8 * x : 8 * x + 8]
        volume._distance[number] = part.ravel()
    return volume


def test_cubes_that_share_a_face_agree_about_it() -> None:
    """On a field of random signs each edge of the mesh has two triangles, in opposite directions."""
    values = np.random.default_rng(5).uniform(0.2, 1, (16, 24, 16))
    inside = np.random.default_rng(6).random(values.shape) < 0.5
    inside[0], inside[-1], inside[:, 0], inside[:, -1], inside[:, :, 0], inside[:, :, -1] = (False,) * 6
    mesh = filled(np.where(inside, -values, values)).mesh()
    uses, opposite, _ = edge_uses(mesh)
    assert (uses, opposite) == ({2}, True)
    assert area_and_volume(mesh)[1] > 0


def test_the_tables_of_cubes() -> None:
    tables = cube_tables()
    assert (tables.counts[0], tables.counts[255], tables.counts[1], tables.counts[0b1111]) == (0, 0, 1, 2)
    for kind in range(256):
        crossed = {edge for edge, (a, b) in enumerate(EDGES) if (kind >> a ^ kind >> b) & 1}
        used = tables.triangles[kind, : 3 * tables.counts[kind]]
        assert {*used.tolist()} == crossed
        assert tables.edges[kind] == sum(1 << edge for edge in crossed)
    assert CORNERS[6] == (0, 1, 1)


def test_a_sphere_of_exact_distances() -> None:
    radius, center = 0.93, np.array([1.17, 1.21, 1.13])
    grid = 0.1 * np.stack(np.meshgrid(*(np.arange(24),) * 3, indexing="ij"), axis=-1)[..., ::-1]
    mesh = filled(np.linalg.norm(grid - center, axis=-1) - radius).mesh()
    assert edge_uses(mesh)[:2] == ({2}, True) and euler(mesh) == 2
    area, volume = area_and_volume(mesh)
    assert area == pytest.approx(4 * np.pi * radius**2, rel=0.01)
    assert volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.01)
    out = (mesh.points_m - center) / np.linalg.norm(mesh.points_m - center, axis=1)[:, None]
    assert np.sum(mesh.normals * out, axis=1).min() > np.cos(np.radians(2))
    np.testing.assert_allclose(np.linalg.norm(mesh.points_m - center, axis=1), radius, atol=0.003)
    np.testing.assert_allclose(mesh.sigma_m, 0.5)


@functools.cache
def fused(shape: str, sigma_m: float = 0.0) -> SurfaceVolume:
    """A ball, or a box, seen from all around."""
    volume = SurfaceVolume(0.015)
    seen = ball(BALL, 0.3) if shape == "ball" else box((-0.2, -0.25, -0.3), (0.28, 0.22, 0.26))
    for number, pose in enumerate(around(BALL if shape == "ball" else (0.04, -0.02, -0.02), 1.0)):
        volume.integrate(view(seen, pose, sigma_m, number if sigma_m else None), pose)
    return volume


def test_a_ball_seen_from_all_around_is_closed() -> None:
    mesh = fused("ball").mesh()
    assert edge_uses(mesh)[:2] == ({2}, True) and euler(mesh) == 2
    area, volume = area_and_volume(mesh)
    assert area == pytest.approx(4 * np.pi * 0.3**2, rel=0.02)
    assert volume == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.02)
    off = np.abs(np.linalg.norm(mesh.points_m - np.array(BALL), axis=1) - 0.3)
    assert np.percentile(off, 95) < 0.003
    out = (mesh.points_m - np.array(BALL)) / 0.3
    assert np.percentile(np.sum(mesh.normals * out, axis=1), 5) > np.cos(np.radians(6))


def test_a_box_seen_from_all_around_is_closed() -> None:
    mesh = fused("box").mesh()
    assert edge_uses(mesh)[:2] == ({2}, True) and euler(mesh) == 2
    a, b, c = 0.48, 0.47, 0.56
    area, volume = area_and_volume(mesh)
    assert area == pytest.approx(2 * (a * b + a * c + b * c), rel=0.02)
    assert volume == pytest.approx(a * b * c, rel=0.02)


def test_noise_is_averaged_by_its_weights() -> None:
    """One far image with much noise, ten with little: the surface has the noise of the mean."""
    wall, volume = plane(2, 1.0), SurfaceVolume(0.02)
    for number in range(11):
        pose = looking_at((0.02 * number - 0.1, 0.03, 0.0), (0.0, 0.0, 1.0))
        volume.integrate(view(wall, pose, 0.02 if number == 10 else 0.004, number), pose)
    mesh = volume.mesh()
    inner = (np.abs(mesh.points_m[:, :2]) < 0.3).all(axis=1)
    off = np.abs(mesh.points_m[inner, 2] - 1.0)
    sigma = mesh.sigma_m[inner]
    assert np.median(sigma) == pytest.approx(0.004 / np.sqrt(10), rel=0.1)  # but for the rays, which are longer
    assert np.median(off) < 0.6745 * np.median(sigma) * 1.5
    assert np.percentile(off, 95) < 3 * np.median(sigma)


def test_the_color_is_that_of_the_pixels() -> None:
    volume = SurfaceVolume(0.02)
    pose = Pose.identity()
    image = view(plane(2, 1.0), pose)
    volume.integrate(image, pose)
    mesh = volume.mesh()
    g = image.triangulation
    x = np.rint(mesh.points_m[:, 0] / mesh.points_m[:, 2] * g.f_px + g.cx_px)
    y = np.rint(mesh.points_m[:, 1] / mesh.points_m[:, 2] * g.fy_px + g.cy_px)
    assert np.abs(mesh.colors - np.stack((40 + x, 60 + y, np.full(len(x), 90)), axis=1)).max() <= 3
    assert (mesh.normals[:, 2] < -0.99).all()  # to the camera


def test_what_a_ray_has_crossed_is_empty() -> None:
    """Points between a ball and the wall behind it, of one image, disappear where others see through them."""
    scene = nearest(ball((0.0, 0.0, 1.0), 0.2), plane(2, 1.8))
    poses = [looking_at((0.12 * i - 0.3, 0.05 * i - 0.1, 0.0), (0.0, 0.0, 1.2)) for i in range(6)]
    volume = SurfaceVolume(0.03)
    for number, pose in enumerate(poses):
        image = view(scene, pose, 0.005)
        if number == 0:
            image.depth_m[30:36, 4:14] = 1.3  # a patch of wrong depths in front of the wall
        volume.integrate(image, pose)
        if number == 0:
            assert in_the_air(volume) > 20
    assert in_the_air(volume) == 0


def in_the_air(volume: SurfaceVolume) -> int:
    """Vertices that are more than 2.5 voxels from both surfaces."""
    points = volume.mesh().points_m
    return int(
        np.count_nonzero((np.abs(np.linalg.norm(points - [0, 0, 1], axis=1) - 0.2) > 0.075) & (points[:, 2] < 1.7))
    )


def test_pixels_between_two_surfaces_do_not_count() -> None:
    scene = nearest(box((-0.2, -0.2, 1.0), (0.1, 0.25, 1.1)), plane(2, 1.8))
    image = view(scene, Pose.identity(), 0.002)
    edges = np.argwhere(np.abs(np.diff(image.depth_m, axis=1)) > 0.5)
    for y, x in edges:
        image.depth_m[y, x] = 1.4  # one pixel beside each step
    volume = SurfaceVolume(0.03)
    done = volume.integrate(image, Pose.identity())
    assert len(edges) > 40 and done.alone >= 0.9 * len(edges)
    points = volume.mesh().points_m
    assert not ((points[:, 2] > 1.2) & (points[:, 2] < 1.7)).any()


def test_counts_of_pixels_that_are_left_out() -> None:
    image = view(plane(0, 0.6), looking_at((0.0, 0.0, 0.0), (0.6, 0.1, 0.5)), 0.004)
    image.sigma_m[:, 60:] = 1.0
    far = float(np.nanmedian(image.depth_m))
    done = SurfaceVolume(0.02).integrate(image, Pose.identity(), max_depth_m=far)
    measured = int(np.count_nonzero(image.measured))
    assert done.too_far == np.count_nonzero(image.depth_m > np.float32(far))
    assert done.uncertain > 0 and done.used > 0
    assert done.used + done.too_far + done.uncertain + done.alone == measured
    assert np.isnan(done.apart)


def test_images_whose_poses_are_wrong_differ() -> None:
    def apart(shift_m: float) -> float:
        volume = SurfaceVolume(0.02)
        scene = nearest(ball((0.1, 0.0, 1.0), 0.3), plane(2, 1.6))
        found = 0.0
        for number in range(3):
            pose = looking_at((0.05 * number, 0.0, 0.0), (0.0, 0.0, 1.2))
            image = view(scene, pose, 0.005, number)
            found = volume.integrate(
                image, Pose(pose.rotation, pose.translation_m + shift_m * number * np.array([0, 0, 1]))
            ).apart
        return found

    assert apart(0.0) < 0.15
    assert apart(0.05) > 0.4


def test_small_pieces_are_removed() -> None:
    seen = nearest(ball((0.0, 0.0, 1.0), 0.25), ball((0.35, 0.2, 1.0), 0.04))
    volume = SurfaceVolume(0.02)
    volume.integrate(view(seen, Pose.identity()), Pose.identity())
    whole, cleaned = volume.surface(), volume.surface(fewest_triangles=150)
    assert whole.pieces == 0 and cleaned.pieces >= 1
    assert (np.linalg.norm(whole.mesh.points_m - [0.35, 0.2, 1.0], axis=1) < 0.06).sum() > 10
    assert len(whole.mesh.triangles) - len(cleaned.mesh.triangles) == cleaned.piece_triangles > 0
    assert (np.linalg.norm(cleaned.mesh.points_m - [0.35, 0.2, 1.0], axis=1) > 0.1).all()
    assert cleaned.mesh.triangles.max() == len(cleaned.mesh.points_m) - 1


def test_holes_are_filled_where_nothing_is_known_behind_them() -> None:
    """A patch of a ball that no image has measured, and a window in a wall through which one sees farther."""
    volume = SurfaceVolume(0.02)
    for pose in around(BALL, 1.0):
        image = view(ball(BALL, 0.3), pose)
        spot = np.array(BALL) + 0.3 * np.array([0.6, 0.0, 0.8])
        with np.errstate(invalid="ignore"):
            near = np.linalg.norm(pose.apply(image.points().reshape(-1, 3).astype(float)) - spot, axis=1) < 0.06
        image.depth_m[near.reshape(image.depth_m.shape)] = np.nan
        volume.integrate(image, pose)
    (loop,) = hole_loops(volume.surface(fewest_triangles=50).mesh.triangles, 1000)
    assert len(loop) > 30
    surface = volume.surface(fewest_triangles=50, largest_hole_m=0.3)
    assert (surface.filled, surface.open) == (1, 0)
    assert edge_uses(surface.mesh)[:2] == ({2}, True) and euler(surface.mesh) == 2
    assert area_and_volume(surface.mesh)[1] == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.02)
    assert volume.surface(fewest_triangles=50, largest_hole_m=0.1).filled == 0  # it is larger

    def wall(origin: F64, rays: F64) -> F64:
        front, back = plane(2, 1.0)(origin, rays), plane(2, 1.5)(origin, rays)
        hit = origin + rays * front[..., None]
        return np.where(np.hypot(hit[..., 0] - 0.05, hit[..., 1]) < 0.06, back, front)

    volume = SurfaceVolume(0.02)
    for i in range(5):
        pose = looking_at((0.1 * i - 0.2, 0.0, 0.0), (0.0, 0.0, 1.0))
        volume.integrate(view(wall, pose), pose)
    kept = volume.surface(largest_hole_m=0.3)
    assert kept.open >= 1
    inner = np.hypot(*(kept.mesh.points_m[:, :2] - [0.05, 0.0]).T) < 0.03
    assert (kept.mesh.points_m[inner, 2] > 1.4).all()


def test_borders_that_meet_in_a_vertex_are_several_loops() -> None:
    """A square of 5 x 5 vertices without two quads that touch in vertex 12."""
    quads = [5 * y + x for y in range(4) for x in range(4) if (y, x) not in ((1, 1), (2, 2))]
    triangles = np.array([t for a in quads for t in ((a, a + 6, a + 1), (a, a + 5, a + 6))], np.int32)
    loops = hole_loops(triangles, 4)
    assert sorted(map(sorted, loops)) == [[6, 7, 11, 12], [12, 13, 17, 18]]
    edges = {(a, b) for t in triangles.tolist() for a, b in zip(t, [*t[1:], t[0]], strict=True)}
    for loop in loops:
        assert {*zip(loop, [*loop[1:], loop[0]], strict=True)} <= edges
    assert sorted(map(len, hole_loops(triangles, 100))) == [4, 4, 16]


def test_memory_is_bounded_and_stated() -> None:
    volume = SurfaceVolume(0.006, most_bytes=7_000_000)
    with pytest.raises(ConfigError) as caught:
        volume.integrate(view(dome(2.0), Pose.identity()), Pose.identity())
    assert "does not fit into 7 MiB of memory with voxels of 0.006 m" in str(caught.value)
    assert "0.012 m" in caught.value.remedy and caught.value.settings[0] == "voxel"
    assert volume.memory_bytes <= 7_000_000
    for values in ({"voxel_m": 0.0}, {"voxel_m": float("nan")}, {"voxel_m": 0.1, "most_bytes": 0}):
        with pytest.raises(ConfigError):
            SurfaceVolume(**values)  # type: ignore[arg-type]


def dome(radius_m: float) -> Depth:
    """A sphere around the origin, seen from inside."""
    return lambda origin, rays: radius_m / np.linalg.norm(rays, axis=2)


def test_a_volume_grows_and_keeps_what_it_has() -> None:
    """Rows that are begun again after it has grown change nothing."""
    poses = [looking_at((0.0, 0.0, 0.0), target) for target in ((0.2, 0, 1.0), (1.0, 0.3, 0), (0, 1.0, 0.1))]
    small, large = SurfaceVolume(0.01), SurfaceVolume(0.01)
    large._grow()
    large._grow()
    large._grow()
    for volume in (small, large):
        for pose in poses:
            volume.integrate(view(dome(1.3), pose, 0.003), pose)
    assert small.block_count == large.block_count > 1024
    one, other = small.mesh(), large.mesh()
    np.testing.assert_array_equal(one.points_m, other.points_m)
    np.testing.assert_array_equal(one.triangles, other.triangles)


def test_an_empty_volume_and_points_that_are_too_far() -> None:
    volume = SurfaceVolume(0.05)
    mesh = volume.surface(fewest_triangles=9, largest_hole_m=1.0).mesh
    assert mesh.points_m.shape == (0, 3) and mesh.triangles.shape == (0, 3)
    far = Pose(np.identity(3), np.array([0.0, 0.0, 1e6]))
    with pytest.raises(ConfigError, match="from the origin"):
        volume.integrate(view(plane(2, 1e6 + 2.0), far), far)
