# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Points of a range sensor as sparse disparities of the left rectified image, without those that it does not see.

A sensor at another place looks past the edges of near objects: it sees points that are hidden to the camera, and whose
pixels lie between the pixels of the near object. Each point therefore stands for a patch of surface as large as its
distance to the next points in the image, and what lies behind the patch is removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, F64

__all__ = ["SparseDisparity", "project", "rectified_from_left"]

I32: TypeAlias = npt.NDArray[np.int32]
Mask: TypeAlias = npt.NDArray[np.bool_]

WIDEST_GAP_PX = 32  # between neighbors; where there are none up to it, it is used
_TILE_PX = 64  # gaps are the medians of tiles
_FEWEST = 16  # points of a tile; with fewer the gaps of the whole image are used
_PATCH = 1.0  # half of a patch, as a share of the gap
_STEP_PX = 1.0  # between the disparities of two surfaces, at least
_SLOPE = 0.5  # of a surface, pixels of disparity for one of the image
_NOISE = 3.0  # standard deviations by which two points of one surface differ at most


@dataclass(frozen=True, eq=False)
class SparseDisparity:
    """What the left rectified camera sees of the points of a range sensor.

    Attributes:
        disparity_px: float32 (H, W), x_left - x_right in pixels, NaN where there is none.
        sigma_px: float32 (H, W), their standard deviations by the noise of the ranges, pixels, NaN where there is none.
        index: int32 (H, W), number of the point of each pixel, -1 where there is none.
        points: number of points given.
        behind: of them, those that are not in front of the camera.
        outside: those whose pixel is outside of the image.
        occluded: those that a nearer surface hides.
        merged: those of the same surface and pixel as a nearer one.
    """

    disparity_px: F32
    sigma_px: F32
    index: I32
    points: int
    behind: int
    outside: int
    occluded: int
    merged: int

    @property
    def visible(self) -> int:
        """Number of pixels with a disparity."""
        return self.points - self.behind - self.outside - self.occluded - self.merged


def rectified_from_left(rig: StereoRig) -> Pose:
    """The pose from the frame of the left camera, which transforms name, to the left rectified camera."""
    return Pose(rig.left.R, np.zeros(3))


def project(
    points_m: F32, sigma_m: float, camera_from_sensor: Pose, triangulation: Triangulation, size: tuple[int, int]
) -> SparseDisparity:
    """Points as disparities of the left rectified image, d = f B / Z + doffs, each in its nearest pixel.

    Of several points in a pixel the nearest one counts (Catmull 1974, z-buffer), the first one of those that differ by
    noise. A point is hidden where a nearer one is within the gap between neighbors, along x and y each, and the
    disparities differ by more than 1 px, half a pixel for each pixel between them, and three standard deviations. The
    gap is the median of a tile of 64 x 64 px, at most 32 px. The standard deviation of a disparity is f B / Z^2 times
    that of the range, the largest that it may be.

    Args:
        points_m: float32 (N, 3), in the frame of the sensor, meters; those that are not finite count as behind.
        sigma_m: standard deviation of the ranges, meters.
        camera_from_sensor: pose from the sensor to the left rectified camera, see :func:`rectified_from_left`.
        triangulation: of the rig.
        size: width and height of the image, px.

    Raises:
        ImageError: points of another shape or type.
    """
    if points_m.dtype != np.float32 or points_m.ndim != 2 or points_m.shape[1] != 3:
        raise ImageError(
            f"points are {points_m.dtype} {points_m.shape}, float32 (N, 3) is expected",
            value=(str(points_m.dtype), points_m.shape),
            limit="float32 (N, 3)",
            remedy="pass x, y, z of each point",
        )
    width, height = size
    camera = np.array(
        [triangulation.f_px, triangulation.fy_px, triangulation.cx_px, triangulation.cy_px, triangulation.doffs_px]
    )
    f_baseline = triangulation.f_px * triangulation.baseline_m
    index = np.full((height, width), -1, np.int32)
    disparities, sigmas = (np.full((height, width), np.nan, np.float32) for _ in range(2))
    counts = np.zeros(4, np.int64)
    pose = np.ascontiguousarray(camera_from_sensor.matrix[:3])
    maps = (index, disparities, sigmas)
    _fill(np.ascontiguousarray(points_m), pose, camera, f_baseline, sigma_m, *maps, counts)
    hidden = np.zeros((height, width), np.bool_)
    run_bands(_hide, height, disparities, sigmas, *_gaps(index), hidden)
    disparities[hidden] = sigmas[hidden] = np.nan
    index[hidden] = -1
    behind, outside, occluded, merged = (int(count) for count in counts)
    occluded += int(np.count_nonzero(hidden))
    return SparseDisparity(disparities, sigmas, index, len(points_m), behind, outside, occluded, merged)


