# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Depth from focus: a stack of images at several focus distances to depth and an all-in-focus image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.focus.breathing import Placement, align_neighbors, place_frames
from stereo_depth_ros.active.focus.measure import (
    image_noise,
    mean_of_noise,
    sigma_of_measure,
    sum_modified_laplacian,
)
from stereo_depth_ros.active.focus.peak import find_peaks
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, ConfigError, ImageError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.types import F32, F64, U8, Frame, Reason
from stereo_depth_ros.matching.filters.speckle_filter import SpeckleFilter
from stereo_depth_ros.stages.rectification import rectification_maps

__all__ = ["FocusResult", "depth_from_focus"]

_FEWEST = 3
_MOST_VALUES = 2**29  # of the focus measure, float32: 2 GiB
_WINDOWS = (3, 101)
_FILL_PX = 15.0  # reach of the depths around a pixel without one, in the all-in-focus image
_APART = 16  # sixteenths of the step between images
_FIT = 0.07  # error of the fit, steps between images: the measure is not exactly a Gaussian
_INFINITE = 1e-9  # 1 / m


@dataclass(frozen=True, eq=False)
class FocusResult:
    """Depth of a focal stack, in the frame of its reference image.

    Attributes:
        index: float32 (H, W), the image in which each pixel is sharpest, 0 the first one, with a fraction; NaN where
            invalid.
        index_sigma: float32 (H, W), its standard deviation, by the noise of the camera and the error of the fit; NaN
            where invalid.
        reasons: uint8 (H, W), bits of :class:`Reason`, 0 exactly where ``index`` is finite: TEXTURE, no peak above the
            noise; RANGE, sharpest in the first or the last image or beyond; UNIQUENESS, two peaks; SPECKLE,
            a part smaller than the window that lies apart; BORDER, not in all
            images.
        depth_m: float32 (H, W), Z from the lens, meters, NaN where invalid; None where no focus distances are given:
            then 1 / Z is a linear function of ``index``, if the lens moved in equal steps, with unknown coefficients.
        sigma_m: float32 (H, W), standard deviation of the depth; None without one.
        all_in_focus: uint8 (H, W) or (H, W, 3), each pixel from the images in which it is sharp.
        encoding: of ``all_in_focus``, that of the images.
        reference: number of the reference image, from 0.
        placements: where the points of the reference are in each image.
        noise: standard deviation of the noise of the images, gray levels.
    """

    index: F32
    index_sigma: F32
    reasons: U8
    depth_m: F32 | None
    sigma_m: F32 | None
    all_in_focus: U8
    encoding: str
    reference: int
    placements: list[Placement]
    noise: float

    @property
    def valid_fraction(self) -> float:
        """Fraction of pixels with a depth, 0..1."""
        return float(np.count_nonzero(self.reasons == 0)) / self.reasons.size

    def rectified(self, camera: CameraModel) -> FocusResult:
        """The same in the rectified frame of the camera; pixels without a source have the reason BORDER.

        Args:
            camera: its calibration, at the focus of the reference image.

        Raises:
            CalibrationError: it is that of images of another size.
        """
        height, width = self.index.shape
        if (camera.width, camera.height) != (width, height):
            raise CalibrationError(
                f"the calibration is of {camera.width}x{camera.height}, the images are {width}x{height}",
                value=(camera.width, camera.height),
                limit=(width, height),
                remedy="calibrate the camera with images of this size",
                settings=("camera",),
            )
        maps = rectification_maps(camera)
        if maps is None:
            return self

        # what is not to be mixed comes from the nearest pixel; cv2.remap would truncate fixed-point maps
        x, y = (_rounded(maps[0][..., axis], maps[1] >> (5 * axis) & 31) for axis in (0, 1))
        outside = (x < 0) | (x >= width) | (y < 0) | (y >= height)
        columns, rows = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)

        def nearest(image: F32) -> F32:
            return np.where(outside, np.float32(np.nan), image[rows, columns])

        return replace(
            self,
            index=nearest(self.index),
            index_sigma=nearest(self.index_sigma),
            reasons=np.where(outside, np.uint8(Reason.BORDER), self.reasons[rows, columns]),
            depth_m=None if self.depth_m is None else nearest(self.depth_m),
            sigma_m=None if self.sigma_m is None else nearest(self.sigma_m),
            all_in_focus=np.asarray(cv2.remap(self.all_in_focus, *maps, cv2.INTER_LINEAR), np.uint8),
        )

    def reason_counts(self) -> dict[str, int]:
        """Number of pixels per reason name (a pixel may have several)."""
        return {str(r.name): int(np.count_nonzero(self.reasons & r.value)) for r in Reason if r.value}


