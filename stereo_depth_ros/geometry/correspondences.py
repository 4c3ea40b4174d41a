# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Correspondences of two images: matched points, and SIFT matching of raw images from unknown cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.geometry.rays import undistort_points
from stereo_depth_ros.matching.features.corners import detect_sift, mutual_best, squared_distances

__all__ = ["Correspondences", "match_features"]

_CONTRAST = 0.02  # half of OpenCV's default, for dim scenes


@dataclass(frozen=True, eq=False)
class Correspondences:
    """N points of the left image and the same points in the right image.

    Attributes:
        left_px, right_px: float64 (N, 2), columns x and y, px; pixel centers are whole numbers.

    Raises:
        ImageError: the two are not both (N, 2).
    """

    left_px: F64
    right_px: F64

    def __post_init__(self) -> None:
        if self.left_px.shape != self.right_px.shape or self.left_px.shape[1:] != (2,):
            raise ImageError(
                f"left and right points have shapes {self.left_px.shape} and {self.right_px.shape}, not both (N, 2)",
                value=(self.left_px.shape, self.right_px.shape),
                remedy="pass the right point of each left point",
            )

    def __len__(self) -> int:
        return len(self.left_px)

    def take(self, chosen: npt.NDArray[Any]) -> Correspondences:
        """The correspondences of these indices, or of this mask."""
        return Correspondences(self.left_px[chosen], self.right_px[chosen])

    def undistorted(self, left: CameraModel, right: CameraModel) -> Correspondences:
        """Points in cameras with the same K and no distortion; points outside their field of view are removed."""
        moved = Correspondences(undistort_points(self.left_px, left), undistort_points(self.right_px, right))
        return moved.take(np.flatnonzero(np.isfinite(moved.left_px + moved.right_px).all(axis=1)))


def match_features(left: U8, right: U8, max_features: int = 4000, ratio: float = 0.75) -> Correspondences:
    """Match SIFT features (Lowe 2004) of two images by mutual best distance and the ratio test.

    Works on raw images of any size: no rectification is assumed. Some percent of the matches are wrong.

    Args:
        left, right: uint8 (H, W), gray.
        max_features: number of strongest features of each image.
        ratio: largest ratio of the distances of the best and the second best candidate.

    Returns:
        The matches in a fixed order, the same for the same images; none where the images have nothing in common.

    Raises:
        ImageError: not gray uint8 images.
    """
    _check_gray(left, "left")
    _check_gray(right, "right")
    left_px, left_descriptors = detect_sift(left, max_features, _CONTRAST)
    right_px, right_descriptors = detect_sift(right, max_features, _CONTRAST)
    if min(len(left_px), len(right_px)) < 2:
        return Correspondences(np.empty((0, 2)), np.empty((0, 2)))
    i, j = mutual_best(squared_distances(left_descriptors, right_descriptors), ratio**2)
    # SIFT gives a corner once for each of its orientations
    single = np.unique(np.hstack((left_px[i], right_px[j])), axis=0)
    return Correspondences(single[:, :2], single[:, 2:])


def _check_gray(image: U8, side: str) -> None:
    if image.dtype != np.uint8 or image.ndim != 2 or not image.size:
        raise ImageError(
            f"{image.dtype} of shape {image.shape}, not uint8 (H, W)",
            subject=f"{side} image",
            value=(image.dtype, image.shape),
            remedy="convert it to gray",
        )
