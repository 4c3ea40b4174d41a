# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A camera and a projector that are known exactly, boards before them, and what the camera sees of the projector."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from rendered_boards import chessboard_points

from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.calibration.board_views import BoardView
from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.projection import camera_matrix, project
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.rays import camera_rays
from stereo_depth_ros.geometry.relative_pose import RelativePose

COLUMNS, ROWS, SQUARE_M = 7, 5, 0.04
BOARD_M = chessboard_points(COLUMNS, ROWS, SQUARE_M)


@dataclass(frozen=True, eq=False)
class KnownProjector:
    """Intrinsics (fx, fy, cx, cy, k1, k2, p1, p2, k3) and sizes; rotation vector and translation, meters."""

    camera: F64
    camera_size: tuple[int, int]
    projector: F64
    projector_size: tuple[int, int]
    rig: F64

    @property
    def pose(self) -> RelativePose:
        return RelativePose(cv2.Rodrigues(self.rig[:3])[0], self.rig[3:])

    @property
    def models(self) -> tuple[CameraModel, CameraModel]:
        """Both as cameras, the projector in its own pixels."""
        camera, projector = (
            CameraModel(*size, "plumb_bob", camera_matrix(each), each[4:], np.identity(3), np.identity(4)[:3])
            for each, size in ((self.camera, self.camera_size), (self.projector, self.projector_size))
        )
        return camera, projector

    def in_projector(self, points_m: F64) -> F64:
        """Projector pixels, float64 (N, 2), of points in the frame of the raw camera, float64 (N, 3)."""
        return project("plumb_bob", self.projector, self.rig, points_m).image_px

    def view(self, name: str, pose: F64, noise_px: tuple[float, float], random: np.random.Generator) -> BoardView:
        """Corners of the board in both, with normal noise."""
        ids = np.arange(len(BOARD_M))
        left = project("plumb_bob", self.camera, pose, BOARD_M).image_px
        right = self.in_projector(BOARD_M @ cv2.Rodrigues(pose[:3])[0].T + pose[3:])
        corners = (
            Corners(ids, BOARD_M, exact + sigma * random.normal(size=exact.shape))
            for exact, sigma in zip((left, right), noise_px, strict=True)
        )
        return BoardView(name, self.camera_size, *corners)

    def board_map(self, pose: F64, cell_px: int = 1, seed: int = 0) -> ProjectorMap:
        """What the raw camera sees of the projector on the plane of the board, in cells; 5 % of the codes are wrong."""
        width, height = self.camera_size
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        rays = camera_rays(np.column_stack((x.ravel(), y.ravel())).astype(np.float64), self.models[0])
        normal = cv2.Rodrigues(pose[:3])[0][:, 2]
        points = rays * (normal @ pose[3:] / (rays @ normal))[:, None]
        exact = self.in_projector(points).reshape(height, width, 2)
        coded = (np.floor((exact + 0.5) / cell_px) + 0.5) * cell_px - 0.5
        random = np.random.default_rng(seed)
        wrong = random.random((height, width)) < 0.05
        coded[wrong] = random.uniform(0, self.projector_size, (int(wrong.sum()), 2))
        inside = ((coded >= 0) & (coded <= np.array(self.projector_size) - 1)).all(axis=2)
        coded[~inside] = np.nan
        sigma = np.where(inside, cell_px / np.sqrt(12), np.nan).astype(np.float32)
        column, row = (np.ascontiguousarray(coded[..., n], np.float32) for n in (0, 1))
        return ProjectorMap(self.projector_size, column, row, sigma, np.where(inside, 0, 128).astype(np.uint8))


# The projector stands to the right and is shifted upward: its principal point is below its image
BESIDE = KnownProjector(
    np.array([301.0, 304.0, 165.0, 114.0, -0.12, 0.05, 0.0007, -0.0005, 0.0]),
    (320, 240),
    np.array([470.0, 463.0, 190.0, 310.0, -0.06, 0.0, 0.0, 0.0, 0.0]),
    (400, 300),
    np.array([0.21, -0.28, 0.03, -0.24, -0.05, 0.04]),
)
# It stands above the camera, as on a shelf, and looks down with its lens shift
ABOVE = replace(
    BESIDE,
    projector=np.array([470.0, 463.0, 190.0, -25.0, -0.06, 0.0, 0.0, 0.0, 0.0]),
    rig=np.array([-0.03, 0.03, -0.02, 0.04, 0.26, 0.02]),
)
TO_THE_LEFT = replace(BESIDE, rig=np.array([0.2, 0.3, -0.02, 0.25, -0.03, 0.03]))
PLACES = {"beside": BESIDE, "above": ABOVE, "to_the_left": TO_THE_LEFT}


def poses(known: KnownProjector, count: int, seed: int = 0) -> list[F64]:
    """Random poses of the board, tilted, in which camera and projector have all of it in view."""
    random, found = np.random.default_rng(seed), []
    center = BOARD_M.mean(axis=0)
    while len(found) < count:
        rotation = random.uniform([-0.6, -0.6, -0.4], [0.6, 0.6, 0.4])
        where = random.uniform([-0.25, -0.2, 0.55], [0.25, 0.2, 1.1])
        pose = np.concatenate([rotation, where - cv2.Rodrigues(rotation)[0] @ center])
        view = known.view("", pose, (0.0, 0.0), random)
        ends = ((view.left.image_px, known.camera_size), (view.right.image_px, known.projector_size))
        if all((px > 4).all() and (px < np.array(size) - 5).all() for px, size in ends):
            found.append(pose)
    return found


def views(
    known: KnownProjector, count: int, noise_px: tuple[float, float] = (0.0, 0.0), seed: int = 0
) -> list[BoardView]:
    """Poses of the board with normal noise of the corners in the camera and in the projector."""
    random = np.random.default_rng(1000 + seed)
    return [
        known.view(f"pose{number:02d}", pose, noise_px, random) for number, pose in enumerate(poses(known, count, seed))
    ]
