# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stripe extraction against lines of known place: accuracy, standard deviation, directions, colors, bad lines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from light_stripe_images import stripe_image

from stereo_depth_ros.active.light_stripe.extraction import StripeExtractor
from stereo_depth_ros.active.light_stripe.profile import StripeProfile, StripeReason
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F64, U8, Frame


def extracted(pixels: U8, encoding: str = "mono8", ambient: U8 | None = None, **settings: Any) -> StripeProfile:
    before = None if ambient is None else Frame(ambient, 0, "", encoding)
    return StripeExtractor(LightStripeConfig(**settings), before).extract(Frame(pixels, 0, "", encoding))


def curve(y: F64) -> F64:
    return np.asarray(70.3 + 0.3 * y + 4 * np.sin(y / 25))


def straight(y: F64) -> F64:
    return np.asarray(60.3 + 0.37 * y)


@pytest.mark.parametrize("sigma_px", [1.2, 2.0])
@pytest.mark.parametrize(("method", "limit"), [("ridge", 1.5), ("center", 1.6)])
def test_errors_are_those_of_the_stated_standard_deviation(method: str, limit: float, sigma_px: float) -> None:
    profile = extracted(stripe_image(straight, sigma_px), stripe_method=method)
    error = profile.position_px - straight(np.arange(120.0))
    assert profile.reasons.tolist() == [0] * 120
    assert float(np.abs(error.mean())) < 0.01
    relative = float(np.sqrt(np.square(error / profile.sigma_px).mean()))
    assert 0.6 < relative < limit
    assert np.median(profile.width_px) == pytest.approx(2.355 * sigma_px, rel=0.08)
    assert np.median(profile.level) == pytest.approx(178, abs=5)


def test_ridge_is_more_exact_than_the_center_of_mass() -> None:
    image = stripe_image(curve, noise=6.0)
    truth = curve(np.arange(120.0))
    errors = {m: float(np.nanstd(extracted(image, stripe_method=m).position_px - truth)) for m in ("ridge", "center")}
    assert errors["ridge"] < 0.6 * errors["center"] < 0.12


def test_without_noise_the_ridge_is_exact_along_steep_lines_to_the_border() -> None:
    def steep(y: F64) -> F64:
        return np.asarray(20.2 + 0.9 * y)

    error = extracted(stripe_image(steep, noise=0.0)).position_px - steep(np.arange(120.0))
    assert float(np.abs(error).max()) < 0.01


def test_horizontal_stripes_are_found_in_columns() -> None:
    image = stripe_image(curve, shape=(160, 200))
    across = extracted(np.ascontiguousarray(image.T), stripe_direction="horizontal")
    along = extracted(image)
    np.testing.assert_array_equal(across.position_px, along.position_px)
    x, y = across.points_px().T
    np.testing.assert_array_equal(np.stack((y, x), axis=1), along.points_px())
    assert (len(across.reasons), across.vertical, along.vertical) == (160, False, True)


def colored(line: U8, ground: U8, color: tuple[float, float, float]) -> U8:
    """A colored line over a gray ground, RGB."""
    light = (line.astype(float) - 30)[..., None] * np.array(color)
    return np.asarray(np.clip(ground[..., None] + light, 0, 255), np.uint8)


