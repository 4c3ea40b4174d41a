# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Windows in space and time against their definition, under changing light, and of a moving scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F64, U8, MatchResult, Reason
from stereo_depth_ros.matching import create_matcher

HEIGHT, WIDTH = 60, 110
UNCHECKED: dict[str, Any] = {"uniqueness_ratio": 0.0, "speckle_size": 0}
Disparity = Callable[[F64, F64, int], F64]  # of x, y and the number of the pair


def smooth_noise(rng: np.random.Generator, height: int, width: int, sigma: float = 1.2) -> F64:
    """float64 (H, W), standard deviation 40 around 120."""
    noise = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), sigma)
    return 120 + 40 * (noise - noise.mean()) / noise.std()


def light(
    disparity_px: Disparity, pairs: int, *, height: int = HEIGHT, width: int = WIDTH, noise: float = 0.0, seed: int = 3
) -> list[tuple[U8, U8]]:
    """Pairs under a light that changes from pair to pair; the pattern is known between the pixels of the right image.

    Args:
        disparity_px: of the left pixels.
        noise: standard deviation of the gray levels of both cameras.
    """
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(float(width)), np.arange(float(height)))
    found = []
    for number in range(pairs):
        fine = smooth_noise(rng, height, 4 * width + 400, 4.8)  # four samples a pixel along x; 50 px more on each side
        at = [np.float32(4 * (column + 50)) for column in (x - disparity_px(x, y, number), x)]
        images = [cv2.remap(fine, column, np.float32(y), cv2.INTER_CUBIC) for column in at]
        # the cameras differ in gain and offset
        noisy = [
            a * image + b + rng.normal(0, noise, image.shape)
            for image, a, b in zip(images, (1, 0.7), (0, 20), strict=True)
        ]
        found.append(tuple(np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in noisy))
    return found  # type: ignore[return-value]


def matched(pairs: list[tuple[U8, U8]], **fields: Any) -> MatchResult:
    matcher = create_matcher("spacetime", num_disparities=32, **{"temporal_window": len(pairs), **fields})
    return matcher.match(*pairs[-1], earlier=pairs[:-1])


def correlation(left: F64, right: F64) -> float:
    """Zero-mean normalized correlation of two windows, 0 without texture."""
    left, right = left - left.mean(), right - right.mean()
    power = (left**2).sum() * (right**2).sum()
    return float((left * right).sum() / np.sqrt(power)) if power else 0.0


def by_definition(pairs: list[tuple[U8, U8]], half: int, low: int, count: int) -> tuple[F64, F64]:
    """Whole disparity of the highest correlation and the correlation, (H, W), from the definition of the window."""
    left, right = (np.stack([np.pad(pair[side], half, mode="edge") for pair in pairs]).astype(float) for side in (0, 1))
    height, width = pairs[0][0].shape
    best = np.full((2, height, width), -2.0)
    side = 2 * half + 1
    for y in range(height):
        for x in range(width):
            for d in range(low + count - 1, low - 1, -1):
                if 0 <= x - d < width:
                    windows = left[:, y : y + side, x : x + side], right[:, y : y + side, x - d : x - d + side]
                    rho = correlation(*windows)
                    if rho > best[1, y, x] + 1e-4:
                        best[:, y, x] = d, rho
    return best[0], best[1]


