# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectifying homographies of least distortion from the fundamental matrix alone (Loop and Zhang 1999).

C. Loop and Z. Zhang, "Computing Rectifying Homographies for Stereo Vision", CVPR 1999. Each homography is decomposed
into a projective part, which moves the epipole to infinity, a similarity, which rotates it into the rows, and a shear
of the columns; each part is chosen for least distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import epipoles, homogeneous

__all__ = ["Shape", "UncalibratedRectification", "rectify_uncalibrated", "shape_under"]

_ANGLES = 720  # number of directions of z over 180 degrees, for the initial search of the least distortion
_MARGIN = 0.05  # least distance of an epipole from the image as a fraction of the image size
_MAX_STRETCH = 4.0  # ratio of magnifications in the image, by the projective part


class Shape(NamedTuple):
    """Effect of a homography on the midlines of an image; (90, 1) means no distortion.

    Attributes:
        angle_deg: between the mapped horizontal and vertical midlines.
        aspect: ratio of their lengths, relative to that of the image.
    """

    angle_deg: float
    aspect: float


@dataclass(frozen=True, eq=False)
class UncalibratedRectification:
    """Two homographies that align the rows of two images.

    Attributes:
        H_left, H_right: float64 (3, 3), from pixels (without distortion) to pixels of the rectified image.
        size: width, height of both rectified images, px.
        distortion: Loop and Zhang's criterion (equation 11) of the projective parts, summed over both images; 0 for an
            affine transformation.
        shape_left, shape_right: effect of the complete homographies on the midlines.
    """

    H_left: F64
    H_right: F64
    size: tuple[int, int]
    distortion: float
    shape_left: Shape
    shape_right: Shape

    def rectified(self, left_px: F64, right_px: F64) -> tuple[F64, F64]:
        """Pixels of the rectified images, from undistorted points, float64 (N, 2) each."""
        left, right = (
            np.asarray(cv2.perspectiveTransform(points[:, None], H)[:, 0], np.float64)
            for points, H in ((left_px, self.H_left), (right_px, self.H_right))
        )
        return left, right


def rectify_uncalibrated(
    F: F64, left_size: tuple[int, int], right_size: tuple[int, int] | None = None
) -> UncalibratedRectification:
    """Rectifying homographies of two images with a known fundamental matrix.

    Both rectified images have the size of the left one; their total area is preserved, and each is centered.
    Disparities have any sign, and no metric scale.

    Args:
        F: float64 (3, 3), x_right^T F x_left = 0, for pixels without distortion.
        left_size, right_size: width, height of the images, px; None for the size of the left one.

    Raises:
        CalibrationError: F is not a fundamental matrix, or an epipole is in or near an image.
    """
    sizes = (left_size, right_size or left_size)
    F = _checked(F)
    for epipole, size, side in zip(epipoles(F), sizes, ("left", "right"), strict=True):
        _check_epipole(epipole, size, side)
    # Coordinates relative to the image centers are well conditioned
    to_center = [_to_center(size) for size in sizes]
    centered = np.linalg.inv(to_center[1]).T @ F @ np.linalg.inv(to_center[0])
    z, distortion = _least_distortion(centered, sizes)
    lines = _vanishing_lines(centered, z)
    for line, size, side in zip(lines, sizes, ("left", "right"), strict=True):
        _check_stretch(line, size, side)
    projective = [_projective(line) for line in lines]
    similarity = _similarities(centered, *lines)
    aligned = [s @ p @ c for s, p, c in zip(similarity, projective, to_center, strict=True)]
    H_left, H_right = _placed([_shear(H, size) @ H for H, size in zip(aligned, sizes, strict=True)], sizes)
    shapes = [shape_under(H, size) for H, size in zip((H_left, H_right), sizes, strict=True)]
    return UncalibratedRectification(H_left, H_right, left_size, distortion, shapes[0], shapes[1])


