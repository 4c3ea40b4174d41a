# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Surfaces of range images: time of meshes, normals, files and fusion, and accuracy on scenes with exact truth.

python benchmarks/surfaces.py
python benchmarks/surfaces.py --data ~/stereo --json surfaces.json

Times are medians over calls in turns in one run.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.datasets.posed import open_posed
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.geometry.robust import robust_sigma
from stereo_depth_ros.offline.camera_poses import poses_of_file
from stereo_depth_ros.offline.fuse import fuse_sequence
from stereo_depth_ros.offline.refinement import PoseRefinement
from stereo_depth_ros.offline.sequence import DatasetSequence
from stereo_depth_ros.stages.depth import depth_sigma
from stereo_depth_ros.surfaces.mesh import mesh_of, normal_image
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.registration import OrientedImage, OrientedPoints, moved_by, register
from stereo_depth_ros.surfaces.volume import SurfaceVolume
from stereo_depth_ros.surfaces.writing import write_surface
from stereo_depth_ros.synthetic.projection import SyntheticScanner
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

CALLS = 5
SIGMA_PX = 0.1
VOXEL_M = 0.02
STREET_PAIRS = 11
ENDS = (".ply", ".glb", ".cloud.ply", ".pcd", ".png", ".npz")


class Row(NamedTuple):
    """One measured quantity."""

    data: str
    figure: str
    value: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="640x480", help="width and height, px")
    parser.add_argument("--frames", type=int, default=100, help="number of range images that are fused")
    parser.add_argument("--data", type=Path, help="folder with kitti_odometry/seqA_1226x370, which is fused too")
    parser.add_argument("--json", type=Path, help="write the rows as JSON")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    rows = []
    for row in chain(
        measured(width, height),
        registered(width, height),
        fused(width, height, arguments.frames),
        road(arguments.data),
        refined(arguments.data),
    ):
        print("| " + " | ".join(row) + " |", flush=True)
        rows.append(row._asdict())
    if arguments.json:
        write_file(arguments.json, json.dumps(rows, indent=2) + "\n", overwrite=True)


def measured(width: int, height: int) -> Iterator[Row]:
    """The table-top scene with the noise of disparities of SIGMA_PX."""
    scanner = SyntheticScanner(width, height, (64, 48))
    truth, geometry = scanner.truth(), Triangulation.from_rig(scanner.rig)
    sigma_m = depth_sigma(truth.depth_m, geometry, SIGMA_PX)
    noise = np.random.default_rng(1).normal(0, 1, sigma_m.shape).astype(np.float32)
    color = np.random.default_rng(2).integers(0, 256, (height, width, 3), np.uint8)
    image = RangeImage(truth.depth_m + noise * sigma_m, sigma_m, geometry, color)
    exact = RangeImage(truth.depth_m, sigma_m, geometry, color)
    data = f"table top, rendered, {width}x{height}"
    mesh = mesh_of(image)
    x, y = mesh.texture_px.T.astype(int)
    corners, depth = truth.surface[y, x][mesh.triangles], truth.depth_m[y, x][mesh.triangles]
    several = (corners != corners[:, :1]).any(axis=1)
    apart = depth.max(axis=1) - depth.min(axis=1) > 6 * sigma_m[y, x][mesh.triangles].max(axis=1)
    yield Row(data, "points, triangles", f"{len(mesh.points_m)}, {len(mesh.triangles)}")
    yield Row(data, "triangles across a depth step", str(int(np.count_nonzero(several & apart))))
    normals = normal_image(exact)
    for radius in (1, 2, 4):
        yield Row(
            data,
            f"median error of normals, window {2 * radius + 1}",
            angle(normal_image(image, radius_px=radius), normals),
        )
    yield Row(data, "median error of normals, mesh", angle(mesh.normals, normals[y, x]))
    for name, call in (("mesh", partial(mesh_of, image)), ("normals, window 5", partial(normal_image, image))):
        yield Row(data, f"time of {name}", f"{median_ms(call):.0f} ms")
    with tempfile.TemporaryDirectory() as folder:
        for end in ENDS:
            path = Path(folder, f"s{end}")
            took_ms = median_ms(partial(write_surface, path, image, overwrite=True))
            yield Row(data, f"time and size of {end}", f"{took_ms:.0f} ms, {path.stat().st_size / 1e6:.1f} MB")


