# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A turntable with ArUco markers whose axis is known: poses of the markers, and rendered images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from stereo_depth_ros.active.light_stripe.motion import Turntable, turn
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64, U8

__all__ = ["AXIS", "CORNERS", "SIDE_M", "TABLE", "rendered", "rendering_camera", "table_pose", "write_table"]

AXIS = np.array([0.04, -0.9, -0.42]) / np.linalg.norm([0.04, -0.9, -0.42])
TABLE = Turntable(AXIS, np.array([0.01, 0.05, 0.45]))
SIDE_M = 0.03
CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * SIDE_M / 2


K_RENDERED = np.array([[640.0, 0.0, 400.0], [0.0, 640.0, 300.0], [0.0, 0.0, 1.0]])


def table_pose(x: float, y: float, roll: float) -> F64:
    """Pose of a marker on the table, x and y from the axis."""
    right = np.cross(AXIS, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    frame = np.column_stack((right, np.cross(AXIS, right), AXIS)) @ np.diag([1.0, -1.0, -1.0])
    pose = np.identity(4)
    pose[:3, :3] = frame @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    pose[:3, 3] = TABLE.point_m + frame @ [x, y, 0.0]
    return pose


def rendered(angle: float) -> U8:
    """Markers on a white table, without distortion, uint8 (600, 800)."""
    dictionary, K = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), np.diag([3.0, 3.0, 1.0]) @ K_RENDERED
    K[:2, 2] += 1.0  # of pixels a third as large
    image = np.full((1800, 2400), 225, np.uint8)
    for number, (x, y) in enumerate(((0.06, 0.0), (-0.05, 0.03), (0.0, -0.06))):
        marker = cv2.aruco.generateImageMarker(dictionary, 5 + number, 120)
        print_ = np.pad(marker, 20, constant_values=225)
        pose = turn(TABLE, angle) @ table_pose(x, y, 0.4 * number)
        to_board = np.diag([SIDE_M / 120, SIDE_M / 120, 1.0])
        to_board[:2, 2] = -79.5 * SIDE_M / 120
        to_image = K @ np.column_stack((pose[:3, 0], pose[:3, 1], pose[:3, 3])) @ to_board
        seen = cv2.warpPerspective(print_, to_image, (2400, 1800))
        inside = cv2.warpPerspective(np.full_like(print_, 255), to_image, (2400, 1800)) == 255
        image[inside] = seen[inside]
    return np.asarray(cv2.resize(image, (800, 600), interpolation=cv2.INTER_AREA), np.uint8)


def rendering_camera() -> CameraModel:
    """The camera of the rendered images."""
    P = np.column_stack((K_RENDERED, np.zeros(3)))
    return CameraModel(800, 600, "plumb_bob", K_RENDERED, np.zeros(5), np.identity(3), P)


def write_table(folder: Path) -> None:
    """Three images of the turning table."""
    folder.mkdir()
    for number, angle in enumerate(np.radians([0, 70, 200])):
        assert cv2.imwrite(str(folder / f"{number}.png"), rendered(float(angle)))
