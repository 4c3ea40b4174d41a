# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matchers against OpenCV, against a plain numpy block matcher, and against shifts known in advance."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig, replace_checked
from stereo_depth_ros.config.matchers import matcher_number
from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import U8, MatchResult, Reason
from stereo_depth_ros.evaluation.metrics import disparity_errors
from stereo_depth_ros.matching import MATCHERS, create_matcher, matcher_from_config
from stereo_depth_ros.matching.sgm.semi_global_block_matching import penalties


def textured_pair(height: int, width: int, low: int, high: int, seed: int = 0) -> tuple[U8, U8]:
    """Noise on the right that differs by patches of constant disparity in low..high, and one flat patch."""
    rng = np.random.default_rng(seed)
    right = cv2.GaussianBlur(rng.uniform(0, 255, (height, width)).astype(np.float32), (0, 0), 1.2)
    right = cv2.normalize(right, None, 0, 255, cv2.NORM_MINMAX)
    right[height // 3 : height // 2, width // 2 : width * 3 // 4] = 90
    patches = rng.uniform(low, high, (4, 6)).astype(np.float32)
    disparity = cv2.resize(patches, (width, height), interpolation=cv2.INTER_NEAREST)
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    left = cv2.remap(right, x - disparity, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    noisy = left + rng.normal(0, 2, left.shape) * (left != 90)
    return np.clip(noisy, 0, 255).astype(np.uint8), right.astype(np.uint8)


def opencv_bm(config: MatchingConfig) -> cv2.StereoBM:
    bm = cv2.StereoBM.create(config.num_disparities, config.correlation_window_size)
    bm.setPreFilterSize(config.prefilter_size)
    bm.setPreFilterCap(config.prefilter_cap)
    bm.setMinDisparity(config.min_disparity)
    bm.setTextureThreshold(config.texture_threshold)
    bm.setUniquenessRatio(int(config.uniqueness_ratio))
    bm.setSpeckleWindowSize(config.speckle_size)
    bm.setSpeckleRange(config.speckle_range)
    bm.setDisp12MaxDiff(config.disp12_max_diff or -1)
    return bm


def opencv_sgbm(config: MatchingConfig) -> cv2.StereoSGBM:
    return cv2.StereoSGBM.create(
        config.min_disparity,
        config.num_disparities,
        config.correlation_window_size,
        int(config.P1),
        int(config.P2),
        config.disp12_max_diff,
        config.prefilter_cap,
        int(config.uniqueness_ratio),
        config.speckle_size,
        config.speckle_range,
        config.sgbm_mode,
    )


def in_pixels(disparity_x16: Any, config: MatchingConfig) -> np.ndarray:
    """OpenCV's 16-bit disparities as float32 with NaN."""
    return np.where(disparity_x16 == (config.min_disparity - 1) * 16, np.nan, disparity_x16 / 16).astype(np.float32)


def check_result(result: MatchResult, shape: tuple[int, int]) -> None:
    assert result.disparity_px.dtype == np.float32 and result.disparity_px.shape == shape
    assert result.reasons.dtype == np.uint8 and result.reasons.shape == shape
    np.testing.assert_array_equal(result.reasons == 0, np.isfinite(result.disparity_px))
    assert result.step_px == 1 / 16


FIXED = ["bm", "sgbm"]  # disparities in OpenCV's 16-bit integers
DENSE = [name for name in MATCHERS if name not in ("features", "onnx")]


@pytest.fixture(params=[1, 2, 5])
def cores(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(parallel, "core_count", lambda: request.param)
    return int(request.param)


BM_CASES: list[tuple[tuple[int, int], dict[str, Any]]] = [
    ((480, 640), {}),
    ((481, 333), {"num_disparities": 48, "correlation_window_size": 9, "min_disparity": 5}),
    ((333, 301), {"num_disparities": 32, "correlation_window_size": 21, "texture_threshold": 900}),
    ((200, 400), {"num_disparities": 32, "correlation_window_size": 33, "uniqueness_ratio": 5.0}),  # 32-bit in OpenCV
    ((201, 300), {"num_disparities": 80, "correlation_window_size": 7, "prefilter_cap": 63, "speckle_size": 0}),
    ((150, 260), {"num_disparities": 32, "correlation_window_size": 41, "prefilter_cap": 63}),  # 32-bit sums here too
    ((131, 199), {"num_disparities": 32, "uniqueness_ratio": 0.0, "texture_threshold": 0, "speckle_size": 0}),
]


@pytest.mark.parametrize(("shape", "fields"), BM_CASES)
def test_bm_equals_opencv(shape: tuple[int, int], fields: dict[str, Any], cores: int) -> None:
    matcher = create_matcher("bm", **fields)
    config = matcher.config
    left, right = textured_pair(*shape, config.min_disparity, config.max_disparity * 3 // 4)
    result = matcher.match(left, right)
    check_result(result, shape)
    np.testing.assert_array_equal(result.disparity_px, in_pixels(opencv_bm(config).compute(left, right), config))
    assert result.valid_fraction > 0.2


def test_bm_equals_opencv_with_negative_disparities_except_clamped_windows() -> None:
    matcher = create_matcher("bm", num_disparities=32, min_disparity=-12, correlation_window_size=11, speckle_size=0)
    left, right = textured_pair(233, 331, -11, 18)
    result = matcher.match(left, right)
    check_result(result, (233, 331))
    expected = in_pixels(opencv_bm(matcher.config).compute(left, right), matcher.config)
    inside = slice(0, 331 - 12 - 5)
    np.testing.assert_array_equal(result.disparity_px[:, inside], expected[:, inside])
    assert (result.reasons[:, inside.stop :] == Reason.BORDER).all()
    assert (result.disparity_px < -1).any()


@pytest.mark.parametrize("tolerance", [1, 3])
def test_bm_left_right_check_equals_opencv(tolerance: int) -> None:
    matcher = create_matcher("bm", num_disparities=32, disp12_max_diff=tolerance, uniqueness_ratio=0.0, speckle_size=0)
    left, right = textured_pair(201, 403, 0, 28)
    result = matcher.match(left, right)
    check_result(result, (201, 403))
    expected = in_pixels(opencv_bm(matcher.config).compute(left, right), matcher.config)
    # Clamped windows of columns up to 31 + 7 vote in OpenCV; they reach left pixels up to another 31 further.
    np.testing.assert_array_equal(result.disparity_px[:, 70:], expected[:, 70:])
    assert result.reason_counts()["LEFT_RIGHT"] > 500


def plain_bm(left: U8, right: U8, config: MatchingConfig) -> tuple[np.ndarray, np.ndarray]:
    """Whole-pixel disparities and reasons of block matching without a speckle filter, by the definition."""

    def prefilter(image: U8) -> np.ndarray:
        sobel = np.rint(cv2.Sobel(image, cv2.CV_32F, 1, 0, borderType=cv2.BORDER_REFLECT_101)).astype(int)
        cap = config.prefilter_cap
        clipped = np.clip(sobel, -cap, cap)
        clipped[:, [0, -1]] = 0
        return clipped

    half = config.correlation_window_size // 2
    height, width = left.shape
    a, b = prefilter(left), prefilter(right)
    reasons = np.full(left.shape, Reason.BORDER, np.uint8)
    disparity = np.full(left.shape, np.nan)
    for y in range(half, height - half):
        band = slice(y - half, y + half + 1)
        for x in range(max(0, config.max_disparity) + half, width + min(0, config.min_disparity) - half):
            here = a[band, x - half : x + half + 1]
            costs = np.array(
                [
                    np.abs(here - b[band, x - d - half : x - d + half + 1]).sum()
                    for d in range(config.max_disparity, config.min_disparity - 1, -1)
                ]
            )
            best = int(costs.argmin())
            others = np.delete(costs, slice(max(0, best - 1), best + 2))
            if np.abs(here).sum() < config.texture_threshold:
                reasons[y, x] = Reason.TEXTURE
            elif (others <= costs[best] * (1 + config.uniqueness_ratio / 100)).any():
                reasons[y, x] = Reason.UNIQUENESS
            else:
                reasons[y, x] = 0
                disparity[y, x] = config.max_disparity - best
    return disparity, reasons


@pytest.mark.parametrize("min_disparity", [0, -7, 4])
def test_bm_reasons_are_those_of_the_definition(min_disparity: int) -> None:
    config = MatchingConfig(
        stereo_algorithm=0,
        num_disparities=32,
        min_disparity=min_disparity,
        correlation_window_size=7,
        texture_threshold=1000,
        uniqueness_ratio=20.0,
        speckle_size=0,
    )
    left, right = textured_pair(30, 110, min_disparity, min_disparity + 24, seed=3)
    disparity, reasons = plain_bm(left, right, config)
    result = matcher_from_config(config).match(left, right)
    np.testing.assert_array_equal(result.reasons, reasons)
    counts = result.reason_counts()
    assert min(counts["TEXTURE"], counts["UNIQUENESS"], counts["BORDER"]) > 10
    # The sub-pixel fit moves the best whole disparity by half a pixel at most.
    valid = reasons == 0
    assert np.abs(result.disparity_px - disparity)[valid].max() <= 0.5


@pytest.mark.parametrize("mode", [0, 1, 2, 3])
@pytest.mark.parametrize("min_disparity", [0, -9, 6])
def test_sgbm_equals_opencv(mode: int, min_disparity: int) -> None:
    fields = {"min_disparity": min_disparity, "num_disparities": 32, "correlation_window_size": 7, "sgbm_mode": mode}
    checks = {"uniqueness_ratio": 5.0, "speckle_size": 60, "speckle_range": 1}
    matcher = create_matcher("sgbm", **fields, **checks, P1=200, P2=400)
    left, right = textured_pair(121, 167, min_disparity, min_disparity + 30)
    result = matcher.match(left, right)
    check_result(result, (121, 167))
    config = matcher.config
    np.testing.assert_array_equal(result.disparity_px, in_pixels(opencv_sgbm(config).compute(left, right), config))
    counts = result.reason_counts()
    assert min(counts["NO_MATCH"], counts["SPECKLE"], counts["BORDER"]) > 0


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"correlation_window_size": 5}, (200, 800)),
        ({"correlation_window_size": 15}, (1800, 7200)),
        ({"correlation_window_size": 5, "P1": 31.9}, (31, 800)),
        ({"correlation_window_size": 3, "P1": 300.0}, (300, 301)),
        ({"correlation_window_size": 5, "P2": 90.0}, (45, 90)),
        ({"correlation_window_size": 21}, (2602, 5205)),  # 32767 - 441 * 125 / 2, what is left in 16 bits
    ],
)
def test_automatic_penalties_follow_the_window(fields: dict[str, Any], expected: tuple[int, int]) -> None:
    config = MatchingConfig(stereo_algorithm=1, **{"P1": 0.0, "P2": 0.0, **fields})
    assert penalties(config) == expected
    left, right = textured_pair(90, 160, 0, 24)
    found, as_set = (
        create_matcher("sgbm", replace_checked(config, changes)).match(left, right).disparity_px
        for changes in ({}, {"P1": float(expected[0]), "P2": min(float(expected[1]), 4000.0)})
    )
    if expected[1] <= 4000:  # as far as a parameter goes
        np.testing.assert_array_equal(found, as_set)


