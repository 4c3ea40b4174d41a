# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The essential matrix of cameras with known intrinsics, and the relative pose that it represents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import (
    camera_coordinates,
    fundamental_from_essential,
    homogeneous,
    sampson_distance,
)
from stereo_depth_ros.geometry.fundamental import estimate_fundamental
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.geometry.sampson_refinement import refine_essential, robust_cost, robust_scale

__all__ = [
    "EssentialEstimate",
    "equal_singular_values",
    "essential_from_fundamental",
    "estimate_essential",
    "pose_from_essential",
]

SAMPLES, SAMPLE = 8, 40  # number and size of the samples of matches that give starting points of the refinement
MIN_SHARE_IN_FRONT = 0.7  # of the points, in front of both cameras for the best of the four poses


@dataclass(frozen=True, eq=False)
class EssentialEstimate:
    """Essential matrix estimated from matches.

    Attributes:
        E: float64 (3, 3), x_right^T E x_left = 0 in camera coordinates; singular values 1, 1 and 0.
        pose: of the right camera relative to the left one, up to scale.
        inliers: bool (N,), the matches whose Sampson distance is below the threshold.
        sampson_rms_px: root mean square of the Sampson distances of the inliers, px.
    """

    E: F64
    pose: RelativePose
    inliers: npt.NDArray[np.bool_]
    sampson_rms_px: float


def essential_from_fundamental(F: F64, K_left: F64, K_right: F64) -> F64:
    """float64 (3, 3): E = K_right^T F K_left with equal singular values.

    Args:
        F: float64 (3, 3), for pixels without distortion.
        K_left, K_right: float64 (3, 3), intrinsics, px.

    Raises:
        CalibrationError: see :func:`equal_singular_values`.
    """
    return equal_singular_values(K_right.T @ F @ K_left)


def equal_singular_values(E: F64) -> F64:
    """float64 (3, 3): the nearest essential matrix, scaled to singular values 1, 1 and 0 (Hartley 1997).

    Raises:
        CalibrationError: not 3 x 3, not finite, or of rank below 2.
    """
    if E.shape != (3, 3) or not np.isfinite(E).all():
        raise CalibrationError(
            f"{E.tolist()} is not an essential matrix, which is 3 x 3 and finite",
            value=E.tolist(),
            remedy="estimate it from matches",
        )
    U, singular, Vt = np.linalg.svd(E)
    if singular[1] <= 1e-6 * singular[0]:
        raise CalibrationError(
            f"singular values {singular.tolist()} are not those of an essential matrix, whose first two are equal",
            value=singular.tolist(),
            remedy="estimate it from matches with several depths",
        )
    nearest: F64 = (U * [1.0, 1.0, 0.0]) @ Vt
    return nearest


def estimate_essential(
    left_px: F64, right_px: F64, K_left: F64, K_right: F64, threshold_px: float = 1.0, method: str = "magsac"
) -> EssentialEstimate:
    """Estimate the essential matrix of least Sampson distance in pixels from the inliers of matches, and its pose.

    Args:
        left_px, right_px: float64 (N, 2), N >= 8, pixels without distortion.
        K_left, K_right: float64 (3, 3), intrinsics, px.
        threshold_px, method: see :func:`~stereo_depth_ros.geometry.fundamental.estimate_fundamental`.

    Raises:
        ConfigError, CalibrationError: see there, and :func:`pose_from_essential`.
    """
    start = estimate_fundamental(left_px, right_px, threshold_px, method)
    matches = _CalibratedMatches(left_px, right_px, K_left, K_right)
    noise_px = robust_scale(sampson_distance(start.F, left_px, right_px)[start.inliers])
    E = matches.best_minimum(essential_from_fundamental(start.F, K_left, K_right), start.inliers, noise_px)
    distances = matches.distances(E)
    inliers = distances < threshold_px
    if 2 * inliers.sum() < start.inliers.sum():
        raise CalibrationError(
            f"{inliers.sum()} of the {start.inliers.sum()} matches that agree on a fundamental matrix agree on an "
            "essential matrix, at least half are needed",
            value=int(inliers.sum()),
            limit=int(start.inliers.sum()) / 2,
            remedy="check that these are the intrinsics of the images, and that the images are undistorted",
        )
    rays = camera_coordinates(left_px[inliers], K_left), camera_coordinates(right_px[inliers], K_right)
    pose = pose_from_essential(E, *rays)
    return EssentialEstimate(E, pose, inliers, float(np.sqrt(np.mean(distances[inliers] ** 2))))


