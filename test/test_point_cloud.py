# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds: every byte of the layout, points against OpenCV's reprojection."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.config import CloudConfig
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.messages.point_cloud import cloud_message
from stereo_depth_ros.stages.point_cloud import CloudLayout, pack_points

WIDTH, HEIGHT = 29, 17
RIG = StereoRig.from_rectified(
    fx=410.0, fy=395.0, cx_left=17.5, cx_right=12.25, cy=9.0, baseline_m=0.12, size=(WIDTH, HEIGHT), frame_id="left"
)


@pytest.fixture
def disparity_px() -> F32:
    disparity = np.linspace(6, 60, WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH)
    disparity[2, 11] = np.nan
    return disparity


@pytest.fixture
def color() -> U8:
    return np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


@pytest.mark.parametrize(
    ("padding", "use_color", "step", "offset"),
    [(False, True, 32, 16), (False, False, 16, None), (True, True, 16, 12), (True, False, 12, None)],
)
def test_every_layout(
    padding: bool, use_color: bool, step: int, offset: int | None, disparity_px: F32, color: U8
) -> None:
    layout = CloudLayout.of(CloudConfig(avoid_point_cloud_padding=padding, use_color=use_color))
    assert layout == CloudLayout(step, offset)
    message = cloud_message(
        RosbagsTypes(),
        disparity_px,
        Triangulation.from_rig(RIG),
        layout,
        stamp_ns=5_000_000_006,
        frame_id="left",
        color=color,
        color_encoding="rgb8",
    )
    assert (message.height, message.width, message.point_step, message.row_step) == (HEIGHT, WIDTH, step, step * WIDTH)
    assert not message.is_dense
    assert not message.is_bigendian
    assert [f.name for f in message.fields] == ["x", "y", "z", "rgb"][: 4 if use_color else 3]
    assert [f.offset for f in message.fields] == [0, 4, 8, offset][: 4 if use_color else 3]
    points = np.frombuffer(message.data, np.uint8).reshape(HEIGHT, WIDTH, step)
    xyz = np.ascontiguousarray(points[:, :, :12]).view(np.float32)
    expected = cv2.reprojectImageTo3D(disparity_px, RIG.Q)
    expected[2, 11] = np.nan
    np.testing.assert_allclose(xyz, expected, rtol=3e-6, atol=1e-7)
    if offset is not None:
        np.testing.assert_array_equal(points[:, :, offset : offset + 3], color[:, :, ::-1])  # blue first in memory
        assert not points[:, :, offset + 3].any()


@pytest.mark.parametrize(
    ("padding", "use_color", "step", "offset", "confidence_at"),
    [(False, True, 32, 16, 20), (False, False, 32, None, 16), (True, True, 24, 12, 16), (True, False, 20, None, 12)],
)
def test_quality_follows_in_every_layout(
    padding: bool, use_color: bool, step: int, offset: int | None, confidence_at: int, disparity_px: F32, color: U8
) -> None:
    config = CloudConfig(avoid_point_cloud_padding=padding, use_color=use_color, point_quality=True)
    layout = CloudLayout.of(config)
    assert layout == CloudLayout(step, offset, confidence_at)
    rng = np.random.default_rng(4)
    quality = rng.uniform(size=(HEIGHT, WIDTH)).astype(np.float32), rng.uniform(size=(HEIGHT, WIDTH)).astype(np.float32)
    given = (RosbagsTypes(), disparity_px, Triangulation.from_rig(RIG))
    header = {"stamp_ns": 6, "frame_id": "left", "color": color, "color_encoding": "rgb8"}
    message = cloud_message(*given, layout, **header, quality=quality)
    plain = cloud_message(*given, dataclasses.replace(layout, quality_offset=None), **header)
    names = ["x", "y", "z", *(["rgb"] if use_color else []), "confidence", "sigma"]
    offsets = [0, 4, 8, *([offset] if use_color else []), confidence_at, confidence_at + 4]
    assert [(f.name, f.offset, f.datatype) for f in message.fields] == [
        (name, at, 7) for name, at in zip(names, offsets, strict=True)
    ]
    points, before = (np.frombuffer(m.data, np.uint8).reshape(HEIGHT, WIDTH, step).copy() for m in (message, plain))
    for values, at in zip(quality, (confidence_at, confidence_at + 4), strict=True):
        np.testing.assert_array_equal(np.ascontiguousarray(points[:, :, at : at + 4]).view(np.float32)[:, :, 0], values)
        points[:, :, at : at + 4] = before[:, :, at : at + 4]
    np.testing.assert_array_equal(points, before)  # nothing else changes
    with pytest.raises(ImageError, match=r"confidence and standard deviation of None"):
        cloud_message(*given, layout, **header)


@pytest.mark.parametrize(("encoding", "order"), [("bgr8", (0, 1, 2)), ("rgb8", (2, 1, 0)), ("mono8", (0, 0, 0))])
def test_colors_of_every_encoding(encoding: str, order: tuple[int, ...], disparity_px: F32, color: U8) -> None:
    image = color[:, :, 0] if encoding == "mono8" else color
    payload = np.zeros(WIDTH * HEIGHT * 16, np.uint8)
    pack_points(disparity_px, Triangulation.from_rig(RIG), CloudLayout(16, 12), payload, image.copy(), encoding)
    np.testing.assert_array_equal(payload.reshape(HEIGHT, WIDTH, 16)[:, :, 12:15], color[:, :, list(order)])


def test_a_verged_rig_differs_from_a_parallel_one(disparity_px: F32) -> None:
    payload, straight = np.zeros((2, WIDTH * HEIGHT * 12), np.uint8)
    triangulation = Triangulation.from_rig(RIG)
    pack_points(disparity_px, triangulation, CloudLayout(12, None), payload)
    pack_points(disparity_px, dataclasses.replace(triangulation, doffs_px=0.0), CloudLayout(12, None), straight)
    with np.errstate(invalid="ignore"):  # one pixel has no depth
        ratio = (payload.view(np.float32) / straight.view(np.float32)).reshape(HEIGHT, WIDTH, 3)[:, :, 2]
    np.testing.assert_allclose(ratio[5, 6], disparity_px[5, 6] / (disparity_px[5, 6] - 5.25), rtol=1e-5)


def test_wrong_sizes_are_refused(disparity_px: F32, color: U8) -> None:
    triangulation = Triangulation.from_rig(RIG)
    with pytest.raises(ImageError, match=r"payload of 100 bytes, 29x17 points of 12 take 5916"):
        pack_points(disparity_px, triangulation, CloudLayout(12, None), np.zeros(100, np.uint8))
    payload = np.zeros(WIDTH * HEIGHT * 16, np.uint8)
    with pytest.raises(ImageError, match=r"left image of \(16, 29\), the disparities have \(17, 29\)"):
        pack_points(disparity_px, triangulation, CloudLayout(16, 12), payload, color[:-1], "rgb8")
    with pytest.raises(ImageError, match=r"left image of None"):
        pack_points(disparity_px, triangulation, CloudLayout(16, 12), payload)
