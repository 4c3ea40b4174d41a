# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Range images to meshes that are open at depth steps, and their normals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.surfaces.mesh_kernels import choose_triangles, fill_triangles, fit_planes, join, mesh_normals
from stereo_depth_ros.surfaces.range_image import RangeImage

__all__ = ["ImageMesh", "Mesh", "joined_neighbors", "mesh_of", "normal_image"]

_EDGE_SIGMAS = 3.0
_MAX_ANGLE_DEG = 88.0
_ROUNDING = np.float32(2.0**-23)  # of w and of the depth, relative; counts where the standard deviation is 0


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles.

    Attributes:
        points_m: float32 (N, 3), vertices, meters; each is in a triangle.
        triangles: int32 (M, 3), vertices of each triangle, counter-clockwise seen from where it was seen.
        normals: float32 (N, 3), unit vectors that point to the side from which the surface was seen.
        colors: uint8 (N, 3) RGB, the color of each vertex.
        sigma_m: float32 (N,), standard deviation of each vertex, meters; NaN where it was not measured.
    """

    points_m: F32
    triangles: npt.NDArray[np.int32]
    normals: F32
    colors: U8
    sigma_m: F32


@dataclass(frozen=True, eq=False)
class ImageMesh(Mesh):
    """That of a range image, in the left rectified optical frame: x right, y down, z forward.

    Attributes:
        texture_px: float32 (N, 2), x, y of each vertex in ``texture``, px; (0, 0) is the center of the first pixel.
        texture: uint8 (H, W) gray or (H, W, 3) RGB, the left rectified image.
        alone: measured pixels that are in no triangle.
    """

    texture_px: F32
    texture: U8
    alone: int


def mesh_of(
    image: RangeImage, *, edge_sigmas: float = _EDGE_SIGMAS, max_angle_deg: float = _MAX_ANGLE_DEG
) -> ImageMesh:
    """The surface of a range image: two triangles for four pixels, none across a depth step.

    Two neighbors are joined where their inverse depths w = 1 / Z, which are linear in the image on a plane, agree: the
    step from one to the other is below ``edge_sigmas`` standard deviations, or it goes on with the slope of the two
    steps before it or behind it. A single pixel between two surfaces, which matching puts there, is joined with
    neither.

    Args:
        image: the range image.
        edge_sigmas: factor of the standard deviation, above 0.
        max_angle_deg: steps above the noise are joined where the angle of view is below, 0 to 90 degrees from the
            normal.

    Raises:
        ConfigError: a parameter out of range.
    """
    _, right, down = joined_neighbors(image, edge_sigmas, max_angle_deg)
    height, width = right.shape
    chosen, counts = np.zeros((max(height - 1, 0), max(width - 1, 0)), np.uint8), np.zeros(max(height - 1, 0), np.int64)
    normals = np.empty((height, width, 3), np.float32)
    rays = image.rays
    if chosen.size:
        run_bands(choose_triangles, height - 1, image.depth_m, right, down, chosen, counts)
    run_bands(mesh_normals, height, image.depth_m, *rays, chosen, normals)
    used = np.isfinite(normals[:, :, 2])
    y, x = np.nonzero(used)
    numbers = np.empty(used.shape, np.int32)
    numbers[used] = np.arange(len(x), dtype=np.int32)
    triangles = np.empty((int(counts.sum()), 3), np.int32)
    if chosen.size:
        run_bands(fill_triangles, height - 1, chosen, np.cumsum(counts) - counts, numbers, triangles)
    depth = image.depth_m[used].astype(np.float64)
    points = np.stack((rays[0][x] * depth, rays[1][y] * depth, depth), axis=1).astype(np.float32)
    alone = int(np.count_nonzero(image.measured)) - len(x)
    pixels = np.stack((x, y), axis=1).astype(np.float32)
    return ImageMesh(points, triangles, normals[used], image.rgb[used], image.sigma_m[used], pixels, image.color, alone)


def normal_image(
    image: RangeImage,
    *,
    radius_px: int = 2,
    edge_sigmas: float = _EDGE_SIGMAS,
    max_angle_deg: float = _MAX_ANGLE_DEG,
) -> F32:
    """The normal of each pixel, from the plane through the pixels of a window that are joined with it.

    The plane is fitted to inverse depths, whose noise is that of the disparities and equal over the window (as in
    Badino, Huber, Park and Kanade, Fast and accurate computation of surface normals from range images, 2011).

    Args:
        image: the range image.
        radius_px: the window has 2 radius_px + 1 pixels, 1 to 15.
        edge_sigmas, max_angle_deg: as of :func:`mesh_of`.

    Returns:
        float32 (H, W, 3), unit vectors that point to the side of the camera; NaN where there is no plane.

    Raises:
        ConfigError: a parameter out of range.
    """
    if not 1 <= radius_px <= 15:
        raise _out_of_range("radius_px", radius_px, "1..15", (1, 15))
    w, right, down = joined_neighbors(image, edge_sigmas, max_angle_deg)
    normals = np.empty((*w.shape, 3), np.float32)
    run_bands(fit_planes, len(w), w, *image.rays, right, down, int(radius_px), normals)
    return normals


def joined_neighbors(
    image: RangeImage, edge_sigmas: float = _EDGE_SIGMAS, max_angle_deg: float = _MAX_ANGLE_DEG
) -> tuple[F32, U8, U8]:
    """Inverse depth, and which neighbors are joined; the arguments are those of :func:`mesh_of`.

    Returns:
        float32 (H, W), 1 / m, NaN where not measured, and twice uint8 (H, W): whether a pixel is joined with its right
        and its lower neighbor.

    Raises:
        ConfigError: a parameter out of range.
    """
    if not 0 < edge_sigmas < math.inf:
        raise _out_of_range("edge_sigmas", edge_sigmas, "0 (excluded) to infinity (excluded)", (0, math.inf))
    if not 0 <= max_angle_deg <= 90:
        raise _out_of_range("max_angle_deg", max_angle_deg, "0..90 degrees", (0, 90))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        w = np.where(image.measured, np.float32(1) / image.depth_m, np.float32(np.nan))
        v = np.square(image.sigma_m * w * w) + np.square(_ROUNDING * w)  # sigma_w = sigma_Z / Z^2
    right, down = np.empty(w.shape, np.uint8), np.empty(w.shape, np.uint8)
    k2, cos2_min = edge_sigmas**2, math.cos(math.radians(max_angle_deg)) ** 2
    rays: tuple[F64, F64] = image.rays
    run_bands(join, len(w), w, v, *rays, k2, cos2_min, right, down)
    return w, right, down


def _out_of_range(name: str, value: Any, text: str, limit: tuple[float, float]) -> ConfigError:
    return ConfigError(
        f"{name} = {value} is outside of {text}",
        value=value,
        limit=limit,
        remedy="set a value in this range",
        settings=(name,),
    )
