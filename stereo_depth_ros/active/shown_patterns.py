# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a projector shows during a scan: a sequence of patterns, or color stripes; read from their files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from stereo_depth_ros.active.one_shot.decoding import one_shot
from stereo_depth_ros.active.one_shot.stripes import StripePattern, read_stripes
from stereo_depth_ros.active.structured_light.decoding import check_sequence, decode
from stereo_depth_ros.active.structured_light.manifest import read_manifest
from stereo_depth_ros.active.structured_light.order import sequence_fault
from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import U8, Frame
from stereo_depth_ros.datasets.image_files import IMAGE_SUFFIXES, read_image
from stereo_depth_ros.stages.rectification import gray_of_camera

__all__ = ["ShownPatterns", "ShownSequence", "ShownStripes", "pattern_images", "read_patterns"]


class ShownPatterns(Protocol):
    """The patterns of a scan.

    Attributes:
        best: number of the capture, from 0, that shows the scene best.
    """

    best: int

    def __len__(self) -> int:
        """Number of patterns."""

    def name(self, number: int) -> str:
        """What a pattern is, by its number from 0."""

    def images(self, frames: Sequence[Frame]) -> list[U8]:
        """Of the frames of one camera, what is rectified and decoded: uint8 (H, W), or (H, W, 3) RGB."""

    def decode(self, images: Sequence[U8]) -> ProjectorMap:
        """The projector pixel that each pixel of the images sees, one image for each pattern."""

    def fault(self, frames: Sequence[Frame]) -> str:
        """Why the frames of one camera are not captures of the patterns; empty where nothing speaks against it."""


class ShownSequence:
    """A sequence of Gray code or phase patterns.

    Raises:
        ConfigError: it cannot be decoded.
    """

    def __init__(self, sequence: PatternSequence) -> None:
        check_sequence(sequence)
        self.sequence = sequence
        self.best = sequence.index("white") or 0

    def __len__(self) -> int:
        return len(self.sequence)

    def name(self, number: int) -> str:
        """See :class:`ShownPatterns`."""
        return str(self.sequence.patterns[number])

    def images(self, frames: Sequence[Frame]) -> list[U8]:
        """See :class:`ShownPatterns`; images of 16 bits have one scale, that of the depth of all of them."""
        grays, depth = [gray_of_camera(frame) for frame in frames], BitDepth()
        depth.include(*grays)
        return [depth.to_8_bit(gray) for gray in grays]

    def decode(self, images: Sequence[U8]) -> ProjectorMap:
        """See :class:`ShownPatterns`."""
        return decode(self.sequence, images)

    def fault(self, frames: Sequence[Frame]) -> str:
        """See :class:`ShownPatterns`."""
        return sequence_fault(self.sequence, self.images(frames))


class ShownStripes:
    """One pattern of color stripes: every capture is a scan."""

    best = 0

    def __init__(self, pattern: StripePattern) -> None:
        self.pattern = pattern

    def __len__(self) -> int:
        return 1

    def name(self, number: int) -> str:
        """See :class:`ShownPatterns`."""
        return "color stripes"

    def images(self, frames: Sequence[Frame]) -> list[U8]:
        """See :class:`ShownPatterns`.

        Raises:
            ImageError: a frame has no colors.
        """
        return [self._rgb(frame) for frame in frames]

    def _rgb(self, frame: Frame) -> U8:
        if frame.encoding == "mono8":
            raise ImageError(
                "the image is gray, color stripes need colors",
                subject="image of color stripes",
                value=frame.encoding,
                limit=("rgb8", "bgr8"),
                remedy="use a color camera, or a sequence of gray patterns",
            )
        return (
            frame.pixels
            if frame.encoding == "rgb8"
            else np.asarray(cv2.cvtColor(frame.pixels, cv2.COLOR_BGR2RGB), np.uint8)
        )

    def decode(self, images: Sequence[U8]) -> ProjectorMap:
        """See :class:`ShownPatterns`."""
        return one_shot(images[0], self.pattern)

    def fault(self, frames: Sequence[Frame]) -> str:
        """See :class:`ShownPatterns`."""
        return ""


def read_patterns(path: Path) -> ShownPatterns:
    """The patterns of a manifest patterns.json, or the color stripes of an image file.

    Raises:
        BagError: a file that cannot be read.
        ConfigError: not a sequence that can be decoded.
        ImageError: an image without color stripes.
    """
    if path.suffix.lower() not in IMAGE_SUFFIXES:
        sequence = read_manifest(path)
        try:
            return ShownSequence(sequence)
        except ConfigError as error:
            raise error.about(path) from error
    return ShownStripes(read_stripes(_rgb(path)))


def pattern_images(path: Path) -> list[U8]:
    """The patterns that the projector shows, uint8 (h, w), or (h, w, 3) RGB of color stripes.

    Raises:
        BagError, ConfigError, ImageError: as :func:`read_patterns`.
    """
    shown = read_patterns(path)
    return list(shown.sequence.render()) if isinstance(shown, ShownSequence) else [_rgb(path)]


def _rgb(path: Path) -> U8:
    pixels = read_image(path)
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB if pixels.ndim == 3 else cv2.COLOR_GRAY2RGB), np.uint8)
