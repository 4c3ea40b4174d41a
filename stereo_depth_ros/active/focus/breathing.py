# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Focus breathing: the scale and the shift of the image that come with the focus, estimated and removed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, F64, U8

__all__ = ["Placement", "align_neighbors", "place_frames"]

_LONG_SIDE = 480  # px of the finest level; a hundredth of its pixel is less than the window resolves
_LEVELS, _BLUR_PX = 3, 2.0
_ITERATIONS, _CLOSE_PX = 30, 2e-3
_TUKEY = 4.685  # 95 % efficiency for normal residuals
_LEAST_CORRELATION = 0.6
_MOST_SCALE, _MOST_SHIFT = 0.2, 0.2
_STEEP = 80  # percentile of the slopes above which the residuals tell how well images match
_LEAST_SHOWN = 0.3  # of an image that the other one shows
_LEAST_SLOPE = 0.05  # gray levels per px, of the blurred image, rms: less is noise


@dataclass(frozen=True)
class Placement:
    """Where the points of the reference image are in an image: x_image - c = scale (x - c) + shift, c the center.

    Attributes:
        scale: 1 for the reference.
        shift_px: (x, y), px.
        gain: gray levels of the image divided by those of the reference.
        correlation: of the image and the one before it when aligned, 0..1; 1 where nothing was estimated.
    """

    scale: float = 1.0
    shift_px: tuple[float, float] = (0.0, 0.0)
    gain: float = 1.0
    correlation: float = 1.0

    def matrix(self, width: int, height: int) -> F64:
        """The affine matrix, float64 (2, 3), that maps pixels of the reference to pixels of the image."""
        center = np.array([(width - 1) / 2, (height - 1) / 2])
        offset = (1 - self.scale) * center + self.shift_px
        return np.column_stack([self.scale * np.identity(2), offset])


def align_neighbors(first: U8, second: U8, names: tuple[str, str] = ("first", "second")) -> Placement:
    """The placement of the second image with respect to the first one.

    Gauss-Newton on gray levels from coarse to fine (Lucas and Kanade 1981; the slopes of both images are used, as by
    Benhimane and Malis 2004) with gain and offset, Tukey's weights
    against what only one image shows, both images blurred so that their focus matters little.

    Args:
        first, second: uint8 (H, W).
        names: for errors.

    Raises:
        ImageError: too little texture, or the images do not show the same.
    """
    scale_px = max(1.0, max(first.shape) / _LONG_SIDE)
    levels = [_reduced(image, scale_px) for image in (first, second)]
    parameters = np.array([0.0, 0.0, 0.0, 1.0, 0.0])  # scale - 1, shift in px of the level, gain, offset
    correlation = 0.0
    for level in reversed(range(_LEVELS)):
        factor = 2.0**level
        pair = [cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA) for image in levels]
        a, b = (np.asarray(cv2.GaussianBlur(image, (0, 0), _BLUR_PX), np.float32) for image in pair)
        scaled = parameters * [1, 1 / factor, 1 / factor, 1, 1]
        scaled, correlation = _gauss_newton(a, b, scaled, names)
        parameters = scaled * [1, factor, factor, 1, 1]
    ratio = first.shape[1] / levels[0].shape[1], first.shape[0] / levels[0].shape[0]
    found = Placement(
        1 + float(parameters[0]),
        (float(parameters[1]) * ratio[0], float(parameters[2]) * ratio[1]),
        float(parameters[3]),
        correlation,
    )
    far = max(abs(shift) / size for shift, size in zip(found.shift_px, first.shape[::-1], strict=True))
    if correlation < _LEAST_CORRELATION or abs(found.scale - 1) > _MOST_SCALE or far > _MOST_SHIFT:
        raise _different(names, correlation)
    return found


def place_frames(neighbors: Sequence[Placement]) -> tuple[int, list[Placement]]:
    """The reference of a stack and the placement of each image.

    The reference is the image with the smallest field of view, all of which the others show.

    Args:
        neighbors: of N - 1 pairs of neighbors, see :func:`align_neighbors`.

    Returns:
        The index of the reference, and N placements.
    """
    scales, shifts, gains = [1.0], [np.zeros(2)], [1.0]
    for step in neighbors:
        scales.append(step.scale * scales[-1])
        shifts.append(step.scale * shifts[-1] + step.shift_px)
        gains.append(step.gain * gains[-1])
    reference = int(np.argmax(scales))
    placements = []
    correlations = [1.0, *(step.correlation for step in neighbors)]
    for scale, shift, gain, correlation in zip(scales, shifts, gains, correlations, strict=True):
        ratio = scale / scales[reference]
        x, y = shift - ratio * shifts[reference]
        placements.append(Placement(ratio, (float(x), float(y)), gain / gains[reference], correlation))
    return reference, placements


