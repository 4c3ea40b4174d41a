# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Corners of a board in the image of a projector, by local homographies (Moreno and Taubin 2012)."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.calibration.boards import Corners, spacing_px
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.geometry.epipolar import homogeneous

__all__ = ["board_in_projector"]

_WINDOW = 0.6  # half of its side, of the distance between corners: within the squares around the corner
_LEAST_HALF_PX = 4
_LEAST_DECODED = 0.15  # of the pixels of a window: black squares often are not decoded, the white ones are half of it
_LEAST_PIXELS = 30
_MOST_PIXELS = 3000  # of a window; more are not more exact
# Residuals in standard deviations of the code, and in projector px at least: of the homography of four pixels, whose
# own codes are as rough, and of that of all inliers
_FIRST_SIGMAS, _FIRST_PX = 7.0, 1.5
_SIGMAS, _PX = 2.6, 0.75
_ROUNDS = 4
_LEAST_INLIERS = 0.4  # of the decoded pixels of a window; dark squares may have wrong codes


def board_in_projector(corners: Corners, projector_map: ProjectorMap) -> Corners:
    """The corners of a board in the image of the projector, as if it were a camera.

    D. Moreno and G. Taubin, Simple, accurate, and robust projector-camera calibration, 3DIMPVT 2012, section 3.3: the
    camera finds corners between pixels, but the code of a pixel is that of a whole projector pixel or cell. Near a
    corner the board is a plane, so camera and projector pixels are related by a homography (their equation 1), which
    is estimated from all decoded pixels of a window, without those that do not fit, and maps the corner.

    Args:
        corners: of the board in the raw image of the camera.
        projector_map: of that image, with columns and rows.

    Returns:
        the corners that are surrounded by enough decoded pixels, in px of the projector; the others are left out.

    Raises:
        ImageError: a map without columns or rows.
    """
    column_px, row_px = projector_map.column_px, projector_map.row_px
    if column_px is None or row_px is None:
        missing = "columns" if column_px is None else "rows"
        raise ImageError(
            f"the patterns do not code {missing}, a projector is calibrated by columns and rows",
            subject="patterns",
            limit=("columns", "rows"),
            remedy=f"project patterns of {missing} too",
        )
    half = max(_LEAST_HALF_PX, round(_WINDOW * spacing_px(corners)))
    found = [_mapped(corner, half, np.stack((column_px, row_px)), projector_map) for corner in corners.image_px]
    kept = np.array([point is not None for point in found], bool)
    points = np.array([point for point in found if point is not None]).reshape(-1, 2)
    return Corners(corners.ids[kept], corners.board_m[kept], points)


def _mapped(corner: F64, half: int, coded: F32, projector_map: ProjectorMap) -> F64 | None:
    """One corner in the image of the projector; None without enough pixels around it."""
    x, y = np.rint(corner).astype(int)
    y0, x0 = max(0, y - half), max(0, x - half)
    window = (slice(y0, y + half + 1), slice(x0, x + half + 1))
    decoded = projector_map.reasons[window] == 0
    count = int(np.count_nonzero(decoded))
    if count < max(_LEAST_PIXELS, _LEAST_DECODED * (2 * half + 1) ** 2):
        return None
    rows, columns = (each[:: 1 + count // _MOST_PIXELS] for each in np.nonzero(decoded))
    # relative to the corner, so that the numbers are small
    camera_px = np.column_stack((columns + x0, rows + y0)) - corner
    projector_px = coded[(slice(None), *window)][:, rows, columns].T.astype(np.float64)
    sigma_px = float(np.median(projector_map.sigma_px[window][decoded]))
    homography, inliers = cv2.findHomography(
        camera_px, projector_px, cv2.RANSAC, max(_FIRST_PX, _FIRST_SIGMAS * sigma_px)
    )
    for _ in range(_ROUNDS):
        if homography is None or np.count_nonzero(inliers) < max(_LEAST_PIXELS, _LEAST_INLIERS * len(rows)):
            return None
        before, inliers = inliers, _inliers(homography, camera_px, projector_px, max(_PX, _SIGMAS * sigma_px))
        if np.array_equal(before, inliers):
            break
        homography, _ = cv2.findHomography(camera_px[inliers], projector_px[inliers], 0)
    if homography is None or not _surrounded(camera_px[inliers]):
        return None
    point: F64 = homography[:2, 2] / homography[2, 2]
    return point


def _inliers(homography: F64, camera_px: F64, projector_px: F64, limit_px: float) -> npt.NDArray[np.bool_]:
    mapped = homogeneous(camera_px) @ homography.T
    near: npt.NDArray[np.bool_] = np.abs(mapped[:, :2] / mapped[:, 2:] - projector_px).max(axis=1) <= limit_px
    return near


def _surrounded(points: F64) -> bool:
    """Whether the origin is within the convex hull of points, so that it is interpolated."""
    if len(points) < _LEAST_PIXELS:
        return False
    hull = cv2.convexHull(points.astype(np.float32))
    return bool(cv2.pointPolygonTest(hull, (0.0, 0.0), False) >= 0)
