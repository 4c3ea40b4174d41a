# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Folders of color and depth images: layouts, units, lens distortion, and what is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.datasets.rgbd import RgbdDataset, is_rgbd, rgbd_size
from stereo_depth_ros.offline.range_views import range_image

K = np.array([[40.0, 0, 15.0], [0, 44.0, 9.0], [0, 0, 1]])
CAMERA = CameraModel(32, 20, "plumb_bob", K, np.zeros(5), np.identity(3), np.column_stack((K, np.zeros(3))))


def color(number: int) -> Any:
    y, x = np.indices((20, 32))
    return np.stack((x * 3, y * 5, np.full(x.shape, 10 * number)), axis=2).astype(np.uint8)  # BGR


def levels(number: int) -> Any:
    y, x = np.indices((20, 32))
    return np.where((x + y) % 7 == 0, 0, 1000 + 100 * number + x).astype(np.uint16)


def write(path: Path, pixels: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels)


@pytest.mark.parametrize(
    "names",
    [
        ("rgb_{}.png", "depth_{}.png"),
        ("color-{:04d}.jpg", "depth-{:04d}.png"),
        ("color/{:06d}.jpg", "depth/{:06d}.png"),
        ("rgb/a{}.png", "depth/b{:03d}.tiff"),
    ],
)
def test_numbered_images_are_in_the_order_of_their_numbers(tmp_path: Path, names: tuple[str, str]) -> None:
    for number in (2, 10, 9):
        write(tmp_path / names[0].format(number), color(number))
        write(tmp_path / names[1].format(number), levels(number))
    write(tmp_path / names[0].format(11), color(11))
    assert is_rgbd(tmp_path) and rgbd_size(tmp_path) == (32, 20)
    dataset = RgbdDataset(tmp_path, CAMERA)
    assert len(dataset) == 3 and dataset.skipped == 1 and not dataset.has_stamps and dataset.poses is None
    assert dataset.step_m == 0.001
    for index, number in enumerate((2, 9, 10)):
        frame = dataset[index]
        expected = np.where(levels(number) > 0, levels(number) * np.float32(0.001), np.nan)
        np.testing.assert_allclose(frame.depth_m, expected, rtol=1e-6)
        assert np.abs(frame.color.astype(int) - color(number)[:, :, ::-1]).mean() < 6  # JPEG
        assert frame.stamp_ns == 0