def _reduced(image: U8, scale_px: float) -> F32:
    if scale_px == 1:
        return image.astype(np.float32)
    size = round(image.shape[1] / scale_px), round(image.shape[0] / scale_px)
    return np.asarray(cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)


def _gauss_newton(a: F32, b: F32, start: F64, names: tuple[str, str]) -> tuple[F64, float]:
    """The parameters for which b(c + (1 + p0)(x - c) + p1:3) is p3 a(x) + p4, and the correlation there."""
    height, width = a.shape
    center = np.array([(width - 1) / 2, (height - 1) / 2])
    slopes = _slopes(b)
    own_x, own_y = _slopes(a)
    parameters, correlation = start.copy(), 0.0
    for _ in range(_ITERATIONS):
        scale = 1 + parameters[0]
        matrix = np.column_stack([scale * np.identity(2), (1 - scale) * center + parameters[1:3]])
        columns, rows = (_inside(scale, matrix[axis, 2], size) for axis, size in ((0, width), (1, height)))
        bx, by, bb = (
            cv2.warpAffine(image, matrix, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)[rows, columns]
            for image in (*slopes, b)
        )
        if bb.size < _LEAST_SHOWN * b.size:
            raise _different(names, 0.0)
        slope = float(np.sqrt(np.mean(bx * bx + by * by)))
        if slope < _LEAST_SLOPE:
            raise ImageError(
                f"{names[0]} and {names[1]} have too little texture to align them",
                value=slope,
                limit=_LEAST_SLOPE,
                remedy="expose better, or take the images as aligned",
                settings=("align",),
            )
        # the mean of both slopes, so that neither image is preferred: one of them is more blurred
        gain = np.float32(parameters[3])
        bx, by = (bx + gain * own_x[rows, columns]) / 2, (by + gain * own_y[rows, columns]) / 2
        aa = a[rows, columns]
        x = np.arange(width, dtype=np.float32)[columns] - np.float32(center[0])
        y = np.arange(height, dtype=np.float32)[rows, None] - np.float32(center[1])
        off = bb - gain * aa - np.float32(parameters[4])
        steep = np.abs(bx) + np.abs(by)  # where images are flat, the residuals are small wherever the images are
        edges = np.abs(off[steep >= np.percentile(steep[::3, ::3], _STEEP)])
        spread = 1.4826 * float(np.median(edges)) + 0.1
        weight = np.square(np.maximum(0, 1 - np.square(off / np.float32(_TUKEY * spread))))
        terms = np.stack([bx * x + by * y, bx, by, -aa, np.full_like(aa, -1)]).reshape(5, -1)
        weighted = terms * weight.reshape(1, -1)
        normal, right = (weighted @ terms.T).astype(np.float64), (weighted @ off.ravel()).astype(np.float64)
        step = -np.linalg.lstsq(normal, right, rcond=1e-12)[0]
        parameters += step
        correlation = float(np.corrcoef(bb.ravel(), aa.ravel())[0, 1])
        if max(abs(step[0]) * np.hypot(*center), abs(step[1]), abs(step[2])) < _CLOSE_PX:
            break
    return parameters, max(correlation, 0.0)


def _different(names: tuple[str, str], correlation: float) -> ImageError:
    return ImageError(
        f"{names[0]} and {names[1]} do not show the same, aligned as well as possible their correlation is "
        f"{correlation:.2f}, {_LEAST_CORRELATION} is the least",
        value=correlation,
        limit=_LEAST_CORRELATION,
        remedy="give the images of one stack in the order of their focus",
        settings=("align",),
    )


def _slopes(image: F32) -> tuple[F32, F32]:
    """Derivatives by x and y, gray levels per px."""
    x, y = (cv2.Sobel(image, cv2.CV_32F, *order, ksize=3, scale=1 / 8) for order in ((1, 0), (0, 1)))
    return np.asarray(x, np.float32), np.asarray(y, np.float32)


def _inside(scale: float, offset: float, size: int) -> slice:
    """The pixels k with 1 <= scale k + offset <= size - 2."""
    first, last = math.ceil((1 - offset) / scale), math.floor((size - 2 - offset) / scale)
    return slice(max(first, 0), max(min(last, size - 1) + 1, max(first, 0)))
