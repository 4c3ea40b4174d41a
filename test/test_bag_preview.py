# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The preview of a bag: left image and depth of one stamp."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.disparity import disparity_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.plots.bag_preview import save_bag_preview
from stereo_depth_ros.plots.preview import preview

SIZE = (96, 60)
RIG = StereoRig.from_rectified(100.0, 101.0, 50.0, 47.0, 31.0, 0.2, SIZE)


def test_preview_shows_depth_beside_the_left_image_of_the_same_stamp(tmp_path: Path) -> None:
    types, random = RosbagsTypes(), np.random.default_rng(1)
    depth_m = random.uniform(2, 6, SIZE[::-1]).astype(np.float32)
    disparity_px = (RIG.f_px * RIG.baseline_m / depth_m + RIG.doffs_px).astype(np.float32)
    disparity_px[7, 9] = depth_m[7, 9] = np.nan
    rgb = random.integers(0, 255, (*SIZE[::-1], 3), np.uint8)
    disparity = disparity_message(
        types, disparity_px, RIG, min_disparity=0, max_disparity=31, step_px=0.1, stamp_ns=20, frame_id="left"
    )
    with BagWriter(tmp_path / "out.mcap") as bag:
        bag.write("/left/image_rect_color", image_message(types, rgb[::-1].copy(), "rgb8", 10, "left"), 10)
        bag.write("/left/image_rect_color", image_message(types, rgb, "rgb8", 20, "left"), 20)
        bag.write("/disparity", disparity, 20)
    save_bag_preview(tmp_path / "out.mcap", tmp_path / "p.png", "title")
    expected = preview(rgb[..., ::-1].copy(), depth_m, "title")
    found = cv2.imread(str(tmp_path / "p.png"))
    assert found.shape == expected.shape
    # float32 rounding of Z may move a pixel to the next of 256 colors
    assert np.abs(found.astype(int) - expected).max() <= 12


def test_bag_without_outputs_is_refused(tmp_path: Path) -> None:
    types = RosbagsTypes()
    with BagWriter(tmp_path / "in.mcap") as bag:
        bag.write("/left/image_rect_color", image_message(types, np.zeros((4, 6), np.uint8), "mono8", 1, "l"), 1)
    with pytest.raises(BagError, match=r"in\.mcap: no /left/image_rect_color with a /disparity of the same stamp"):
        save_bag_preview(tmp_path / "in.mcap", tmp_path / "p.png")