@pytest.mark.parametrize("table", [True, False])
def test_the_layout_of_the_tum_benchmark(tmp_path: Path, table: bool) -> None:
    stamps = ["1311868164.363181", "1311868164.399026", "1311868165.5"]
    apart = [0.004, -0.012, 0.05]  # the last one has no partner
    rows: list[list[str]] = [[], []]
    for number, stamp in enumerate(stamps):
        other = f"{float(stamp) + apart[number]:.6f}"
        write(tmp_path / f"rgb/{stamp}.png", color(number))
        write(tmp_path / f"depth/{other}.png", levels(number) * 5)
        rows[0].append(f"{stamp} rgb/{stamp}.png")
        rows[1].append(f"{other} depth/{other}.png")
    if table:
        lines = [f"{rows[1][n]} {rows[0][n]}" for n in range(2)]
        (tmp_path / "associations.txt").write_text("\n".join(lines) + "\n", "utf-8")
    else:
        for name, lines in zip(("rgb", "depth"), rows, strict=True):
            (tmp_path / f"{name}.txt").write_text("# timestamp filename\n" + "\n".join(lines) + "\n", "utf-8")
    (tmp_path / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw\n", "utf-8")
    dataset = RgbdDataset(tmp_path, CAMERA)
    assert len(dataset) == 2 and dataset.has_stamps and dataset.poses == tmp_path / "groundtruth.txt"
    assert dataset.skipped == (0 if table else 2)
    assert dataset[1].depth_m[3, 5] == pytest.approx(1.105, rel=1e-6)
    if not table:
        assert dataset.stamps_ns == [1311868164363181000, 1311868164399026000]
    assert RgbdDataset(tmp_path, CAMERA, 0.001)[1].depth_m[3, 5] == pytest.approx(5.525, rel=1e-6)


def test_floats_are_meters(tmp_path: Path) -> None:
    depth = np.where(levels(1) > 0, levels(1) / 900, np.inf).astype(np.float32)
    write(tmp_path / "rgb_1.png", color(1)[:, :, 0])
    write(tmp_path / "depth_1.tiff", depth)
    dataset = RgbdDataset(tmp_path, CAMERA)
    np.testing.assert_array_equal(dataset[0].depth_m, np.where(np.isinf(depth), np.nan, depth))
    assert dataset[0].color.ndim == 2 and dataset.step_m == 0


def test_the_standard_deviation_of_a_range_camera(tmp_path: Path) -> None:
    write(tmp_path / "rgb_1.png", color(1))
    write(tmp_path / "depth_1.png", levels(1))
    dataset = RgbdDataset(tmp_path, CAMERA)
    image = range_image(dataset[0], dataset, 0.003)
    assert image.sigma_m[3, 5] == pytest.approx(np.hypot(0.003 * 1.105**2, 0.001 / np.sqrt(12)), rel=1e-5)
    assert (image.triangulation.f_px, image.triangulation.fy_px) == (40, 44)
    assert not image.measured[0, 0] and image.measured[3, 5]


@pytest.mark.parametrize(
    ("model", "D"), [("plumb_bob", [-0.2, 0.05, 0.001, -0.002, 0.0]), ("equidistant", [0.05, -0.02, 0.003, 0.0])]
)
def test_lens_distortion_is_removed_from_both(tmp_path: Path, model: str, D: list[float]) -> None:
    """A depth that is a function of the ray, and the color too."""
    camera = dataclasses.replace(CAMERA, distortion_model=model, D=np.array(D))
    y, x = np.indices((20, 32))
    pixels = np.stack((x.ravel(), y.ravel()), axis=1).astype(np.float64)[:, None]
    undistort = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
    rays = undistort(pixels, K, np.array(D)).reshape(20, 32, 2)
    write(tmp_path / "rgb_0.png", np.clip(120 + 200 * rays[..., 0], 0, 255).astype(np.uint8))
    write(tmp_path / "depth_0.png", (2000 + 1000 * rays[..., 1]).astype(np.uint16))
    dataset = RgbdDataset(tmp_path, camera)
    frame = dataset[0]
    inner = np.s_[3:-3, 3:-3]
    expected = (x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]
    assert np.abs(frame.color - (120 + 200 * expected[0]))[inner].max() < 3
    assert np.nanmax(np.abs(frame.depth_m - (2 + expected[1]))[inner]) < 0.6 / 44 + 0.002  # the nearest pixel
    assert not dataset.camera.D.any()


def test_folders_of_something_else_are_refused(tmp_path: Path) -> None:
    assert not is_rgbd(tmp_path) and not is_rgbd(tmp_path / "none")
    with pytest.raises(BagError, match="holds no color images with depth images"):
        RgbdDataset(tmp_path, CAMERA)
    write(tmp_path / "rgb_0.png", color(0))
    assert not is_rgbd(tmp_path)
    write(tmp_path / "depth_0.png", levels(0))
    with pytest.raises(CalibrationError, match="is 32x20, the camera is that of 33x20"):
        RgbdDataset(tmp_path, dataclasses.replace(CAMERA, width=33))
    write(tmp_path / "depth_0.png", levels(0)[:, :30])
    with pytest.raises(BagError, match=r"depth_0\.png: is 30x20, the camera is that of 32x20: align"):
        RgbdDataset(tmp_path, CAMERA)[0]
    write(tmp_path / "depth_0.png", levels(0).astype(np.uint8))
    with pytest.raises(BagError, match="has 8 bits, a depth image has 16"):
        RgbdDataset(tmp_path, CAMERA)[0]
    write(tmp_path / "depth_0.png", color(0))
    with pytest.raises(BagError, match="has 3 channels, a depth image has one"):
        RgbdDataset(tmp_path, CAMERA)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("1.5 rgb_0.png\n", "line 1 has 2 words, 4 are needed"),
        ("# a\nx rgb_0.png 1.5 depth_0.png\n", "x is not a time in seconds"),
        ("-1 rgb_0.png 1.5 depth_0.png\n", "-1 is not a time in seconds"),
    ],
)
def test_damaged_tables_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "associations.txt").write_text(text, "utf-8")
    assert is_rgbd(tmp_path)
    with pytest.raises(BagError, match=problem):
        RgbdDataset(tmp_path, CAMERA)