def fused(width: int, height: int, frames: int) -> Iterator[Row]:
    """The room, with the noise of disparities of SIGMA_PX, from known poses along the way of its camera."""
    sequence = SyntheticSequence(100, width, height)
    geometry, volume, times_ms = Triangulation.from_rig(sequence.rig), SurfaceVolume(VOXEL_M), []
    for number in np.linspace(0, 99, frames).astype(int).tolist():
        frame, (R, center) = sequence[number], sequence.pose(number)
        depth_m = np.where(frame.occluded, np.float32(np.nan), frame.truth_depth_m)
        sigma_m = depth_sigma(depth_m, geometry, SIGMA_PX)
        noise = np.random.default_rng(number).normal(0, 1, depth_m.shape).astype(np.float32)
        image = RangeImage(depth_m + noise * sigma_m, sigma_m, geometry, frame.pair.left.pixels)
        pose = Pose(R, center) @ Pose(np.ascontiguousarray(sequence.rig.left.R.T), np.zeros(3))
        start = time.perf_counter()
        volume.integrate(image, pose)
        times_ms.append(1e3 * (time.perf_counter() - start))
    start = time.perf_counter()
    surface = volume.surface(fewest_triangles=100)
    took_ms, mesh = 1e3 * (time.perf_counter() - start), surface.mesh
    off = sequence.scene.distances(mesh.points_m.astype(np.float64))
    data = f"room, {frames} range images of {width}x{height}, voxels of {VOXEL_M} m"
    yield Row(data, "time of an image", f"{statistics.median(times_ms):.0f} ms")
    yield Row(data, "time of the surface", f"{took_ms:.0f} ms")
    yield Row(data, "points, triangles", f"{len(mesh.points_m)}, {len(mesh.triangles)}")
    yield Row(data, "memory of the volume", f"{volume.memory_bytes / 2**20:.0f} MiB")
    median, most = np.percentile(1e3 * off, [50, 95])
    yield Row(data, "distance from the truth, median and 95 %", f"{median:.1f} mm, {most:.1f} mm")
    median, most = np.percentile(off / np.maximum(mesh.sigma_m, 0.1 * VOXEL_M), [50, 95])
    yield Row(data, "the same in standard deviations", f"{median:.2f}, {most:.2f}")


def road(data: Path | None) -> Iterator[Row]:
    """A street, matched by the default matcher, with its poses."""
    if data is None:
        return
    config, volume = PipelineConfig(), SurfaceVolume(0.1)
    posed = open_posed(data / "kitti_odometry" / "seqA_1226x370")
    assert posed.poses is not None
    poses = poses_of_file(posed.poses, 10**9, None, posed)
    report = fuse_sequence(DatasetSequence(posed, config), poses, volume, max_depth_m=25.0)
    mesh = volume.surface(fewest_triangles=100).mesh
    spread_m, count = road_spread(mesh.points_m.astype(np.float64))
    name = f"street, {report.fused} pairs of 1226x370, voxels of 0.1 m"
    yield Row(name, "time of an image", f"{report.integrate_ms:.0f} ms")
    yield Row(name, "points, triangles", f"{len(mesh.points_m)}, {len(mesh.triangles)}")
    yield Row(name, "memory of the volume", f"{volume.memory_bytes / 2**20:.0f} MiB")
    yield Row(name, "heights of the lane above its plane, robust std", f"{1e3 * spread_m:.1f} mm, {count} points")


