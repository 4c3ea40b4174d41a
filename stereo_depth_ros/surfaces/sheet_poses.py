# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses of range images of an object on a sheet of dots, from the dots that their color images show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import RegistrationError, StereoDepthError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.levenberg_marquardt import StopRules, damped_step, minimize
from stereo_depth_ros.surfaces.marks import DotSheet, find_dots, match_dots, plane_of_most
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.registration import moved_by

__all__ = ["SheetPoses", "rigid_pose", "sheet_poses"]

_AROUND_PX = 3  # around a dot, whose own depth is less certain: the depth of it is the median of both
_FEWEST = 4  # pixels of it that are measured
_CURVED_M = 0.001  # how far paper is from a plane, and a depth from itself, besides the noise
_SIGMA_PX = 0.2  # of the center of a dot
_HUBER = 2.0
_STOP = StopRules(60, 1e-8, 3, 1e8)


@dataclass(frozen=True, eq=False)
class SheetPoses:
    """Poses in the frame of a sheet: origin in its middle, x right, y up in its image, z out of the sheet, meters.

    Attributes:
        views: numbers of the range images whose pose is known.
        poses: from the camera of each of these to the sheet.
        covariances: float64 (V, 6, 6), as of :class:`Registration`, in the frame of the sheet.
        dots_m: float64 (M, 3), the fused position of each dot; NaN for those that fewer than two views show.
        size_m: width and height of the image of the sheet as it is printed.
        reprojection_px: root mean square distance of the dots in the images from where the fused positions are seen.
        flatness_m: root mean square distance of the fused positions from their common plane.
        spread_m: root mean square distance of the positions that single views measure, by their depths, from the fused
            ones.
        refused: an error for each range image without a pose.
    """

    views: tuple[int, ...]
    poses: tuple[Pose, ...]
    covariances: F64
    dots_m: F64
    size_m: tuple[float, float]
    reprojection_px: float
    flatness_m: float
    spread_m: float
    refused: tuple[StereoDepthError, ...]


@dataclass(frozen=True, eq=False)
class _SheetView:
    """What one view shows.

    Attributes:
        dots: int (K,), numbers of the dots of the sheet.
        pixels: float64 (K, 2).
        depth_m, sigma_m: float64 (K,), measured.
        on_plane: float64 (K, 3), where the rays meet the plane of the sheet.
        scale: size of a pixel of the image of the sheet, m.
    """

    dots: npt.NDArray[np.intp]
    pixels: F64
    depth_m: F64
    sigma_m: F64
    on_plane: F64
    scale: float


def sheet_poses(images: Sequence[RangeImage], sheet: DotSheet, names: Sequence[str] = ()) -> SheetPoses:
    """The poses of range images that show dots of the same sheet, refined together.

    The dots of each view are found by :func:`find_dots`, identified in the plane that most of them lie on
    (:func:`match_dots`), and give a first pose. Then all poses and positions of dots are refined together: least
    squared distances of dots in the images, and of depths (bundle adjustment, Triggs and others 2000), weighted by
    Huber.

    Args:
        images: range images with color, of one object that does not move on the sheet.
        sheet: the sheet.
        names: of the images, for errors; their numbers by default.

    Raises:
        RegistrationError: fewer than two views show enough dots.
    """
    names = names or [f"view {number}" for number in range(len(images))]
    found: dict[int, _SheetView] = {}
    refused: list[StereoDepthError] = []
    for number, image in enumerate(images):
        try:
            found[number] = _view(image, sheet, names[number])
        except RegistrationError as error:
            refused.append(error)
    if len(found) < 2:
        raise RegistrationError(
            f"{len(found)} of {len(images)} views show the sheet, 2 are the least"
            + "".join(f"; {error}" for error in refused[:3]),
            value=len(found),
            limit=2,
            remedy="show the sheet sharp and lit in all views, and give the image of this sheet",
        )
    scale = float(np.median([view.scale for view in found.values()]))
    width, height = sheet.size
    printed = scale * (sheet.dots_px - np.array([width - 1, height - 1]) / 2) * np.array([1, -1])
    start = np.concatenate((printed, np.zeros((len(printed), 1))), axis=1)
    poses = [rigid_pose(start[view.dots], view.on_plane) for view in found.values()]
    bundle = minimize(
        _Bundle([*found.values()], [_intrinsics(images[number]) for number in found], poses, start), _STOP
    )
    seen = np.bincount(np.concatenate([view.dots for view in found.values()]), minlength=len(start))
    used = seen >= 2
    back = rigid_pose(bundle.dots[used], start[used])  # into the frame of the sheet
    dots = np.where(used[:, None], back.apply(bundle.dots), np.nan)
    final = [back @ pose.inverse() for pose in bundle.poses]
    return SheetPoses(
        tuple(found),
        tuple(final),
        np.array([bundle.covariance(number, pose) for number, pose in enumerate(final)]),
        dots,
        (scale * width, scale * height),
        bundle.reprojection_px(),
        _flatness(dots[used]),
        _spread([*found.values()], [_intrinsics(images[number]) for number in found], final, dots),
        tuple(refused),
    )


