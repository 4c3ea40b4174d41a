# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images of light stripes whose places are known: profiles of a Gaussian, and stripes on rendered chessboards."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from rendered_boards import PINHOLE, SIZE, SQUARE_M, chessboard_print, photograph

from stereo_depth_ros.calibration.projection import camera_matrix
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64, U8, Frame

__all__ = ["BOARD_PLANE", "POSES", "board_camera", "board_image", "pose", "stripe_image", "write_boards"]

# A, B, C, D of the light plane on the boards
BOARD_PLANE = np.array([0.93, 0.08, 0.36, -0.22]) / np.linalg.norm([0.93, 0.08, 0.36])


CENTER = np.array([3.0, 2.0, 0.0]) * SQUARE_M


def pose(x: float, y: float, z: float, *rotation: float) -> F64:
    """The pose of the board whose center is at x, y, z."""
    turn = np.array(rotation)
    return np.concatenate([turn, np.array([x, y, z]) - cv2.Rodrigues(turn)[0] @ CENTER])


POSES = [
    pose(0.02, 0.0, 0.46, 0.3, 0.2, 0.05),
    pose(-0.02, 0.02, 0.6, -0.2, 0.35, -0.1),
    pose(0.05, -0.03, 0.52, 0.1, -0.4, 0.2),
    pose(-0.03, 0.01, 0.7, -0.3, -0.2, 0.0),
]


def stripe_image(
    place: Callable[[F64], F64],
    sigma_px: float = 1.8,
    shape: tuple[int, int] = (120, 160),
    level: float = 150.0,
    base: float = 30.0,
    noise: float = 2.0,
    seed: int = 0,
) -> U8:
    """A bright line of Gaussian profile at x = place(y) over a flat ground, uint8 (H, W)."""
    y, x = np.indices(shape).astype(float)
    exact = base + level * np.exp(-0.5 * np.square((x - place(y)) / sigma_px))
    noisy = exact + noise * np.random.default_rng(seed).normal(size=shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


def board_camera() -> CameraModel:
    """The camera of the boards: distorted, its pixels not quite square."""
    K = camera_matrix(PINHOLE.left)
    return CameraModel(*SIZE, "plumb_bob", K, PINHOLE.left[4:], np.identity(3), np.column_stack((K, np.zeros(3))))


def board_image(pose: F64, plane: npt.ArrayLike = BOARD_PLANE, sigma_m: float = 0.0025, green: float = 90.0) -> Frame:
    """A chessboard of 7 x 5 corners in a pose, with the stripe of a green laser across it, bgr8."""
    gray = photograph((chessboard_print(7, 5)[0], chessboard_print(7, 5)[1]), 40, SQUARE_M, PINHOLE, pose)[0]
    y, x = np.indices(gray.shape).astype(float)
    camera = board_camera()
    pixels = np.stack((x.ravel(), y.ravel()), axis=1)[:, None]
    rays = np.column_stack((cv2.undistortPoints(pixels, camera.K, camera.D)[:, 0], np.ones(x.size)))
    normal = cv2.Rodrigues(pose[:3])[0][:, 2]
    points = rays * (normal @ pose[3:] / (rays @ normal))[:, None]
    distance = (points @ np.asarray(plane)[:3] + np.asarray(plane)[3]).reshape(gray.shape)
    light = green * np.exp(-0.5 * np.square(distance / sigma_m)) * (gray / 235.0 + 0.1)
    color = 0.6 * gray[..., None] + light[..., None] * np.array([0.3, 1.0, 0.05])
    return Frame(np.clip(np.rint(color), 0, 255).astype(np.uint8), 0, "camera", "bgr8")


def write_boards(folder: Path) -> None:
    """Images of the board in all poses."""
    folder.mkdir()
    for number, each in enumerate(POSES):
        assert cv2.imwrite(str(folder / f"{number}.png"), board_image(each).pixels)
