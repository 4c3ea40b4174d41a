# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inspection of a bag: usable, or every reason why not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.bags.info import BagInfo, ImageInfo, TopicSummary, inspect_bag
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.types import make_header

TYPES = RosbagsTypes()
WIDTH, HEIGHT = 44, 30
RIG = StereoRig.from_rectified(51.5, 52.5, 20.0, 23.0, 14.0, 0.125, (WIDTH, HEIGHT))
PERIOD_NS = 100_000_000


def write(
    path: Path,
    *,
    right_late_ns: int = 0,
    rights: int = 5,
    right_size: tuple[int, int] = (HEIGHT, WIDTH),
    infos: int = 1,
    rig: StereoRig = RIG,
) -> BagInfo:
    """Five left images, ``rights`` right ones, ``infos`` camera infos per camera."""
    with BagWriter(path) as bag:
        for index in range(5):
            stamp = 1_000_000_000 + index * PERIOD_NS
            if index < infos:
                bag.write("/left/camera_info", camera_info_message(TYPES, rig.left, stamp), stamp)
                bag.write("/right/camera_info", camera_info_message(TYPES, rig.right, stamp), stamp)
            left = image_message(TYPES, np.zeros((HEIGHT, WIDTH, 3), np.uint8), "rgb8", stamp, "left")
            bag.write("/left/image_raw", left, stamp)
            if index < rights:
                late = stamp + right_late_ns
                right = image_message(TYPES, np.zeros(right_size, np.uint8), "mono8", late, "right")
                bag.write("/right/image_raw", right, late)
    return inspect_bag(path)


def test_a_usable_bag(tmp_path: Path) -> None:
    info = write(tmp_path / "bag.mcap", rights=3)
    assert info.usable and info.problems == () and info.warnings == ()
    assert info.start_ns == 1_000_000_000 and info.duration_s == pytest.approx(0.4)
    assert info.topics["/left/image_raw"] == TopicSummary("sensor_msgs/msg/Image", 5, pytest.approx(10.0))
    assert info.topics["/left/camera_info"] == TopicSummary("sensor_msgs/msg/CameraInfo", 1, 0.0)
    assert info.left_image == ImageInfo(WIDTH, HEIGHT, "rgb8")
    assert info.right_image == ImageInfo(WIDTH, HEIGHT, "mono8")
    assert info.rig is not None
    assert (info.rig.baseline_m, info.rig.f_px, info.rig.doffs_px) == pytest.approx((0.125, 51.5, -3.0))
    assert (info.exact_pairs, info.near_pairs) == (3, 3)


def test_pairs_that_need_approximate_sync(tmp_path: Path) -> None:
    info = write(tmp_path / "bag.mcap", right_late_ns=9_000_000)
    assert (info.exact_pairs, info.near_pairs) == (0, 5)
    assert len(info.problems) == 1
    assert "5 pairs are within 0.01 s: pair stamps that differ by up to 0.01 s" in str(info.problems[0])
    assert info.problems[0].settings == ("approximate_sync", "approximate_sync_tolerance_seconds")


def test_pairs_that_are_too_far_apart(tmp_path: Path) -> None:
    info = write(tmp_path / "bag.mcap", right_late_ns=30_000_000)
    assert (info.exact_pairs, info.near_pairs, len(info.problems)) == (0, 0, 1)
    assert "none is within 0.01 s: synchronize the cameras" in str(info.problems[0])
    assert inspect_bag(tmp_path / "bag.mcap", tolerance_s=0.03).near_pairs == 5


def test_a_bag_without_a_pair(tmp_path: Path) -> None:
    info = write(tmp_path / "bag.mcap", rights=0)
    assert not info.usable
    assert info.stereo is None and info.rig is None and info.left_image is None
    assert "no stereo pair among the image topics /left/image_raw" in str(info.problems[0])