def rigid_pose(source: F64, target: F64) -> Pose:
    """The pose of least squared distances from points to others, float64 (N, 3) each (Umeyama 1991, equation 40)."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    U, _, Vt = np.linalg.svd((target - b).T @ (source - a))
    R = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return Pose(R, b - R @ a)


def _intrinsics(image: RangeImage) -> F64:
    t = image.triangulation
    return np.array([t.f_px, t.fy_px, t.cx_px, t.cy_px])


def _rays(pixels: F64, intrinsics: F64) -> F64:
    fx, fy, cx, cy = intrinsics
    return np.stack(((pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy, np.ones(len(pixels))), axis=1)


def _view(image: RangeImage, sheet: DotSheet, name: str) -> _SheetView:
    gray = image.color if image.color.ndim == 2 else cv2.cvtColor(image.color, cv2.COLOR_RGB2GRAY)
    found = find_dots(np.asarray(gray, np.uint8))
    depth, sigma = _depths(image, found)
    measured = np.isfinite(depth)
    found, depth, sigma = found[measured], depth[measured], sigma[measured]
    if len(found) < 4:
        raise RegistrationError(
            f"{len(found)} dark dots with a depth, 4 are the least",
            subject=name,
            value=len(found),
            limit=4,
            remedy="show the sheet sharp and lit, and near enough for a depth",
        )
    rays = _rays(found[:, :2], _intrinsics(image))
    normal, distance, on = plane_of_most(rays * depth[:, None], np.hypot(sigma, _CURVED_M))
    right = np.cross([0.0, 1.0, 0.0], normal)  # as the camera sees the sheet: its image is not mirrored
    right = right / np.linalg.norm(right)
    on_plane = rays[on] * (distance / (rays[on] @ normal))[:, None]
    flat = np.stack((on_plane @ right, on_plane @ np.cross(normal, right)), axis=1)
    diameters = found[on, 2] * depth[on] / image.triangulation.f_px
    match = match_dots(flat, diameters, sheet, name)
    kept = on[match.found]
    return _SheetView(match.dots, found[kept, :2], depth[kept], sigma[kept], on_plane[match.found], match.scale)


def _depths(image: RangeImage, found: F64) -> tuple[F64, F64]:
    """The depth at each dot and its standard deviation: medians of the pixels of it and around it; NaN without."""
    depth, sigma = np.full(len(found), np.nan), np.full(len(found), np.nan)
    known = np.where(image.measured, image.depth_m, np.float32(np.nan))
    for number, (x, y, diameter) in enumerate(found):
        reach = math.ceil(diameter / 2) + _AROUND_PX
        column, row = round(x), round(y)
        window = np.s_[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
        inside = np.isfinite(known[window])
        if np.count_nonzero(inside) >= _FEWEST:
            depth[number] = np.median(known[window][inside])
            sigma[number] = np.median(image.sigma_m[window][inside])
    return depth, sigma


class _Bundle:
    """Poses from the sheet to each camera, and positions of dots; see :class:`Iterate`."""

    def __init__(self, views: list[_SheetView], intrinsics: list[F64], poses: list[Pose], dots: F64) -> None:
        self._views, self._intrinsics = views, intrinsics
        self.poses, self.dots = poses, dots
        self._residuals = [self._residual(number) for number in range(len(views))]
        sizes = np.concatenate([np.linalg.norm(pixel, axis=1) for pixel, _ in self._residuals])
        depths = np.concatenate([np.abs(depth) for _, depth in self._residuals])
        self.cost = float(np.sum(_huber(sizes)) + np.sum(_huber(depths)))

    def _points(self, number: int) -> F64:
        return self.poses[number].apply(self.dots[self._views[number].dots])

    def _residual(self, number: int) -> tuple[F64, F64]:
        """Differences in standard deviations: float64 (K, 2) of pixels, (K,) of depths."""
        view, (fx, fy, cx, cy), p = self._views[number], self._intrinsics[number], self._points(number)
        seen = np.stack((fx * p[:, 0] / p[:, 2] + cx, fy * p[:, 1] / p[:, 2] + cy), axis=1)
        return (seen - view.pixels) / _SIGMA_PX, (p[:, 2] - view.depth_m) / np.hypot(view.sigma_m, _CURVED_M)

    def _rows(self, number: int) -> tuple[F64, F64, F64]:
        """Weighted residuals, float64 (K, 3), and their derivatives by the camera, (K, 3, 6), and dots, (K, 3, 3)."""
        view, (fx, fy, _, _), p = self._views[number], self._intrinsics[number], self._points(number)
        pixel, depth = self._residuals[number]
        by_point = np.zeros((len(p), 3, 3))
        x, y, z = p.T
        by_point[:, 0, 0], by_point[:, 0, 2] = fx / z, -fx * x / z**2
        by_point[:, 1, 1], by_point[:, 1, 2] = fy / z, -fy * y / z**2
        by_point[:, :2] /= _SIGMA_PX
        by_point[:, 2, 2] = 1 / np.hypot(view.sigma_m, _CURVED_M)
        of_pixel = np.sqrt(np.minimum(1, _HUBER / np.maximum(np.linalg.norm(pixel, axis=1), 1e-12)))
        of_depth = np.sqrt(np.minimum(1, _HUBER / np.maximum(np.abs(depth), 1e-12)))
        weight = np.stack((of_pixel, of_pixel, of_depth), axis=1)
        by_point *= weight[:, :, None]
        moved = np.zeros((len(p), 3, 6))
        moved[:, 0, 1], moved[:, 0, 2], moved[:, 1, 0] = z, -y, -z
        moved[:, 1, 2], moved[:, 2, 0], moved[:, 2, 1] = x, y, -x
        moved[:, :, 3:] = np.identity(3)
        residual = np.concatenate((pixel, depth[:, None]), axis=1) * weight
        return residual, by_point @ moved, by_point @ self.poses[number].rotation

    def trial(self, damping: float) -> _Bundle:
        cameras = 6 * len(self._views)
        normal = np.zeros((cameras + 3 * len(self.dots),) * 2)
        gradient = np.zeros(len(normal))
        for number, view in enumerate(self._views):
            residual, by_camera, by_dot = self._rows(number)
            for k, dot in enumerate(view.dots):
                place = np.concatenate((np.arange(6 * number, 6 * number + 6), cameras + 3 * dot + np.arange(3)))
                jacobian = np.concatenate((by_camera[k], by_dot[k]), axis=1)
                normal[np.ix_(place, place)] += jacobian.T @ jacobian
                gradient[place] += jacobian.T @ residual[k]
        step = damped_step(normal, gradient, damping)
        poses = [moved_by(pose, step[6 * n : 6 * n + 6]) for n, pose in enumerate(self.poses)]
        return _Bundle(self._views, self._intrinsics, poses, self.dots + step[cameras:].reshape(-1, 3))

    def covariance(self, number: int, sheet_from_camera: Pose) -> F64:
        """That of a motion after ``sheet_from_camera``, float64 (6, 6), for these positions of the dots."""
        _, by_camera, _ = self._rows(number)
        rows = by_camera.reshape(-1, 6)
        R, (x, y, z) = sheet_from_camera.rotation, sheet_from_camera.translation_m
        turned = np.zeros((6, 6))  # a motion of the sheet in the frame of the camera, seen in that of the sheet
        turned[:3, :3] = turned[3:, 3:] = R
        turned[3:, :3] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ R
        squared = np.concatenate([np.concatenate((pixel.ravel(), depth)) for pixel, depth in self._residuals])
        scale = max(1.0, float(np.mean(np.square(np.clip(squared, -_HUBER, _HUBER)))))
        return np.asarray(scale * turned @ np.linalg.inv(rows.T @ rows) @ turned.T, np.float64)

    def reprojection_px(self) -> float:
        pixel = np.concatenate([pixel for pixel, _ in self._residuals])
        return _SIGMA_PX * math.sqrt(float(np.mean(np.sum(np.square(pixel), axis=1))))


def _huber(r: F64) -> F64:
    return np.where(r <= _HUBER, r * r, 2 * _HUBER * r - _HUBER**2)


def _flatness(dots: F64) -> float:
    values = np.linalg.svd(dots - dots.mean(axis=0), compute_uv=False)
    return float(values[2]) / math.sqrt(len(dots))


def _spread(views: list[_SheetView], intrinsics: list[F64], poses: list[Pose], dots: F64) -> float:
    squared = []
    for view, camera, pose in zip(views, intrinsics, poses, strict=True):
        single = pose.apply(_rays(view.pixels, camera) * view.depth_m[:, None])
        squared.append(np.sum(np.square(single - dots[view.dots]), axis=1))
    return math.sqrt(float(np.nanmean(np.concatenate(squared))))
