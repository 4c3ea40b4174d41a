# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the images as published: bit depth, empty, black, saturated, or the same image twice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.diagnosis.finding import Finding, Level

__all__ = ["check_bit_depth", "check_exposure", "check_two_cameras"]

BLACK, WHITE = 16, 250  # gray values; noise and stray light stay below, a saturated sensor above
MAX_WHITE, ALL_WHITE = 0.2, 0.9  # share of pixels
MIN_CONTRAST = 3.0  # standard deviation of gray values; the noise of a sensor alone is about that


def check_exposure(images: Sequence[U8], side: str) -> Finding:
    """Whether the images of a camera are well exposed; medians over them.

    Args:
        images: uint8 (H, W), gray, at least one.
    """
    bright = float(np.median([np.percentile(image, 99) for image in images]))
    white = float(np.median([(image >= WHITE).mean() for image in images]))
    contrast = float(np.median([image.std() for image in images]))
    mean = float(np.median([image.mean() for image in images]))
    value = f"mean gray {mean:.0f}, contrast {contrast:.1f}, {100 * white:.1f} % saturated"
    limit = f"contrast {MIN_CONTRAST:g}, {100 * MAX_WHITE:.0f} % saturated"
    level, remedy = Level.OK, ""
    if bright < BLACK:
        level, remedy = Level.ERROR, "black: remove the lens cap, expose longer, or light the scene"
    elif white > ALL_WHITE:
        level, remedy = Level.ERROR, "white: reduce the exposure, or switch automatic exposure on"
    elif contrast < MIN_CONTRAST:
        level, remedy = Level.ERROR, "empty: check focus and lens cap, and the encoding that the driver publishes"
    elif white > MAX_WHITE:
        level, remedy = Level.WARNING, "saturated pixels do not match: reduce the exposure"
    figures = {"mean": mean, "contrast": contrast, "saturated": white}
    return Finding(f"{side} image", level, value, limit, remedy, figures)


def check_bit_depth(bits: int) -> Finding:
    """Whether 16-bit images, which are scaled by the depth found, have more bits than 8-bit ones."""
    check, value, limit = "bit depth", f"{bits} bit in 16-bit samples", "more than 8 bit"
    if bits > 8:
        return Finding(check, Level.OK, value, limit, "", {"bits": bits})
    remedy = "no pixel is above 255: remove the lens cap and expose longer, or publish mono8 if the camera has 8 bits"
    return Finding(check, Level.WARNING, value, limit, remedy, {"bits": bits})


def check_two_cameras(left: Sequence[U8], right: Sequence[U8]) -> Finding:
    """Whether the images of each pair have the same size, and are of two cameras."""
    check, limit = "two cameras", "two images of one size"
    sizes = {(one.shape, other.shape) for one, other in zip(left, right, strict=True)}
    for one, other in sizes:
        if one != other:
            value = f"left is {one[1]}x{one[0]}, right is {other[1]}x{other[0]}"
            return Finding(check, Level.ERROR, value, limit, "set both cameras to the same resolution")
    same = sum(np.array_equal(one, other) for one, other in zip(left, right, strict=True))
    if same:
        value = f"left and right image are identical in {same} of {len(left)} pairs"
        return Finding(check, Level.ERROR, value, limit, "both topics show one camera: check drivers and remappings")
    return Finding(check, Level.OK, f"{len(left)} different pairs", limit)
