# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The axis of a turntable: from poses of what lies on it, and refined to images of markers or of a board on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from stereo_depth_ros.active.light_stripe.motion import Turntable, turn
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.levenberg_marquardt import StopRules, damped_step, minimize
from stereo_depth_ros.geometry.rays import undistort_points

__all__ = ["TableView", "Target", "TurntableCalibration", "axis_from_poses", "calibrate_turntable"]

_MIN_VIEWS = 2
_LEAST_TURN_DEG = 5.0  # of the views in all
_MAX_RMS_PX = 3.0
_STEP = 1e-6  # of the numerical derivatives, relative to the size of a parameter
_STOP = StopRules(max_trials=100, tolerance=1e-9, converged_steps=2, max_damping=1e9)


@dataclass(frozen=True, eq=False)
class Target:
    """What is seen of a flat, rigid thing on the table: a marker, or a board.

    Attributes:
        ids: int (N,), numbers of its points.
        board_m: float64 (N, 3), their places on it, meters, z = 0.
        image_px: float64 (N, 2), in the image, raw px.
    """

    ids: np.ndarray[tuple[int], np.dtype[np.int64]]
    board_m: F64
    image_px: F64


@dataclass(frozen=True, eq=False)
class TableView:
    """An image of the table: its name, and the targets that it shows, by their numbers."""

    name: str
    targets: Mapping[int, Target]


@dataclass(frozen=True, eq=False)
class TurntableCalibration:
    """Result of the calibration of a turntable.

    Attributes:
        turntable: its axis.
        angles_rad: float64 (V,), of the views, from the first one.
        points_m: float64 (N, 3), all points of the targets in the first view, in the optical frame, meters.
        rms_px: root mean square reprojection error of the points.
        axis_sigma_deg: standard deviation of the direction of the axis, by the reprojection errors.
        point_sigma_m: that of its place beside the targets, meters.
    """

    turntable: Turntable
    angles_rad: F64
    points_m: F64
    rms_px: float
    axis_sigma_deg: float
    point_sigma_m: float

    @property
    def table_plane(self) -> tuple[F64, float]:
        """Normal, float64 (3,), and distance d_m of the plane n X + d = 0 through the points, meters."""
        center = self.points_m.mean(axis=0)
        normal = np.linalg.svd(self.points_m - center)[2][2]
        return normal, float(-normal @ center)


def axis_from_poses(poses: Sequence[F64]) -> Turntable:
    """The common axis of rotations, from poses of one thing on a table.

    Direction and place follow from all pairs of poses: R c + t = c for each motion (R, t) from one to the other.

    Args:
        poses: float64 (4, 4) each, from the thing to the camera; angles increase from pose to pose.

    Raises:
        CalibrationError: fewer than two poses, or they hardly turn.
    """
    motions = [after @ np.linalg.inv(before) for n, after in enumerate(poses) for before in poses[:n]]
    vectors = np.array([cv2.Rodrigues(motion[:3, :3])[0].ravel() for motion in motions]).reshape(-1, 3)
    largest_deg = float(np.degrees(np.linalg.norm(vectors, axis=1).max())) if len(vectors) else 0.0
    if largest_deg < _LEAST_TURN_DEG:
        raise _hardly_turns(largest_deg)
    # half a turn has no sign, and counts as much as a quarter: directions by the moment matrix of axis sin(angle / 2)
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    halves = vectors / np.maximum(lengths, 1e-12) * np.sin(lengths / 2)
    axis = np.linalg.eigh(halves.T @ halves)[1][:, 2]
    steps = [after @ np.linalg.inv(before) for before, after in pairwise(poses)]
    signed = sum(float(axis @ _skew_part(step[:3, :3])) for step in steps)
    axis = -axis if signed < 0 else axis
    rows = np.concatenate([np.identity(3) - motion[:3, :3] for motion in motions])
    across = np.identity(3) - np.outer(axis, axis)
    shifts = np.concatenate([across @ motion[:3, 3] for motion in motions])
    point = np.linalg.lstsq(rows @ across, shifts, rcond=1e-9)[0]
    return Turntable(axis, across @ point)


