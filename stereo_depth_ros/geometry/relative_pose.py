# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose of the right camera relative to the left one, and its essential matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.camera import check_rotation
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

__all__ = ["RelativePose", "cross_matrix"]


@dataclass(frozen=True, eq=False)
class RelativePose:
    """X_right = R X_left + t for the coordinates of one point in both cameras (x right, y down, z forward).

    Attributes:
        R: float64 (3, 3), rotation from the left to the right camera.
        t: float64 (3,), meters: the left center in the right camera. Of length 1 if ``up_to_scale``.
        up_to_scale: only the direction of t is known, as from images alone.

    Raises:
        CalibrationError: R is not a rotation, or t is zero or not finite.
    """

    R: F64
    t: F64
    up_to_scale: bool = False

    def __post_init__(self) -> None:
        R, t = np.array(self.R, np.float64), np.array(self.t, np.float64).ravel()
        if R.shape != (3, 3) or t.shape != (3,):
            raise CalibrationError(
                f"R has shape {R.shape} and t {t.shape}, not (3, 3) and (3,)",
                value=(R.shape, t.shape),
                limit=((3, 3), (3,)),
                remedy="give all values of both",
            )
        check_rotation(R, "R from the left to the right camera")
        if not (np.isfinite(t).all() and t.any()):
            raise CalibrationError(
                f"t = {t.tolist()} is not a baseline, which is finite and not 0",
                value=t.tolist(),
                remedy="give the translation between the cameras",
            )
        object.__setattr__(self, "R", R)
        object.__setattr__(self, "t", t / np.linalg.norm(t) if self.up_to_scale else t)

    @classmethod
    def from_rig(cls, rig: StereoRig) -> RelativePose:
        """The pose of the raw cameras, from R and P of the rig."""
        baseline_m = np.array([-rig.baseline_m, 0.0, 0.0])
        return cls(rig.right.R.T @ rig.left.R, rig.right.R.T @ baseline_m)

    @property
    def right_center(self) -> F64:
        """float64 (3,): T = -R^T t, the right center in the left camera, in the unit of t."""
        center: F64 = -self.R.T @ self.t
        return center

    @property
    def essential(self) -> F64:
        """float64 (3, 3): E = R [T]x = -[t]x R, so that x_right^T E x_left = 0 (Longuet-Higgins 1981)."""
        E: F64 = self.R @ cross_matrix(self.right_center)
        return E

    def rotation_angle_to(self, other: RelativePose) -> float:
        """Angle between the rotations of the two poses, radians."""
        difference = self.R.T @ other.R
        axis = np.array([difference[2, 1] - difference[1, 2], difference[0, 2] - difference[2, 0]])
        sine = np.hypot(np.linalg.norm(axis), difference[1, 0] - difference[0, 1])
        return float(np.arctan2(sine, np.trace(difference) - 1))

    def direction_angle_to(self, other: RelativePose) -> float:
        """Angle between the directions of the two t, radians."""
        return float(np.arctan2(np.linalg.norm(np.cross(self.t, other.t)), self.t @ other.t))


def cross_matrix(v: F64) -> F64:
    """float64 (3, 3) [v]x of float64 (3,): [v]x w = v x w for every w."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
