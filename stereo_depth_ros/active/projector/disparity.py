# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Disparities of one camera and a projector, from what each pixel of the camera sees of the projector."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.projector.raster import resized_points
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, ImageError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, MatchResult, Reason
from stereo_depth_ros.geometry.epipolar import homogeneous
from stereo_depth_ros.geometry.rays import rectify_points

__all__ = ["disparity_from_projector"]

_LEAST_PIXELS = 50  # from which the whole map is judged
_ROW_SIGMAS, _ROW_PROJECTOR_PX = 6.0, 2.0  # of the row error: a calibration is exact to a fraction of a pixel
_LEAST_CROSSING = 0.17  # sine of 10 degrees
_STEPS, _CONVERGED_PX = 30, 1e-3  # of the distortion of a point in a plane of light


def disparity_from_projector(rig: StereoRig, projector_map: ProjectorMap) -> MatchResult:
    """Disparities of one camera and a projector, an inverse camera whose pixels need no search: they are decoded.

    With columns and rows the projector pixel is undistorted and rectified as that of a camera. It lies on the row of
    the camera pixel but for errors, so a pixel whose row differs by more than 6 sigma and 2 projector px is not used.
    With one coordinate alone, which is a plane of light, it is the point of the plane on the row of the camera pixel:
    with the homography H from rectified to raw projector pixels, u (h3 p) = h1 p is linear in the x of p = (x, y, 1).
    The distortion is added by iteration.

    Args:
        rig: the left camera, and the projector as the right one, stored as a camera of the size of the left one.
        projector_map: decoded from images that were rectified by the rig.

    Returns:
        disparities, reasons and sigma of the left rectified image. The reasons are those of the map, with RANGE where
        the point is not in front of the camera, UNIQUENESS where the row shows that the code is wrong.

    Raises:
        ImageError: a map of another size than the images of the rig, or without any decoded pixel.
        CalibrationError: most rows differ, so the calibration is not that of this projector; or the one coordinate
            that is coded runs along the rows.
    """
    _check_size(rig, projector_map)
    y, x = np.nonzero(projector_map.reasons == 0)
    if not len(y):
        raise ImageError(
            f"no pixel of {projector_map.reasons.size} is decoded",
            subject="projector map",
            value=0,
            limit=1,
            remedy="check that the projector lights what the camera sees, the exposure, and the order of the images",
        )
    pixels = np.column_stack((x, y)).astype(np.float64)
    if projector_map.column_px is not None and projector_map.row_px is not None:
        found = _from_both(rig, projector_map, pixels)
    else:
        found = _from_one(rig, projector_map, pixels)
    shape = projector_map.reasons.shape
    disparity_px, sigma_px = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    reasons = projector_map.reasons.copy()
    d = x - found.x
    rejected = np.where(found.doubtful, int(Reason.UNIQUENESS), 0)
    rejected |= np.where(np.isfinite(d) & (d <= rig.doffs_px), int(Reason.RANGE), 0)
    rejected |= np.where(np.isfinite(d), 0, int(Reason.NO_MATCH))
    reasons[y, x] = rejected
    valid = rejected == 0
    disparity_px[y[valid], x[valid]] = d[valid]
    sigma_px[y[valid], x[valid]] = found.sigma[valid]
    step_px = float(np.median(found.sigma[valid])) if valid.any() else 1.0
    return MatchResult(disparity_px, reasons, step_px, sigma_px=sigma_px)


class _Found(NamedTuple):
    """Columns x of the rectified projector, float64 (N,), their standard deviations, and whether the code is wrong."""

    x: F64
    sigma: F64
    doubtful: npt.NDArray[np.bool_]


def _from_both(rig: StereoRig, projector_map: ProjectorMap, pixels: F64) -> _Found:
    columns, rows = _coded(projector_map.column_px, pixels), _coded(projector_map.row_px, pixels)
    size, stored = projector_map.size, (rig.width, rig.height)
    points = rectify_points(resized_points(np.column_stack((columns, rows)), size, stored), rig.right)
    H = _raw_homography(rig.right)
    G = np.linalg.inv(H)
    # how far a rectified point moves with one pixel of the projector along columns and rows; distortion left out
    per_px = np.array([stored[0] / size[0], stored[1] / size[1]])
    ahead = homogeneous(points) @ H[2]
    moves = (G[:2, :2] - points[:, :, None] * G[2, :2]) * ahead[:, None, None] * per_px
    lengths = np.linalg.norm(moves, axis=2)
    sigma = _coded(projector_map.sigma_px, pixels)[:, None] * lengths
    error = np.abs(points[:, 1] - pixels[:, 1])
    doubtful = ~(error <= np.maximum(_ROW_SIGMAS * sigma[:, 1], _ROW_PROJECTOR_PX * lengths[:, 1]))
    if len(pixels) >= _LEAST_PIXELS and doubtful.mean() > 0.5:
        raise CalibrationError(
            f"the rows of {100 * doubtful.mean():.0f} % of {len(pixels)} decoded pixels differ from those of the "
            f"projector, their median by {np.nanmedian(error):.1f} px",
            subject="rig",
            value=float(np.nanmedian(error)),
            limit=_ROW_PROJECTOR_PX,
            remedy="use the calibration of this camera and projector, images that it rectified, and calibrate again "
            "after one of them was moved, zoomed or set to another resolution",
        )
    return _Found(points[:, 0], sigma[:, 0], doubtful)


