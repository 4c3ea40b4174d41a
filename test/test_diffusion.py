# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diffusion against its equations in plain numpy, known shifts, and Tsukuba and Venus."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from middlebury2001 import bad, matched, scene

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F64, U8, MatchResult, Reason
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.global_methods import diffusion
from stereo_depth_ros.matching.global_methods.diffusion import DiffusionMatcher

UNCHECKED: dict[str, Any] = {
    "num_disparities": 32,
    "uniqueness_ratio": 0.0,
    "speckle_size": 0,
    "correlation_window_size": 1,
}
MODELS = ("bayesian", "membrane")


def noisy_pair(height: int, width: int, shift: int, seed: int = 1) -> tuple[U8, U8]:
    rng = np.random.default_rng(seed)
    right = rng.integers(0, 240, (height, width)).astype(np.uint8)
    left = np.roll(right, shift, 1) + rng.integers(0, 12, right.shape)
    return left.astype(np.uint8), right


def check_result(result: MatchResult, shape: tuple[int, int]) -> None:
    assert result.disparity_px.dtype == np.float32 and result.disparity_px.shape == shape
    assert result.reasons.dtype == np.uint8 and result.reasons.shape == shape
    np.testing.assert_array_equal(result.reasons == 0, np.isfinite(result.disparity_px))
    assert result.confidence is not None and result.confidence.dtype == np.float32
    assert (result.confidence >= 0).all() and (result.confidence <= 1).all()
    assert (result.confidence[result.reasons != 0] == 0).all()


def plain_data(left: U8, right: U8, low: int, count: int) -> F64:
    """E0 (H, W, D), disparities ascending, inf outside the right image."""
    height, width = left.shape
    data = np.full((height, width, count), np.inf)
    for index in range(count):
        d = low + index
        seen = slice(max(0, d), width + min(0, d))
        difference = left[:, seen].astype(float) - right[:, max(0, -d) : width - max(0, d)]
        gaussian = np.exp(-(difference**2) / (2 * diffusion.NOISE_SIGMA**2))
        data[:, seen, index] = -np.log((1 - diffusion.NOISE_OUTLIERS) * gaussian + diffusion.NOISE_OUTLIERS)
    return data


def four_neighbors(values: F64) -> list[F64]:
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return [padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]]


def plain_bayesian(data: F64, iterations: int) -> F64:
    beside = np.exp(-1 / (2 * diffusion.STEP_SIGMA_PX**2))
    heard = np.zeros_like(data)
    energies = data.copy()
    for _ in range(iterations):
        p = np.exp(-(energies - energies.min(axis=2, keepdims=True)))
        p /= p.sum(axis=2, keepdims=True)
        wide = np.pad(p, ((0, 0), (0, 0), (1, 1)))
        smooth = (wide[:, :, 1:-1] + beside * (wide[:, :, :-2] + wide[:, :, 2:])) / (1 + 2 * beside)
        heard = -np.log((1 - diffusion.STEP_OUTLIERS) * smooth + diffusion.STEP_OUTLIERS)
        energies = data + diffusion.NEIGHBOR_WEIGHT * np.sum(four_neighbors(heard), axis=0)
    return energies


def plain_membrane(data: F64, iterations: int) -> F64:
    energies = data.copy()
    seen = np.isfinite(data)
    for _ in range(iterations):
        here = np.where(seen, energies, 0)
        flow = diffusion.HOLD_RATE * (np.where(seen, data, 0) - here)
        for near, near_seen in zip(four_neighbors(here), four_neighbors(seen.astype(float)), strict=True):
            flow += diffusion.DIFFUSION_RATE * np.where(near_seen > 0, near - here, 0)
        energies = np.where(seen, here + flow, np.inf)
    return energies


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("low", [0, -11])
def test_energies_are_those_of_the_equations(model: str, low: int, monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = noisy_pair(13, 58, low + 9)
    left[4:9, 20:40] = 120
    found: list[F64] = []
    select = diffusion._select_rows

    def keep(first: int, last: int, energies: F64, *rest: Any) -> None:
        found.append(energies.copy())
        select(first, last, energies, *rest)

    monkeypatch.setattr(diffusion, "_select_rows", keep)
    config = MatchingConfig(min_disparity=low, iterations=7, diffusion_model=model, **UNCHECKED)
    result = DiffusionMatcher(config).match(left, right)
    plain = {"bayesian": plain_bayesian, "membrane": plain_membrane}[model]
    expected = plain(plain_data(left, right, low, 32), 7)
    # float32 over seven iterations
    np.testing.assert_allclose(found[0][:, :, ::-1], expected, rtol=1e-4, atol=1e-4)
    winners = expected.argmin(axis=2) + low
    second = np.sort(expected, axis=2)[:, :, 1]
    clear = second > expected.min(axis=2) + 1e-2
    assert clear.mean() > 0.5
    assert np.abs(result.disparity_px - winners)[clear].max() <= 0.5


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("low", "shift"), [(0, 13), (5, 21), (-40, -17)])
def test_known_shift_and_border(model: str, low: int, shift: int) -> None:
    left, right = noisy_pair(31, 97, shift)
    config = MatchingConfig(min_disparity=low, diffusion_model=model, **UNCHECKED)
    result = DiffusionMatcher(config).match(left, right)
    check_result(result, left.shape)
    border = np.zeros(left.shape, np.bool_)
    border[:, : max(0, low)] = True
    border[:, 97 + min(0, low + 31) :] = True
    np.testing.assert_array_equal(result.reasons, np.where(border, Reason.BORDER, 0))
    seen = np.s_[:, shift + 8 :] if shift > 0 else np.s_[:, : shift - 8]
    np.testing.assert_allclose(result.disparity_px[seen], shift, atol=0.5)


