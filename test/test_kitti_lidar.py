# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The laser scanner of KITTI: sweeps and pose in the bag, and as the truth of its pairs."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.transforms import read_transforms
from stereo_depth_ros.camera_files.extrinsics import read_extrinsics
from stereo_depth_ros.camera_files.kitti import parse_calibration
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.datasets.to_bag import convert_dataset
from stereo_depth_ros.evaluation.bag_scenes import BagScenes
from stereo_depth_ros.evaluation.truth import TruthOption
from stereo_depth_ros.messages.range_sensor import range_points
from stereo_depth_ros.messages.types import stamp_ns

TURN = np.asarray(cv2.Rodrigues(np.array([0.01, -0.02, 0.015]))[0], np.float64)
R = TURN @ np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
T = np.array([-0.004, -0.076, -0.272])
SIZE = (960, 240)
VELO = f"calib_time: 15-Mar-2012 11:37:16\nR: {' '.join(map(str, R.ravel()))}\nT: {' '.join(map(str, T))}\n"
P0 = np.array([[582.5, 0, 480.25, 0], [0, 591.5, 119, 0], [0, 0, 1, 0]])
P1 = np.array([[582.5, 0, 480.25, -313.9], [0, 591.5, 119, 0], [0, 0, 1, 0]])


def points(seed: int) -> F32:
    """x forward, y left, z up, reflectance: far apart in the image, so that none hides another."""
    rng = np.random.default_rng(seed)
    ahead = rng.uniform(8, 40, 60)
    made = np.stack([ahead, ahead * rng.uniform(-0.6, 0.6, 60), ahead * rng.uniform(-0.1, 0.1, 60)], axis=1)
    return np.column_stack([made, rng.uniform(0, 1, 60)]).astype(np.float32)


def write_images(folder: Path, left: str, right: str, size: tuple[int, int], count: int = 2) -> None:
    rng = np.random.default_rng(3)
    for index in range(count):
        for name in (left, right):
            (folder / name).mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(folder / name / f"{index:010d}.png"), rng.integers(0, 255, size[::-1], np.uint8))


def row(name: str, matrix: F64) -> str:
    return f"{name}: {' '.join(map(str, matrix.ravel()))}\n"


def sequence(folder: Path, count: int = 2) -> Path:
    """Odometry: calib.txt with Tr, velodyne beside the images."""
    write_images(folder, "image_0", "image_1", SIZE, count)
    (folder / "calib.txt").write_text(row("P0", P0) + row("P1", P1) + row("Tr", np.column_stack([R, T])))
    (folder / "velodyne").mkdir()
    for index in range(count):
        points(index).tofile(folder / "velodyne" / f"{index:010d}.bin")
    return folder


def drive(data: Path, folder: Path, size: tuple[int, int], camera: int = 0) -> Path:
    """A raw drive with the real calibration of the cameras, and times of its sweeps."""
    images = folder / "drive_0001"
    left, right = f"image_{camera:02d}", f"image_{camera + 1:02d}"
    write_images(images, f"{left}/data", f"{right}/data", size)
    shutil.copy(data / "kitti_stereo" / "calib_only_kimera" / "calib_cam_to_cam.txt", folder)
    (folder / "calib_velo_to_cam.txt").write_text(VELO)
    (images / left / "timestamps.txt").write_text("2011-09-26 13:02:25.96\n2011-09-26 13:02:26.06\n")
    (images / "velodyne_points" / "data").mkdir(parents=True)
    times = "2011-09-26 13:02:25.951\n2011-09-26 13:02:26.054\n"
    (images / "velodyne_points" / "timestamps.txt").write_text(times)
    for index in range(2):
        points(index).tofile(images / "velodyne_points" / "data" / f"{index:010d}.bin")
    return images


def expected(
    seed: int, P_left: F64, P_right: F64, to_rectified: F64, size: tuple[int, int]
) -> dict[tuple[int, int], float]:
    """Disparity by row and column, by the definition of the dataset: P R_rect (R | T) X of both cameras."""
    homogeneous = np.column_stack([points(seed)[:, :3].astype(np.float64), np.ones(60)])
    camera = np.column_stack([homogeneous @ (to_rectified @ np.column_stack([R, T])).T, np.ones(60)])
    left, right = camera @ P_left.T, camera @ P_right.T
    u, v, u_right = left[:, 0] / left[:, 2], left[:, 1] / left[:, 2], right[:, 0] / right[:, 2]
    inside = (u > -0.5) & (u < size[0] - 0.5) & (v > -0.5) & (v < size[1] - 0.5)
    return {(round(b), round(a)): a - c for a, b, c in zip(u[inside], v[inside], u_right[inside], strict=True)}