def test_a_bag_without_infos(tmp_path: Path) -> None:
    info = write(tmp_path / "bag.mcap", infos=0)
    assert tuple(map(str, info.problems)) == (
        f"{tmp_path / 'bag.mcap'}: no CameraInfo topic belongs to /left/image_raw, topics of the bag are "
        "/left/image_raw, /right/image_raw: record the camera infos too, or give calibration files",
    )
    assert info.exact_pairs == 5


def test_a_calibration_that_is_refused(tmp_path: Path) -> None:
    swapped = StereoRig.from_rectified(51.5, 52.5, 20.0, 23.0, 14.0, 0.125, (WIDTH, HEIGHT))
    object.__setattr__(swapped, "left", RIG.right)
    object.__setattr__(swapped, "right", RIG.left)
    info = write(tmp_path / "bag.mcap", rig=swapped)
    assert info.rig is None and len(info.problems) == 1
    assert "left and right are probably swapped" in str(info.problems[0])
    assert "/left/camera_info" in str(info.problems[0])


def test_images_of_another_size_than_their_camera_infos(tmp_path: Path) -> None:
    info = write(tmp_path / "bag.mcap", right_size=(HEIGHT, WIDTH + 2))
    assert len(info.problems) == 1
    assert f"/right/image_raw: the image is {WIDTH + 2}x{HEIGHT}, its camera info is for {WIDTH}x{HEIGHT}" in str(
        info.problems[0]
    )


def test_images_that_cannot_be_decoded(tmp_path: Path) -> None:
    image = image_message(TYPES, np.zeros((HEIGHT, WIDTH), np.uint8), "mono8", 5, "left")
    with BagWriter(tmp_path / "bag.mcap") as bag:
        bag.write("/left/image_raw", replace(image, encoding="magic"), 5)
        bag.write_raw("/right/image_raw", "sensor_msgs/msg/Image", b"\0\1\0\0", 6)
    problems = "\n".join(map(str, inspect_bag(tmp_path / "bag.mcap").problems))
    assert "/left/image_raw: encoding = 'magic' is not supported" in problems
    assert "/right/image_raw at 6 ns: 4 bytes are not a sensor_msgs/msg/Image" in problems


def test_compressed_images_and_a_cut_bag(tmp_path: Path) -> None:
    ok, data = cv2.imencode(".png", np.zeros((HEIGHT, WIDTH), np.uint8))
    assert ok
    with BagWriter(tmp_path / "bag.mcap") as bag:
        for side, camera in (("left", RIG.left), ("right", RIG.right)):
            header = make_header(TYPES, 7, side)
            message = TYPES.CompressedImage(header=header, format="mono8; png compressed ", data=data.ravel())
            bag.write(f"/{side}/image_raw/compressed", message, 7)
            bag.write(f"/{side}/camera_info", camera_info_message(TYPES, camera, 7), 7)
    cut = tmp_path / "cut.mcap"
    whole = (tmp_path / "bag.mcap").read_bytes()
    cut.write_bytes(whole[: whole.index(b"\x0f" + (4).to_bytes(8, "little"))])  # at the end of the data
    info = inspect_bag(cut)
    assert info.usable and info.stereo is not None and info.stereo.compressed
    assert info.left_image == ImageInfo(WIDTH, HEIGHT, "mono8; png compressed ")
    assert info.warnings == (f"{cut} is cut in the middle: the 4 messages before the cut are read",)


def test_a_path_that_is_not_a_bag_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="does not exist"):
        inspect_bag(tmp_path / "nowhere")


@pytest.mark.real_data
def test_a_real_bag_without_a_stereo_pair(stereo_data: Path) -> None:
    path = stereo_data / "bags" / "mvtb_test_ros2"
    info = inspect_bag(path)
    assert info.topics["/imu/data"].count == 3
    assert tuple(map(str, info.problems)) == (
        f"{path}: no stereo pair among the image topics /camera/compressed, /camera/raw: name both image topics",
    )
