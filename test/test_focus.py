# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Depth from focus: measure, peak and alignment against definitions, depth against truth, a real stack."""

from __future__ import annotations

import functools
import itertools
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from focal_stacks import FAR_M, IMAGES, NEAR_M, stack

from stereo_depth_ros.active.focus.breathing import Placement, align_neighbors, place_frames
from stereo_depth_ros.active.focus.measure import (
    image_noise,
    mean_of_noise,
    sigma_of_measure,
    sum_modified_laplacian,
)
from stereo_depth_ros.active.focus.peak import find_peaks
from stereo_depth_ros.active.focus.stack import FocusResult, depth_from_focus
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, ConfigError, ImageError
from stereo_depth_ros.core.types import F32, F64, U8, Frame, Reason
from stereo_depth_ros.datasets.numbered_images import numbered_images, read_plain_frame


@functools.cache
def result() -> FocusResult:
    return depth_from_focus(stack().frames, stack().distances_m)


def test_the_measure_is_that_of_its_definition() -> None:
    image = np.random.default_rng(1).integers(0, 256, (13, 17)).astype(np.uint8)
    found = sum_modified_laplacian(image, 5)
    level = image.astype(float)
    for y, x in ((3, 3), (6, 12), (9, 4)):
        total = 0.0
        for v in range(y - 2, y + 3):
            for u in range(x - 2, x + 3):
                total += abs(2 * level[v, u] - level[v, u - 1] - level[v, u + 1])
                total += abs(2 * level[v, u] - level[v - 1, u] - level[v + 1, u])
        assert found[y, x] == pytest.approx(total / 25, rel=1e-6)


def test_noise_and_its_share_of_the_measure() -> None:
    rng = np.random.default_rng(2)
    ramp = np.linspace(60, 180, 200)[:, None] + np.linspace(0, 40, 300)
    noisy = np.clip(np.rint(ramp + rng.normal(0, 2.5, ramp.shape)), 0, 255).astype(np.uint8)
    assert image_noise(noisy) == pytest.approx(2.5, rel=0.05)
    assert sum_modified_laplacian(noisy, 9).mean() == pytest.approx(mean_of_noise(2.5), rel=0.03)
    assert image_noise(np.zeros((20, 20), np.uint8)) == pytest.approx(1 / math.sqrt(12))
    # at edges of random direction: the spread of the measure of one image under independent noise
    edges = cv2.resize(rng.integers(0, 2, (50, 75)) * 160.0 + 40, (300, 200), interpolation=cv2.INTER_NEAREST)
    images = [np.rint(edges + rng.normal(0, 2.0, edges.shape)).astype(np.uint8) for _ in range(12)]
    spread = np.std([sum_modified_laplacian(image, 9) for image in images], axis=0).mean()
    assert spread == pytest.approx(sigma_of_measure(2.0, 9), rel=0.35)


def peak(values: Any, positions: F64, noise: tuple[float, float] = (0.0, 1e-3)) -> tuple[float, float, int]:
    measure = np.ascontiguousarray(np.asarray(values, np.float32).reshape(-1, 1, 1))
    found, sigma = np.empty((2, 1, 1), np.float32)
    reasons = np.zeros((1, 1), np.uint8)
    find_peaks(0, 1, measure, positions, np.float32(noise[0]), np.float32(noise[1]), found, sigma, reasons)
    return float(found[0, 0]), float(sigma[0, 0]), int(reasons[0, 0])


@pytest.mark.parametrize("turned", [False, True])
def test_the_peak_of_a_gaussian_at_unequal_positions_is_exact(turned: bool) -> None:
    positions = np.array([0.2, 0.5, 1.1, 1.4, 2.6, 3.0])
    positions = positions[::-1].copy() if turned else positions
    values = 40 * np.exp(-((positions - 1.29) ** 2) / (2 * 0.8**2))
    assert peak(values, positions)[0] == pytest.approx(1.29, abs=1e-5)