def shape_under(H: F64, size: tuple[int, int]) -> Shape:
    """Effect of a homography, float64 (3, 3), on the midlines of an image of this size (width, height)."""
    x, y = _midlines(H, size)
    angle = np.degrees(np.arctan2(abs(x[0] * y[1] - x[1] * y[0]), x @ y))
    return Shape(float(angle), float(np.hypot(*x) / np.hypot(*y) * size[1] / size[0]))


def _checked(F: F64) -> F64:
    singular = np.linalg.svd(F, compute_uv=False) if F.shape == (3, 3) and np.isfinite(F).all() else np.zeros(3)
    if not singular[1] > 1e-9 * singular[0] or singular[2] > 1e-3 * singular[1]:
        raise CalibrationError(
            f"singular values {singular.tolist()} are not those of a fundamental matrix, which has rank 2",
            value=singular.tolist(),
            remedy="estimate it from matches",
        )
    return F / np.linalg.norm(F)


def _check_epipole(epipole: F64, size: tuple[int, int], side: str) -> None:
    x, y, w = epipole
    if w < 1e-12:
        return
    at = np.array([x, y]) / w
    margin = _MARGIN * np.array(size)
    if (at >= -margin).all() and (at <= size + margin).all():
        raise CalibrationError(
            f"the {side} epipole is at ({at[0]:.0f}, {at[1]:.0f}) px, in the image of {size[0]}x{size[1]} px or "
            f"within {100 * _MARGIN:g} % of it: no homography aligns "
            "epipolar lines that intersect there",
            value=at.tolist(),
            limit=(size, _MARGIN),
            remedy="move the camera sideways, not forward",
        )


def _to_center(size: tuple[int, int]) -> F64:
    return np.array([[1, 0, -(size[0] - 1) / 2], [0, 1, -(size[1] - 1) / 2], [0, 0, 1]])


def _vanishing_lines(F: F64, z: F64) -> tuple[F64, F64]:
    """The lines w = [e]x z and w' = F z that are mapped to infinity, by the direction z (equation 8)."""
    left = np.cross(epipoles(F)[0], z)
    right = F @ z
    tiny = np.finfo(np.float64).tiny  # for the direction of an epipole at infinity, which has no line
    return left / max(np.linalg.norm(left), tiny), right / max(np.linalg.norm(right), tiny)


def _least_distortion(F: F64, sizes: tuple[tuple[int, int], tuple[int, int]]) -> tuple[F64, float]:
    """The direction z of the most uniform pixel weights in both images (section 5), and the criterion."""

    def criterion(angle: float) -> float:
        lines = _vanishing_lines(F, np.array([np.cos(angle), np.sin(angle), 0.0]))
        return sum(_weight_variation(line, size) for line, size in zip(lines, sizes, strict=True))

    step = np.pi / _ANGLES
    best = step * int(np.argmin([criterion(step * k) for k in range(_ANGLES)]))
    while step > 1e-12:  # the lowest of three neighbors, with a decreasing step
        best = min((best - step, best, best + step), key=criterion)
        step /= 1.7
    return np.array([np.cos(best), np.sin(best), 0.0]), criterion(best)


def _weight_variation(line: F64, size: tuple[int, int]) -> float:
    """Mean squared deviation of the pixel weights from that of the center, relative to it (equation 10).

    The mean square of coordinates relative to the center is (width^2 - 1) / 12.
    """
    a, b, c = line
    if c == 0:
        return float("inf")
    return float((a**2 * (size[0] ** 2 - 1) + b**2 * (size[1] ** 2 - 1)) / 12 / c**2)


def _check_stretch(line: F64, size: tuple[int, int], side: str) -> None:
    corners = np.array([[x, y, 1] for x in (-size[0] / 2, size[0] / 2) for y in (-size[1] / 2, size[1] / 2)])
    weights = corners @ line * np.sign(line[2])
    if weights.min() <= 0 or weights.max() > _MAX_STRETCH * weights.min():
        stretch = weights.max() / weights.min() if weights.min() > 0 else np.inf
        raise CalibrationError(
            f"magnification would vary {stretch:.3g} times between corners, limit {_MAX_STRETCH:g}: the epipole is too "
            "near",
            subject=f"{side} image",
            value=float(stretch),
            limit=_MAX_STRETCH,
            remedy="move the camera sideways, not forward",
        )


