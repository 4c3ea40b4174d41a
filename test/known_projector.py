# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A camera and a projector that are known exactly, boards before them, and what the camera sees of the projector."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import cv2
import numpy as np
from rendered_boards import chessboard_points, chessboard_print

from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.calibration.board_views import BoardView
from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.projection import camera_matrix, project
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.geometry.rays import camera_rays
from stereo_depth_ros.geometry.relative_pose import RelativePose

COLUMNS, ROWS, SQUARE_M = 7, 5, 0.03
OUTLINE_M = SQUARE_M * np.array([[x, y, 0.0] for x in (-1.5, COLUMNS + 0.5) for y in (-1.5, ROWS + 0.5)])
CELL_PX, FINE = 20, 2  # of the print; samples of a pixel in either direction
BOARD_M = chessboard_points(COLUMNS, ROWS, SQUARE_M)


def pixels_of(intrinsics: F64, x: F64, y: F64) -> F64:
    """Raw pixels, float64 (N, 2), of rays (x, y, 1): the model of Brown and Conrady, plumb_bob."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.column_stack((fx * u + cx, fy * v + cy))


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
        x, y, z = (points_m @ self.pose.R.T + self.rig[3:]).T
        return pixels_of(self.projector, x / z, y / z)

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

    def captures(self, pose: F64, sequence: PatternSequence) -> list[U8]:
        """Images of the board under the patterns, with ambient light and slight noise."""
        width, height = FINE * self.camera_size[0], FINE * self.camera_size[1]
        points = self._on_board(self._rays(FINE), pose)
        local = (points - pose[3:]) @ cv2.Rodrigues(pose[:3])[0][:, :2] / SQUARE_M
        print_, origin = chessboard_print(COLUMNS, ROWS, CELL_PX)
        on_print = ((local - origin) * CELL_PX - 0.5).reshape(height, width, 2).astype(np.float32)
        albedo = cv2.remap(print_, on_print, None, cv2.INTER_LINEAR, borderValue=110) / np.float32(255)
        seen = self.in_projector(points).reshape(height, width, 2).astype(np.float32)
        random = np.random.default_rng(round(1e6 * abs(pose[0])))
        images = []
        for pattern in sequence.render():
            light = cv2.remap(pattern, seen, None, cv2.INTER_LINEAR, borderValue=0)
            exact = cv2.resize(albedo * (12 + 0.8 * light), self.camera_size, interpolation=cv2.INTER_AREA)
            images.append(np.clip(exact + random.normal(size=exact.shape), 0, 255).round().astype(np.uint8))
        return images

    @functools.cache  # noqa: B019, a few of them
    def _rays(self, fine: int) -> F64:
        """Directions of ``fine`` x ``fine`` samples of each raw camera pixel, row by row."""
        width, height = self.camera_size
        x, y = np.meshgrid(*((np.arange(fine * n) + 0.5) / fine - 0.5 for n in (width, height)))
        return camera_rays(np.column_stack((x.ravel(), y.ravel())), self.models[0])

    @staticmethod
    def _on_board(rays: F64, pose: F64) -> F64:
        """Points of the plane of the board on rays, float64 (N, 3)."""
        normal = cv2.Rodrigues(pose[:3])[0][:, 2]
        points: F64 = rays * (normal @ pose[3:] / (rays @ normal))[:, None]
        return points

    def board_map(self, pose: F64, cell_px: int = 1, seed: int = 0) -> ProjectorMap:
        """What the raw camera sees of the projector on the plane of the board, in cells; 5 % of the codes are wrong."""
        width, height = self.camera_size
        points = self._on_board(self._rays(1), pose)
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
    np.array([0.21, 0.28, 0.03, -0.24, -0.05, 0.04]),
)
# It stands above the camera, as on a shelf, and looks down with its lens shift
ABOVE = replace(
    BESIDE,
    projector=np.array([470.0, 463.0, 190.0, -25.0, -0.06, 0.0, 0.0, 0.0, 0.0]),
    rig=np.array([-0.03, 0.03, -0.02, 0.04, 0.26, 0.02]),
)
TO_THE_LEFT = replace(BESIDE, rig=np.array([0.2, -0.3, -0.02, 0.25, -0.03, 0.03]))
PLACES = {"beside": BESIDE, "above": ABOVE, "to_the_left": TO_THE_LEFT}


def poses(known: KnownProjector, count: int, seed: int = 0) -> list[F64]:
    """Random poses of the board, tilted, in which camera and projector have all of it in view, with a margin."""
    random, found = np.random.default_rng(seed), []
    center = BOARD_M.mean(axis=0)
    while len(found) < count:
        rotation = random.uniform([-0.6, -0.6, -0.4], [0.6, 0.6, 0.4])
        where = random.uniform([-0.15, -0.12, 0.45], [0.2, 0.12, 0.95])
        pose = np.concatenate([rotation, where - cv2.Rodrigues(rotation)[0] @ center])
        points = OUTLINE_M @ cv2.Rodrigues(rotation)[0].T + pose[3:]
        ends = (
            (project("plumb_bob", known.camera, pose, OUTLINE_M).image_px, known.camera_size),
            (known.in_projector(points), known.projector_size),
        )
        if all((px > 2).all() and (px < np.array(size) - 3).all() for px, size in ends):
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