def test_the_standard_deviation_of_the_peak_is_that_of_noisy_measures() -> None:
    positions, rng = np.array([0.0, 1.0, 2.2, 3.0, 4.0]), np.random.default_rng(4)
    values = 2 + 40 * np.exp(-((positions - 2.0) ** 2) / 2)
    found = [peak(values + rng.normal(0, 0.4, 5), positions, (0.0, 0.4))[0] for _ in range(600)]
    assert np.std(found) == pytest.approx(peak(values, positions, (0.0, 0.4))[1], rel=0.1)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ([3, 3, 4, 3, 3], Reason.TEXTURE),  # within the noise
        ([30, 31, 33, 31, 30], Reason.TEXTURE),  # hardly higher than the rest
        ([40, 30, 20, 10, 9], Reason.RANGE),
        ([9, 10, 20, 30, 40], Reason.RANGE),
        ([10, 40, 15, 30, 10], Reason.UNIQUENESS),
        ([30, 12, 20, 40, 20], Reason.UNIQUENESS),  # rises again at the end
        ([10, 40, 15, 13, 12], Reason.VALID),
    ],
)
def test_what_is_not_a_peak_has_its_reason(values: list[float], reason: Reason) -> None:
    found, sigma, reasons = peak(values, np.arange(5.0), (3.0, 0.3))
    assert reasons == reason
    assert math.isnan(found) == math.isnan(sigma) == bool(reason)


def test_breathing_is_found() -> None:
    made = stack()
    grays = [np.asarray(cv2.cvtColor(frame.pixels, cv2.COLOR_BGR2GRAY), np.uint8) for frame in made.frames]
    reference, placements = place_frames([align_neighbors(a, b) for a, b in itertools.pairwise(grays)])
    assert reference == int(made.scales.argmax()) == IMAGES - 1
    assert made.scales.min() < 0.96
    off_px = [
        abs(p.scale - scale) * 80 + max(map(abs, p.shift_px)) for p, scale in zip(placements, made.scales, strict=True)
    ]
    assert max(off_px) < 0.5  # of 4 px at the border, after eleven steps


def test_scale_shift_and_gain_of_a_pair() -> None:
    first = np.asarray(cv2.cvtColor(stack().frames[6].pixels, cv2.COLOR_BGR2GRAY), np.uint8)
    truth = Placement(1.03, (2.4, -1.7))
    inverse = cv2.invertAffineTransform(truth.matrix(160, 120))
    moved = cv2.warpAffine(first, inverse, (160, 120), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderMode=4)
    second = np.clip(np.rint(0.8 * np.asarray(moved, float) + 7), 0, 255).astype(np.uint8)
    second[20:60, 30:60] = 90  # shown by one image only
    found = align_neighbors(first, second)
    assert found.scale == pytest.approx(1.03, abs=5e-4)
    np.testing.assert_allclose(found.shift_px, truth.shift_px, atol=0.05)
    assert found.gain == pytest.approx(0.8, abs=0.02)


def test_placements_are_with_respect_to_the_largest_magnification() -> None:
    steps = [Placement(1.25, (3.0, -2.0), 0.5), Placement(0.8, (1.0, 4.0), 3.0)]
    reference, (first, second, third) = place_frames(steps)
    assert (reference, second.scale, second.shift_px, second.gain) == (1, 1.0, (0.0, 0.0), 1.0)
    # a point of the first image that the steps move on
    point = np.array([10.0, -6.0])
    moved = 1.25 * point + [3, -2]
    np.testing.assert_allclose(first.scale * moved + first.shift_px, point)
    np.testing.assert_allclose(third.scale * moved + third.shift_px, 0.8 * moved + [1, 4])
    assert (first.gain, third.gain) == (2.0, 3.0)


