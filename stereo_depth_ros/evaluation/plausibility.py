# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Refuses scenes with swapped cameras or with true disparities of a wrong scale."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.evaluation.scenes import Scene
from stereo_depth_ros.stages.camera_swap import CameraSwapDetector

__all__ = ["check_plausible"]

_WIDTH = 480  # px, of the small images that are matched
_DISPARITIES = 144  # px of those: nearly a third of the width
_WINDOW = 15
_CLOSE_PX = 1.5  # of the small images: largest difference of a match that agrees with the truth
_ENOUGH = 0.4  # share of matches that agree with the scaled truth, below which the truth is accepted
_CLEARLY = 2.0  # times as many agree with the scaled truth as with the truth


def check_plausible(scene: Scene) -> None:
    """Compares the truth with block matching of small copies of the images.

    Raises:
        ImageError: the cameras look swapped, or the scale of the truth looks wrong.
    """
    try:
        CameraSwapDetector(min(scene.doffs_px, 0.0)).check(scene.left, scene.right)
    except ImageError as error:
        raise ImageError(
            error.problem, value=error.value, limit=error.limit, remedy="exchange the left and the right images"
        ) from error
    found, truth = _matches(scene)
    usable = np.isfinite(found) & np.isfinite(truth) & (np.abs(truth) > 0)
    found, truth = found[usable], truth[usable]
    if found.size < _WINDOW**2:
        return
    scale = float(np.median(truth / np.maximum(found, np.float32(1))))
    if scale == 0:
        return
    as_given, scaled = _share_close(found, truth), _share_close(found, truth / np.float32(scale))
    if scaled > _ENOUGH and scaled > _CLEARLY * as_given:
        raise ImageError(
            f"the scale of the truth looks wrong, it is about {scale:.3g} times the disparities of the images: "
            f"{100 * as_given:.0f} % of the matches agree with the truth as given, {100 * scaled:.0f} % with the truth "
            f"divided by {scale:.3g}",
            value=scale,
            limit=1.0,
            remedy="check the gray levels per pixel of disparity and the image size of the truth",
        )


def _share_close(found: F32, truth: F32) -> float:
    return float(np.mean(np.abs(found - truth) <= _CLOSE_PX))


def _matches(scene: Scene) -> tuple[F32, F32]:
    """Reliable disparities of block matching, NaN elsewhere, and the truth, both of and in pixels of small copies."""
    scale = min(1.0, _WIDTH / scene.left.shape[1])
    left, right = (
        cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for image in (scene.left, scene.right)
    )
    height, width = left.shape
    truth = cv2.resize(scene.truth_px, (width, height), interpolation=cv2.INTER_NEAREST) * np.float32(scale)
    first = int(np.floor(min(scene.doffs_px, 0.0) * scale))
    count = min(_DISPARITIES, (width - _WINDOW + first) // 32 * 16)  # at most half of the width
    if count < 16 or height <= 2 * _WINDOW:
        return np.full_like(truth, np.nan), truth
    stereo = cv2.StereoBM.create(count, _WINDOW)
    stereo.setMinDisparity(first)
    stereo.setUniquenessRatio(15)
    stereo.setTextureThreshold(100)
    stereo.setSpeckleWindowSize(100)
    stereo.setSpeckleRange(32)
    disparity_x16 = stereo.compute(left, right)
    return np.where(disparity_x16 >= 16 * first, disparity_x16.astype(np.float32) / 16, np.float32(np.nan)), truth