def test_penalties_that_are_not_set_are_those_of_stereo_image_proc() -> None:
    left, right = textured_pair(90, 160, 0, 24)
    found = create_matcher("sgbm", num_disparities=32).match(left, right).disparity_px
    sgbm = cv2.StereoSGBM.create(0, 32, 15, 200, 400, 0, 31, 15, 100, 4, cv2.STEREO_SGBM_MODE_SGBM)
    np.testing.assert_array_equal(found, in_pixels(sgbm.compute(left, right), MatchingConfig()))


@pytest.mark.parametrize("name", FIXED)
def test_fractions_are_cut_off(name: str) -> None:
    left, right = textured_pair(90, 160, 0, 24)
    found, whole, next_whole = (
        create_matcher(name, num_disparities=32, speckle_size=0, **fields).match(left, right).disparity_px
        for fields in (
            {"uniqueness_ratio": 40.9, "P1": 90.9, "P2": 140.9},
            {"uniqueness_ratio": 40.0, "P1": 90.0, "P2": 140.0},
            {"uniqueness_ratio": 41.0, "P1": 91.0, "P2": 141.0},
        )
    )
    np.testing.assert_array_equal(found, whole)
    assert not np.array_equal(whole, next_whole, equal_nan=True)


@pytest.mark.parametrize("name", DENSE)
@pytest.mark.parametrize("shift", [7, -5])
def test_a_shift_is_found_exactly(name: str, shift: int) -> None:
    rng = np.random.default_rng(5)
    wide = rng.integers(0, 256, (70, 200), dtype=np.uint8)
    left, right = wide[:, 20:150], wide[:, 20 + shift : 150 + shift]  # x_right = x_left - shift, rows with padding
    matcher = create_matcher(name, min_disparity=-16, num_disparities=32, correlation_window_size=9)
    result = matcher.match(left, right)
    found = result.disparity_px[5:-5, 30:-30]
    # The parabola through costs that are not symmetric moves the minimum by one step of 1/16 px or two.
    np.testing.assert_allclose(found, shift, atol=2 / 16)