def _from_one(rig: StereoRig, projector_map: ProjectorMap, pixels: F64) -> _Found:
    axis = 0 if projector_map.column_px is not None else 1
    coded = _coded(projector_map.column_px if axis == 0 else projector_map.row_px, pixels)
    size, stored = projector_map.size, (rig.width, rig.height)
    u = resized_points(np.column_stack((coded, coded)), size, stored)[:, axis]
    H, y = _raw_homography(rig.right), pixels[:, 1]
    bent = np.zeros_like(u)  # of the point by the distortion, along the axis
    x = np.zeros_like(u)
    for _ in range(_STEPS):
        before, ideal = x, u - bent
        x = (H[axis, 1] * y + H[axis, 2] - ideal * (H[2, 1] * y + H[2, 2])) / (ideal * H[2, 0] - H[axis, 0])
        if not rig.right.D.any() or not np.nanmax(np.abs(x - before)) > _CONVERGED_PX:
            break
        bent = _distorted(rig.right, np.column_stack((x, y)))[:, axis] - ideal
    ahead = homogeneous(np.column_stack((x, y))) @ H[2]
    across, along = ((H[axis, n] - (u - bent) * H[2, n]) / ahead for n in (0, 1))
    crossing = np.abs(across) / np.hypot(across, along)
    if np.median(crossing) < _LEAST_CROSSING:
        coded_name, other = ("columns", "rows") if axis == 0 else ("rows", "columns")
        angle_deg = float(np.degrees(np.arcsin(np.median(crossing))))
        raise CalibrationError(
            f"the {coded_name} of the projector run along the rows of the rectified image, {angle_deg:.1f} degrees "
            f"off, limit {np.degrees(np.arcsin(_LEAST_CROSSING)):.0f}: they give no depth",
            subject="projector map",
            value=angle_deg,
            limit=float(np.degrees(np.arcsin(_LEAST_CROSSING))),
            remedy=f"project {other}, or both",
        )
    sigma = _coded(projector_map.sigma_px, pixels) * stored[axis] / size[axis] / np.abs(across)
    return _Found(np.where(ahead > 0, x, np.nan), sigma, np.zeros(len(x), bool))


def _raw_homography(camera: CameraModel) -> F64:
    """float64 (3, 3), from rectified pixels to raw ones without distortion; the third coordinate is above 0 ahead."""
    H: F64 = camera.K @ camera.R.T @ np.linalg.inv(camera.P[:, :3])
    return H


def _distorted(camera: CameraModel, points: F64) -> F64:
    """Raw pixels, float64 (N, 2), of rectified ones."""
    rays = homogeneous(points) @ (camera.R.T @ np.linalg.inv(camera.P[:, :3])).T
    none = np.zeros(3)
    if camera.distortion_model == "equidistant":
        return np.asarray(cv2.fisheye.projectPoints(rays[:, None], none, none, camera.K, camera.D)[0][:, 0], np.float64)
    return np.asarray(cv2.projectPoints(rays, none, none, camera.K, camera.D)[0][:, 0], np.float64)


def _coded(values: npt.NDArray[np.float32] | None, pixels: F64) -> F64:
    """The values of a map at pixels (x, y), float64 (N,)."""
    assert values is not None
    return values[pixels[:, 1].astype(np.int64), pixels[:, 0].astype(np.int64)].astype(np.float64)


def _check_size(rig: StereoRig, projector_map: ProjectorMap) -> None:
    height, width = projector_map.reasons.shape
    if (width, height) != (rig.width, rig.height):
        raise ImageError(
            f"the map is {width}x{height}, the rig is for {rig.width}x{rig.height}",
            subject="projector map",
            value=(width, height),
            limit=(rig.width, rig.height),
            remedy="decode images that the rig rectified",
        )
