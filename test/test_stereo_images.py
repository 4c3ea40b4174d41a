# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Image pairs of folders and bags for calibration."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from stereo_bags import HEIGHT, WIDTH, compressed_folder, sequence, write_odd_bag

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import BagError, TopicError
from stereo_depth_ros.datasets.stereo_images import ImagePair, open_stereo_images
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message


def write(folder: Path, names: list[str]) -> Path:
    """Images whose gray level counts up from 10."""
    for number, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((4, 6), 10 + number, np.uint8))
    return folder


def values(pairs: list[ImagePair]) -> list[tuple[str, int, int]]:
    return [(pair.name, int(pair.left[0, 0]), int(pair.right[0, 0])) for pair in pairs]


@pytest.mark.parametrize(
    "names",
    [
        ["left01.png", "left02.png", "right01.png", "right02.png"],
        ["left/01.png", "left/02.png", "right/01.png", "right/02.png"],
        ["cam0/data/01.png", "cam0/data/02.png", "cam1/data/01.png", "cam1/data/02.png"],
        ["image_0/01.png", "image_0/02.png", "image_1/01.png", "image_1/02.png"],
        ["L_01.png", "L_02.png", "R_01.png", "R_02.png"],
        ["01_left.png", "02_left.png", "01_right.png", "02_right.png"],
    ],
)
def test_names_of_cameras(tmp_path: Path, names: list[str]) -> None:
    images = open_stereo_images(write(tmp_path, names))
    assert len(images) == 2
    assert not images.dense
    assert [found[1:] for found in values(list(images))] == [(10, 12), (11, 13)]


def test_patterns(tmp_path: Path) -> None:
    names = ["a/x1.png", "a/x2.png", "b/y2.png", "b/y1.png", "b/z1.png"]
    images = open_stereo_images(write(tmp_path, names), "a/x*.png", "b/y*.png")
    assert values(list(images)) == [("x1.png", 10, 13), ("x2.png", 11, 12)]


def test_an_image_without_a_partner_is_reported(tmp_path: Path) -> None:
    images = open_stereo_images(write(tmp_path, ["left1.png", "left2.png", "right1.png"]))
    assert len(images) == 1
    assert images.warnings == [f"{tmp_path / 'left2.png'}: skipped, it has no right image"]


def test_frame_numbers_do_not_name_a_camera(tmp_path: Path) -> None:
    """image_0.png in left/ is frame 0, not camera 0."""
    names = [f"{side}/image_{number}.png" for side in ("left", "right") for number in range(3)]
    assert [found[1:] for found in values(list(open_stereo_images(write(tmp_path, names))))] == [
        (10, 13),
        (11, 14),
        (12, 15),
    ]


def test_images_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    names = ["left1.png", "left2.png", "left10.png", "right1.png", "right2.png", "right10.png"]
    assert [found[0] for found in values(list(open_stereo_images(write(tmp_path, names))))] == [
        "left1.png",
        "left2.png",
        "left10.png",
    ]


def test_errors_name_the_patterns_as_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="or give patterns for both cameras") as caught:
        open_stereo_images(write(tmp_path, ["left1.png", "right2.png"]))
    assert caught.value.settings == ("left", "right")
    with pytest.raises(
        BagError, match=r"a1\.png: matches the left and the right pattern: give patterns that no file matches both"
    ):
        open_stereo_images(write(tmp_path / "same", ["a1.png", "a2.png"]), "a*.png", "a*.png")


def test_files_with_both_images(tmp_path: Path) -> None:
    for number in (10, 9):
        halves = [np.full((4, 6), gray, np.uint8) for gray in (number, 100 + number)]
        (tmp_path / "views").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "views" / f"{number}.png"), np.concatenate(halves, axis=1))
    (tmp_path / "notes.txt").write_text("none")
    expected = [("9.png", 9, 109), ("10.png", 10, 110)]
    images = open_stereo_images(tmp_path, side_by_side=True)
    assert (values(list(images)), len(images), images.files) == (expected, 2, [tmp_path / "views" / "9.png"] * 2
                                                                 + [tmp_path / "views" / "10.png"] * 2)  # fmt: skip
    assert values(list(open_stereo_images(tmp_path, "views/9*", side_by_side=True))) == expected[:1]
    with pytest.raises(BagError, match=r"10\.png looks like both images side by side, 12x4: read both from") as caught:
        open_stereo_images(tmp_path)
    assert caught.value.settings == ("side_by_side",)
    with pytest.raises(BagError, match="has no images"):
        open_stereo_images(tmp_path, "none*", side_by_side=True)
    cv2.imwrite(str(tmp_path / "odd.png"), np.zeros((4, 11), np.uint8))
    odd = open_stereo_images(tmp_path, "odd*", side_by_side=True)
    assert list(odd) == []
    assert odd.unreadable == [f"{tmp_path / 'odd.png'}: skipped, it is 11x4, an odd width has no two halves"]