class _CalibratedMatches:
    """Matches of two cameras with known intrinsics."""

    def __init__(self, left_px: F64, right_px: F64, K_left: F64, K_right: F64) -> None:
        self._left_px, self._right_px, self._K = left_px, right_px, (K_left, K_right)

    def distances(self, E: F64) -> F64:
        """float64 (N,), Sampson distances, px."""
        return sampson_distance(fundamental_from_essential(E, *self._K), self._left_px, self._right_px)

    def best_minimum(self, E: F64, chosen: npt.NDArray[np.bool_], scale_px: float) -> F64:
        """The lowest local minimum near E of the robust cost of the chosen matches, with this scale.

        As a sideways translation resembles a rotation, a single distant outlier can cause another local minimum. Small
        samples of the matches, most of them without the outlier, give the starting points.
        """
        indices, rng = np.flatnonzero(chosen), np.random.default_rng(0)
        samples = [rng.choice(indices, min(SAMPLE, len(indices)), replace=False) for _ in range(SAMPLES)]
        starts = [self._refined(E, matches) for matches in (indices, *samples)]
        ends = [self._refined(start, indices, scale_px) for start in starts]
        return min(ends, key=lambda end: robust_cost(self.distances(end)[indices], scale_px))

    def _refined(self, E: F64, indices: npt.NDArray[np.intp], scale_px: float = np.inf) -> F64:
        return refine_essential(E, self._left_px[indices], self._right_px[indices], *self._K, scale_px)


def pose_from_essential(E: F64, left_norm: F64, right_norm: F64) -> RelativePose:
    """The one of the four poses of an essential matrix with the points in front of both cameras.

    (Longuet-Higgins 1981; Hartley and Zisserman 2004, section 9.6.)

    Args:
        E: float64 (3, 3), of any sign and scale.
        left_norm, right_norm: float64 (N, 2), matches in camera coordinates (x / z, y / z), without outliers.

    Returns:
        A pose up to scale: t has length 1.

    Raises:
        CalibrationError: not an essential matrix, or no pose with 70 % of the points in front of both cameras: few
            points, points that are distant compared to the baseline, or wrong matches.
    """
    U, _, Vt = np.linalg.svd(equal_singular_values(E))
    W = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotations = [R * np.sign(np.linalg.det(R)) for R in (U @ W @ Vt, U @ W.T @ Vt)]
    poses = [RelativePose(R, t, up_to_scale=True) for R in rotations for t in (U[:, 2], -U[:, 2])]
    in_front = [_in_front(pose, homogeneous(left_norm), homogeneous(right_norm)) for pose in poses]
    best = int(np.argmax(in_front))
    if not in_front[best] > MIN_SHARE_IN_FRONT * len(left_norm):
        raise CalibrationError(
            f"cheirality is ambiguous: the four poses have {', '.join(map(str, in_front))} of {len(left_norm)} points "
            f"in front of both cameras, more than {100 * MIN_SHARE_IN_FRONT:.0f} % are needed",
            value=in_front,
            limit=MIN_SHARE_IN_FRONT * len(left_norm),
            remedy="use correct matches of points whose parallax is above their noise",
        )
    return poses[best]


def _in_front(pose: RelativePose, left: F64, right: F64) -> int:
    """Number of points in front of both cameras, from rays, float64 (N, 3); points at infinity do not count."""
    rotated = left @ pose.R.T
    # depth_right right = depth_left rotated + t, crossed with each of the rays; only the signs are needed
    normal = np.cross(right, rotated)
    depth_left = -np.einsum("ij,ij->i", np.cross(right, pose.t), normal)
    depth_right = -np.einsum("ij,ij->i", np.cross(rotated, pose.t), normal)
    return int(np.count_nonzero((depth_left > 0) & (depth_right > 0)))
