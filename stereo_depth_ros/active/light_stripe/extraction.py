# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stripe extraction: center of mass or Steger's ridge, in the channels of the laser's color, line by line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.light_stripe.extraction_kernel import SCALE, difference_histogram, extract_lines
from stereo_depth_ros.active.light_stripe.profile import StripeProfile
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, U8, Frame

__all__ = ["CHANNELS", "StripeExtractor"]

# Weights of red, green, blue
CHANNELS: Mapping[str, tuple[float, float, float]] = {
    "gray": (0.299, 0.587, 0.114),
    "red": (1.0, 0.0, 0.0),
    "green": (0.0, 1.0, 0.0),
    "blue": (0.0, 0.0, 1.0),
    "red_excess": (1.0, -1.0, 0.0),
    "green_excess": (-1.0, 1.0, 0.0),
    "blue_excess": (-1.0, 0.0, 1.0),
}
_STEP = 16  # rows between those whose noise is measured
_BINS = 4096
_MEDIAN = 0.6745  # of the absolute value of a normal variable of standard deviation 1
_SECOND_DIFFERENCE = np.sqrt(6.0)  # its standard deviation for a noise of 1
_ROUNDING = 1 / np.sqrt(12.0)  # standard deviation of a rounding to whole gray levels
_RADIUS = 4.0  # of the derivatives, in units of the Gaussian's standard deviation


class StripeExtractor:
    """Finds the stripe in images, with the settings of a config.

    With the channel "auto" the first image decides, and stays decided: of all channels that find the stripe in nearly
    as many lines as the best, the one of least median standard deviation.

    Args:
        config: method, direction, channel, width and contrast of the stripe.
        ambient: image without the stripe, which is subtracted from all images; None for none.

    Attributes:
        vertical: whether the lines are rows.
        channel: the one in use, a name of :data:`CHANNELS`; "auto" before the first image.
    """

    def __init__(self, config: LightStripeConfig, ambient: Frame | None = None) -> None:
        self._config = config
        self._ambient = ambient
        self.vertical = config.stripe_direction == "vertical"
        self.channel = config.stripe_channel

    def extract(self, frame: Frame, search: npt.NDArray[np.int32] | None = None) -> StripeProfile:
        """The stripe in an image.

        Args:
            frame: raw or rectified, gray or color.
            search: int32 (L, 2), first and last pixel, excluded, of each line in which the stripe is sought; None for
                the whole image.

        Raises:
            ImageError: the ambient image has another size or encoding.
        """
        image, ambient = self._lines(frame), np.empty((0, 1), np.uint8)
        if self._ambient is not None:
            _check_alike(self._ambient, frame)
            ambient = self._lines(self._ambient)
        if search is None:
            length = frame.pixels.shape[1 if self.vertical else 0]
            search = np.tile(np.array([0, length], np.int32), (len(image), 1))
        if self.channel == "auto":
            self.channel = self._best_channel(image, ambient, search, frame.encoding)
        profile = self._extract(image, ambient, search, _weights(self.channel, frame.encoding))
        return profile.without_speckles(self._config.min_stripe_length)

    def _best_channel(self, image: U8, ambient: U8, search: npt.NDArray[np.int32], encoding: str) -> str:
        if encoding == "mono8":
            return "gray"
        profiles = {name: self._extract(image, ambient, search, _weights(name, encoding)) for name in CHANNELS}
        counts = {name: len(profile.valid_lines) for name, profile in profiles.items()}
        enough = [name for name in CHANNELS if counts[name] >= 0.95 * max(counts.values())]
        if not max(counts.values()):
            return "gray"
        return min(enough, key=lambda name: float(np.nanmedian(profiles[name].sigma_px)))

    def _extract(
        self, image: U8, ambient: U8, search: npt.NDArray[np.int32], weights: npt.NDArray[np.int32]
    ) -> StripeProfile:
        count = len(image)
        found: list[F32] = [np.empty(count, np.float32) for _ in range(4)]
        reasons = np.empty(count, np.uint8)
        noise = self._noise(image, ambient, weights)
        sigma_px = self._config.stripe_width / (2 * np.sqrt(3.0))  # of a bar of this width (Steger 1998, section 2.2)
        half = max(1, round((self._config.stripe_width - 1) / 2))
        # the mean of a window has a standard deviation of noise / sqrt(size), its contrast twice that variance
        least = max(SCALE * self._config.stripe_contrast, 5.0 * noise * np.sqrt(2.0 / (2 * half + 1)))
        run_bands(
            extract_lines,
            count,
            image,
            ambient,
            weights,
            np.ascontiguousarray(search, np.int32),
            sigma_px,
            max(2, round(_RADIUS * sigma_px)),
            half,
            float(least),
            self._config.second_stripe,
            noise,
            self._config.stripe_method == "ridge",
            *found,
            reasons,
        )
        return StripeProfile(found[0], found[1], found[2], found[3], reasons, self.vertical)

    def _noise(self, image: U8, ambient: U8, weights: npt.NDArray[np.int32]) -> float:
        """Standard deviation of the signal of a pixel, from the median second difference; that of rounding at least."""
        histogram = np.zeros(_BINS, np.int64)
        difference_histogram(image, ambient, weights, _STEP, histogram)
        middle = float(np.searchsorted(np.cumsum(histogram), histogram.sum() / 2)) * SCALE / 4
        rounding = _ROUNDING * float(np.linalg.norm(weights)) * (np.sqrt(2.0) if len(ambient) else 1.0)
        return float(max(middle / (_MEDIAN * float(_SECOND_DIFFERENCE)), rounding))

    def _lines(self, frame: Frame) -> U8:
        """The image with the lines as rows, uint8 (L, C N), the channels of a pixel side by side."""
        pixels = frame.pixels
        if self._config.stripe_direction == "horizontal":
            pixels = np.asarray(cv2.transpose(pixels), np.uint8)
        return pixels.reshape(len(pixels), -1)


def _weights(channel: str, encoding: str) -> npt.NDArray[np.int32]:
    """Weights of the channels of an image, int32 (C,), in units of 1 / SCALE."""
    if encoding == "mono8":
        return np.array([SCALE], np.int32)
    red, green, blue = (round(SCALE * weight) for weight in CHANNELS[channel])
    return np.array([red, green, blue] if encoding == "rgb8" else [blue, green, red], np.int32)


def _check_alike(ambient: Frame, frame: Frame) -> None:
    def kind(of: Frame) -> tuple[Any, ...]:
        return (*of.pixels.shape, of.encoding)

    if kind(ambient) != kind(frame):
        raise ImageError(
            f"the ambient image is {_text(ambient)}, the image is {_text(frame)}",
            subject="ambient image",
            value=kind(ambient),
            limit=kind(frame),
            remedy="take both with one camera and the same settings",
            settings=("ambient",),
        )


def _text(frame: Frame) -> str:
    height, width = frame.pixels.shape[:2]
    return f"{width}x{height} {frame.encoding}"
