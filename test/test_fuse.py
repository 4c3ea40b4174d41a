# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth fuse`: bags and datasets with poses to surfaces near the truth, counts, and what is refused."""

from __future__ import annotations

import importlib.util
import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import CommandLine
from posed_bags import MAP_FROM_SCENE, write_drive, write_kitti
from stereo_bags import sequence
from test_camera_poses import tum

from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.stages.depth import depth_sigma
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.volume import SurfaceVolume
from stereo_depth_ros.synthetic.scene import Cylinder, room_scene
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

BOARDS = room_scene(7).primitives[6:9]  # without a back side
FRAMES, VOXEL = 3, 0.05
MEDIAN_M = 0.045  # a disparity of 0.25 px is 0.14 m at 3 m
OPTIONS = ("--voxel", VOXEL, "--max-depth", 4, "--param", "disparity_range:=48")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pairs, and the odometry of a robot; the last pair has none."""
    return write_drive(tmp_path_factory.mktemp("fused") / "drive.mcap", FRAMES, before_ns=30_000_000)


def program(name: str) -> Any:
    """A program of benchmarks/."""
    path = Path(__file__).resolve().parents[1] / "benchmarks" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"{name}_benchmark", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def points_of(path: Path) -> F64:
    """The vertices of a PLY file, float64 (N, 3)."""
    header, _, data = path.read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    count = int(next(line for line in lines if line.startswith("element vertex")).split()[-1])
    names = [line.split()[1:] for line in lines if line.startswith("property ") and "list" not in line]
    rows = np.frombuffer(data, [(name, "<f4" if kind == "float" else "u1") for kind, name in names], count)
    return np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)


def test_a_bag_with_odometry(bag: Path, tmp_path: Path, command_line: CommandLine) -> None:
    fuse, output = command_line("fuse"), tmp_path / "room.ply"
    report, preview = tmp_path / "room.json", tmp_path / "room.png"
    code, out, err = fuse(bag, "-o", output, *OPTIONS, "--json", report, "--preview", preview)
    assert code == 0, err
    assert "1 of 3 pairs were left out, no pose is known at their time" in err
    assert "/odom, of base_link" in out and "2 of 3" in out
    values = json.loads(report.read_text())
    assert (values["pairs"], values["fused"], values["without_pose"], values["skipped"]) == (3, 2, 1, 0)
    assert values["too_far"] > 0 and values["used"] > 5000 and values["z_up"] and values["apart"] < 0.3
    points = MAP_FROM_SCENE.inverse().apply(points_of(output))
    off = sequence(FRAMES).scene.distances(points)
    assert len(points) == values["surfaces"][0]["points"] > 2000
    assert np.median(off) < MEDIAN_M and np.percentile(off, 85) < 4 * MEDIAN_M
    assert cv2.imread(str(preview)).shape[0] > 400
    code, _, err = fuse(bag, "-o", output, *OPTIONS)
    assert code == 1 and "already exists" in err
    code, _, err = fuse(bag, "-o", tmp_path / "none.ply", *OPTIONS, "--start", 0.19)
    assert code == 1 and "no pair could be fused: 1 of 1 pairs have no pose" in err
    assert not (tmp_path / "none.ply").exists()


def test_a_bag_with_a_file_of_poses(bag: Path, tmp_path: Path, command_line: CommandLine) -> None:
    fuse, poses = command_line("fuse"), tum(tmp_path / "poses.txt")
    options = (*OPTIONS, "--poses", poses, "--every", 2, "--refine", "--json", "-")
    code, out, err = fuse(bag, "-o", tmp_path / "room.cloud.ply", *options)
    assert code == 0, err
    values = json.loads(out)
    assert (values["pairs"], values["fused"]) == (2, 2) and "TUM, of the left camera" in values["poses"]
    assert values["refined"] + values["refinement_kept"] == 1
    assert values["parameters"]["disparity_range"] == "48" and values["parameters"]["sequence"] == str(bag)
    points = MAP_FROM_SCENE.inverse().apply(points_of(tmp_path / "room.cloud.ply"))
    assert np.median(sequence(FRAMES).scene.distances(points)) < MEDIAN_M


def test_a_sequence_of_write_kitti(tmp_path: Path, command_line: CommandLine) -> None:
    folder, fuse = write_kitti(tmp_path / "00"), command_line("fuse")
    code, out, err = fuse(folder, "-o", tmp_path / "street.ply", *OPTIONS, "--json", "-")
    assert code == 0, err
    values = json.loads(out)
    assert values["fused"] == 3 and not values["z_up"] and values["poses"].endswith("KITTI, of camera 0")
    off = sequence(FRAMES).scene.distances(points_of(tmp_path / "street.ply"))
    assert np.median(off) < MEDIAN_M
    shutil.copy(folder / "poses.txt", tmp_path / "poses.txt")
    (folder / "poses.txt").unlink()
    code, _, err = fuse(folder, "-o", tmp_path / "x.ply", *OPTIONS)
    assert code == 2 and "has no file of poses of its own" in err and "--poses" in err
    wrong = [row.split() for row in (tmp_path / "poses.txt").read_text().splitlines()]
    for number, row in enumerate(wrong):
        row[11] = str(float(row[11]) + 1.6 * number)
    (folder / "poses.txt").write_text("\n".join(" ".join(row) for row in wrong))
    code, _, err = fuse(folder, "-o", tmp_path / "wrong.ply", *OPTIONS)
    assert code == 0 and "the images do not fit each other" in err


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("-o", "x.stl"), 1, "its name does not end in"),
        (("-o", "x.ply", "--poses", "/none"), 1, "/none is not a topic of poses; the bag has /odom"),
        (("-o", "x.ply", "--voxel", "0"), 2, "voxel = 0 m is not above 0"),
        (("-o", "x.ply", "--voxel", "0.03", "--memory", "6"), 2, "does not fit into 6 MiB of memory"),
        (("-o", "x.ply", "--voxel", "1e-4"), 1, "no surface was found"),
        (("-o", "x.ply", "--preview", "x.jpg"), 2, "does not end in .png"),
        (("-o", "x.ply", "--pose-frame", "gripper"), 1, "those of gripper"),
        (("-o", "x.ply", "--world-frame", "map"), 2, "world_frame has no effect"),
        (("-o", "x.ply", "--param", "cloud_padding:=1"), 2, "cloud_padding"),
    ],
)
def test_what_is_refused(
    bag: Path, tmp_path: Path, command_line: CommandLine, arguments: tuple[str, ...], code: int, text: str
) -> None:
    given = [str(tmp_path / name) if name.startswith("x.") else name for name in arguments]
    found, out, err = command_line("fuse")(bag, *given)
    assert (found, out) == (code, "") and text in err, err
    assert "Traceback" not in err and not [*tmp_path.iterdir()]


def test_folders_that_are_not_sequences(tmp_path: Path, command_line: CommandLine) -> None:
    fuse = command_line("fuse")
    code, _, err = fuse(tmp_path / "none", "-o", tmp_path / "x.ply")
    assert code == 1 and "is neither a bag nor a folder" in err
    code, _, err = fuse(tmp_path, "-o", tmp_path / "x.ply", "--start", 1)
    assert code == 2 and "--start has no effect with a folder" in err
    code, _, err = fuse(write_kitti(tmp_path / "00"), "-o", tmp_path / "x.ply", "--side-by-side")
    assert code == 2 and "side_by_side has no effect" in err


def test_exact_depth_with_noise_gives_the_surfaces_of_the_room(tmp_path: Path) -> None:
    """Fused vertices are within their standard deviation of the truth, and none is between the surfaces."""
    made = SyntheticSequence(60, 160, 120)
    geometry, volume = Triangulation.from_rig(made.rig), SurfaceVolume(0.06)
    for number in range(0, 60, 10):
        frame, pose = made[number], made.pose(number)
        depth = np.where(frame.occluded, np.float32(np.nan), frame.truth_depth_m)
        sigma = depth_sigma(depth, geometry, 0.05)
        noise = np.random.default_rng(number).normal(0, 1, depth.shape).astype(np.float32)
        image = RangeImage(depth + noise * sigma, sigma, geometry, frame.pair.left.pixels)
        volume.integrate(image, Pose(*pose) @ Pose(made.rig.left.R.T, np.zeros(3)), max_depth_m=3.5)
    mesh = volume.surface(fewest_triangles=50).mesh
    off = made.scene.distances(mesh.points_m.astype(np.float64))
    floor = np.maximum(mesh.sigma_m, 0.1 * volume.voxel_m)
    assert np.median(off / floor) < 0.5 and np.percentile(off / floor, 95) < 2
    # what is thinner than voxels, boards and poles, gets a back side; beside all others nothing is in the air
    each = np.stack([p.distances(mesh.points_m.astype(np.float64)) for p in made.scene.primitives])
    thin = [n for n, p in enumerate(made.scene.primitives) if isinstance(p, Cylinder) or p in BOARDS]
    beside = np.delete(each, thin, axis=0).min(axis=0) <= each[thin].min(axis=0)
    assert np.count_nonzero(beside) > 4500 and off[beside].max() < 2.5 * volume.voxel_m


@pytest.mark.real_data
def test_a_road_is_flat(tmp_path: Path, command_line: CommandLine, stereo_data: Path) -> None:
    """Five pairs of a street, cropped: the heights of the lane above its plane, 5 to 15 m ahead of the first pair."""
    source, folder, (x0, y0) = stereo_data / "kitti_odometry" / "seqA_1226x370", tmp_path / "street", (330, 150)
    rows = (source / "poses.txt").read_text().splitlines()
    for name in ("image_l", "image_r"):
        (folder / name).mkdir(parents=True)
        for number in range(0, 20, 4):
            image = cv2.imread(str(source / name / f"{number:06d}.png"), cv2.IMREAD_GRAYSCALE)
            assert cv2.imwrite(str(folder / name / f"{number:06d}.png"), image[y0:, x0 : x0 + 560])
    (folder / "poses.txt").write_text("\n".join(rows))
    P = [np.array(row.split(), float).reshape(3, 4) for row in (source / "calib.txt").read_text().splitlines()[:2]]
    for matrix in P:
        matrix[0, 2], matrix[1, 2] = matrix[0, 2] - x0, matrix[1, 2] - y0
    texts = (" ".join(map(str, matrix.ravel())) for matrix in P)
    (folder / "calib.txt").write_text("\n".join(f"P{number}: {text}" for number, text in enumerate(texts)))
    output = tmp_path / "street.cloud.ply"
    code, _, err = command_line("fuse")(folder, "-o", output, "--voxel", 0.1, "--max-depth", 20)
    assert code == 0, err
    spread_m, count = program("surfaces").road_spread(points_of(output))
    assert count > 2000 and spread_m < 0.02