def assert_truth(bag: Path, expectations: list[dict[tuple[int, int], float]], tolerance_px: float = 1e-2) -> None:
    sources = list(BagScenes(BagSelection(bag), truth=TruthOption("/velodyne_points")))
    assert len(sources) == len(expectations)
    for source, wanted in zip(sources, expectations, strict=True):
        truth_px = source.load().truth_px
        found = {(int(y), int(x)): float(truth_px[y, x]) for y, x in np.argwhere(np.isfinite(truth_px))}
        assert len(found) > 20
        # hidden ones are missing; the nearest pixel may be another one by rounding
        common = found.keys() & wanted.keys()
        assert len(common) >= 0.9 * len(found)
        assert max(abs(found[pixel] - wanted[pixel]) for pixel in common) < tolerance_px


def test_odometry(tmp_path: Path, command_line: CommandLine) -> None:
    folder = sequence(tmp_path / "00")
    code, _, err = command_line("convert")("kitti", folder, tmp_path / "00.mcap")
    assert code == 0 and "warning" not in err, err
    with BagReader(tmp_path / "00.mcap") as reader:
        messages = [reader.deserialize(message) for message in reader.messages(["/velodyne_points"])]
        assert [field.name for field in messages[0].fields] == ["x", "y", "z", "intensity"]
        assert [stamp_ns(message.header) for message in messages] == [1_000_000_000, 1_100_000_000]
        assert {message.header.frame_id for message in messages} == {"velodyne"}
        np.testing.assert_array_equal(range_points(messages[1]).points_m, points(1)[:, :3])
        intensity = np.frombuffer(messages[1].data.tobytes(), np.float32).reshape(-1, 4)[:, 3]
        np.testing.assert_array_equal(intensity, points(1)[:, 3])
        tree = read_transforms(reader).tree
    np.testing.assert_allclose(
        tree.pose("left_optical_frame", "velodyne", 0).matrix[:3], np.column_stack([R, T]), atol=1e-9
    )
    assert_truth(tmp_path / "00.mcap", [expected(seed, P0, P1, np.identity(3), SIZE) for seed in (0, 1)])


@pytest.mark.real_data
@pytest.mark.parametrize(("size", "camera"), [((1242, 375), 0), ((1242, 375), 2), ((1392, 512), 0)])
def test_a_drive_with_the_real_calibration(
    tmp_path: Path, stereo_data: Path, size: tuple[int, int], camera: int
) -> None:
    """Rectified gray and color images, whose left camera is beside camera 0, and raw ones."""
    dataset = KittiDataset(drive(stereo_data, tmp_path, size, camera))
    assert dataset.warnings == []
    convert_dataset(dataset, tmp_path / "drive.mcap")
    with BagReader(tmp_path / "drive.mcap") as reader:
        stamps = [stamp_ns(reader.deserialize(m).header) % 10**11 for m in reader.messages(["/velodyne_points"])]
    assert stamps == [45_951_000_000, 46_054_000_000]
    values = parse_calibration((tmp_path / "calib_cam_to_cam.txt").read_text())
    P_left, P_right = (values[f"P_rect_{number:02d}"].reshape(3, 4) for number in (camera, camera + 1))
    if camera == 2:  # rows that differ by millimeters are aligned
        P_right = P_right.copy()
        P_right[2, 3] = P_left[2, 3]
    wanted = [expected(seed, P_left, P_right, values["R_rect_00"].reshape(3, 3), size) for seed in (0, 1)]
    assert_truth(tmp_path / "drive.mcap", wanted, 0.05)


def test_sweeps_that_are_missing_or_damaged(tmp_path: Path) -> None:
    folder = sequence(tmp_path / "00", count=3)
    (folder / "velodyne" / f"{1:010d}.bin").unlink()
    dataset = KittiDataset(folder)
    assert [frame.sweep is not None for frame in dataset] == [True, False, True]
    assert dataset.warnings == ["1 of 3 pairs have no sweep of the laser scanner"]
    assert folder / "velodyne" / f"{2:010d}.bin" in dataset.files
    (folder / "velodyne" / f"{2:010d}.bin").write_bytes(b"12345")
    with pytest.raises(BagError, match=r"2\.bin: has 5 bytes, points of KITTI have 16"):
        list(dataset)


