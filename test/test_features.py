# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sparse matching on drawn scenes whose disparities are known in closed form, and on real pairs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from test_line_segments import edge_image

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64, U8, MatchResult, Reason
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.features.matcher import FeatureMatcher, FeatureMatches

KINDS = ("sift", "orb", "lines")
HEIGHT, WIDTH = 150, 240


def matcher(feature_type: str, **fields: Any) -> FeatureMatcher:
    return FeatureMatcher(MatchingConfig(**{"num_disparities": 32, "feature_type": feature_type, **fields}))


def blobs(x: F64, y: F64, size: F64, gray: F64, height: int = HEIGHT, width: int = WIDTH) -> U8:
    """Round Gaussian spots of a size and a signed gray value at sub-pixel positions."""
    image = np.full((height, width), 128.0)
    v, u = np.arange(height)[:, None], np.arange(width)
    for at_x, at_y, sigma, peak in zip(x, y, size, gray, strict=True):
        image += peak * np.exp(-((v - at_y) ** 2) / (2 * sigma**2)) * np.exp(-((u - at_x) ** 2) / (2 * sigma**2))
    return np.rint(np.clip(image, 0, 255)).astype(np.uint8)


def spotted_pair(upper_px: float, lower_px: float, seed: int = 4, row_shift: float = 0.0) -> tuple[U8, U8]:
    """Random spots with one disparity in the upper half and another in the lower half of the image."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-40, WIDTH + 40, 900), rng.uniform(0, HEIGHT, 900)
    size, gray = rng.uniform(1.5, 4, 900), rng.uniform(30, 90, 900) * rng.choice([-1, 1], 900)
    disparity = np.where(y < HEIGHT / 2, upper_px, lower_px)
    return blobs(x, y, size, gray), blobs(x - disparity, y + row_shift, size, gray)


def check_result(result: MatchResult, shape: tuple[int, int]) -> None:
    assert result.confidence is not None
    for values, dtype in (
        (result.disparity_px, np.float32),
        (result.reasons, np.uint8),
        (result.confidence, np.float32),
    ):
        assert values.dtype == dtype
        assert values.shape == shape
    np.testing.assert_array_equal(result.reasons == 0, np.isfinite(result.disparity_px))
    assert (result.confidence[result.reasons != 0] == 0).all()
    assert 0 <= result.confidence.min() <= result.confidence.max() <= 1


@pytest.fixture
def opencv_threads() -> Iterator[None]:
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


@pytest.mark.parametrize("kind", ["sift", "orb"])
@pytest.mark.parametrize(("upper_px", "lower_px", "low"), [(11.4, 4.75, 0), (-2.3, 7.6, -6)])
def test_corners_of_a_drawn_scene(kind: str, upper_px: float, lower_px: float, low: int) -> None:
    result = matcher(kind, min_disparity=low).match(*spotted_pair(upper_px, lower_px))
    check_result(result, (HEIGHT, WIDTH))
    # Nothing is there twice, though ORB finds one corner at several scales.
    assert result.reason_counts()["UNIQUENESS"] < 3
    for rows, truth_px in ((slice(0, 65), upper_px), (slice(85, None), lower_px)):
        found = result.disparity_px[rows][result.reasons[rows] == 0]
        assert found.size > 60
        # A fraction of a pixel of the detector; ORB's whole pixels alone would be off by a quarter in the mean.
        assert np.median(np.abs(found - truth_px)) < 0.08
        assert np.mean(np.abs(found - truth_px) < 1) > 0.97


def test_positions_are_those_of_the_spots() -> None:
    """SIFT finds the spots themselves; pixel centers taken wrongly would move all by 0.25 px in x and in y."""
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(np.arange(30, 220, 24), np.arange(25, 130, 22)), axis=-1).reshape(-1, 2)
    xy = grid + rng.uniform(-3, 3, grid.shape)
    size, gray = rng.uniform(2, 5, len(xy)), rng.uniform(50, 110, len(xy)) * rng.choice([-1, 1], len(xy))
    found = matcher("sift").find(*(blobs(xy[:, 0] - d, xy[:, 1], size, gray) for d in (0, 8.3)))
    distance = np.abs(found.left_xy[:, None] - xy).max(axis=2)
    spots = distance.min(axis=1) < 1
    assert np.count_nonzero(spots) > len(xy) // 2
    for points, truth in ((found.left_xy, xy), (found.right_xy, xy - [8.3, 0])):
        error = (points - truth[distance.argmin(axis=1)])[spots]
        assert np.abs(np.median(error, axis=0)).max() < 0.05
    assert len(np.unique(found.left_xy, axis=0)) == len(found)  # a spot has several orientations, but one match


@pytest.mark.parametrize("kind", ["sift", "orb"])
def test_a_corner_is_at_its_pixel_with_its_score(kind: str) -> None:
    pair, features = spotted_pair(9.3, 15.8), matcher(kind)
    result, found = features.match(*pair), features.find(*pair)
    columns, rows = np.rint(found.left_xy).astype(int).T
    assert len(found) > 100
    assert set(zip(*np.nonzero(result.reasons == 0), strict=True)) == set(zip(rows, columns, strict=True))
    assert result.confidence is not None
    for at in set(zip(rows, columns, strict=True)):
        here = found.take((rows == at[0]) & (columns == at[1]))
        best = here.take(here.score == here.score.max())
        assert result.confidence[at] == pytest.approx(best.score[0], abs=1e-6)
        assert np.abs(result.disparity_px[at] - best.disparity_px).min() < 1e-5


@pytest.mark.parametrize("kind", KINDS)
def test_equal_images_match_at_0_with_full_score(kind: str) -> None:
    image = spotted_pair(5, 5)[0]
    found = matcher(kind, min_disparity=-16).find(image, image)
    assert len(found) > 50
    # Lucas and Kanade stop at a hundredth of a pixel.
    np.testing.assert_allclose(found.right_xy, found.left_xy, atol=0.01 if kind == "orb" else 0)
    np.testing.assert_array_equal(found.score, 1)


@pytest.mark.parametrize(("x0", "slope"), [(60.0, 0.5), (105.0, -0.4)])
def test_lines_have_the_disparity_of_each_row(x0: float, slope: float) -> None:
    """Two slants differ between the cameras, as where a line goes into the depth."""
    left = edge_image(90, 170, [(x0, slope, 60, 190)])
    right = edge_image(90, 170, [(x0 - 6, slope - 0.12, 60, 190)])
    result = matcher("lines").match(left, right)
    check_result(result, (90, 170))
    rows, columns = np.nonzero(result.reasons == 0)
    np.testing.assert_array_equal(rows, np.arange(rows[0], rows[0] + len(rows)))  # one pixel a row
    assert len(rows) > 80
    np.testing.assert_allclose(columns, x0 + slope * rows, atol=0.6)
    # Each of the two fits is within 0.06 px.
    np.testing.assert_allclose(result.disparity_px[rows, columns], 6 + 0.12 * rows, atol=0.12)
    found = matcher("lines").find(left, right)
    np.testing.assert_array_equal(found.left_xy[:, 1], rows)
    np.testing.assert_array_equal(found.right_xy[:, 1], rows)
    assert len(np.unique(found.score)) == 1


def test_line_of_opposite_contrast_does_not_match() -> None:
    left, right = edge_image(90, 170, [(80, 0.2, 60, 190)]), edge_image(90, 170, [(70, 0.2, 190, 60)])
    result = matcher("lines").match(left, right)
    assert result.valid_fraction == 0
    assert set(np.unique(result.reasons)) == {Reason.NO_MATCH}


@pytest.mark.parametrize("kind", ["sift", "orb"])
def test_rows_differ_by_a_pixel_at_most_by_default(kind: str) -> None:
    pair = spotted_pair(12, 6, row_shift=3.0)
    features = matcher(kind)
    assert len(features.find(*pair)) < 15
    found = features.find(*pair, max_row_difference_px=4.0)
    rows_px = (found.left_xy - found.right_xy)[:, 1]
    assert len(found) > 100
    assert np.median(rows_px) == pytest.approx(-3, abs=0.05)
    assert np.abs(rows_px).max() <= 4
    default = features.find(*spotted_pair(12, 6, row_shift=0.8))
    assert len(default) > 50
    assert np.abs(default.left_xy - default.right_xy)[:, 1].max() <= 1


@pytest.mark.parametrize("kind", KINDS)
def test_disparities_are_those_searched(kind: str) -> None:
    pair = spotted_pair(40, 40)
    assert matcher(kind, min_disparity=20).match(*pair).valid_fraction > 0.002
    for low in (0, 41, -60):
        result = matcher(kind, min_disparity=low).match(*pair)
        valid = result.disparity_px[result.reasons == 0]
        assert ((valid >= low) & (valid <= low + 31)).all()
        assert valid.size < 0.002 * result.disparity_px.size


def things(kind: str, *columns: int) -> U8:
    """The same small thing at several columns: a bar, which has two lines, or a spot, for corners."""
    if kind != "lines":
        ones = np.ones(len(columns))
        return blobs(np.array(columns) + 0.3, 45.2 * ones, 1.5 * ones, 110 * ones, 90, 170)
    image = np.full((90, 170), 60, np.uint8)
    for x in columns:
        image[20:71, x : x + 9] = 200
    return image


@pytest.mark.parametrize("kind", ["sift", "lines"])
def test_repeated_features_are_not_unique(kind: str) -> None:
    left, right = things(kind, 100), things(kind, 96, 70)
    result = matcher(kind).match(left, right)
    assert result.valid_fraction == 0
    assert result.reason_counts()["UNIQUENESS"] > 0
    unchecked = matcher(kind, uniqueness_ratio=0.0).match(left, right)
    valid = unchecked.reasons == 0
    assert valid.any()
    assert (np.abs(unchecked.disparity_px[valid, None] - [4, 30]).min(axis=1) < 0.1).all()
    assert unchecked.confidence is not None
    assert unchecked.confidence.max() < 0.15  # the other one is as good


@pytest.mark.parametrize("kind", ["sift", "lines"])
def test_a_right_feature_has_one_left_feature(kind: str) -> None:
    left, right = things(kind, 100, 70), things(kind, 69)
    result = matcher(kind).match(left, right)
    assert result.reason_counts()["LEFT_RIGHT"] > 0
    found = matcher(kind).find(left, right)
    assert len(found) > 0
    assert len(np.unique(found.right_xy, axis=0)) == len(found)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("low", "columns"), [(9, range(9)), (-41, range(WIDTH - 10, WIDTH)), (-5, range(0))])
def test_columns_without_a_searched_disparity_are_border(kind: str, low: int, columns: range) -> None:
    result = matcher(kind, min_disparity=low).match(*spotted_pair(low + 10, low + 20))
    border = np.isin(np.arange(WIDTH), columns)
    np.testing.assert_array_equal((result.reasons & Reason.BORDER != 0).all(axis=0), border)
    assert not (result.reasons[:, ~border] & Reason.BORDER).any()


@pytest.mark.parametrize("kind", KINDS)
def test_same_input_same_bytes_in_any_memory(kind: str, opencv_threads: None) -> None:
    left, right = spotted_pair(7.5, 13.25)
    expected = matcher(kind).match(left, right)
    cv2.setNumThreads(1)
    wide = np.zeros((HEIGHT, WIDTH + 9), np.uint8)
    wide[:, 5:-4] = left
    frozen = np.frombuffer(right.tobytes(), np.uint8).reshape(right.shape)
    out = np.full(left.shape, 7, np.float32)
    result = matcher(kind).match(wide[:, 5:-4], frozen, out)
    assert result.disparity_px is out
    for name in ("disparity_px", "reasons", "confidence"):
        assert getattr(result, name).tobytes() == getattr(expected, name).tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_flat_images_have_no_features(kind: str) -> None:
    textured, flat = spotted_pair(8, 8)[0], np.full((HEIGHT, WIDTH), 128, np.uint8)
    for pair in ((flat, flat), (flat, textured), (textured, flat)):
        result = matcher(kind).match(*pair)
        check_result(result, (HEIGHT, WIDTH))
        assert result.valid_fraction == 0
        found = matcher(kind).find(*pair)
        assert (found.left_xy.shape, found.right_xy.shape, found.disparity_px.shape) == ((0, 2), (0, 2), (0,))


def some_matches() -> FeatureMatches:
    left = np.array([[40.5, 20.25], [70.0, 31.0], [10.0, 5.0]])
    return FeatureMatches(left, left - [[20.5, 0.25], [6.0, -0.5], [2.0, 0.0]], np.array([0.9, 0.2, 0.5]))


def test_points_are_triangulated() -> None:
    triangulation = Triangulation(f_px=400.0, fy_px=500.0, cx_px=60.0, cy_px=25.0, baseline_m=0.1, doffs_px=4.0)
    z = np.array([40 / 16.5, 40 / 2.0])
    expected = np.stack((np.array([-19.5, 10]) / 400 * z, np.array([-4.75, 6]) / 500 * z, z), axis=1)
    points = some_matches().points_m(triangulation)
    np.testing.assert_allclose(points[:2], expected, rtol=1e-12)
    assert np.isnan(points[2]).all()  # disparity 2 is behind infinity


def test_matches_inside_masks() -> None:
    matches = some_matches()
    everywhere = np.ones((40, 80), np.uint8)
    left_mask, right_mask = everywhere.copy(), everywhere.copy()
    left_mask[20, 40] = 0
    right_mask[5, 8] = 0
    assert len(matches.inside(everywhere, everywhere)) == 3
    np.testing.assert_array_equal(matches.inside(left_mask, everywhere).score, [0.2, 0.5])
    np.testing.assert_array_equal(matches.inside(everywhere, right_mask).score, [0.9, 0.2])


def test_created_by_name() -> None:
    made = create_matcher("features", feature_type="orb", disparity_range=48)
    assert (made.name, made.step_px, made.config.feature_type) == ("features", 1 / 16, "orb")
    assert isinstance(made, FeatureMatcher)


def test_refused_parameters() -> None:
    with pytest.raises(ConfigError, match="parameter feature_type = 'surf' is not one of sift, orb, lines: use one"):
        matcher("surf")
    with pytest.raises(ConfigError, match=r"disparities 2032\.\.2063 are searched.*use a smaller search range"):
        matcher("sift", min_disparity=2032)


def test_refused_images() -> None:
    good, features = np.zeros((60, 120), np.uint8), matcher("sift")
    for call in (features.match, features.find):
        with pytest.raises(ImageError, match=r"right image is uint8 of shape \(60, 120, 3\).*convert it to gray"):
            call(good, np.zeros((60, 120, 3), np.uint8))
        with pytest.raises(ImageError, match=r"left image is \(60, 120\), right image is \(60, 121\)"):
            call(good, np.zeros((60, 121), np.uint8))
    with pytest.raises(ImageError, match=r"disparity buffer is float64 of shape \(60, 120\)"):
        features.match(good, good, np.zeros((60, 120)))  # type: ignore[arg-type]


def real_pair(folder: Path, scene: str) -> tuple[U8, U8, np.ndarray]:
    """Left, right, and the true disparity, NaN where there is none."""
    if scene == "terrace":
        files = [folder / "eth3d/terrace" / name for name in ("im0.png", "im1.png", "disp0.pfm")]
    else:
        files = [folder / "middlebury2003/cones" / name for name in ("im2.png", "im6.png", "disp2.pgm")]
    left, right = (cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files[:2])
    truth = cv2.imread(str(files[2]), cv2.IMREAD_UNCHANGED).astype(np.float32)
    if scene == "cones":
        truth = truth / 4
    return left, right, np.where(np.isfinite(truth) & (truth > 0), truth, np.nan)


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("scene", "kind", "least", "wrong"),
    [
        ("terrace", "sift", 350, 0.015),
        ("terrace", "orb", 1400, 0.015),
        ("terrace", "lines", 3000, 0.01),
        ("cones", "sift", 350, 0.005),
        ("cones", "orb", 700, 0.01),
        ("cones", "lines", 2500, 0.01),
    ],
)
def test_real_pairs(stereo_data: Path, scene: str, kind: str, least: int, wrong: float) -> None:
    left, right, truth = real_pair(stereo_data, scene)
    result = matcher(kind, num_disparities=80).match(left, right)
    check_result(result, truth.shape)
    valid = result.reasons == 0
    assert np.count_nonzero(valid) > least
    beside = [np.roll(truth, shift, axis=1) for shift in (-1, 0, 1)]  # the truth of a line is on one side of it
    errors = np.stack([np.abs(side - result.disparity_px)[valid] for side in (beside if kind == "lines" else [truth])])
    error = np.nanmin(errors[:, np.isfinite(errors).any(axis=0)], axis=0)
    assert np.median(error) < 0.25
    assert np.mean(error > 2) < wrong
    assert kind == "lines" or np.mean(error) < 0.25
    assert result.confidence is not None
    known = np.isfinite(errors).any(axis=0)
    trusted = result.confidence[valid][known] > np.median(result.confidence[valid][known])
    assert np.mean(error[trusted]) < np.mean(error[~trusted])