def test_depth_of_a_rendered_stack() -> None:
    made, found = stack(), result()
    assert found.depth_m is not None and found.sigma_m is not None
    valid = found.reasons == 0
    np.testing.assert_array_equal(valid, np.isfinite(found.depth_m))
    np.testing.assert_array_equal(valid, np.isfinite(found.index))
    np.testing.assert_array_equal(valid, np.isfinite(found.sigma_m))
    window = np.ones((11, 11), np.uint8)
    textured = cv2.erode(made.textured.astype(np.uint8), window) > 0
    plain = cv2.erode((~made.textured).astype(np.uint8), np.ones((23, 23), np.uint8)) > 0
    inside = found.reasons != Reason.BORDER
    assert valid[textured & inside].mean() > 0.9
    assert (found.reasons[plain & inside] == Reason.TEXTURE).all() and (plain & inside).sum() > 150
    off_m = np.abs(found.depth_m - made.depth_m)[valid & textured]
    assert np.median(off_m) < 0.01 * (FAR_M - NEAR_M)
    assert np.percentile(off_m, 95) < 0.05 * (FAR_M - NEAR_M)
    ratio = off_m / found.sigma_m[valid & textured]
    assert 0.4 < np.median(ratio) < 1.2  # 0.67 of normal errors
    expected = np.interp(1 / made.depth_m, 1 / made.distances_m, np.arange(IMAGES))
    assert np.median(np.abs(found.index - expected)[valid & textured]) < 0.1


def test_the_all_in_focus_image_is_sharper_than_any_image() -> None:
    made = stack()

    def sharpness(pixels: U8) -> float:
        gray = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)
        rows = sum_modified_laplacian(gray, 9)[12:-12, 50:-12]
        return float(np.percentile(rows, 10))  # the worst part

    assert result().encoding == "bgr8"
    assert sharpness(result().all_in_focus) > 1.5 * max(sharpness(frame.pixels) for frame in made.frames)


def test_without_distances_the_number_of_the_image_is_found() -> None:
    made = stack()
    found = depth_from_focus(made.frames, align=False)
    assert found.depth_m is None and found.sigma_m is None
    assert [p.scale for p in found.placements] == [1.0] * IMAGES
    middle = (slice(40, 80), slice(50, 110))  # where the breathing is small
    both = np.isfinite(found.index[middle]) & np.isfinite(result().index[middle])
    assert both.mean() > 0.7
    assert np.median(np.abs(found.index - result().index)[middle][both]) < 0.15


def test_the_reversed_stack_gives_the_same_depth() -> None:
    made = stack()
    other = depth_from_focus(made.frames[::-1], made.distances_m[::-1])
    assert other.depth_m is not None and result().depth_m is not None
    assert other.reference == 0
    both = np.isfinite(other.depth_m) & np.isfinite(result().depth_m)
    assert both.mean() > 0.5
    assert np.median(np.abs(other.depth_m - result().depth_m)[both]) < 0.005 * (FAR_M - NEAR_M)


def test_rectified_results_are_those_of_the_raw_pixels() -> None:
    K = np.array([[150.0, 0, 81], [0, 145, 58], [0, 0, 1]])
    P = np.column_stack([K, np.zeros(3)])
    camera = CameraModel(160, 120, "plumb_bob", K, np.array([0.15, 0, 0, 0, 0]), np.identity(3), P)
    moved = result().rectified(camera)
    raw_x, raw_y = cv2.projectPoints(
        np.array([[(130 - 81) / 150, (40 - 58) / 145, 1.0]]), np.zeros(3), np.zeros(3), K, camera.D
    )[0].ravel()
    assert abs(raw_x - 130) + abs(raw_y - 40) > 0.5
    assert moved.reasons[40, 130] == result().reasons[round(raw_y), round(raw_x)]
    for name in ("index", "index_sigma", "depth_m", "sigma_m"):
        values: F32 = getattr(moved, name)
        np.testing.assert_array_equal(values[40, 130], getattr(result(), name)[round(raw_y), round(raw_x)])
        np.testing.assert_array_equal(np.isfinite(values), moved.reasons == 0)
    with pytest.raises(CalibrationError, match="is of 160x120, the images are 159x120"):
        cropped = [Frame(np.ascontiguousarray(f.pixels[:, 1:]), 0, "", "bgr8") for f in stack().frames]
        depth_from_focus(cropped, align=False).rectified(camera)


