# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Alignment of many views: the poses that fit all relative poses between them best, loops included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stereo_depth_ros.core.errors import RegistrationError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.surfaces.registration import moved_by

__all__ = ["WORLD", "Alignment", "RelativePose", "align"]

WORLD = -1  # instead of a view: the pose of the other one is known in the world

_MOST_STEPS, _SMALL_STEP = 50, 1e-9
_HUBER = 3.55  # Mahalanobis distance that 5 % of six-dimensional errors are above


@dataclass(frozen=True, eq=False)
class RelativePose:
    """What is known about two views.

    Attributes:
        first, second: numbers of the views; ``first`` may be WORLD.
        pose: from the frame of the second to that of the first.
        covariance: float64 (6, 6), as of :class:`Registration`, in the frame of the first.
    """

    first: int
    second: int
    pose: Pose
    covariance: F64


@dataclass(frozen=True, eq=False)
class Alignment:
    """The poses of all views.

    Attributes:
        poses: from the frame of each view to the world; without a pose known in it, the world is the first view.
        covariances: float64 (N, 6, 6), each as of :class:`Registration`, in the world; 0 for a view that is the world.
        distances: float64 (E,), of each relative pose from that between both poses, the Mahalanobis distance: 6 is the
            mean of its square without loops that do not close.
    """

    poses: tuple[Pose, ...]
    covariances: F64
    distances: F64


def align(count: int, relative: Sequence[RelativePose]) -> Alignment:
    """The poses of least squared distances from all relative poses, weighted by their covariances.

    A graph of poses, solved by Gauss-Newton steps (Lu and Milios 1997); what does not fit the others has less weight
    (Huber). The start is chained from view to view along the fewest relative poses.

    Args:
        count: number of views, at least 1.
        relative: relative poses, of which some may close loops.

    Raises:
        RegistrationError: a view that no chain of relative poses connects with the first one or the world.
    """
    anchored = any(edge.first == WORLD for edge in relative)
    poses = _chained(count, relative, anchored)
    roots = [np.linalg.cholesky(np.linalg.inv(edge.covariance)).T for edge in relative]
    free = np.arange(count) if anchored else np.arange(1, count)
    normal = np.zeros((6 * count, 6 * count))
    for _ in range(_MOST_STEPS):
        normal, gradient = _normal_equations(poses, relative, roots)
        used = np.concatenate([np.arange(6 * n, 6 * n + 6) for n in free]) if len(free) else np.zeros(0, int)
        motion = np.zeros(6 * count)
        motion[used] = -np.linalg.solve(normal[np.ix_(used, used)], gradient[used])
        poses = [moved_by(pose, motion[6 * n : 6 * n + 6]) for n, pose in enumerate(poses)]
        if np.abs(motion).max(initial=0.0) <= _SMALL_STEP:
            break
    covariances = np.zeros((count, 6, 6))
    if len(free):
        inverse = np.linalg.inv(normal[np.ix_(used, used)])
        for place, n in enumerate(free):
            covariances[n] = inverse[6 * place : 6 * place + 6, 6 * place : 6 * place + 6]
    apart = [float(np.linalg.norm(root @ _error(poses, edge))) for edge, root in zip(relative, roots, strict=True)]
    return Alignment(tuple(poses), covariances, np.array(apart))


def _chained(count: int, relative: Sequence[RelativePose], anchored: bool) -> list[Pose]:
    known = {WORLD: Pose.identity()} if anchored else {0: Pose.identity()}
    reached = list(known)
    for view in reached:  # grows
        for edge in relative:
            if edge.first == view and edge.second not in known:
                known[edge.second] = known[view] @ edge.pose
                reached.append(edge.second)
            elif edge.second == view and edge.first not in known:
                known[edge.first] = known[view] @ edge.pose.inverse()
                reached.append(edge.first)
    missing = [view for view in range(count) if view not in known]
    if missing:
        raise RegistrationError(
            f"{len(missing)} of {count} views are not connected with the others, the first is view {missing[0]}",
            value=missing,
            limit=count,
            remedy="add views between them, or leave them out",
        )
    return [known[view] for view in range(count)]


def _error(poses: Sequence[Pose], edge: RelativePose) -> F64:
    """The motion from the relative pose to that between both poses, float64 (6,), in the frame of the first."""
    first = Pose.identity() if edge.first == WORLD else poses[edge.first]
    apart = first.inverse() @ poses[edge.second] @ edge.pose.inverse()
    return np.concatenate((np.asarray(cv2.Rodrigues(apart.rotation)[0], np.float64).ravel(), apart.translation_m))


def _normal_equations(poses: Sequence[Pose], relative: Sequence[RelativePose], roots: Sequence[F64]) -> tuple[F64, F64]:
    """J^T J and J^T r for motions of all poses in the world."""
    normal, gradient = np.zeros((6 * len(poses), 6 * len(poses))), np.zeros(6 * len(poses))
    for edge, root in zip(relative, roots, strict=True):
        residual = root @ _error(poses, edge)
        weight = min(1.0, _HUBER / max(float(np.linalg.norm(residual)), 1e-300))
        jacobian = root @ _adjoint(Pose.identity() if edge.first == WORLD else poses[edge.first].inverse())
        square, pull = weight * jacobian.T @ jacobian, weight * jacobian.T @ residual
        second = slice(6 * edge.second, 6 * edge.second + 6)
        normal[second, second] += square
        gradient[second] += pull
        if edge.first != WORLD:
            first = slice(6 * edge.first, 6 * edge.first + 6)
            normal[first, first] += square
            normal[first, second] -= square
            normal[second, first] -= square
            gradient[first] -= pull
    return normal, gradient


def _adjoint(pose: Pose) -> F64:
    """The motion (rotation vector, translation) in another frame, float64 (6, 6): pose o motion o pose^-1."""
    R, (x, y, z) = pose.rotation, pose.translation_m
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = R
    adjoint[3:, :3] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ R
    return adjoint