@pytest.mark.parametrize("name", DENSE)
def test_read_only_images_changing_sizes_and_buffers(name: str) -> None:
    matcher = create_matcher(name, num_disparities=32)
    for shape in ((45, 120), (35, 140), (45, 120)):
        left, right = textured_pair(*shape, 0, 20)
        expected = create_matcher(name, num_disparities=32).match(left, right)
        frozen = np.frombuffer(left.tobytes(), np.uint8).reshape(shape)
        out = np.full(shape, 7, np.float32)
        result = matcher.match(frozen, right, out)
        assert result.disparity_px is out
        np.testing.assert_array_equal(out, expected.disparity_px)
        kept = result.reasons.copy()
        matcher.match(right, left)
        np.testing.assert_array_equal(result.reasons, kept)  # a result stays as it was


def test_matchers_in_several_threads() -> None:
    pairs = [textured_pair(140, 180, 0, 25, seed) for seed in range(4)]
    expected = [create_matcher("bm", num_disparities=32).match(*pair).disparity_px for pair in pairs]

    def work(number: int) -> bool:
        matcher = create_matcher("bm", num_disparities=32)
        results = [matcher.match(*pairs[number]).disparity_px for _ in range(20)]
        return all(np.array_equal(found, expected[number], equal_nan=True) for found in results)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(4)))