def flat(height: int = 40, width: int = 60, encoding: str = "mono8") -> Frame:
    return Frame(np.full((height, width) if encoding == "mono8" else (height, width, 3), 90, np.uint8), 0, "", encoding)


@pytest.mark.parametrize(
    ("frames", "arguments", "error", "text"),
    [
        ([flat()], {}, ImageError, "1 image, a focal stack has at least 3"),
        ([flat(), flat(), flat(50)], {}, ImageError, "c: is 60x50 mono8, and a is 60x40 mono8"),
        ([flat(), flat(), flat(encoding="bgr8")], {}, ImageError, "c: is 60x40 bgr8"),
        ([flat()] * 3, {}, ImageError, "a and b have too little texture"),
        ([flat()] * 3, {"window": 8}, ConfigError, "window 8 is not an odd number"),
        ([flat()] * 3, {"window": 1}, ConfigError, "window 1"),
        ([flat()] * 3, {"distances_m": np.array([1.0, 2])}, ConfigError, "distances are not 3"),
        ([flat()] * 3, {"distances_m": np.array([1.0, 3, 2])}, ConfigError, "become nearer, or farther"),
        ([flat()] * 3, {"distances_m": np.array([1.0, 2, -3])}, ConfigError, "become nearer, or farther"),
        ([flat()] * 3, {"distances_m": np.array([1.0, math.nan, 3])}, ConfigError, "become nearer, or farther"),
    ],
)
def test_wrong_stacks(frames: list[Frame], arguments: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        depth_from_focus(frames, names=["a", "b", "c"][: len(frames)], **arguments)


def test_images_of_other_scenes_are_named() -> None:
    other = np.ascontiguousarray(stack().frames[5].pixels[::-1, ::-1])
    frames = [*stack().frames[3:5], Frame(other, 0, "", "bgr8")]
    with pytest.raises(ImageError, match="image 2 and image 3 do not show the same"):
        depth_from_focus(frames)


def test_a_stack_without_texture_has_no_depth() -> None:
    found = depth_from_focus([flat()] * 3, np.array([1.0, 2.0, 3.0]), align=False)
    assert found.valid_fraction == 0
    assert found.reason_counts()["TEXTURE"] + found.reason_counts()["BORDER"] == 40 * 60
    np.testing.assert_array_equal(found.all_in_focus, flat().pixels)


@pytest.mark.real_data
def test_the_sharpest_image_of_a_real_plane_is_linear_in_the_image(stereo_data: Path) -> None:
    """A keyboard that recedes, from far at the top to near at the bottom: 1 / Z of a plane is linear in the pixel."""
    folder = stereo_data / "active" / "f_focal_keyboard"
    if not folder.is_dir():
        pytest.skip("no focal stack")
    frames = []
    for path in numbered_images([folder]):
        half = cv2.resize(read_plain_frame(path).pixels, (640, 360), interpolation=cv2.INTER_AREA)
        frames.append(Frame(np.asarray(half, np.uint8), 0, "", "bgr8"))
    found = depth_from_focus(frames, window=9)
    assert found.valid_fraction > 0.3
    bands = [float(np.nanmedian(band)) for band in np.array_split(found.index[60:300], 8)]
    assert np.all(np.diff(bands) > 0.3), bands
    y, x = np.nonzero(np.isfinite(found.index[60:280, 100:440]))
    index = found.index[60:280, 100:440][y, x]
    A, kept = np.column_stack([x, y, np.ones_like(x)]).astype(float), np.ones(len(x), bool)
    for _ in range(8):
        coefficients = np.linalg.lstsq(A[kept], index[kept], rcond=None)[0]
        off = np.abs(index - A @ coefficients)
        kept = off < 3 * 1.4826 * np.median(off)
    assert np.median(off) < 0.6  # of 15 steps; keys stand above the plane
    assert kept.mean() > 0.9
    # the breathing of this lens is small: affine fits of the first to the last image are misled by the blur
    assert all(0.99 < placement.scale <= 1 for placement in found.placements)
