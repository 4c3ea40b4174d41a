# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The essential matrix of cameras with known intrinsics, and the pose that it stands for."""

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

SAMPLES, SAMPLE = 8, 40  # of matches, from which the search for the lowest minimum starts
MIN_SHARE_IN_FRONT = 0.7  # of the points, for the pose that has most of them in front of both cameras


@dataclass(frozen=True, eq=False)
class EssentialEstimate:
    """What matches tell about two cameras whose intrinsics are known.

    Attributes:
        E: float64 (3, 3), x_right^T E x_left = 0 in camera coordinates; singular values 1, 1 and 0.
        pose: the right camera as the left one sees it, up to scale.
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
        CalibrationError: not finite, or of rank below 2: nothing is near it.
    """
    if E.shape != (3, 3) or not np.isfinite(E).all():
        raise CalibrationError(f"{E.tolist()} is no essential matrix, it is 3 x 3 and finite: estimate it from matches")
    U, singular, Vt = np.linalg.svd(E)
    if singular[1] <= 1e-6 * singular[0]:
        raise CalibrationError(
            f"singular values {singular.tolist()} are those of no essential matrix, whose first two are equal: "
            "estimate it from matches with several depths"
        )
    nearest: F64 = (U * [1.0, 1.0, 0.0]) @ Vt
    return nearest


def estimate_essential(
    left_px: F64, right_px: F64, K_left: F64, K_right: F64, threshold_px: float = 1.0, method: str = "magsac"
) -> EssentialEstimate:
    """The essential matrix that most matches agree on, of least Sampson distance in pixels from them, and its pose.

    Args:
        left_px, right_px: float64 (N, 2), N >= 8, pixels without distortion.
        K_left, K_right: float64 (3, 3), intrinsics, px.
        threshold_px, method: see :func:`~stereo_depth_ros.geometry.fundamental.estimate_fundamental`.

    Raises:
        ConfigError, CalibrationError: see there, and :func:`pose_from_essential`.
    """
    start = estimate_fundamental(left_px, right_px, threshold_px, method)
    sight = _Sight(left_px, right_px, K_left, K_right)
    noise_px = robust_scale(sampson_distance(start.F, left_px, right_px)[start.inliers])
    E = sight.lowest(essential_from_fundamental(start.F, K_left, K_right), start.inliers, noise_px)
    distances = sight.distances(E)
    inliers = distances < threshold_px
    if 2 * inliers.sum() < start.inliers.sum():
        raise CalibrationError(
            f"{inliers.sum()} of the {start.inliers.sum()} matches that agree on a fundamental matrix agree on an "
            "essential one: these are not the intrinsics of the images, or the images are still distorted"
        )
    rays = camera_coordinates(left_px[inliers], K_left), camera_coordinates(right_px[inliers], K_right)
    pose = pose_from_essential(E, *rays)
    return EssentialEstimate(E, pose, inliers, float(np.sqrt(np.mean(distances[inliers] ** 2))))


class _Sight:
    """Matches of two cameras whose intrinsics are known."""

    def __init__(self, left_px: F64, right_px: F64, K_left: F64, K_right: F64) -> None:
        self._left_px, self._right_px, self._K = left_px, right_px, (K_left, K_right)

    def distances(self, E: F64) -> F64:
        """float64 (N,), Sampson distances, px."""
        return sampson_distance(fundamental_from_essential(E, *self._K), self._left_px, self._right_px)

    def lowest(self, E: F64, chosen: npt.NDArray[np.bool_], scale_px: float) -> F64:
        """The lowest of the minima near E of the robust cost, of this scale, of the chosen matches.

        A sideways shift looks nearly like a turn, so that a single wrong match far from the others makes a minimum of
        its own. Small samples of the matches, most of them without it, give the starts from which the others are found.
        """
        indices, rng = np.flatnonzero(chosen), np.random.default_rng(0)
        samples = [rng.choice(indices, min(SAMPLE, len(indices)), replace=False) for _ in range(SAMPLES)]
        starts = [self._refined(E, matches) for matches in (indices, *samples)]
        ends = [self._refined(start, indices, scale_px) for start in starts]
        return min(ends, key=lambda end: robust_cost(self.distances(end)[indices], scale_px))

    def _refined(self, E: F64, indices: npt.NDArray[np.intp], scale_px: float = np.inf) -> F64:
        return refine_essential(E, self._left_px[indices], self._right_px[indices], *self._K, scale_px)


def pose_from_essential(E: F64, left_norm: F64, right_norm: F64) -> RelativePose:
    """The one of the four poses of an essential matrix that has the points in front of both cameras.

    (Longuet-Higgins 1981; Hartley and Zisserman 2004, section 9.6.)

    Args:
        E: float64 (3, 3); its sign and scale do not matter.
        left_norm, right_norm: float64 (N, 2), matches in camera coordinates (x / z, y / z), without wrong ones.

    Returns:
        A pose up to scale: t has length 1.

    Raises:
        CalibrationError: no essential matrix, or no pose with 70 % of the points in front of both cameras: few points,
            points that are far away beside the baseline, or wrong matches.
    """
    U, _, Vt = np.linalg.svd(equal_singular_values(E))
    W = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotations = [R * np.sign(np.linalg.det(R)) for R in (U @ W @ Vt, U @ W.T @ Vt)]
    poses = [RelativePose(R, t, up_to_scale=True) for R in rotations for t in (U[:, 2], -U[:, 2])]
    in_front = [_in_front(pose, homogeneous(left_norm), homogeneous(right_norm)) for pose in poses]
    best = int(np.argmax(in_front))
    if not in_front[best] > MIN_SHARE_IN_FRONT * len(left_norm):
        raise CalibrationError(
            f"cheirality is not decided: the four poses have {', '.join(map(str, in_front))} of {len(left_norm)} "
            f"points in front of both cameras, it takes more than {100 * MIN_SHARE_IN_FRONT:.0f} %: take right matches "
            "of points whose parallax is above their noise"
        )
    return poses[best]


def _in_front(pose: RelativePose, left: F64, right: F64) -> int:
    """Number of points in front of both cameras where the rays, float64 (N, 3), come nearest; beside infinity none."""
    turned = left @ pose.R.T
    # depth_right right = depth_left turned + t, once crossed with each of the rays; only the signs are needed
    normal = np.cross(right, turned)
    depth_left = -np.einsum("ij,ij->i", np.cross(right, pose.t), normal)
    depth_right = -np.einsum("ij,ij->i", np.cross(turned, pose.t), normal)
    return int(np.count_nonzero((depth_left > 0) & (depth_right > 0)))