def _skew_part(rotation: F64) -> F64:
    """axis sin(angle), float64 (3,)."""
    return 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )


def calibrate_turntable(
    views: Sequence[TableView], camera: CameraModel, angles_rad: F64 | None = None
) -> TurntableCalibration:
    """The axis of a turntable from images of targets on it, of least reprojection error.

    Args:
        views: at least two, which turn by 5 degrees or more; each shares targets with another one.
        camera: of the images.
        angles_rad: float64 (V,), of the table in each view; None estimates them, and the angles increase in the order
            of the views.

    Raises:
        CalibrationError: too few views or targets, views that hardly turn, or do not fit one axis.
    """
    seen = [view for view in views if view.targets]
    if len(seen) < _MIN_VIEWS:
        raise CalibrationError(
            f"targets are found in {len(seen)} of {len(views)} images, at least {_MIN_VIEWS} are required",
            value=len(seen),
            limit=_MIN_VIEWS,
            remedy="check size, dictionary and light of the markers, or the size of the board",
            settings=("marker", "dictionary", "size"),
        )
    if angles_rad is not None:
        kept = np.array([bool(view.targets) for view in views])
        angles_rad = angles_rad[kept] - angles_rad[kept][0]
        if np.degrees(np.abs(angles_rad).max()) < _LEAST_TURN_DEG:
            raise _hardly_turns(float(np.degrees(np.abs(angles_rad).max())))
    bundle = _TableBundle(seen, camera)
    start = bundle.start(angles_rad)
    best = minimize(_Values(bundle, start, angles_rad), _STOP)
    return bundle.result(best, angles_rad)