def test_bayesian_fills_a_flat_patch_and_keeps_a_step_sharp() -> None:
    rng = np.random.default_rng(8)
    right = rng.integers(0, 240, (60, 140)).astype(np.uint8)
    left = np.roll(right, 6, 1)
    left[20:40, 60:100] = right[20:40, 45:85]  # 15 px
    left[27:33, 76:84] = right[27:33, 61:69] = 128
    result = create_matcher("diffusion", **UNCHECKED).match(left, right)
    np.testing.assert_allclose(result.disparity_px[20:40, 61:99], 15, atol=0.5)
    np.testing.assert_allclose(result.disparity_px[:18, 40:], 6, atol=0.5)
    np.testing.assert_allclose(result.disparity_px[20:40, 102:], 6, atol=0.5)


def test_checks_mark_occlusions() -> None:
    rng = np.random.default_rng(9)
    right = rng.integers(0, 240, (60, 140)).astype(np.uint8)
    left = np.roll(right, 6, 1)
    left[20:40, 60:100] = right[20:40, 45:85]
    left[20:40, 51:60] = rng.integers(0, 240, (20, 9))
    result = create_matcher("diffusion", **{**UNCHECKED, "disp12_max_diff": 1}).match(left, right)
    assert (result.reasons[22:38, 52:60] == Reason.LEFT_RIGHT).mean() > 0.9
    assert (result.reasons[:18, 40:] == 0).all()
    check_result(result, left.shape)


def test_same_bytes_on_any_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = noisy_pair(200, 70, 7)
    found = []
    for cores in (1, 3):
        monkeypatch.setattr(parallel, "core_count", lambda cores=cores: cores)
        result = create_matcher("diffusion", num_disparities=32, iterations=3).match(left, right)
        assert result.confidence is not None
        found.append(result.disparity_px.tobytes() + result.reasons.tobytes() + result.confidence.tobytes())
    assert found[0] == found[1]


def test_refused() -> None:
    with pytest.raises(ConfigError, match=r"disparities 2040\.\.2103 are searched"):
        create_matcher("diffusion", min_disparity=2040)
    with pytest.raises(ImageError, match="needs 32 x 1 px"):
        create_matcher("diffusion", **UNCHECKED).match(*noisy_pair(9, 31, 3))
    out = np.empty((9, 40), np.float32)
    assert create_matcher("diffusion", **UNCHECKED).match(*noisy_pair(9, 40, 3), out).disparity_px is out


def test_smooth_photometric_differences_do_not_matter() -> None:
    left, right = noisy_pair(60, 150, 7)
    left, right = (cv2.GaussianBlur(image, (0, 0), 1.5) for image in (left, right))  # contrasts below the noise's sigma
    brighter = np.clip(left + np.linspace(6, 14, 150), 0, 255).astype(np.uint8)
    fields = {**UNCHECKED, "correlation_window_size": 9}
    result = create_matcher("diffusion", **fields).match(brighter, right)
    np.testing.assert_allclose(result.disparity_px[:, 15:-15], 7, atol=0.5)


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "bayesian", "membrane"), [("tsukuba", 4.2, 7.5), ("venus", 2.8, 5.2)])
def test_real_scenes(stereo_data: Path, name: str, bayesian: float, membrane: float) -> None:
    of = scene(name, stereo_data)
    limits = {"bayesian": bayesian, "membrane": membrane}
    for model, limit in limits.items():
        result = matched("diffusion", name, stereo_data, diffusion_model=model).result
        assert result.valid_fraction == 1
        assert bad(result.disparity_px, of) <= limit
    for side in (3, 21):
        window = matched("window", name, stereo_data, correlation_window_size=side).result
        assert window.valid_fraction == 1
        assert bayesian < bad(window.disparity_px, of)
