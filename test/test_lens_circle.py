# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Image circles of fisheyes: found from the images, coverage and distortion judged within them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rendered_boards import FISHEYE, SIZE, KnownRig, exact_views

from stereo_depth_ros.calibration.board_views import BoardView, placement
from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.lens_circle import LensCircle, LitPixels
from stereo_depth_ros.calibration.stereo_calibration import calibrate
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.stages.rectification import Rectifier

# A wide lens whose distortion saturates right outside of its image circle, as those of circular fisheyes do
D = (-0.05, 0.002, -0.001, 0.0)
WIDE = dataclasses.replace(
    FISHEYE,
    left=np.array([80.0, 81.0, 205.0, 144.0, *D]),
    right=np.array([82.0, 81.0, 192.0, 153.0, *D]),
)
CIRCLES = (LensCircle(206.0, 143.0, 108.0), LensCircle(191.0, 153.5, 107.0))


def distances(circle: LensCircle, size: tuple[int, int] = SIZE) -> F64:
    rows, columns = np.indices(size[::-1])
    return np.asarray(np.hypot(columns - circle.x, rows - circle.y), np.float64)


def images(circle: LensCircle, count: int = 6) -> list[U8]:
    """Noise in the circle, each image lit in another part only, and dark noise outside."""
    random = np.random.default_rng(3)
    made = []
    for number in range(count):
        scene = random.integers(5, 255, SIZE[::-1])
        scene[:, number * SIZE[0] // count : (number + 1) * SIZE[0] // count] //= 30
        dark = random.integers(0, 8, SIZE[::-1])
        made.append(np.where(distances(circle) <= circle.radius, scene, dark).astype(np.uint8))
    return made


def found(shown: list[U8]) -> LensCircle | None:
    pixels = LitPixels()
    for image in shown:
        pixels.add(image)
    return pixels.circle()


@pytest.mark.parametrize(
    "circle", [LensCircle(207.0, 141.0, 120.0), LensCircle(190.0, 160.0, 185.0), LensCircle(150.0, 151.0, 130.0)]
)
def test_the_circle_is_found(circle: LensCircle) -> None:
    """Within the image, cut at two of its edges, and cut at none but beside the middle."""
    at = found(images(circle))
    assert at is not None
    assert (at.x, at.y, at.radius) == pytest.approx((circle.x, circle.y, circle.radius), abs=1.5)


def test_other_dark_corners_are_not_a_circle() -> None:
    rows, columns = np.indices(SIZE[::-1])
    flat = np.full(SIZE[::-1], 120, np.uint8)
    window = np.where((abs(rows - 150) < 90) & (abs(columns - 200) < 150), 200, 3).astype(np.uint8)
    diamond = np.where(abs(rows - 150) + abs(columns - 200) < 140, 200, 3).astype(np.uint8)
    spot = np.where(np.hypot(rows - 150, columns - 200) < 20, 200, 3).astype(np.uint8)
    for image in (flat, window, diamond, spot, 0 * flat):
        assert found([image]) is None
    assert LitPixels().circle() is None


def test_a_board_at_the_edge_of_the_circle_is_at_the_end_of_the_range() -> None:
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    corners = Corners(np.arange(20), np.column_stack([grid, 0 * grid[:, 0]]), 10 * grid + (100, 120))
    circle = LensCircle(200.0, 150.0, 100.0)
    assert placement(corners, SIZE).x == pytest.approx(0.28, abs=0.01)
    place = placement(corners, SIZE, circle)
    assert place.x == pytest.approx(0.0, abs=0.02)
    assert place.y == pytest.approx((135 - 50 - 17.3) / (201 - 34.6), abs=0.01)
    assert place.size == pytest.approx(np.sqrt(1200) / 201, abs=0.01)


def views_in_circles(rig: KnownRig, count: int) -> list[BoardView]:
    """Views whose corners are all within both circles, near their edges too."""
    kept: list[BoardView] = []
    for seed in range(100):
        for view in exact_views(rig, 20, 0.05, seed=seed):
            sides = zip((view.left, view.right), CIRCLES, strict=True)
            if all((np.hypot(*(s.image_px - (c.x, c.y)).T) < c.radius - 2).all() for s, c in sides):
                kept.append(dataclasses.replace(view, name=f"{seed} {view.name}"))
        if len(kept) >= count:
            return kept[:count]
    raise AssertionError(len(kept))


def test_a_circular_fisheye_is_calibrated_with_what_it_can_see() -> None:
    views = views_in_circles(WIDE, 25)
    with pytest.raises(CalibrationError, match="show the board near the edges of the image too"):
        calibrate(views, "equidistant")
    result = calibrate(views, "equidistant", CIRCLES)
    assert result.circles == CIRCLES
    assert result.left.K[0, 0] == pytest.approx(80, abs=0.5)
    assert result.baseline_m == pytest.approx(np.linalg.norm(WIDE.rig[3:]), rel=0.01)
    assert result.epipolar_rms_px < 0.3
    assert not [text for text in result.coverage.missing if "corner" in text]
    # every rectified pixel shows a point within the circle, and the image is used
    rectifier = Rectifier(result.rig)
    for rectify, circle in ((rectifier.rectify_left, CIRCLES[0]), (rectifier.rectify_right, CIRCLES[1])):
        shown = rectify(np.where(distances(circle) <= circle.radius + 1, 200, 0).astype(np.uint8))
        assert shown.min() > 150
    reach_rad = np.arctan(np.hypot(*SIZE) / 2 / result.rig.f_px)
    assert np.degrees(reach_rad) == pytest.approx(60, abs=5)


def test_a_circle_without_views_near_its_edge_is_refused() -> None:
    saturated = dataclasses.replace(
        WIDE, left=np.array([*WIDE.left[:4], -0.3, 0, 0, 0]), right=np.array([*WIDE.right[:4], -0.3, 0, 0, 0])
    )
    views = [view for view in exact_views(saturated, 60, 0.05) if np.ptp(view.left.image_px) < 200][:20]
    with pytest.raises(CalibrationError, match=r"the image circle \(center .*near the edge of the circle too"):
        calibrate(views, "equidistant", CIRCLES)
