# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Swapped cameras are detected from images, without false positives."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.stages import camera_swap
from stereo_depth_ros.stages.camera_swap import CameraSwapDetector
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.sequence import SyntheticSequence


@pytest.fixture(scope="module")
def verged_pair() -> tuple[U8, U8, float]:
    sequence = SyntheticSequence(frames=1, width=200, height=120)
    pair = Rectifier(sequence.rig).rectify(sequence[0].pair)
    return pair.left, pair.right, sequence.rig.doffs_px


def test_right_order_passes(verged_pair: tuple[U8, U8, float]) -> None:
    left, right, doffs_px = verged_pair
    CameraSwapDetector(doffs_px).check(left, right)


def test_swapped_cameras_are_refused_until_corrected(verged_pair: tuple[U8, U8, float]) -> None:
    left, right, doffs_px = verged_pair
    order = CameraSwapDetector(doffs_px)
    for _ in range(3):
        with pytest.raises(ImageError, match=r"cameras look swapped: \d+ % .* exchange the image topics"):
            order.check(right, left)
    order.check(left, right)
    order.check(right, left)  # not checked again once confirmed: the topics of a graph do not change


def test_undecided_images_pass_and_are_checked_again(verged_pair: tuple[U8, U8, float]) -> None:
    left, right, doffs_px = verged_pair
    order = CameraSwapDetector(doffs_px)
    for _ in range(10):
        order.check(np.zeros_like(left), np.zeros_like(right))
    with pytest.raises(ImageError, match="cameras look swapped"):
        order.check(right, left)


def test_every_pair_is_checked_until_one_shows_the_order(verged_pair: tuple[U8, U8, float]) -> None:
    left, right, doffs_px = verged_pair
    order = CameraSwapDetector(doffs_px)
    order.check(np.zeros_like(left), np.zeros_like(right))
    for one, other in ((right, left), (np.zeros_like(left), np.zeros_like(right))):
        with pytest.raises(ImageError, match="cameras look swapped"):
            order.check(one, other)  # once they are known to be swapped, a dark pair does not pass either
    order.check(left, right)


def test_no_thread_passes_swapped_cameras_while_another_checks(
    verged_pair: tuple[U8, U8, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    left, right, doffs_px = verged_pair
    smooth_share = camera_swap._smooth_share

    def slow(*pair: Any) -> float:
        time.sleep(0.05)
        return smooth_share(*pair)

    monkeypatch.setattr(camera_swap, "_smooth_share", slow)
    order, start = CameraSwapDetector(doffs_px), threading.Barrier(2)

    def refused(_: int) -> bool:
        start.wait(timeout=60)
        try:
            order.check(right, left)
        except ImageError:
            return True
        return False

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(refused, range(2))) == [True, True]


def test_images_too_small_for_the_search_pass() -> None:
    noise = np.random.default_rng(5).integers(0, 255, (40, 50), np.uint8)
    CameraSwapDetector(0.0).check(noise, noise)


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("left", "right", "doffs_px"),
    [
        ("middlebury2003/cones/im2.png", "im6.png", 0.0),
        ("middlebury2001/tsukuba/scene1.row3.col3.ppm", "scene1.row3.col4.ppm", 0.0),
        ("middlebury2006/Plastic/view1.png", "view5.png", 0.0),
        ("oakd/stereodemo/stairs_left.png", "stairs_right.png", 0.0),
        ("eth3d/terrace/im0.png", "im1.png", 0.0),
    ],
)
def test_real_pairs(stereo_data: Path, left: str, right: str, doffs_px: float) -> None:
    left_path = stereo_data / left
    images = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in (left_path, left_path.with_name(right))]
    CameraSwapDetector(doffs_px).check(images[0], images[1])
    with pytest.raises(ImageError, match="cameras look swapped"):
        CameraSwapDetector(doffs_px).check(images[1], images[0])


@pytest.mark.real_data
def test_an_offset_with_swapped_points_in_front_is_not_refused(stereo_data: Path) -> None:
    """Cropped images: doffs is -31 px, so that half the scene has a depth in either order."""
    folder = stereo_data / "middlebury2014" / "Motorcycle_quarter"
    left, right = (
        cv2.imread(str(folder / f"motorcycle_{side}.png"), cv2.IMREAD_GRAYSCALE) for side in ("left", "right")
    )
    CameraSwapDetector(-31.086).check(left, right)


@pytest.mark.real_data
@pytest.mark.parametrize("scene", ["Art", "Reindeer"])
def test_infinity_far_below_zero_does_not_mean_swapped_cameras(stereo_data: Path, scene: str) -> None:
    """Cropped images whose true disparities lie 67 px and more above that of infinity."""
    folder = stereo_data / "middlebury2005" / scene
    left, right = (cv2.imread(str(folder / f"view{number}.png"), cv2.IMREAD_GRAYSCALE) for number in (1, 5))
    doffs_px = -float((folder / "dmin.txt").read_text()) / 3
    CameraSwapDetector(doffs_px).check(left, right)