class _TableBundle:
    """Reprojection of the targets; parameters: axis (3), point (3), angles of the views (V), poses of targets (6 K)."""

    def __init__(self, views: Sequence[TableView], camera: CameraModel) -> None:
        self.views, self.camera = views, camera
        self.numbers = sorted({number for view in views for number in view.targets})
        self._undistorted = [
            {number: undistort_points(target.image_px, camera) for number, target in view.targets.items()}
            for view in views
        ]

    def residuals(self, values: F64) -> F64:
        """Of all points, px, float64 (2 N,)."""
        count = len(self.views)
        length = np.linalg.norm(values[:3])
        table = Turntable(values[:3] / length, values[3:6])
        poses = values[6 + count :].reshape(-1, 6)
        targets = {number: _matrix(pose) for number, pose in zip(self.numbers, poses, strict=True)}
        found = []
        for view, seen, angle in zip(self.views, self._undistorted, values[6 : 6 + count], strict=True):
            motion = turn(table, float(angle))
            for number, target in view.targets.items():
                pose = motion @ targets[number]
                points = target.board_m @ pose[:3, :3].T + pose[:3, 3]
                projected = points @ self.camera.K.T
                found.append((projected[:, :2] / projected[:, 2:] - seen[number]).ravel())
        return np.concatenate(found)

    def start(self, angles_rad: F64 | None) -> F64:
        """Initial parameters, from the pose of each target in each view."""
        candidates = [
            {n: _target_poses(view.targets[n].board_m, seen[n], self.camera) for n in view.targets}
            for view, seen in zip(self.views, self._undistorted, strict=True)
        ]
        motions = self._motions(candidates)
        table = axis_from_poses(motions)
        angles = np.array([_angle_about(table.axis, motion[:3, :3]) for motion in motions])
        angles[0] = 0.0
        if angles_rad is not None:
            same, opposite = (float(np.cos(angles - sign * angles_rad).sum()) for sign in (1, -1))
            if opposite > same:
                table = Turntable(-table.axis, table.point_m)
            angles = angles_rad
        poses = [self._best_pose(number, candidates, table, angles) for number in self.numbers]
        return np.concatenate([table.axis, table.point_m, angles, *poses])

    def _motions(self, candidates: Sequence[Mapping[int, Sequence[F64]]]) -> list[F64]:
        """Motion of the table from the first view to each view, from the points that both have."""
        clouds = [
            {
                (number, int(i)): (pose[:3, :3] @ point + pose[:3, 3])
                for number, target in view.targets.items()
                for pose in candidates[at][number][:1]
                for i, point in zip(target.ids, target.board_m, strict=True)
            }
            for at, view in enumerate(self.views)
        ]
        motions: dict[int, F64] = {0: np.identity(4)}
        while len(motions) < len(clouds):
            pairs = [
                (len(clouds[new].keys() & clouds[old].keys()), new, old)
                for new in range(len(clouds))
                if new not in motions
                for old in motions
            ]
            shared, new, old = max(pairs)
            if shared < 3:
                raise CalibrationError(
                    f"{self.views[new].name} shares no target with the other images",
                    value=shared,
                    limit=3,
                    remedy="take images in smaller steps",
                )
            common = sorted(clouds[new].keys() & clouds[old].keys())
            step = _rigid_fit(*(np.array([clouds[view][key] for key in common]) for view in (old, new)))
            motions[new] = step @ motions[old]
        return [motions[at] for at in range(len(clouds))]

    def _best_pose(
        self, number: int, candidates: Sequence[Mapping[int, Sequence[F64]]], table: Turntable, angles: F64
    ) -> F64:
        """Pose of a target in the first view, float64 (6,): of all those seen, the one that fits all views best.

        A small square has two poses of nearly the same image.
        """
        best, least = np.zeros(6), np.inf
        for at, found in enumerate(candidates):
            for pose in found.get(number, ()):
                first = np.linalg.inv(turn(table, float(angles[at]))) @ pose
                errors = []
                for view, seen, angle in zip(self.views, self._undistorted, angles, strict=True):
                    if number in view.targets:
                        moved = turn(table, float(angle)) @ first
                        points = view.targets[number].board_m @ moved[:3, :3].T + moved[:3, 3]
                        projected = points @ self.camera.K.T
                        errors.append(np.abs(projected[:, :2] / projected[:, 2:] - seen[number]).mean())
                if float(np.mean(errors)) < least:
                    best, least = _vector(first), float(np.mean(errors))
        return best

    def result(self, best: _Values, angles_rad: F64 | None) -> TurntableCalibration:
        values, count = best.values, len(self.views)
        axis = values[:3] / np.linalg.norm(values[:3])
        residuals = self.residuals(values)
        rms_px = float(np.sqrt(np.square(residuals).sum() / (residuals.size / 2)))
        if not rms_px <= _MAX_RMS_PX:
            raise CalibrationError(
                f"the images do not fit one axis, the reprojection rms is {rms_px:.2f} px",
                value=rms_px,
                limit=_MAX_RMS_PX,
                remedy="check camera, marker size and angles, and that the camera did not move",
                settings=("camera", "marker", "angles", "step"),
            )
        poses = [_matrix(pose) for pose in values[6 + count :].reshape(-1, 6)]
        corners = {n: view.targets[n].board_m for view in self.views for n in view.targets}
        points = np.concatenate(
            [corners[n] @ pose[:3, :3].T + pose[:3, 3] for n, pose in zip(self.numbers, poses, strict=True)]
        )
        # the point of the axis nearest to the targets
        point = values[3:6] + axis * float(axis @ (points.mean(axis=0) - values[3:6]))
        covariance = best.covariance()
        across = np.identity(3) - np.outer(axis, axis)
        axis_sigma = np.sqrt(np.trace(across @ covariance[:3, :3] @ across)) / np.linalg.norm(values[:3])
        reach = float(axis @ (point - values[3:6])) / np.linalg.norm(values[:3])
        jacobian = np.hstack((reach * across, across))
        point_sigma = np.sqrt(max(float(np.trace(jacobian @ covariance[:6, :6] @ jacobian.T)), 0.0))
        return TurntableCalibration(
            Turntable(axis, point),
            values[6 : 6 + count],
            points,
            rms_px,
            float(np.degrees(axis_sigma)),
            float(point_sigma),
        )