def registered(width: int, height: int) -> Iterator[Row]:
    """Two images of the room, with the noise of disparities of SIGMA_PX, from a start that is wrong."""
    sequence, images, poses = SyntheticSequence(100, width, height), [], []
    geometry = Triangulation.from_rig(sequence.rig)
    for number in (40, 44):
        frame, (R, center) = sequence[number], sequence.pose(number)
        depth_m = np.where(frame.occluded, np.float32(np.nan), frame.truth_depth_m)
        sigma_m = depth_sigma(depth_m, geometry, SIGMA_PX)
        noise = np.random.default_rng(number).normal(0, 1, depth_m.shape).astype(np.float32)
        images.append(RangeImage(depth_m + noise * sigma_m, sigma_m, geometry, frame.pair.left.pixels))
        poses.append(Pose(R, center) @ Pose(np.ascontiguousarray(sequence.rig.left.R.T), np.zeros(3)))
    truth = poses[0].inverse() @ poses[1]
    source, target = OrientedImage.of(images[1]), OrientedImage.of(images[0])
    mesh = mesh_of(images[0])
    along = np.abs(np.sum(mesh.normals * mesh.points_m, axis=1)) / mesh.points_m[:, 2]
    points = OrientedPoints(mesh.points_m, mesh.normals, along * mesh.sigma_m)
    start = moved_by(truth, np.array([0.03, -0.03, 0.02, 0.08, -0.05, 0.1]))
    data = f"room, rendered, {width}x{height}"
    yield Row(data, "time of normals for a registration", f"{median_ms(partial(OrientedImage.of, images[0])):.0f} ms")
    for kind, surface in (("a range image", target), ("points", points)):
        found = register(source, surface, start)
        took_ms = median_ms(partial(register, source, surface, start))
        turned_deg, moved_m = apart(found.pose, truth)
        sigma = np.sqrt(np.diag(found.covariance))
        yield Row(data, f"registration with {kind}, time and steps", f"{took_ms:.0f} ms, {found.iterations}")
        yield Row(data, "error", f"{1e3 * moved_m:.2f} mm, {turned_deg:.4f} degrees")
        expected = f"{1e3 * np.linalg.norm(sigma[3:]):.2f} mm, {np.degrees(np.linalg.norm(sigma[:3])):.4f} degrees"
        yield Row(data, "its standard deviation, and the residuals", f"{expected}; {found.residual_rms:.2f}")


def refined(data: Path | None) -> Iterator[Row]:
    """A street with poses that are wrong by 0.1 m and 0.5 degrees, each image registered with those before it.

    The rotation between two images is also known from features and the essential matrix, without any depth.
    """
    if data is None:
        return
    posed, volume = open_posed(data / "kitti_odometry" / "seqA_1226x370"), SurfaceVolume(0.2)
    assert posed.poses is not None
    known, rng = poses_of_file(posed.poses, 10**9, None, posed), np.random.default_rng(1)
    refinement, times_s, poses, grays = PoseRefinement(volume), [], [], []
    for number, pair in enumerate(DatasetSequence(posed, PipelineConfig())):
        if number == STREET_PAIRS:
            break
        view = pair.read()
        truth, image = known.at(pair.number, pair.stamp_ns, view.frame_id, view.rig), view.compute()
        assert truth is not None
        off = rng.normal(0, 1, (2, 3))
        off *= np.array([[np.radians(0.5)], [0.1]]) / np.linalg.norm(off, axis=1, keepdims=True)
        given = truth @ moved_by(Pose.identity(), off.ravel()) if number else truth
        start = time.perf_counter()
        used = refinement(image, given)
        times_s.append(time.perf_counter() - start)
        volume.integrate(image, used, max_depth_m=30.0)
        poses.append((truth, given, used))
        grays.append(image.color)
    K = np.array([[image.triangulation.f_px, 0, image.triangulation.cx_px]] * 2 + [[0, 0, 1]])
    K[1] = [0, image.triangulation.fy_px, image.triangulation.cy_px]
    errors = []
    for (one, first), (other, second) in itertools.pairwise(zip(poses, grays, strict=True)):
        truth, given, used = (a.inverse() @ b for a, b in zip(one, other, strict=True))
        seen = Pose(rotation_of_features(first, second, K), np.zeros(3))
        against = [apart(pose, truth)[::-1] for pose in (given, used)]
        errors.append([*against[0], *against[1], *(apart(pose, seen)[0] for pose in (truth, given, used))])
    row = np.median(errors, axis=0)
    name = f"street, {len(poses)} poses wrong by 0.1 m and 0.5 degrees, registered with the surface"
    yield Row(name, "between two images, from the truth, given", f"{row[0]:.3f} m, {row[1]:.3f} degrees")
    yield Row(name, "refined", f"{row[2]:.3f} m, {row[3]:.3f} degrees")
    turns = f"truth {row[4]:.3f}, given {row[5]:.3f}, refined {row[6]:.3f} degrees"
    yield Row(name, "from the rotation of features", turns)
    yield Row(name, "time of an image", f"{1e3 * statistics.median(times_s[1:]):.0f} ms")


