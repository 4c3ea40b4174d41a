# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes of DrivingStereo, Sintel stereo, TartanAir and Middlebury 2021, in small folders of their layouts."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from stereo_depth_ros.cli.main import app
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.evaluation.scenes import Scene, find_scenes

HEIGHT, WIDTH = 40, 90
RNG = np.random.default_rng(8)
IMAGES: tuple[U8, U8] = tuple(RNG.integers(0, 256, (2, HEIGHT, WIDTH, 3), np.uint8))
TRUTH: F32 = RNG.uniform(0.5, 30, (HEIGHT, WIDTH)).astype(np.float32)
UNKNOWN = RNG.uniform(size=(HEIGHT, WIDTH)) < 0.2


def write(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, pixels)
    else:
        assert cv2.imwrite(str(path), pixels)


def check(scene: Scene, expected: F32, step: float) -> None:
    for found, image in zip((scene.left, scene.right), IMAGES, strict=True):
        assert np.abs(found.astype(int) - cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)).max() <= 30  # jpg
    np.testing.assert_array_equal(np.isnan(scene.truth_px), np.isnan(expected))
    np.testing.assert_allclose(scene.truth_px, expected, atol=step)


@pytest.mark.parametrize(
    ("names", "per_px"),
    [
        (("left-image-half-size", "right-image-half-size", "disparity-map-half-size"), 256),
        (("left-image-full-size", "right-image-full-size", "disparity-map-full-size"), 128),
        (("train-left-image", "train-right-image", "train-disparity-map"), 256),
    ],
)
def test_driving_stereo(names: tuple[str, str, str], per_px: int, tmp_path: Path) -> None:
    left, right, truth = names
    below = "2018-07-11-14-48-52" if "train" in left else "."
    for folder, image in ((left, IMAGES[0]), (right, IMAGES[1])):
        write(tmp_path / folder / below / "frame_01.jpg", image)
    levels = np.where(UNKNOWN, 0, np.rint(per_px * TRUTH)).astype(np.uint16)
    write(tmp_path / truth / below / "frame_01.png", levels)
    (source,) = find_scenes(tmp_path)
    expected = f"{below}/frame_01" if below != "." else "frame_01"
    assert source.name == f"{tmp_path.name}/{expected}"
    scene = source.load()
    check(scene, np.where(UNKNOWN, np.float32(np.nan), TRUTH), 0.5 / per_px + 1e-6)
    assert scene.occlusion == "truth"


def test_sintel(tmp_path: Path) -> None:
    occluded, outside = RNG.uniform(size=(2, HEIGHT, WIDTH)) < 0.1
    whole = np.rint(TRUTH * 2**14).astype(np.int64)
    red, rest = whole >> 16, whole & 0xFFFF
    encoded = np.stack([rest & 255, rest >> 8, red], axis=-1).astype(np.uint8)  # blue first
    below = "training/{}/alley_1/frame_0001.png"
    for kind in ("clean", "final"):
        for side, image in zip(("left", "right"), IMAGES, strict=True):
            write(tmp_path / below.format(f"{kind}_{side}"), image)
    write(tmp_path / below.format("disparities"), encoded)
    write(tmp_path / below.format("occlusions"), np.uint8(255) * occluded)
    write(tmp_path / below.format("outofframe"), np.uint8(255) * outside)
    scenes = find_scenes(tmp_path)
    assert [source.name for source in scenes] == [f"training/{kind}/alley_1/frame_0001" for kind in ("final", "clean")]
    for source in scenes:
        scene = source.load()
        check(scene, TRUTH, 2**-15 + 1e-5)
        np.testing.assert_array_equal(scene.visible, ~occluded & ~outside)
        assert scene.occlusion == "mask" and len(source.files) == 5


@pytest.mark.parametrize("version", [1, 2])
def test_tartan_air(version: int, tmp_path: Path) -> None:
    depth_m = np.where(UNKNOWN, 0, 80 / TRUTH).astype(np.float32)
    left, right = ("left", "right") if version == 1 else ("lcam_front", "rcam_front")
    for side, image in ((left, IMAGES[0]), (right, IMAGES[1])):
        write(tmp_path / "P000" / f"image_{side}" / f"000000_{side}.png", image)
    path = tmp_path / "P000" / f"depth_{left}" / f"000000_{left}_depth"
    if version == 1:
        write(path.with_suffix(".npy"), depth_m)
    else:
        write(path.with_suffix(".png"), depth_m[..., None].view(np.uint8))
    (source,) = find_scenes(tmp_path)
    assert source.name == "P000/000000"
    check(source.load(), np.where(UNKNOWN, np.float32(np.nan), TRUTH), 1e-4)


def test_middlebury_2021(tmp_path: Path) -> None:
    folder = tmp_path / "artroom1"
    for name, image in zip(("im0.png", "im1.png"), IMAGES, strict=True):
        write(folder / name, image)
    write(folder / "disp0.pfm", np.where(UNKNOWN, np.float32(np.inf), TRUTH))
    (source,) = find_scenes(tmp_path)
    check(source.load(), np.where(UNKNOWN, np.float32(np.nan), TRUTH), 0)


def test_files_that_are_missing_or_of_another_kind(tmp_path: Path) -> None:
    truth = tmp_path / "disparities" / "a" / "frame_0001.png"
    write(truth, IMAGES[0][..., 0])
    for side in ("left", "right"):
        (tmp_path / f"final_{side}" / "a").mkdir(parents=True)
    with pytest.raises(BagError, match=r"frame_0001.png: has a truth, but there is no image .*final_left/a/frame_0001"):
        find_scenes(tmp_path)
    for side, image in zip(("left", "right"), IMAGES, strict=True):
        write(tmp_path / f"final_{side}" / "a" / "frame_0001.png", image)
    (source,) = find_scenes(tmp_path)
    with pytest.raises(BagError, match=r"has 1 channel\(s\) of uint8, 3 of uint8 are expected"):
        source.load()
    depth = tmp_path / "P1" / "depth_left" / "0_left_depth.npy"
    for side, image in zip(("left", "right"), IMAGES, strict=True):
        write(tmp_path / "P1" / f"image_{side}" / f"0_{side}.png", image)
    write(depth, TRUTH[None])
    (source,) = find_scenes(tmp_path / "P1")
    with pytest.raises(BagError, match=r"it has 1x40x90 values of type float32, disparities are rows x columns"):
        source.load()
    depth.write_bytes(b"no array")
    with pytest.raises(BagError, match=r"it is damaged, or not an .npy file"):
        source.load()


def test_evaluate_takes_them(tmp_path: Path) -> None:
    right = RNG.integers(0, 256, (HEIGHT, WIDTH + 8), np.uint8)
    write(tmp_path / "image_left" / "000000_left.png", right[:, :WIDTH])
    write(tmp_path / "image_right" / "000000_right.png", right[:, 8:])
    write(tmp_path / "depth_left" / "000000_left_depth.npy", np.full((HEIGHT, WIDTH), 10, np.float32))  # 8 px
    result = CliRunner().invoke(app, ["evaluate", str(tmp_path), "--matcher", "sgm", "--json", "-"])
    assert result.exit_code == 0, result.output
    (row,) = json.loads(result.stdout)
    assert row["scene"] == f"{tmp_path.name}/000000" and row["density"] > 0.8 and row["bad_1"] < 1