def _gaps(index: I32) -> tuple[F64, F64]:
    """Pixels between neighbors along x and along y, float64 (rows, columns) of tiles each."""
    rows, columns = (-(-length // _TILE_PX) for length in index.shape)
    histograms = np.zeros((2, rows, columns, WIDEST_GAP_PX + 1), np.int64)
    # bands of whole tiles, so that no two of them count in the same histogram
    run_bands(_measure_gaps, rows, index, histograms, min_rows=1)
    of_all = _medians(histograms.sum(axis=(1, 2), keepdims=True))
    few = histograms.sum(axis=3) < _FEWEST
    medians = np.where(few, of_all, _medians(histograms))
    return np.ascontiguousarray(medians[0]), np.ascontiguousarray(medians[1])


def _medians(histograms: npt.NDArray[np.int64]) -> F64:
    """The median of each histogram of 0, 1, ... along the last axis, between two of them by their shares."""
    total = histograms.cumsum(axis=-1)
    half = total[..., -1:] / 2
    at = np.argmax(total >= np.maximum(half, 0.5), axis=-1)[..., None]
    own = np.take_along_axis(histograms, at, axis=-1)
    before = np.take_along_axis(total, at, axis=-1) - own
    return np.asarray((at + (half - before) / np.maximum(own, 1) - 0.5)[..., 0], np.float64)


_POINTS = "Array(float32, 2, 'C', readonly=True)"
_MAP = "float32[:, ::1]"


@compiled()
def _project(points_m: F32, at: int, pose: F64, camera: F64, f_baseline: float) -> tuple[float, float, float, float]:
    """Column, row, disparity and depth of a point; the depth is 0 or less, or NaN, where it is not before the camera.

    The camera is fx, fy, cx, cy, doffs.
    """
    x, y, z = points_m[at, 0], points_m[at, 1], points_m[at, 2]
    depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
    if not depth > 0.0:
        return 0.0, 0.0, 0.0, 0.0
    u = camera[0] * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / depth + camera[2]
    v = camera[1] * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / depth + camera[3]
    return u, v, f_baseline / depth + camera[4], depth


@compiled(
    f"void({_POINTS}, float64[:, ::1], float64[::1], float64, float64, int32[:, ::1], {_MAP}, {_MAP}, int64[::1])"
)
def _fill(
    points_m: F32,
    pose: F64,
    camera: F64,
    f_baseline: float,
    sigma_m: float,
    index: I32,
    disparities: F32,
    sigmas: F32,
    counts: npt.NDArray[np.int64],
) -> None:
    """Put the nearest point of each pixel there; count those behind the camera, outside, hidden, and merged."""
    height, width = index.shape
    for at in range(points_m.shape[0]):
        u, v, d, depth = _project(points_m, at, pose, camera, f_baseline)
        if not depth > 0.0 or not np.isfinite(depth):
            counts[0] += 1
        elif not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            counts[1] += 1
        else:
            x, y = int(u + 0.5), int(v + 0.5)
            sigma = f_baseline / (depth * depth) * sigma_m
            step = d - disparities[y, x]  # above that of the point that is there
            if index[y, x] >= 0:
                counts[2 if abs(step) > _STEP_PX + _NOISE * sigma else 3] += 1
            # not the nearest one by its noise: that would be too near on average
            if index[y, x] < 0 or step > _NOISE * sigma:
                disparities[y, x], sigmas[y, x] = d, sigma
                index[y, x] = at


@compiled("void(int64, int64, int32[:, ::1], int64[:, :, :, ::1])")
def _measure_gaps(first: int, last: int, index: I32, histograms: npt.NDArray[np.int64]) -> None:
    """Count how far it is from each point to the next one along x, and along y, within 27 degrees of the axis."""
    height, width = index.shape
    for y in range(first * _TILE_PX, min(last * _TILE_PX, height)):
        for x in range(width):
            if index[y, x] < 0:
                continue
            gap_x = gap_y = WIDEST_GAP_PX
            for gap in range(1, WIDEST_GAP_PX):
                aside = gap // 2
                if x + gap < width and gap_x == WIDEST_GAP_PX:
                    for other in range(max(y - aside, 0), min(y + aside + 1, height)):
                        if index[other, x + gap] >= 0:
                            gap_x = gap
                            break
                if y + gap < height and gap_y == WIDEST_GAP_PX:
                    for other in range(max(x - aside, 0), min(x + aside + 1, width)):
                        if index[y + gap, other] >= 0:
                            gap_y = gap
                            break
                if gap_x < WIDEST_GAP_PX and gap_y < WIDEST_GAP_PX:
                    break
            histograms[0, y // _TILE_PX, x // _TILE_PX, gap_x] += 1
            histograms[1, y // _TILE_PX, x // _TILE_PX, gap_y] += 1


@compiled(f"void(int64, int64, {_MAP}, {_MAP}, float64[:, ::1], float64[:, ::1], boolean[:, ::1])")
def _hide(first: int, last: int, disparities: F32, sigmas: F32, gaps_x: F64, gaps_y: F64, hidden: Mask) -> None:
    """Mark the points behind the patches of those in the rows from ``first`` to ``last``, in any rows."""
    height, width = disparities.shape
    for y in range(first, last):
        for x in range(width):
            near = disparities[y, x]
            if np.isnan(near):
                continue
            limit = near - np.float32(_STEP_PX + _NOISE * sigmas[y, x])
            beside = max(int(_PATCH * gaps_x[y // _TILE_PX, x // _TILE_PX] + 0.5), 1)
            above = max(int(_PATCH * gaps_y[y // _TILE_PX, x // _TILE_PX] + 0.5), 1)
            for v in range(max(y - above, 0), min(y + above + 1, height)):
                for u in range(max(x - beside, 0), min(x + beside + 1, width)):
                    far = disparities[v, u]
                    if far < limit and far < limit - _SLOPE * max(abs(u - x), abs(v - y)):  # false of NaN
                        hidden[v, u] = True