def test_color_images_are_converted_to_gray(tmp_path: Path) -> None:
    for name in ("left1.png", "right1.png"):
        cv2.imwrite(str(tmp_path / name), np.full((4, 6, 3), (0, 0, 200), np.uint8))
    (pair,) = open_stereo_images(tmp_path)
    assert pair.left.shape == (4, 6)
    assert abs(int(pair.left[0, 0]) - 60) <= 1  # 0.299 of red


def test_folders_without_pairs(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="does not exist: name a folder of images, or a bag"):
        open_stereo_images(tmp_path / "none")
    with pytest.raises(BagError, match=r"no images of a left and a right camera: name them left\*\.png"):
        open_stereo_images(tmp_path)
    with pytest.raises(BagError, match=r"2 images such as left1\.png and none of the right camera"):
        open_stereo_images(write(tmp_path / "one", ["left1.png", "left2.png"]))
    with pytest.raises(BagError, match=r"no left image has the number of a right one"):
        open_stereo_images(write(tmp_path / "odd", ["left1.png", "right2.png"]))
    with pytest.raises(BagError, match="give both patterns, or none"):
        open_stereo_images(tmp_path / "one", "left*.png")


def test_bag(tmp_path: Path) -> None:
    """An image without a partner, right images late by less than 5 ms, camera infos that are ignored."""
    write_odd_bag(tmp_path / "b.mcap", 4, without_right=[1], right_late_ns=2_000_000)
    images = open_stereo_images(tmp_path / "b.mcap")
    assert images.dense
    pairs = list(images)
    assert len(pairs) == 3
    assert pairs[0].left.shape == (HEIGHT, WIDTH)
    np.testing.assert_array_equal(pairs[0].left, next(iter(sequence(1))).pair.left.pixels)
    assert pairs[0].name.endswith(" s")
    assert any("1 images have no partner within 5 ms" in text for text in images.warnings)


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_folder_of_a_compressed_bag(tmp_path: Path, plugin: StoragePlugin) -> None:
    write_odd_bag(tmp_path / "b.mcap", 2)
    folder = compressed_folder(tmp_path / "b.mcap", tmp_path / "bag", plugin)
    assert [path.suffix for path in folder.iterdir() if path.suffix != ".yaml"] == [".zstd"]
    images = open_stereo_images(folder)
    assert images.dense
    np.testing.assert_array_equal([pair.left for pair in images], [frame.pair.left.pixels for frame in sequence(2)])


def test_rectified_bags_are_refused(tmp_path: Path) -> None:
    types, frame = RosbagsTypes(), next(iter(sequence(1)))
    with BagWriter(tmp_path / "r.mcap") as bag:
        for side, image in (("left", frame.pair.left), ("right", frame.pair.right)):
            message = image_message(types, image.pixels, "mono8", image.stamp_ns, image.frame_id)
            bag.write(f"/{side}/image_rect", message, image.stamp_ns)
    with pytest.raises(TopicError, match="rectified already: calibrate with raw images"):
        open_stereo_images(tmp_path / "r.mcap")


def test_raw_images_are_preferred_also_without_camera_infos(tmp_path: Path) -> None:
    types, frame = RosbagsTypes(), sequence(1)[0]
    with BagWriter(tmp_path / "both.mcap") as bag:
        for side, image in (("left", frame.pair.left), ("right", frame.pair.right)):
            for kind in ("raw", "rect"):
                bag.write(f"/{side}/image_{kind}", image_message(types, image.pixels, "mono8", 5, side), 5)
            bag.write(f"/{side}/camera_info_rect", camera_info_message(types, sequence(1).rig.left, 5), 5)
    assert len(list(open_stereo_images(tmp_path / "both.mcap"))) == 1
