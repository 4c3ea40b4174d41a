# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reconstruction of points and cameras from matches: Euclidean, up to scale, or projective."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, U8, Reason
from stereo_depth_ros.geometry.correspondences import Correspondences
from stereo_depth_ros.geometry.epipolar import epipoles
from stereo_depth_ros.geometry.essential import estimate_essential
from stereo_depth_ros.geometry.fundamental import estimate_fundamental
from stereo_depth_ros.geometry.rays import undistort_points
from stereo_depth_ros.geometry.relative_pose import RelativePose, cross_matrix
from stereo_depth_ros.geometry.triangulation import (
    MIN_PARALLAX_RAD,
    fundamental_from_cameras,
    optimal_matches,
    parallax,
    triangulate_linear,
)

__all__ = ["Cameras", "Level", "Reconstruction", "canonical_cameras", "reconstruct"]

Cameras: TypeAlias = StereoRig | tuple[CameraModel, CameraModel] | None


class Level(enum.Enum):
    """Ambiguity of a reconstruction: what all scenes with the same images have in common.

    (Trucco and Verri, Introductory Techniques for 3-D Computer Vision, 1998, section 7.4.)
    """

    EUCLIDEAN = "euclidean"  # lengths in meters
    UP_TO_SCALE = "up_to_scale"  # angles and ratios of lengths
    PROJECTIVE = "projective"  # incidence and cross ratios; no lengths, angles or parallels

    @property
    def unit(self) -> str | None:
        """Unit of the coordinates: meters or baselines; None for PROJECTIVE."""
        return {Level.EUCLIDEAN: "meters", Level.UP_TO_SCALE: "baselines", Level.PROJECTIVE: None}[self]


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Points of N matches, and the camera matrices.

    Attributes:
        level: ambiguity of the reconstruction.
        homogeneous: float64 (N, 4) of length 1, in the frame of the left camera; NaN where invalid.
        reasons: uint8 (N,), bits of :class:`Reason`, 0 exactly where ``homogeneous`` is finite: NO_MATCH, the match
            violates the epipolar constraint; RANGE, the point is behind a camera, at infinity or on the baseline.
        residual_px: float64 (N,), reprojection error in both images together, px without distortion; NaN where no point
            is found.
        P_left, P_right: float64 (3, 4), camera matrices, from points to pixels without distortion.
        pose: of the right camera, in the unit of the level; None for PROJECTIVE.
    """

    level: Level
    homogeneous: F64
    reasons: U8
    residual_px: F64
    P_left: F64
    P_right: F64
    pose: RelativePose | None

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """bool (N,), the matches with a valid point."""
        return np.equal(self.reasons, Reason.VALID)

    @property
    def points(self) -> F64:
        """float64 (N, 3): X, Y, Z in the left camera, in the unit of the level; NaN where invalid.

        Raises:
            CalibrationError: PROJECTIVE.
        """
        if self.level is Level.PROJECTIVE:
            raise CalibrationError(
                "points of a projective reconstruction have no X, Y, Z: its homogeneous coordinates are known up to "
                "any 4 x 4 homography",
                value=self.level.value,
                remedy="use `homogeneous`, or give the intrinsics of the cameras",
            )
        points: F64 = self.homogeneous[:, :3] / self.homogeneous[:, 3:]
        return points

    def with_baseline(self, baseline_m: float) -> Reconstruction:
        """The Euclidean reconstruction from an UP_TO_SCALE one and the length of its baseline.

        Raises:
            CalibrationError: another level, or a baseline that is not above 0.
        """
        if self.level is not Level.UP_TO_SCALE or self.pose is None:
            raise CalibrationError(
                "a baseline applies to an up_to_scale reconstruction only",
                subject=f"{self.level.value} reconstruction",
                value=self.level.value,
                limit=Level.UP_TO_SCALE.value,
                remedy="reconstruct with the intrinsics of both cameras, without a baseline",
            )
        if not 0 < baseline_m < np.inf:
            raise CalibrationError(
                f"baseline {baseline_m:g} m is not above 0",
                value=baseline_m,
                limit=0.0,
                remedy="measure it, in meters",
                settings=("baseline",),
            )
        homogeneous = self.homogeneous * [baseline_m, baseline_m, baseline_m, 1]
        return replace(
            self,
            level=Level.EUCLIDEAN,
            homogeneous=homogeneous / np.linalg.norm(homogeneous, axis=1, keepdims=True),
            P_right=self.P_right * [1, 1, 1, baseline_m],
            pose=RelativePose(self.pose.R, self.pose.t * baseline_m),
        )


def reconstruct(left_px: F64, right_px: F64, cameras: Cameras, threshold_px: float = 1.0) -> Reconstruction:
    """Reconstruct points of least reprojection error from matches, at the level that the known cameras allow.

    - A rig gives a EUCLIDEAN reconstruction.
    - Two cameras with known K and D give an UP_TO_SCALE one: the essential matrix is estimated from the matches, and of
      its four poses the one with the points in front of both cameras is used. The baseline is 1.
    - None gives a PROJECTIVE one: the fundamental matrix is estimated, the cameras are :func:`canonical_cameras`. The
      images must be undistorted.

    Args:
        left_px, right_px: float64 (N, 2), px of the raw images; outliers are allowed.
        cameras: known cameras of the images. For a rectified pair, its rectified cameras.
        threshold_px: matches of larger reprojection error are invalid.

    Raises:
        ImageError: the two are not both (N, 2).
        CalibrationError: the matches do not determine the cameras to be estimated.
    """
    matches = Correspondences(np.asarray(left_px, np.float64), np.asarray(right_px, np.float64))
    if isinstance(cameras, StereoRig):
        matches = _undistorted(matches, cameras.left, cameras.right)
        pose = RelativePose.from_rig(cameras)
        return _euclidean(matches, (cameras.left.K, cameras.right.K), pose, threshold_px)
    if cameras is not None:
        matches = _undistorted(matches, *cameras)
        K_left, K_right = (camera.K for camera in cameras)
        known = _finite(matches)
        pose = estimate_essential(known.left_px, known.right_px, K_left, K_right, threshold_px).pose
        return _euclidean(matches, (K_left, K_right), pose, threshold_px)
    known = _finite(matches)
    P_left, P_right = canonical_cameras(estimate_fundamental(known.left_px, known.right_px, threshold_px).F)
    return _triangulated(Level.PROJECTIVE, matches, P_left, P_right, None, threshold_px)


def canonical_cameras(F: F64, v: npt.ArrayLike = (0.0, 0.0, 0.0), scale: float = 1.0) -> tuple[F64, F64]:
    """Two cameras with this fundamental matrix: P_left = [I | 0], P_right = [[e']x F + e' v^T | scale e'].

    e' is the right epipole, of length 1. All pairs of cameras with this F are related to them by a homography of space;
    those with P_left = [I | 0], by the choice of v and scale (Hartley and Zisserman 2004, results 9.9 and 9.15).

    Args:
        F: float64 (3, 3) of rank 2, of any scale.
        v: (3,), the plane that is mapped to infinity.
        scale: not 0.

    Returns:
        P_left and P_right, float64 (3, 4).
    """
    epipole = epipoles(F)[1]
    M = cross_matrix(epipole) @ F / np.linalg.norm(F) + np.outer(epipole, np.asarray(v, np.float64))
    return np.identity(4)[:3], np.column_stack((M, scale * epipole))


def _undistorted(matches: Correspondences, left: CameraModel, right: CameraModel) -> Correspondences:
    return Correspondences(undistort_points(matches.left_px, left), undistort_points(matches.right_px, right))


def _finite(matches: Correspondences) -> Correspondences:
    seen: npt.NDArray[np.bool_] = np.isfinite((matches.left_px + matches.right_px).sum(axis=1))
    return matches.take(seen)


def _euclidean(matches: Correspondences, K: tuple[F64, F64], pose: RelativePose, threshold_px: float) -> Reconstruction:
    level = Level.UP_TO_SCALE if pose.up_to_scale else Level.EUCLIDEAN
    P_left, P_right = K[0] @ np.identity(4)[:3], K[1] @ np.column_stack((pose.R, pose.t))
    return _triangulated(level, matches, P_left, P_right, pose, threshold_px)


def _triangulated(
    level: Level, matches: Correspondences, P_left: F64, P_right: F64, pose: RelativePose | None, threshold_px: float
) -> Reconstruction:
    nearest = optimal_matches(fundamental_from_cameras(P_left, P_right), matches.left_px, matches.right_px)
    moved = np.hstack((nearest.left_px - matches.left_px, nearest.right_px - matches.right_px))
    residual_px = np.linalg.norm(moved, axis=1)
    X = triangulate_linear(P_left, P_right, nearest.left_px, nearest.right_px)
    reasons = np.where(residual_px <= threshold_px, 0, Reason.NO_MATCH).astype(np.uint8)
    reasons[(reasons == 0) & ~_in_range(X, P_right, pose)] = Reason.RANGE
    X[reasons != 0] = np.nan
    return Reconstruction(level, X, reasons, residual_px, P_left, P_right, pose)


def _in_range(X: F64, P_right: F64, pose: RelativePose | None) -> npt.NDArray[np.bool_]:
    """Whether a point exists and, for calibrated cameras, is in front of both and not at infinity."""
    exists: npt.NDArray[np.bool_] = np.isfinite(X.sum(axis=1))
    if pose is None:
        return exists
    in_front: npt.NDArray[np.bool_] = exists & (X[:, 3] > 0) & (X[:, 2] > 0) & (X @ P_right[2] > 0)
    in_front &= parallax(X, pose) > MIN_PARALLAX_RAD
    return in_front
