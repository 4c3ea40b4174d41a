# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose: a rotation and a translation from one frame to another, unit quaternions, and what lies between two poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.types import F64

__all__ = ["Pose", "quaternion_rotation", "slerp"]

_STRAIGHT_RAD = 1e-6  # below this angle the arc between two quaternions is a line


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion between two frames: X_to = rotation @ X_from + translation_m.

    A name such as ``world_from_camera`` tells the frames, so that those that meet in a product are equal:
    ``world_from_camera = world_from_body @ body_from_camera``.

    Attributes:
        rotation: float64 (3, 3).
        translation_m: float64 (3,), meters.
    """

    rotation: F64
    translation_m: F64

    @classmethod
    def identity(cls) -> Pose:
        """The pose of a frame in itself."""
        return cls(np.identity(3), np.zeros(3))

    @classmethod
    def from_matrix(cls, matrix: F64) -> Pose:
        """That of a float64 (4, 4), or of its upper three rows (3, 4)."""
        return cls(np.array(matrix[:3, :3], np.float64), np.array(matrix[:3, 3], np.float64))

    @classmethod
    def from_quaternion(cls, quaternion: F64, translation_m: F64) -> Pose:
        """That of a quaternion x, y, z, w, float64 (4,), which need not have length 1, and a translation (3,)."""
        return cls(quaternion_rotation(quaternion), np.array(translation_m, np.float64))

    @property
    def matrix(self) -> F64:
        """The pose as float64 (4, 4)."""
        matrix = np.identity(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation_m
        return matrix

    @property
    def quaternion(self) -> F64:
        """The rotation as a quaternion x, y, z, w, float64 (4,), of length 1 (Shepperd 1978: from its largest part)."""
        R = self.rotation
        trace = float(np.trace(R))
        squares = np.array([2 * R[0, 0] - trace, 2 * R[1, 1] - trace, 2 * R[2, 2] - trace, trace]) + 1  # 4 q^2
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        xy, xz, yz = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
        a, b, c, w = squares
        rows = [(a, xy, xz, x), (xy, b, yz, y), (xz, yz, c, z), (x, y, z, w)]
        q = np.array(rows[int(np.argmax(squares))], np.float64)
        return np.asarray(q / np.linalg.norm(q), np.float64)

    def inverse(self) -> Pose:
        """The way back."""
        return Pose(self.rotation.T.copy(), -self.rotation.T @ self.translation_m)

    def __matmul__(self, other: Pose) -> Pose:
        """First ``other``, then this one."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation_m + self.translation_m)

    def apply(self, points_m: F64) -> F64:
        """Points, float64 (N, 3), in the other frame."""
        return np.asarray(points_m @ self.rotation.T + self.translation_m, np.float64)

    def interpolate(self, other: Pose, share: float) -> Pose:
        """The pose between this one (share 0) and another one (share 1).

        The translation lies on a line, the rotation on the shortest arc (Shoemake 1985).
        """
        translation = self.translation_m + share * (other.translation_m - self.translation_m)
        return Pose.from_quaternion(slerp(self.quaternion, other.quaternion, share), translation)


def quaternion_rotation(quaternion: F64) -> F64:
    """The rotation, float64 (3, 3), of a quaternion x, y, z, w, float64 (4,), which need not have length 1."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def slerp(one: F64, other: F64, share: float) -> F64:
    """The quaternion between two of length 1, float64 (4,), along the shortest arc (Shoemake 1985)."""
    cosine = float(one @ other)
    if cosine < 0:
        other, cosine = -other, -cosine
    angle = float(np.arccos(min(cosine, 1.0)))
    if angle < _STRAIGHT_RAD:
        return one + share * (other - one)
    weights = np.sin([(1 - share) * angle, share * angle]) / np.sin(angle)
    return np.asarray(weights[0] * one + weights[1] * other, np.float64)
