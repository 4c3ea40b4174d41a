# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two views of one projector: points and disparities against closed forms and published captures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.active.structured_light.correspondence import correspondences, disparity_from_maps
from stereo_depth_ros.active.structured_light.decoding import decode
from stereo_depth_ros.active.structured_light.patterns import Pattern, PatternSequence
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import Reason
from stereo_depth_ros.geometry.epipolar import homogeneous
from stereo_depth_ros.geometry.fundamental import estimate_fundamental
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.projection import SyntheticScanner

SIZE = (400, 300)
F64 = npt.NDArray[np.float64]


def map_of(column: F64, row: F64 | None = None, sigma_px: float = 0.1) -> ProjectorMap:
    """A map with these coordinates; NaN is in shadow."""
    reasons = np.where(np.isfinite(column), 0, Reason.SHADOW).astype(np.uint8)
    sigma = np.where(reasons == 0, sigma_px, np.nan).astype(np.float32)
    return ProjectorMap(
        SIZE, column.astype(np.float32), None if row is None else row.astype(np.float32), sigma, reasons
    )


def view(H: F64, width: int = 160, height: int = 120) -> ProjectorMap:
    """A camera that sees a plane: ``H`` maps its pixels to those of the projector."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    mapped = np.stack((x, y, np.ones_like(x)), axis=-1) @ H.T
    return map_of(mapped[..., 0] / mapped[..., 2], mapped[..., 1] / mapped[..., 2])


H_LEFT = np.array([[1.31, 0.12, 20.3], [-0.09, 1.4, 11.8], [3e-4, -2e-4, 1.0]])
H_RIGHT = np.array([[1.22, -0.21, 37.1], [0.11, 1.35, 2.2], [-2e-4, 1e-4, 1.0]])


@pytest.mark.parametrize("cell_px", [None, 3, 4])
def test_correspondences_of_a_plane_are_its_homography(cell_px: int | None) -> None:
    left, right = view(H_LEFT), view(H_RIGHT)
    left_px, right_px = correspondences(left, right, cell_px)
    assert len(left_px) > 1500 and left_px.shape == right_px.shape
    mapped = homogeneous(left_px) @ (np.linalg.inv(H_RIGHT) @ H_LEFT).T
    errors = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - right_px, axis=1)
    assert np.median(errors) < 0.005 and errors.max() < 0.05


def test_a_cell_that_is_partly_hidden_has_the_same_point() -> None:
    left, right = view(H_LEFT), view(H_RIGHT)
    hidden = np.zeros(left.reasons.shape, bool)
    hidden[::7] = True  # of every cell of 8 px, some rows in the left view only
    column, row = (np.where(hidden, np.nan, each) for each in (left.column_px, left.row_px))
    left_px, right_px = correspondences(map_of(column, row), right, 8)
    mapped = homogeneous(left_px) @ (np.linalg.inv(H_RIGHT) @ H_LEFT).T
    errors = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - right_px, axis=1)
    assert len(left_px) > 100 and errors.max() < 0.1


def steps(width: int, gain: float, start: float, height: int = 7) -> F64:
    return np.tile(start + gain * np.arange(width, dtype=np.float64), (height, 1))


def test_disparity_of_a_plane_is_exact() -> None:
    left, right = steps(100, 1.7, 40.0), steps(100, 1.6, 61.3)
    found = disparity_from_maps(map_of(left), map_of(right))
    x = np.arange(100)
    expected = x - (left[0] - 61.3) / 1.6
    inside = (x - expected >= 0) & (x - expected <= 99)
    assert np.isfinite(found.disparity_px).all(axis=0).tolist() == inside.tolist()
    assert np.abs(found.disparity_px - expected)[:, inside].max() < 1e-4
    assert (found.reasons[:, ~inside] == Reason.NO_MATCH).all()
    assert found.confidence is not None and found.sigma_px is not None
    assert found.sigma_px[0, 60] == pytest.approx(2**0.5 * 0.1 / 1.6, rel=1e-4)
    assert np.array_equal(np.isfinite(found.sigma_px), found.reasons == 0)
    assert found.confidence[0, 60] == pytest.approx(1 / (1 + 2 * (0.1 / 1.6) ** 2))


def test_shadow_and_occlusion_are_not_bridged() -> None:
    """Right pixels 40 and 41 are of two surfaces: no match for the columns between them."""
    left, right = steps(100, 1.0, 50.0), steps(100, 1.0, 60.0)
    right[:, 41:] += 25.0
    left[2, 10:20] = np.nan
    found = disparity_from_maps(map_of(left), map_of(right))
    between = (left[0] > right[0, 40]) & (left[0] < right[0, 41])
    assert between.sum() == 25 and (found.reasons[:, between] == Reason.NO_MATCH).all()
    assert (found.reasons[2, 10:20] == Reason.SHADOW).all()
    assert np.allclose(found.disparity_px[3, 10:51], 10.0) and np.allclose(found.disparity_px[3, 76:], 35.0)


def test_a_pole_in_front_is_matched_out_of_order() -> None:
    left, right = steps(100, 1.0, 100.0), steps(100, 1.0, 110.0)
    left[:, 60:66] = np.arange(300, 306)
    right[:, 20:26] = np.arange(300, 306)
    found = disparity_from_maps(map_of(left), map_of(right))
    assert np.allclose(found.disparity_px[:, 60:66], 40.0)
    assert np.allclose(found.disparity_px[:, 40:50], 10.0)
    assert (found.reasons[:, 30:36] == Reason.NO_MATCH).all()  # behind the pole of the right view


def test_descending_columns_are_matched() -> None:
    found = disparity_from_maps(map_of(steps(100, -1.3, 250.0)), map_of(steps(100, -1.3, 240.0)))
    assert np.allclose(found.disparity_px[:, 20:80], 10 / 1.3, atol=1e-3)


def test_of_several_places_the_projector_row_decides() -> None:
    left, right = steps(100, 1.0, 100.0), steps(100, 1.0, 110.0)
    right[:, 70:90] = right[:, 20:40]  # the same columns again
    rows = np.full_like(left, 30.0)
    other = rows.copy()
    other[:, 70:90] = 80.0
    alone = disparity_from_maps(map_of(left), map_of(right))
    assert (alone.reasons[:, 32:48] == Reason.UNIQUENESS).all()
    decided = disparity_from_maps(map_of(left, rows), map_of(right, other))
    assert np.allclose(decided.disparity_px[:, 32:48], 10.0)
    none = disparity_from_maps(map_of(left, rows + 9), map_of(right, other))
    assert (none.reasons == Reason.NO_MATCH).all()


def test_a_right_pixel_with_two_left_pixels() -> None:
    left, right = steps(100, 1.0, 100.0), steps(100, 1.0, 110.0)
    left[:, 70:90] = left[:, 20:40]
    found = disparity_from_maps(map_of(left), map_of(right))
    assert (found.reasons[:, 22:38] == Reason.LEFT_RIGHT).all()
    assert (found.reasons[:, 72:88] == Reason.LEFT_RIGHT).all()


def test_scanner_gives_the_disparities_of_the_truth() -> None:
    scanner = SyntheticScanner(240, 180, (384, 288), seed=4)
    rectifier = Rectifier(scanner.rig)
    sequence = PatternSequence.of_kind("gray+phase", (384, 288))
    captures = [scanner.capture(pattern) for pattern in sequence.render()]
    left = decode(sequence, [rectifier.rectify_left(image) for image, _ in captures])
    right = decode(sequence, [rectifier.rectify_right(image) for _, image in captures])
    found, truth = disparity_from_maps(left, right), scanner.truth()
    valid = np.isfinite(found.disparity_px)
    assert np.array_equal(valid, found.reasons == 0)
    errors = np.abs(found.disparity_px - truth.disparity_px)[valid]
    assert np.median(errors) < 0.05 and np.mean(errors < 1) > 0.99
    assert found.sigma_px is not None and 0.4 < 1.4826 * np.median(errors / found.sigma_px[valid]) < 1.5
    visible = truth.lit & ~truth.occluded
    assert np.count_nonzero(valid & visible) > 0.85 * np.count_nonzero(visible)


def test_maps_that_do_not_belong_together() -> None:
    left, right = view(H_LEFT), view(H_RIGHT)
    for function in (correspondences, disparity_from_maps):
        for other in (replace(right, size=(640, 480)), replace(right, column_px=None)):
            with pytest.raises(ImageError) as error:
                function(left, other)
            assert error.value.remedy
    with pytest.raises(ImageError):
        correspondences(replace(left, row_px=None), right)
    with pytest.raises(ImageError):
        disparity_from_maps(left, view(H_RIGHT, 150))
    with pytest.raises(ConfigError):
        correspondences(left, right, 0)


def gray(axis: str, bits: int, offset_px: int = 0) -> list[Pattern]:
    return [
        Pattern("gray", axis, bit, inverse, offset_px=offset_px)
        for bit in range(bits - 1, -1, -1)
        for inverse in (False, True)
    ]


@pytest.mark.real_data
def test_published_plane_gives_one_homography(stereo_data: Path) -> None:
    """A flat screen with stripes down to 1 px, of which a pixel of the cameras sees 6."""
    folder = stereo_data / "structured_light" / "zeng_graycode_plane"
    patterns = [
        Pattern("ambient"),
        Pattern("white"),
        Pattern("black"),
        *gray("columns", 12, 128),
        *gray("rows", 12, 968),
    ]
    sequence = PatternSequence((3840, 2160), tuple(patterns))
    maps = [
        decode(sequence, [cv2.imread(str(folder / f"{number:02d}-{side}.png"), 0)[100:560] for number in range(51)])
        for side in ("left", "right")
    ]
    screen = np.mean([np.mean(each.reasons == 0) for each in maps])
    assert 0.38 < screen < 0.44 and all(np.nanmedian(each.sigma_px) < 1 for each in maps)
    left_px, right_px = correspondences(*maps)
    H, _ = cv2.findHomography(left_px, right_px, cv2.USAC_MAGSAC, 1.0)
    mapped = homogeneous(left_px) @ H.T
    errors = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - right_px, axis=1)
    assert len(errors) >= 25_000 and np.median(errors) < 0.1 and np.mean(errors < 1) > 0.999


@pytest.mark.real_data
def test_published_views_give_one_fundamental_matrix(stereo_data: Path) -> None:
    folder = stereo_data / "active" / "e_graycode_two_views_joep"
    patterns = [Pattern("white"), Pattern("black"), *gray("columns", 10), *gray("rows", 10)]
    sequence = PatternSequence((960, 540), tuple(patterns))
    maps = [
        decode(sequence, [cv2.imread(str(folder / f"view{view}" / f"{number:02d}.jpg"), 0) for number in range(42)])
        for view in (0, 1)
    ]
    left_px, right_px = correspondences(*maps)
    assert len(left_px) >= 110_000
    F = estimate_fundamental(left_px[::20], right_px[::20]).F
    lines = homogeneous(left_px) @ F.T
    distances = np.abs((homogeneous(right_px) * lines).sum(axis=1)) / np.hypot(lines[:, 0], lines[:, 1])
    assert np.mean(distances < 1) > 0.97 and np.median(distances) < 0.15