def apart(pose: Pose, other: Pose) -> tuple[float, float]:
    """The angle between two poses, degrees, and the distance, meters."""
    cosine = (np.trace(pose.rotation @ other.rotation.T) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), float(
        np.linalg.norm(pose.translation_m - other.translation_m)
    )


def rotation_of_features(first: U8, second: U8, K: F64) -> F64:
    """The rotation from the second camera to the first, by tracked corners and the essential matrix."""
    one = cv2.goodFeaturesToTrack(first, 2000, 0.005, 8)
    other = cv2.calcOpticalFlowPyrLK(first, second, one, None, winSize=(15, 15), maxLevel=5)[0]
    back = cv2.calcOpticalFlowPyrLK(second, first, other, None, winSize=(15, 15), maxLevel=5)[0]
    kept = np.linalg.norm(one - back, axis=2).ravel() < 0.3
    E, inliers = cv2.findEssentialMat(one[kept], other[kept], K, cv2.RANSAC, 0.9999, 0.5)
    R = cv2.recoverPose(E, one[kept], other[kept], K, mask=inliers)[1]
    return np.ascontiguousarray(R.T, np.float64)


def road_spread(points_m: F64) -> tuple[float, int]:
    """Robust standard deviation of heights above the plane of a lane, meters, and the number of its points.

    The lane is 2 m to both sides, 5 to 15 m ahead, 1.2 to 2.2 m below the first camera. The plane is that of least
    squares without what is farther than three robust standard deviations (1.4826 times the median deviation).

    Args:
        points_m: float64 (N, 3), x right, y down, z forward.
    """
    x, y, z = points_m.T
    x, y, z = points_m[(np.abs(x) < 2) & (y > 1.2) & (y < 2.2) & (z > 5) & (z < 15)].T
    A, kept, spread_m = np.stack((x, z, np.ones(len(x))), axis=1), np.ones(len(x), bool), 0.0
    for _ in range(10):
        off = y - A @ np.linalg.lstsq(A[kept], y[kept], rcond=None)[0]
        spread_m = robust_sigma(off - np.median(off))
        kept = np.abs(off) < 3 * spread_m
    return spread_m, len(x)


def angle(found: F32, expected: F32) -> str:
    """The median angle between unit vectors."""
    cosines = np.clip(np.sum(found * expected, axis=-1), -1, 1)
    return f"{np.nanmedian(np.degrees(np.arccos(cosines))):.2f} degrees"


def median_ms(call: Callable[[], object]) -> float:
    """Median time after one call."""
    times = []
    for number in range(CALLS + 1):
        start = time.perf_counter()
        call()
        if number:
            times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


if __name__ == "__main__":
    main()