class _Values:
    """Parameters of a bundle; an iterate of :func:`minimize`."""

    def __init__(self, bundle: _TableBundle, values: F64, angles_rad: F64 | None) -> None:
        self.bundle, self.values, self.angles_rad = bundle, values, angles_rad
        self._residuals = bundle.residuals(values)
        self._system: tuple[F64, F64] | None = None

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(np.square(self._residuals).sum())

    def _free(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """The angle of the first view is 0, and given angles stay."""
        free, count = np.ones(len(self.values), bool), len(self.bundle.views)
        free[6] = False
        if self.angles_rad is not None:
            free[6 : 6 + count] = False
        return free

    def jacobian(self) -> F64:
        """Of the free parameters, by central differences."""
        columns = []
        for at in np.flatnonzero(self._free()):
            step = np.zeros(len(self.values))
            step[at] = _STEP * max(abs(float(self.values[at])), 0.1)
            forward, back = (self.bundle.residuals(self.values + sign * step) for sign in (1, -1))
            columns.append((forward - back) / (2 * step[at]))
        return np.stack(columns, axis=1)

    def trial(self, damping: float) -> _Values:
        """The values after a damped step."""
        if self._system is None:
            jacobian = self.jacobian()
            self._system = jacobian.T @ jacobian, jacobian.T @ self._residuals
        values = self.values.copy()
        values[self._free()] += damped_step(*self._system, damping)
        return _Values(self.bundle, values, self.angles_rad)

    def covariance(self) -> F64:
        """Of all parameters, 0 for those that are held; the length of the axis and its place along it have none."""
        jacobian, free = self.jacobian(), self._free()
        freedom = max(len(self._residuals) - int(free.sum()), 1)
        full = np.zeros((len(self.values), len(self.values)))
        full[np.ix_(free, free)] = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12) * self.cost / freedom
        return full


def _target_poses(board_m: F64, seen_px: F64, camera: CameraModel) -> list[F64]:
    """Both poses of a flat target, the better one first, float64 (4, 4) each."""
    _, rotations, translations, _ = cv2.solvePnPGeneric(board_m, seen_px, camera.K, None, flags=cv2.SOLVEPNP_IPPE)
    return [_matrix(np.concatenate((r.ravel(), t.ravel()))) for r, t in zip(rotations, translations, strict=True)]


def _rigid_fit(source: F64, target: F64) -> F64:
    """The rigid motion of least squares from points to points, float64 (4, 4) (Arun, Huang and Blostein 1987)."""
    centers = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - centers[1]).T @ (source - centers[0]))
    rotation = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    motion = np.identity(4)
    motion[:3, :3], motion[:3, 3] = rotation, centers[1] - rotation @ centers[0]
    return motion


def _angle_about(axis: F64, rotation: F64) -> float:
    """Angle of a rotation about an axis, radians."""
    first = np.cross(axis, np.identity(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    turned = rotation @ first
    return float(np.arctan2(turned @ np.cross(axis, first), turned @ first))


def _matrix(pose: F64) -> F64:
    matrix = np.identity(4)
    matrix[:3, :3], matrix[:3, 3] = cv2.Rodrigues(pose[:3])[0], pose[3:]
    return matrix


def _vector(matrix: F64) -> F64:
    return np.concatenate((cv2.Rodrigues(matrix[:3, :3])[0].ravel(), matrix[:3, 3]))


def _hardly_turns(angle_deg: float) -> CalibrationError:
    return CalibrationError(
        f"the views turn by {angle_deg:.1f} degrees, at least {_LEAST_TURN_DEG:g} are required",
        value=angle_deg,
        limit=_LEAST_TURN_DEG,
        remedy="turn the table further between the images",
    )