def test_sweeps_without_a_pose_are_left_out(tmp_path: Path) -> None:
    folder = sequence(tmp_path / "00")
    (folder / "calib.txt").write_text(row("P0", P0) + row("P1", P1))
    dataset = KittiDataset(folder)
    assert all(frame.sweep is None for frame in dataset)
    (text,) = dataset.warnings
    assert "calib.txt: has no pose of a sensor, it has 'P0, P1'" in text


def test_files_with_the_pose_of_a_sensor(tmp_path: Path) -> None:
    folder = sequence(tmp_path / "00")
    found = read_extrinsics(folder / "calib.txt")
    assert found.rectified
    np.testing.assert_allclose(found.parent_from_child.matrix[:3], np.column_stack([R, T]))
    (tmp_path / "calib_velo_to_cam.txt").write_text(VELO)
    assert not read_extrinsics(tmp_path / "calib_velo_to_cam.txt").rectified
    (tmp_path / "calib_cam_to_cam.txt").write_text(row("R_rect_00", TURN))
    found = read_extrinsics(tmp_path / "calib_velo_to_cam.txt")
    assert found.rectified
    np.testing.assert_allclose(found.parent_from_child.matrix[:3], TURN @ np.column_stack([R, T]))


@pytest.mark.parametrize(
    "text",
    [
        "parent: mast\nchild: lidar\ntranslation: [1.0, 2.0, -0.5]\nquaternion: [0.6, 0, 0, 0.8]\n",
        "translation: {x: 1.0, y: 2.0, z: -0.5}\nrotation: {x: 0.6, y: 0, z: 0, w: 0.8}\nparent: mast\nchild: lidar\n",
        "transforms:\n- header:\n    stamp: {sec: 0, nanosec: 0}\n    frame_id: mast\n  child_frame_id: lidar\n"
        "  transform:\n    translation:\n      x: 1.0\n      y: 2.0\n      z: -0.5\n    rotation:\n      x: 0.6\n"
        "      y: 0.0\n      z: 0.0\n      w: 0.8\n---\n",
        "parent: mast\nchild: lidar\nmatrix: [[1, 0, 0, 1], [0, 0.28, -0.96, 2], [0, 0.96, 0.28, -0.5]]\n",
    ],
)
def test_poses_in_yaml(tmp_path: Path, text: str) -> None:
    (tmp_path / "pose.yaml").write_text(text)
    found = read_extrinsics(tmp_path / "pose.yaml")
    assert (found.parent, found.child, found.rectified) == ("mast", "lidar", False)
    turn = [[1, 0, 0], [0, 0.28, -0.96], [0, 0.96, 0.28]]
    np.testing.assert_allclose(found.parent_from_child.rotation, turn, atol=1e-12)
    np.testing.assert_allclose(found.parent_from_child.translation_m, [1, 2, -0.5])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("translation: [1, 2, 3]\n", "lacks the key 'quaternion'"),
        ("quaternion: [0, 0, 0, 1]\n", "lacks the key 'translation'"),
        ("translation: [1, 2]\nquaternion: [0, 0, 0, 1]\n", "translation has 2 values, not 3"),
        ("translation: [1, 2, .nan]\nquaternion: [0, 0, 0, 1]\n", "is not a number"),
        ("translation: [1, 2, 3]\nquaternion: [0, 0, 0, 2]\n", "quaternion has the length 2, limit 0.001 from 1"),
        ("parent: 5\ntranslation: [1, 2, 3]\nquaternion: [0, 0, 0, 1]\n", "parent is 5, not the name of a frame"),
        ("[1, 2]\n", "is not a mapping"),
        ("a: [\n", "is not YAML"),
        ("matrix: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 2, 0]]\n", "is not a rotation"),
    ],
)
def test_poses_that_are_none_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "pose.yaml").write_text(text)
    with pytest.raises(CalibrationError, match=rf"pose\.yaml: .*{problem}"):
        read_extrinsics(tmp_path / "pose.yaml")