@pytest.mark.parametrize(("pairs", "window"), [(1, 5), (3, 3), (8, 1)])
@pytest.mark.parametrize("low", [0, -9])
def test_the_winner_is_that_of_the_definition(pairs: int, window: int, low: int) -> None:
    images = light(lambda x, y, n: 6.3 + low / 2 + 0.02 * x, pairs, height=9, width=48, noise=3.0)
    found = matched(images, min_disparity=low, spacetime_window=window, **UNCHECKED)
    best, rho = by_definition(images, window // 2, low, 32)
    valid = found.reasons == 0
    assert valid.mean() > 0.5
    np.testing.assert_array_equal(np.abs(found.disparity_px - best)[valid] < 1, True)
    np.testing.assert_array_equal(rho[found.reasons == Reason.NO_MATCH] < 0.501, True)
    assert (rho[valid] > 0.499).all()


def test_the_subpixel_part_has_the_highest_correlation_with_a_cubic_image() -> None:
    pairs, half = light(lambda x, y, n: 6.3 + 0.02 * x, 4, height=9, width=48, noise=3.0), 1
    found = matched(pairs, spacetime_window=3, **UNCHECKED)
    left, right = (np.stack([pair[side] for pair in pairs]).astype(float) for side in (0, 1))
    for y in range(2, 7):
        for x in range(20, 40):
            if found.reasons[y, x]:
                continue
            window = left[:, y - half : y + half + 1, x - half : x + half + 1]
            rows = right[:, y - half : y + half + 1]
            steps = found.disparity_px[y, x] + np.arange(-8, 9) / 64
            rho = []
            for disparity_px in steps:
                at = x - disparity_px + np.arange(-half, half + 1)
                whole = np.floor(at + 1e-9).astype(int)
                part = at - whole
                a, b, c, d = (rows[..., whole + i] for i in (-1, 0, 1, 2))
                # as Keys (1981) writes the cubic of Catmull and Rom
                cubic = b + 0.5 * part * (c - a + part * (2 * a - 5 * b + 4 * c - d + part * (3 * (b - c) + d - a)))
                rho.append(correlation(window, cubic))
            assert rho[8] >= max(rho) - 2e-5


def test_results_do_not_depend_on_the_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = light(lambda x, y, n: 6.3 + 0.02 * x, 3, height=200, width=70, noise=3.0)
    found = []
    for cores in (1, 3):
        monkeypatch.setattr(parallel, "core_count", lambda cores=cores: cores)
        found.append(matched(pairs, spacetime_window=7, slanted_windows=True))
    np.testing.assert_array_equal(found[0].disparity_px, found[1].disparity_px)
    np.testing.assert_array_equal(found[0].reasons, found[1].reasons)


def errors_px(result: MatchResult, disparity_px: Disparity, number: int) -> npt.NDArray[np.float64]:
    """Errors of the valid pixels that the right camera sees, away from the border of the image."""
    height, width = result.disparity_px.shape
    x, y = np.meshgrid(np.arange(float(width)), np.arange(float(height)))
    error = np.abs(result.disparity_px - disparity_px(x, y, number))[6:-6, 36:-6]
    return np.asarray(error[np.isfinite(error)])


def test_pixels_alone_are_matched_by_their_gray_levels_over_time() -> None:
    """The longer they are watched the better: 1 x 1 windows of 2, 6 and 24 pairs."""
    surface: Disparity = lambda x, y, n: 12 + 6 * np.sin(x / 17) * np.cos(y / 13)  # noqa: E731
    pairs = light(surface, 24, noise=4.0)
    density, error = [], []
    for count in (2, 6, 24):
        found = matched(pairs[-count:], spacetime_window=1)
        density.append((found.reasons == 0)[6:-6, 36:-6].mean())
        error.append(np.median(errors_px(found, surface, 0)) if density[-1] else np.inf)
    assert density[0] < 0.2 < density[1] < density[2]
    assert density[2] > 0.95
    assert error[2] < 0.6 * error[1]
    # The best that an unbiased estimate reaches: noise over the root of the sum of the squared derivatives.
    noise, slope = np.hypot(4.0, 4.0 / 0.7), 40 / (np.sqrt(2) * 1.2)
    assert error[2] < 1.5 * 0.6745 * noise / (slope * np.sqrt(24))


def test_a_single_pair_is_a_window_in_space_and_gain_and_offset_do_not_matter() -> None:
    surface: Disparity = lambda x, y, n: 12 + 0.03 * x  # noqa: E731
    found = matched(light(surface, 1), spacetime_window=9)
    assert np.median(errors_px(found, surface, 0)) < 0.1
    assert (found.reasons == 0)[6:-6, 36:-6].mean() > 0.98


def test_reasons() -> None:
    pairs = [(left.copy(), right.copy()) for left, right in light(lambda x, y, n: 0 * x + 9, 4)]
    rng = np.random.default_rng(8)
    for left, _ in pairs:
        left[20:40, 40:60] = 77  # never lit
        left[:, 80:95] = rng.integers(0, 255, (HEIGHT, 15))  # seen by the left camera alone
    found = matched(pairs, min_disparity=4, spacetime_window=3, speckle_size=0)
    assert (found.reasons[22:38, 42:58] == Reason.TEXTURE).all()
    assert (found.reasons[:, :4] == Reason.BORDER).all() and not (found.reasons[:, 4:] == Reason.BORDER).any()
    assert (found.reasons[:, 82:93] != 0).mean() > 0.95
    assert found.reason_counts()["NO_MATCH"] > 100
    np.testing.assert_array_equal(found.reasons == 0, np.isfinite(found.disparity_px))
    assert found.confidence is not None and found.confidence[5:15, 50:70].min() > 0.3


def test_images_without_texture_have_no_disparity() -> None:
    gray = np.full((HEIGHT, WIDTH), 90, np.uint8)
    for right in (gray, light(lambda x, y, n: 0 * x, 1)[0][1]):
        assert (matched([(gray, right)] * 2, spacetime_window=3).reasons == Reason.TEXTURE).all()
    lit = light(lambda x, y, n: 0 * x, 1)[0][0]
    assert matched([(lit, gray)] * 2, spacetime_window=3).valid_fraction == 0


def test_windows_whose_sums_overflow_are_refused() -> None:
    create_matcher("spacetime", spacetime_window=127, temporal_window=8)
    with pytest.raises(ConfigError, match=r"129 x 129 pixels in 8 pairs has more than 131072 samples: use a smaller"):
        create_matcher("spacetime", spacetime_window=129, temporal_window=8)
    dark, bright = np.zeros((2, 140, 160), np.uint8)
    bright[:, ::2] = 255  # the largest products
    found = matched([(bright, bright)] * 8, spacetime_window=127, **UNCHECKED)
    assert (found.reasons[dark == 0] & Reason.NO_MATCH == 0).all()


@pytest.mark.parametrize("pairs", [1, 8])
def test_slanted_windows_follow_steep_surfaces(pairs: int) -> None:
    surface: Disparity = lambda x, y, n: 4 + 0.22 * x - 0.15 * (y - 30)  # noqa: E731
    images = light(surface, pairs, noise=2.0)
    flat, slanted = (
        errors_px(matched(images, spacetime_window=9, slanted_windows=on), surface, 0) for on in (False, True)
    )
    assert slanted.size >= 0.98 * flat.size
    assert np.sqrt(np.mean(slanted**2)) < 0.5 * np.sqrt(np.mean(flat**2))
    assert np.median(slanted) < 0.05


def test_slanted_windows_follow_a_moving_scene() -> None:
    """A tilted wall that comes nearer; the disparity is that of the newest pair."""
    scene: Disparity = lambda x, y, n: 8 + 0.05 * x + 0.02 * y + 0.4 * n  # noqa: E731
    images = light(scene, 7, noise=2.0)
    flat, slanted = (
        errors_px(matched(images, spacetime_window=7, slanted_windows=on), scene, 6) for on in (False, True)
    )
    assert np.median(flat) > 0.9  # the disparity in the middle of the seven, 3 x 0.4 px earlier
    assert np.median(slanted) < 0.08
    assert slanted.size >= 0.98 * flat.size


def test_where_no_slant_fits_better_the_disparity_stays() -> None:
    pairs = light(lambda x, y, n: 0 * x + 9, 2)
    unrelated = light(lambda x, y, n: 0 * x + 9, 2, seed=4)
    mixed = [(left, other) for (left, _), (_, other) in zip(pairs, unrelated, strict=True)]
    fields = {"spacetime_window": 3, **UNCHECKED}
    flat, slanted = (matched(mixed, slanted_windows=on, **fields) for on in (False, True))
    np.testing.assert_array_equal(flat.reasons, slanted.reasons)
    valid = flat.reasons == 0
    assert (slanted.disparity_px[valid] >= 0).all() and (slanted.disparity_px[valid] <= 31).all()
    assert np.abs(slanted.disparity_px - flat.disparity_px)[valid].max() < 2 + 2 * 0.5
