# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The published convention: shifted once, invalid below the minimum, window of the actual size."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.messages.disparity import (
    disparity_message,
    published_disparity,
    published_triangulation,
    valid_window,
)
from stereo_depth_ros.stages.depth import depth_from_disparity

WIDTH, HEIGHT = 53, 31
TYPES = RosbagsTypes()


@pytest.fixture
def rig() -> StereoRig:
    return StereoRig.from_rectified(
        fx=410.0, fy=395.0, cx_left=30.1, cx_right=24.9, cy=9.0, baseline_m=0.12, size=(WIDTH, HEIGHT), frame_id="left"
    )


@pytest.fixture
def disparity_px() -> np.ndarray[Any, np.dtype[np.float32]]:
    disparity = np.linspace(8, 39, WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH)
    disparity[4, 7] = np.nan
    disparity[30, 0] = 8.0  # exactly the minimum
    return disparity


@pytest.fixture
def message(rig: StereoRig, disparity_px: Any) -> Any:
    return disparity_message(
        TYPES,
        disparity_px,
        rig,
        min_disparity=8,
        max_disparity=39,
        step_px=1 / 16,
        stamp_ns=12_000_000_034,
        frame_id="left",
        support_px=(5, 5),
    )


def test_depth_of_a_verged_rig_follows_from_the_published_value(
    message: Any, rig: StereoRig, disparity_px: Any
) -> None:
    published = np.frombuffer(message.image.data, np.float32).reshape(HEIGHT, WIDTH)
    valid = published >= message.min_disparity
    depth_m = message.f * message.t / published[valid]
    expected = depth_from_disparity(disparity_px, Triangulation.from_rig(rig))
    np.testing.assert_allclose(depth_m, expected[valid], rtol=1e-5)
    assert valid.sum() == WIDTH * HEIGHT - 1
    assert not valid[4, 7]
    assert valid[30, 0]


def test_fields(message: Any) -> None:
    assert (message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id) == (12, 34, "left")
    assert message.image.header == message.header
    assert (message.image.encoding, message.image.step, message.image.is_bigendian) == ("32FC1", 4 * WIDTH, 0)
    assert message.min_disparity == pytest.approx(8 - 5.2, abs=1e-5)
    assert message.max_disparity == pytest.approx(39 - 5.2, abs=1e-5)
    assert (message.delta_d, message.f, message.t) == (1 / 16, 410.0, pytest.approx(0.12))
    window = message.valid_window
    assert (window.x_offset, window.y_offset, window.width, window.height) == (41, 2, 10, 27)


def test_reading_back_gives_the_published_values_and_the_same_depth(
    message: Any, rig: StereoRig, disparity_px: Any
) -> None:
    published = published_disparity(message)
    assert np.isnan(published[4, 7])
    assert np.isnan(published).sum() == 1
    depth_m = depth_from_disparity(published, published_triangulation(message, rig))
    np.testing.assert_array_equal(depth_m, depth_from_disparity(disparity_px, Triangulation.from_rig(rig)))


def test_padded_big_endian_disparities_are_read() -> None:
    rows = np.zeros((2, 5), ">f4")
    rows[:, :3] = [[3, 4, 5], [-1, np.inf, 7]]
    image = SimpleNamespace(encoding="32FC1", width=3, height=2, step=20, is_bigendian=1, data=rows.tobytes())
    disparity = published_disparity(SimpleNamespace(image=image, f=400.0, t=0.1, min_disparity=0.0))
    np.testing.assert_array_equal(disparity, [[3, 4, 5], [np.nan, np.nan, 7]])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"encoding": "16UC1"}, r"disp: encoding '16UC1', a DisparityImage holds 32FC1"),
        ({"step": 10}, r"disp: step 10 with 3x2 pixels"),
        ({"height": 0}, r"disp: step 12 with 3x0 pixels"),
        ({"data": bytes(20)}, r"disp: 20 bytes, step x height is 24"),
    ],
)
def test_contradictory_fields(changes: dict[str, Any], text: str) -> None:
    fields = {"encoding": "32FC1", "width": 3, "height": 2, "step": 12, "is_bigendian": 0, "data": bytes(24)} | changes
    with pytest.raises(MessageError, match=text):
        published_disparity(SimpleNamespace(image=SimpleNamespace(**fields), f=400.0, t=0.1, min_disparity=0.0), "disp")


def test_no_focal_length_and_other_calibrations_are_refused(message: Any, rig: StereoRig) -> None:
    message.f = 0.0
    with pytest.raises(MessageError, match=r"f = 0.0, T = 0.12, both must be positive"):
        published_disparity(message)
    message.f = 500.0
    with pytest.raises(MessageError, match=r"f = 500 px, T = 0.12 m, the camera infos have 410 px"):
        published_triangulation(message, rig)


@pytest.mark.parametrize(
    ("size", "search", "support_px", "expected"),
    [
        ((53, 31), (0, 15), (5, 5), (17, 2, 34, 27)),
        ((53, 31), (-16, 15), (5, 5), (17, 2, 18, 27)),
        ((53, 31), (-32, -17), (7, 7), (3, 3, 15, 25)),
        ((53, 31), (0, 15), (9, 7), (19, 3, 30, 25)),
        ((20, 31), (0, 63), (15, 15), (20, 7, 0, 17)),  # the search leaves nothing
    ],
)
def test_valid_window(
    size: tuple[int, int], search: tuple[int, int], support_px: tuple[int, int], expected: tuple[int, int, int, int]
) -> None:
    """Closed form: x - d_max - margin >= 0 and x - d_min + margin < width, and the window inside the left image."""
    assert valid_window(*size, *search, support_px) == expected