def depth_from_focus(
    frames: Sequence[Frame],
    distances_m: F64 | None = None,
    *,
    window: int = 9,
    align: bool = True,
    names: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> FocusResult:
    """Depth and all-in-focus image of a focal stack.

    The focus measure of each image is the sum-modified Laplacian; its peak over the images is that of a Gaussian
    through the largest measure and those before and after it (Nayar and Nakagawa, "Shape from focus", IEEE PAMI 16(8),
    1994). The Gaussian is over the inverse distance, to which the blur of a thin lens is proportional.

    Args:
        frames: at least 3 images of one size, of a scene and a camera at rest, the focus moving in one direction.
        distances_m: float64 (N,), focus distance of each image from the lens, meters, strictly monotone, may be
            infinite; None where only the order of the images is known.
        window: width and height of the window of the focus measure, odd, px.
        align: estimate and remove the focus breathing; the images are taken as aligned otherwise.
        names: of the images, for errors.
        progress: called with the number of images done, and the total.

    Raises:
        ImageError: fewer than 3 images, different sizes, too large a stack, or images that cannot be aligned.
        ConfigError: distances that are not one for each image and strictly monotone, or another window.
    """
    names = names or [f"image {number}" for number in range(1, len(frames) + 1)]
    _check_frames(frames, names)
    positions = _positions(distances_m, len(frames))
    if not (_WINDOWS[0] <= window <= _WINDOWS[1] and window % 2):
        raise ConfigError(
            f"window {window} is not an odd number of {_WINDOWS[0]} to {_WINDOWS[1]} px",
            value=window,
            limit=_WINDOWS,
            remedy="choose one, such as 9",
            settings=("window",),
        )
    height, width = frames[0].pixels.shape[:2]
    total = 2 * len(frames)
    grays: list[U8] = []
    neighbors: list[Placement] = []
    for number, frame in enumerate(frames):
        grays.append(to_gray(frame))
        if number:
            pair = names[number - 1], names[number]
            neighbors.append(align_neighbors(grays[-2], grays[-1], pair) if align else Placement())
        progress(number + 1, total)
    reference, placements = place_frames(neighbors)
    noise = float(np.percentile([image_noise(gray) for gray in grays], 25))
    measure = np.empty((len(frames), height, width), np.float32)
    for number, (gray, placement) in enumerate(zip(grays, placements, strict=True)):
        _warp(sum_modified_laplacian(gray, window) / np.float32(placement.gain), placement, measure[number])
        progress(len(frames) + number + 1, total)
    found, sigma = np.empty((2, height, width), np.float32)
    reasons = np.zeros((height, width), np.uint8)
    levels = np.float32(mean_of_noise(noise)), np.float32(sigma_of_measure(noise, window))
    run_bands(find_peaks, height, measure, positions, *levels, found, sigma, reasons)
    _reject_outside(reasons, placements, window)
    depth_m, sigma_m = None, None
    if distances_m is not None:
        reasons[found <= _INFINITE] |= np.uint8(Reason.RANGE)  # beyond infinity
    index, per_position = _as_index(found, positions)
    _reject_speckles(index, reasons, window)
    sigma = np.hypot(sigma, np.float32(_FIT) / per_position)
    for values in (index, found, sigma):
        values[reasons != 0] = np.nan
    index_sigma = sigma * per_position
    if distances_m is not None:
        depth_m = np.reciprocal(found)
        sigma_m = depth_m * depth_m * sigma
    sharp = _all_in_focus(frames, placements, index, measure)
    return FocusResult(
        index, index_sigma, reasons, depth_m, sigma_m, sharp, frames[0].encoding, reference, placements, noise
    )


def _rounded(whole: npt.NDArray[Any], part: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
    """The nearest pixel of a fixed-point map, whose parts are 1/32 px."""
    return whole.astype(np.intp) + (part >= 16)


def _check_frames(frames: Sequence[Frame], names: Sequence[str]) -> None:
    if len(frames) < _FEWEST:
        raise ImageError(
            f"{len(frames)} image{'' if len(frames) == 1 else 's'}, a focal stack has at least {_FEWEST}",
            value=len(frames),
            limit=_FEWEST,
            remedy="take images of one scene at several focus distances",
        )
    for frame, name in zip(frames, names, strict=True):
        size, first = frame.pixels.shape[:2], frames[0].pixels.shape[:2]
        if size != first or frame.encoding != frames[0].encoding:
            what = f"{size[1]}x{size[0]} {frame.encoding}", f"{first[1]}x{first[0]} {frames[0].encoding}"
            raise ImageError(
                f"is {what[0]}, and {names[0]} is {what[1]}",
                subject=name,
                value=what[0],
                limit=what[1],
                remedy="give the images of one camera",
            )
    if frames[0].pixels.shape[0] * frames[0].pixels.shape[1] * len(frames) > _MOST_VALUES:
        height, width = frames[0].pixels.shape[:2]
        raise ImageError(
            f"{len(frames)} images of {width}x{height} are more than {_MOST_VALUES} px",
            value=len(frames) * width * height,
            limit=_MOST_VALUES,
            remedy="scale them down, or give fewer",
        )


def _positions(distances_m: F64 | None, count: int) -> F64:
    """What the blur is proportional to the difference of: 1 / distance, or the number of the image."""
    if distances_m is None:
        return np.arange(count, dtype=np.float64)
    distances_m = np.asarray(distances_m, np.float64)
    with np.errstate(divide="ignore"):
        positions = 1 / distances_m
    steps = np.diff(positions) if positions.shape == (count,) else np.zeros(1)
    monotone = bool((steps > 0).all() or (steps < 0).all())
    if not (monotone and np.isfinite(positions).all() and positions.min() >= 0):
        raise ConfigError(
            f"the focus distances are not {count} that become nearer, or farther, from image to image",
            value=distances_m.tolist(),
            limit=count,
            remedy="give each image another distance, in the order of the images",
            settings=("table",),
        )
    return positions


def _warp(image: F32, placement: Placement, out: F32) -> None:
    """The image in the frame of the reference."""
    height, width = image.shape
    if placement.scale == 1 and placement.shift_px == (0.0, 0.0):
        out[:] = image
        return
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    border = cv2.BORDER_REPLICATE
    cv2.warpAffine(image, placement.matrix(width, height), (width, height), dst=out, flags=flags, borderMode=border)


def _reject_outside(reasons: U8, placements: Sequence[Placement], window: int) -> None:
    """The reason BORDER where the window is not within all images, and no other one."""
    height, width = reasons.shape
    inside = np.ones((height, width), bool)
    margin = window // 2 + 1
    for placement in placements:
        (a, _, x0), (_, b, y0) = placement.matrix(width, height)
        u, v = a * np.arange(width) + x0, b * np.arange(height) + y0
        inside &= (u >= margin) & (u <= width - 1 - margin)
        inside &= ((v >= margin) & (v <= height - 1 - margin))[:, None]
    reasons[~inside] = np.uint8(Reason.BORDER)


def _as_index(found: F32, positions: F64) -> tuple[F32, F32]:
    """Positions as numbers of images, and images per unit of the position."""
    numbers = np.arange(len(positions), dtype=np.float64)
    order = np.argsort(positions)
    index = np.interp(found, positions[order], numbers[order]).astype(np.float32)
    near = np.nan_to_num(np.rint(index)).astype(np.intp)
    return index, np.abs(np.gradient(numbers, positions)).astype(np.float32)[near]


def _reject_speckles(index: F32, reasons: U8, window: int) -> None:
    """The reason SPECKLE for parts smaller than the window, which determines a whole part, that lie apart in depth."""
    invalid = np.where(reasons == 0, index, np.float32(0))
    SpeckleFilter(window * window, _APART)(np.rint(16 * invalid).astype(np.int16), reasons)


def _all_in_focus(frames: Sequence[Frame], placements: Sequence[Placement], index: F32, measure: F32) -> U8:
    """Each pixel from the two images between which it is sharpest.

    Where the index is not known it is that of the pixels around, or, if there are none, of the largest measure.
    """
    known = np.isfinite(index)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), _FILL_PX)
    around = cv2.GaussianBlur(np.where(known, index, np.float32(0)), (0, 0), _FILL_PX)
    filled = np.where(weight > 1e-2, around / np.maximum(weight, np.float32(1e-2)), measure.argmax(axis=0))
    place = np.where(known, index, filled).astype(np.float32)
    height, width = index.shape
    total = np.zeros(frames[0].pixels.shape, np.float32)
    for number, (frame, placement) in enumerate(zip(frames, placements, strict=True)):
        share = np.maximum(0, 1 - np.abs(place - np.float32(number)))
        if not share.any():
            continue
        pixels = cv2.warpAffine(
            frame.pixels,
            placement.matrix(width, height),
            (width, height),
            flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        ).astype(np.float32)
        total += (share if pixels.ndim == 2 else share[..., None]) * pixels * np.float32(1 / placement.gain)
    return np.clip(np.rint(total), 0, 255).astype(np.uint8)