@pytest.mark.parametrize(
    ("color", "channel"),
    [((1.0, 0.1, 0.2), "red_excess"), ((0.1, 1.0, 0.3), "green_excess"), ((0.1, 0.2, 1.0), "blue_excess")],
)
def test_a_laser_stands_out_of_white_and_gray_surfaces_in_its_color(
    color: tuple[float, float, float], channel: str
) -> None:
    """The ground has bright and dark squares with stronger contrast than the line."""
    y, x = np.indices((120, 160))
    ground = np.where((x // 12 + y // 15) % 2, 150, 30).astype(np.uint8)
    image = colored(stripe_image(curve, level=90.0, noise=1.0), ground, color)
    truth = curve(np.arange(120.0))
    for encoding, pixels in (("rgb8", image), ("bgr8", np.ascontiguousarray(image[..., ::-1]))):
        found = extracted(pixels, encoding, stripe_channel=channel)
        assert len(found.valid_lines) > 115
        assert float(np.nanmedian(np.abs(found.position_px - truth))) < 0.05
        extractor = StripeExtractor(LightStripeConfig())
        extractor.extract(Frame(pixels, 0, "", encoding))
        assert extractor.channel == channel  # chosen by itself
    gray = extracted(image, "rgb8", stripe_channel="gray").position_px
    assert np.count_nonzero(np.abs(gray - truth) < 1) < 60


def test_the_ambient_image_is_subtracted() -> None:
    y, x = np.indices((120, 160))
    ambient = np.where((x // 12 + y // 15) % 2, 150, 30).astype(np.uint8)
    line = stripe_image(curve, level=60.0, noise=1.0)
    image = np.asarray(np.clip(ambient.astype(int) + line - 30, 0, 255), np.uint8)
    found = extracted(image, ambient=ambient)
    assert len(found.valid_lines) == 120
    assert float(np.nanmedian(np.abs(found.position_px - curve(np.arange(120.0))))) < 0.03
    with pytest.raises(ImageError, match="ambient image is 160x119 mono8, the image is 160x120 mono8"):
        extracted(image, ambient=ambient[:-1])


def test_bad_lines_have_reasons_and_no_places() -> None:
    image = stripe_image(straight)
    image[:20] = np.random.default_rng(1).normal(30, 2, (20, 160)).round().astype(np.uint8)  # no stripe
    image[20:40] = np.maximum(image[20:40], np.roll(image[20:40], 50, axis=1))  # two
    x = np.arange(160.0)
    image[40:60] = np.clip(30 + 5000 * np.exp(-0.5 * np.square((x - 80) / 3)), 0, 255)  # saturated
    image[60:80] = (30 + 150 * np.exp(-0.5 * np.square((x - 80) / 12))).round()  # wide
    reasons = extracted(image).reasons
    for first, reason in enumerate(
        (StripeReason.NO_STRIPE, StripeReason.TWO_STRIPES, StripeReason.SATURATED, StripeReason.WIDE)
    ):
        inside = reasons[20 * first + 7 : 20 * first + 13]
        assert inside.tolist() == [reason] * 6, (reason, inside)
    profile = extracted(image)
    assert np.array_equal(np.isfinite(profile.position_px), profile.reasons == 0)
    assert np.array_equal(np.isfinite(profile.sigma_px), profile.reasons == 0)
    assert profile.reason_counts()["SATURATED"] >= 10


def test_a_channel_that_is_not_saturated_is_enough() -> None:
    x = np.arange(160.0)
    exact = 20 + np.outer(np.exp(-0.5 * np.square((x - 80.3) / 3)), [300, 2000, 100]) + np.zeros((120, 1, 1))
    image = np.clip(np.rint(exact), 0, 255).astype(np.uint8)
    gray, green = (extracted(image, "rgb8", stripe_channel=channel) for channel in ("gray", "green"))
    assert green.reason_counts()["SATURATED"] == 120
    np.testing.assert_allclose(gray.position_px, 80.3, atol=0.1)


def test_short_pieces_are_rejected() -> None:
    image = np.full((120, 160), 30, np.uint8)
    for first, count in ((10, 3), (30, 4), (50, 40)):
        image[first : first + count] = stripe_image(straight, noise=0.0)[first : first + count]
    image[70:73] = np.roll(image[70:73], 30, axis=1)  # a jump, within a longer piece
    reasons = extracted(image, stripe_method="center").reasons
    assert np.flatnonzero(reasons == StripeReason.SPECKLE).tolist() == [10, 11, 12, 70, 71, 72]
    assert np.flatnonzero(reasons == 0).tolist() == [*range(30, 34), *range(50, 70), *range(73, 90)]
    assert not extracted(image, stripe_method="center", min_stripe_length=1).reason_counts()["SPECKLE"]


def test_an_edge_is_not_a_stripe() -> None:
    image = np.full((60, 160), 40, np.uint8)
    image[:, 80:] = 220
    assert extracted(image).reason_counts()["NO_STRIPE"] == 60


def test_a_stripe_along_the_line_is_wide() -> None:
    image = np.ascontiguousarray(stripe_image(lambda y: 60 + 0.1 * y).T)
    assert not len(extracted(image).valid_lines)


def test_the_stripe_is_sought_in_a_range() -> None:
    image = np.maximum(stripe_image(straight), stripe_image(lambda y: straight(y) - 40, level=170))
    assert extracted(image).reason_counts()["TWO_STRIPES"] == 120
    search = np.stack((straight(np.arange(120.0)) - 20, straight(np.arange(120.0)) + 20), axis=1).astype(np.int32)
    found = StripeExtractor(LightStripeConfig()).extract(Frame(image, 0, ""), search)
    assert float(np.abs(found.position_px - straight(np.arange(120.0))).max()) < 0.1


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (200, 3), (7, 7), (1, 300)])
def test_small_images_give_no_error(shape: tuple[int, int]) -> None:
    for method in ("ridge", "center"):
        profile = extracted(stripe_image(lambda y: 100 + 0 * y, shape=shape), stripe_method=method)
        assert len(profile.reasons) == shape[0]
        assert len(profile.points_px()) == np.count_nonzero(profile.reasons == 0)


def test_unknown_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="stripe_channel = 'cyan' is not one of auto, gray"):
        LightStripeConfig(stripe_channel="cyan")