def test_create_by_name_number_and_public_name() -> None:
    assert [create_matcher(name).name for name in ("bm", "sgbm", 0, 1)] == ["bm", "sgbm", "bm", "sgbm"]
    numbers = {matcher_number(name): name for name in MATCHERS if name != "onnx"}  # which needs a network
    assert [create_matcher(number).name for number in numbers] == list(numbers.values())
    assert matcher_from_config(MatchingConfig()).name == "sgm"
    config = MatchingConfig(stereo_algorithm=1, speckle_size=7)
    matcher = create_matcher("bm", config, disparity_range=96)
    assert (matcher.config.num_disparities, matcher.config.speckle_size) == (96, 7)
    assert matcher.config.stereo_algorithm == 0
    assert matcher_from_config(config).name == "sgbm"
    assert matcher_from_config(config).config == config


@pytest.mark.parametrize("name", ["sbm", len(MATCHERS), -1, True, 0.0, None])
def test_unknown_matcher(name: Any) -> None:
    with pytest.raises(ConfigError, match=r"unknown matcher .*: known are bm \(0\), sgbm \(1\)"):
        create_matcher(name)


def test_refused_parameters() -> None:
    with pytest.raises(ConfigError, match="unknown parameter 'num_disparity'"):
        create_matcher("bm", num_disparity=64)
    with pytest.raises(ConfigError, match="P2 = 100 is not above P1 = 200"):
        create_matcher("sgbm", P1=200, P2=100)
    with pytest.raises(ConfigError, match=r"uniqueness_ratio = 100 divides by zero in sgbm_mode 2: use 99"):
        create_matcher("sgbm", uniqueness_ratio=100.0, sgbm_mode=2)
    create_matcher("sgbm", uniqueness_ratio=99.6, sgbm_mode=2)


@pytest.mark.parametrize("name", FIXED)
@pytest.mark.parametrize(("low", "count"), [(0, 2064), (-2048, 32), (2032, 32)])
def test_disparities_that_do_not_fit_are_refused(name: str, low: int, count: int) -> None:
    with pytest.raises(ConfigError, match=rf"disparities {low}\.\.{low + count - 1} are searched.*-2047\.\.2047"):
        create_matcher(name, min_disparity=low, num_disparities=count)
    assert create_matcher(name, min_disparity=-2047).config.min_disparity == -2047