def _projective(line: F64) -> F64:
    """H_p, equation 6."""
    return np.array([[1, 0, 0], [0, 1, 0], line / line[2]])


def _similarities(F: F64, left: F64, right: F64) -> tuple[F64, F64]:
    """H_r and H_r', equations 12 and 13 with v'_c = 0: epipoles along the rows, equal rows and scale."""
    (a, b, _), (a_right, b_right, _) = left / left[2], right / right[2]
    to_rows = np.array(
        [
            [F[2, 1] - b * F[2, 2], a * F[2, 2] - F[2, 0], 0],
            [F[2, 0] - a * F[2, 2], F[2, 1] - b * F[2, 2], F[2, 2]],
            [0, 0, 1],
        ]
    )
    to_rows_right = np.array(
        [
            [b_right * F[2, 2] - F[1, 2], F[0, 2] - a_right * F[2, 2], 0],
            [a_right * F[2, 2] - F[0, 2], b_right * F[2, 2] - F[1, 2], 0],
            [0, 0, 1],
        ]
    )
    upside_down = np.diag([-1.0, -1.0, 1.0]) if to_rows[0, 0] < 0 else np.identity(3)
    return upside_down @ to_rows, upside_down @ to_rows_right


def _shear(H: F64, size: tuple[int, int]) -> F64:
    """H_s, equations 17 and 18: restores the right angle of the midlines and the ratio of their lengths."""
    x, y = _midlines(H, size)
    width, height = size
    area = width * height * (x[1] * y[0] - x[0] * y[1])
    a = (height**2 * x[1] ** 2 + width**2 * y[1] ** 2) / area
    b = -(height**2 * x[0] * x[1] + width**2 * y[0] * y[1]) / area
    return np.array([[a, b, 0], [0, 1, 0], [0, 0, 1]]) if a > 0 else np.array([[-a, -b, 0], [0, 1, 0], [0, 0, 1]])


def _midlines(H: F64, size: tuple[int, int]) -> tuple[F64, F64]:
    """Mapped midlines, from left to right and from top to bottom, float64 (2,) each."""
    x, y = (size[0] - 1) / 2, (size[1] - 1) / 2
    ends = np.array([[size[0] - 0.5, y], [-0.5, y], [x, size[1] - 0.5], [x, -0.5]])
    mapped = homogeneous(ends) @ H.T
    east, west, south, north = mapped[:, :2] / mapped[:, 2:]
    return east - west, south - north


def _placed(homographies: list[F64], sizes: tuple[tuple[int, int], tuple[int, int]]) -> tuple[F64, F64]:
    """Homographies scaled equally to the area of the raw images, and translated to center both images."""
    corners = [np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5 for w, h in sizes]
    mapped = [homogeneous(points) @ H.T for points, H in zip(corners, homographies, strict=True)]
    outlines = [points[:, :2] / points[:, 2:] for points in mapped]
    area = sum(abs(cv2.contourArea(outline.astype(np.float32))) for outline in outlines)
    scale = np.sqrt(sum(w * h for w, h in sizes) / area)
    centers = [scale * (outline.min(axis=0) + outline.max(axis=0)) / 2 for outline in outlines]
    row = (sizes[0][1] - 1) / 2 - (centers[0][1] + centers[1][1]) / 2
    left, right = (
        np.array([[scale, 0, (sizes[0][0] - 1) / 2 - center[0]], [0, scale, row], [0, 0, 1]]) @ H
        for H, center in zip(homographies, centers, strict=True)
    )
    return left / left[2, 2], right / right[2, 2]
