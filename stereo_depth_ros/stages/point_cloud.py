# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Organized point clouds: from disparities directly to the payload of a PointCloud2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.config import CloudConfig, PointConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.triangulation import Triangulation, pixel_depth
from stereo_depth_ros.core.types import F32, U8

__all__ = ["CloudLayout", "pack_points"]

_WORDS = "float32[:, :, ::1]"


@dataclass(frozen=True)
class CloudLayout:
    """Memory layout of a point; x, y, z are float32 at bytes 0, 4 and 8, meters, NaN where invalid.

    Attributes:
        point_step: bytes per point.
        rgb_offset: byte offset of the packed color (as float32, bytes blue, green, red, 0), or None.
        quality_offset: byte offset of the confidence, 0..1, which the standard deviation of the depth follows, meters;
            both float32; or None.
    """

    point_step: int
    rgb_offset: int | None
    quality_offset: int | None = None

    @classmethod
    def of(cls, config: PointConfig) -> CloudLayout:
        """The layouts of stereo_image_proc: 32 bytes with color, 16 without; unpadded 16 and 12.

        Confidence and standard deviation come behind them: where there is no padding for them 8 or 16 bytes more.
        """
        step, rgb_offset = {
            (False, False): (16, None),
            (False, True): (32, 16),
            (True, False): (12, None),
            (True, True): (16, 12),
        }[config.avoid_point_cloud_padding, config.use_color]
        if not (isinstance(config, CloudConfig) and config.point_quality):
            return cls(step, rgb_offset)
        if config.avoid_point_cloud_padding:
            return cls(step + 8, rgb_offset, step)
        return cls(32, rgb_offset, 20 if config.use_color else 16)


def pack_points(
    disparity_px: F32,
    triangulation: Triangulation,
    layout: CloudLayout,
    points: U8,
    color: U8 | None = None,
    color_encoding: str = "mono8",
    quality: tuple[F32, F32] | None = None,
) -> None:
    """Write the points of a disparity map, row by row, into the payload of an organized cloud.

    Args:
        disparity_px: float32 (H, W), NaN where invalid.
        triangulation: the geometry of the rig.
        layout: memory layout of a point.
        points: uint8 (H * W * point_step,), the payload; padding bytes are unchanged.
        color: uint8 (H, W) or (H, W, 3), the left rectified image; required if the layout has a color.
        color_encoding: "mono8", "rgb8" or "bgr8".
        quality: confidence and standard deviation of the depth, meters, float32 (H, W); required if the layout has
            them.

    Raises:
        ImageError: image and disparities differ in size, or the payload has another length.
    """
    height, width = disparity_px.shape
    if points.nbytes != height * width * layout.point_step:
        raise ImageError(
            f"payload of {points.nbytes} bytes, {width}x{height} points of {layout.point_step} take "
            f"{height * width * layout.point_step}",
            value=points.nbytes,
            limit=height * width * layout.point_step,
            remedy="allocate that many",
        )
    t = triangulation
    geometry = (
        np.float32(t.doffs_px),
        np.float32(t.f_px * t.baseline_m),
        ((np.arange(width) - t.cx_px) / t.f_px).astype(np.float32),
        ((np.arange(height) - t.cy_px) / t.fy_px).astype(np.float32),
    )
    words = points.view(np.float32).reshape(height, width, layout.point_step // 4)
    if layout.quality_offset is not None:
        for word, values in enumerate(_checked_quality(quality, (height, width)), start=layout.quality_offset // 4):
            words[:, :, word] = values
    if layout.rgb_offset is None:
        run_bands(_pack_xyz, height, disparity_px, *geometry, words)
        return
    if color is None or color.shape[:2] != (height, width):
        shape = None if color is None else color.shape[:2]
        raise ImageError(
            f"left image of {shape}, the disparities have {(height, width)} (rows, columns)",
            value=shape,
            limit=(height, width),
            remedy="pass the left image of the disparities, or use no color",
            settings=("use_color",),
        )
    colors = color.reshape(height, width, -1)
    channels = {"mono8": (0, 0, 0), "rgb8": (0, 1, 2), "bgr8": (2, 1, 0)}[color_encoding]
    red, green, blue = channels
    rgb = points.view(np.uint32).reshape(words.shape)
    word = layout.rgb_offset // 4
    run_bands(_pack_xyz_rgb, height, disparity_px, *geometry, words, rgb, word, colors, red, green, blue)


def _checked_quality(quality: tuple[F32, F32] | None, shape: tuple[int, int]) -> tuple[F32, F32]:
    shapes = None if quality is None else tuple(values.shape for values in quality)
    if quality is None or shapes != (shape, shape):
        raise ImageError(
            f"confidence and standard deviation of {shapes}, the disparities have {shape} (rows, columns)",
            value=shapes,
            limit=shape,
            remedy="pass those of the disparities, or leave them out",
            settings=("point_quality",),
        )
    return quality


@compiled(f"void(int64, int64, float32[:, ::1], float32, float32, float32[::1], float32[::1], {_WORDS})")
def _pack_xyz(
    first: int,
    last: int,
    disparity_px: F32,
    doffs: np.float32,
    f_baseline: np.float32,
    rays_x: F32,
    rays_y: F32,
    xyz: F32,
) -> None:
    for v in range(first, last):
        for u in range(disparity_px.shape[1]):
            z = pixel_depth(disparity_px[v, u], doffs, f_baseline)
            xyz[v, u, 0] = rays_x[u] * z
            xyz[v, u, 1] = rays_y[v] * z
            xyz[v, u, 2] = z


@compiled(
    f"void(int64, int64, float32[:, ::1], float32, float32, float32[::1], float32[::1], {_WORDS}, uint32[:, :, ::1], "
    "int64, Array(uint8, 3, 'C', readonly=True), int64, int64, int64)"
)
def _pack_xyz_rgb(
    first: int,
    last: int,
    disparity_px: F32,
    doffs: np.float32,
    f_baseline: np.float32,
    rays_x: F32,
    rays_y: F32,
    xyz: F32,
    rgb: U8,
    word: int,
    colors: U8,
    red: int,
    green: int,
    blue: int,
) -> None:
    for v in range(first, last):
        for u in range(disparity_px.shape[1]):
            z = pixel_depth(disparity_px[v, u], doffs, f_baseline)
            xyz[v, u, 0] = rays_x[u] * z
            xyz[v, u, 1] = rays_y[v] * z
            xyz[v, u, 2] = z
            r, g, b = np.uint32(colors[v, u, red]), np.uint32(colors[v, u, green]), np.uint32(colors[v, u, blue])
            rgb[v, u, word] = (r << np.uint32(16)) | (g << np.uint32(8)) | b
