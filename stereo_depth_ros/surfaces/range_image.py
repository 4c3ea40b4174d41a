# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Range images: the depth of each pixel of a camera, its standard deviation, and the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, F64, U8

if TYPE_CHECKING:
    from stereo_depth_ros.pipeline import StereoResult

__all__ = ["RangeImage"]


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Depth of the left rectified image, in its optical frame: x right, y down, z forward.

    A pixel counts as measured where its depth is finite and above 0 and its standard deviation is finite.

    Attributes:
        depth_m: float32 (H, W), Z in meters; NaN where it is not measured.
        sigma_m: float32 (H, W), standard deviation of the depth, meters.
        triangulation: the geometry of the rig.
        color: uint8 (H, W) gray or (H, W, 3) RGB, the left rectified image.

    Raises:
        ImageError: another dtype or shape.
    """

    depth_m: F32
    sigma_m: F32
    triangulation: Triangulation
    color: U8

    def __post_init__(self) -> None:
        shape = getattr(self.depth_m, "shape", None)
        if not isinstance(shape, tuple) or len(shape) != 2 or not all(shape):
            raise ImageError(
                f"the depth has shape {shape}, a range image has (H, W) of at least one pixel",
                subject="depth_m",
                value=shape,
                limit="(H, W)",
                remedy="pass one depth per pixel",
            )
        for name, dtype, channels in (("depth_m", np.float32, 0), ("sigma_m", np.float32, 0), ("color", np.uint8, 3)):
            _check(name, getattr(self, name), np.dtype(dtype), shape, channels)
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name)))

    @classmethod
    def of(cls, result: StereoResult) -> RangeImage:
        """That of a result of the pipeline.

        Raises:
            CalibrationError: its rig is not calibrated.
        """
        color = result.rectified.left_color
        if result.rectified.color_encoding == "bgr8":
            color = color[:, :, ::-1]
        return cls(result.depth_m, result.noise_m, result.triangulation, color)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        height, width = self.depth_m.shape
        return width, height

    @property
    def measured(self) -> Any:
        """Whether each pixel is measured, bool (H, W)."""
        with np.errstate(invalid="ignore"):
            return (self.depth_m > 0) & np.isfinite(self.depth_m) & np.isfinite(self.sigma_m) & (self.sigma_m >= 0)

    @property
    def rays(self) -> tuple[F64, F64]:
        """X / Z of each column, float64 (W,), and Y / Z of each row, float64 (H,)."""
        t, (width, height) = self.triangulation, self.size
        x, y = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
        return (x - t.cx_px) / t.f_px, (y - t.cy_px) / t.fy_px

    @property
    def rgb(self) -> U8:
        """The image as uint8 (H, W, 3) RGB, also where it is gray."""
        return np.repeat(self.color[:, :, None], 3, axis=2) if self.color.ndim == 2 else self.color

    def points(self) -> F32:
        """Points in the left rectified optical frame, float32 (H, W, 3), meters, NaN where not measured."""
        x, y = self.rays
        depth = np.where(self.measured, self.depth_m, np.float32(np.nan)).astype(np.float64)
        return np.stack((x[None] * depth, y[:, None] * depth, depth), axis=2).astype(np.float32)


def _check(name: str, array: Any, dtype: np.dtype[Any], shape: tuple[int, ...], channels: int) -> None:
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        found = getattr(array, "dtype", type(array).__name__)
        raise ImageError(
            f"{name} is {found}, a range image has {dtype}",
            subject=name,
            value=str(found),
            limit=str(dtype),
            remedy=f"convert it to {dtype}",
        )
    allowed = [shape, (*shape, channels)] if channels else [shape]
    if array.shape not in allowed:
        raise ImageError(
            f"{name} has shape {array.shape}, the depth has {shape}",
            subject=name,
            value=array.shape,
            limit=shape,
            remedy="pass arrays of the same image",
        )