@pytest.mark.parametrize(("cap", "largest"), [(31, 21), (63, 17)])
def test_sgbm_windows_that_overflow_are_refused(cap: int, largest: int) -> None:
    create_matcher("sgbm", correlation_window_size=largest, prefilter_cap=cap)
    with pytest.raises(ConfigError, match=rf"correlation_window_size = {largest + 2} overflows.*use {largest} or less"):
        create_matcher("sgbm", correlation_window_size=largest + 2, prefilter_cap=cap)


@pytest.mark.parametrize("name", FIXED)
@pytest.mark.parametrize("min_disparity", [-100, -40, -10, 0, 10])
def test_smallest_image(name: str, min_disparity: int) -> None:
    matcher = create_matcher(name, min_disparity=min_disparity, num_disparities=32, correlation_window_size=9)
    width = 9 + max(0, min_disparity + 31) + max(0, -min_disparity)
    left, right = textured_pair(9, width, min_disparity, min_disparity + 20)
    check_result(matcher.match(left, right), (9, width))
    for small in (np.s_[:, 1:], np.s_[1:, :]):
        with pytest.raises(ImageError, match=rf"needs {width} x 9 px: use a smaller search range or window"):
            matcher.match(left[small], right[small])


@pytest.mark.parametrize("name", [*DENSE, "features"])
def test_wrong_images_are_refused(name: str) -> None:
    matcher = create_matcher(name)
    good = np.zeros((60, 120), np.uint8)
    with pytest.raises(ImageError, match=r"left image is uint16 of shape \(60, 120\).*gray"):
        matcher.match(good.astype(np.uint16), good)  # type: ignore[arg-type]
    with pytest.raises(ImageError, match=r"right image is uint8 of shape \(60, 120, 3\)"):
        matcher.match(good, np.zeros((60, 120, 3), np.uint8))
    with pytest.raises(ImageError, match=r"left image is \(60, 120\), right image is \(60, 121\)"):
        matcher.match(good, np.zeros((60, 121), np.uint8))
    for out in (np.zeros((60, 121), np.float32), np.zeros((60, 120)), np.zeros((60, 240), np.float32)[:, ::2]):
        with pytest.raises(ImageError, match=r"disparity buffer is .*pass such an array or None"):
            matcher.match(good, good, out)  # type: ignore[arg-type]


def real_pair(folder: Path, name: str) -> tuple[U8, U8, np.ndarray]:
    """Left, right, true disparity with NaN where there is none."""
    if name == "motorcycle":
        files = [folder / "middlebury2014/Motorcycle_quarter" / f"motorcycle_{side}.png" for side in ("left", "right")]
        truth = np.load(files[0].parent / "motorcycle_disp.npz")["arr_0"]
    else:
        files = [folder / "eth3d/terrace" / f"im{side}.png" for side in (0, 1)]
        truth = cv2.imread(str(files[0].parent / "disp0.pfm"), cv2.IMREAD_UNCHANGED)
    left, right = (cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files)
    return left, right, np.where(np.isfinite(truth), truth, np.nan).astype(np.float32)


@pytest.mark.real_data
@pytest.mark.parametrize("scene", ["motorcycle", "terrace"])
def test_real_pairs(stereo_data: Path, scene: str) -> None:
    left, right, truth = real_pair(stereo_data, scene)
    fields = {"num_disparities": 80, "correlation_window_size": 9}
    references = {"bm": opencv_bm, "sgbm": opencv_sgbm}
    for name, least_density in (("bm", 0.4), ("sgbm", 0.75)):
        matcher = create_matcher(name, **fields)
        result = matcher.match(left, right)
        check_result(result, truth.shape)
        expected = in_pixels(references[name](matcher.config).compute(left, right), matcher.config)
        np.testing.assert_array_equal(result.disparity_px, expected)
        errors = disparity_errors(result.disparity_px, truth)
        assert errors.median_px < 0.5
        assert errors.density > least_density


@pytest.mark.parametrize(("name", "window"), [("sgm", "7 x 5"), ("features", "15 x 15")])
def test_small_images_name_the_support_of_the_method(name: str, window: str) -> None:
    """Not the parameter of a window that these methods do not have."""
    matcher = create_matcher(name, min_disparity=60, num_disparities=32, correlation_window_size=101)
    with pytest.raises(
        ImageError, match=f"a window of {window} px .*: use a smaller search range, or larger"
    ) as raised:
        matcher.match(*np.zeros((2, 40, 50), np.uint8))
    assert raised.value.settings == ("disparity_range",)
