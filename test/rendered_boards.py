# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Printed boards rendered by cameras that are known exactly, and their exact corners."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np

from stereo_depth_ros.calibration.board_views import BoardView
from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.projection import camera_matrix, project
from stereo_depth_ros.core.types import F64, U8

SIZE = (400, 300)
SQUARE_M = 0.03
FINE = 3  # samples of a pixel in either direction
_MARGIN = 1.0  # squares of white around a board


@dataclass(frozen=True, eq=False)
class KnownRig:
    """Two different cameras of one model; rotation vector and translation, meters, from left to right."""

    model: str
    left: F64
    right: F64
    rig: F64

    def second(self, pose: F64) -> F64:
        """The pose in the right camera."""
        rotation, translation = cv2.composeRT(pose[:3], pose[3:], self.rig[:3], self.rig[3:])[:2]
        return np.concatenate([rotation.ravel(), translation.ravel()])


_POSE = np.array([0.01, -0.03, 0.008, -0.11, 0.003, 0.002])
PINHOLE = KnownRig(
    "plumb_bob",
    np.array([311.0, 316.0, 205.0, 144.0, -0.21, 0.06, 0.0007, -0.0005, 0.01]),
    np.array([322.0, 319.0, 192.0, 153.0, -0.18, 0.04, -0.0004, 0.0009, 0.02]),
    _POSE,
)
RATIONAL = KnownRig(
    "rational_polynomial",
    np.array([311.0, 316.0, 205.0, 144.0, 0.3, 0.1, 0.0007, -0.0005, 0.01, 0.55, 0.12, 0.02]),
    np.array([322.0, 319.0, 192.0, 153.0, 0.28, 0.08, -0.0004, 0.0009, 0.02, 0.5, 0.1, 0.03]),
    _POSE,
)
FISHEYE = KnownRig(
    "equidistant",
    np.array([171.0, 174.0, 205.0, 144.0, -0.03, 0.01, -0.008, 0.002]),
    np.array([177.0, 175.0, 192.0, 153.0, -0.02, 0.005, -0.004, 0.001]),
    _POSE,
)
RIGS = {rig.model: rig for rig in (PINHOLE, RATIONAL, FISHEYE)}


def poses(count: int, board_m: F64, rig: KnownRig, seed: int = 0) -> list[F64]:
    """Random poses of a board, tilted, in which both cameras see all of it."""
    random = np.random.default_rng(seed)
    found: list[F64] = []
    center = board_m.mean(axis=0)
    length = np.ptp(board_m, axis=0).max()
    while len(found) < count:
        rotation = random.uniform([-0.6, -0.6, -0.5], [0.6, 0.6, 0.5])
        where = random.uniform([-0.75, -0.55, 1.0], [0.85, 0.55, 2.2]) * length
        if rig.model != "equidistant":
            where[2] += 0.5 * length
        pose = np.concatenate([rotation, where - cv2.Rodrigues(rotation)[0] @ center])
        pixels = [project(rig.model, side, at, board_m).image_px for side, at in _sides(rig, pose)]
        if all((each > 8).all() and (each < np.array(SIZE) - 9).all() for each in pixels):
            found.append(pose)
    return found


def _sides(rig: KnownRig, pose: F64) -> tuple[tuple[F64, F64], tuple[F64, F64]]:
    return (rig.left, pose), (rig.right, rig.second(pose))


def chessboard_points(columns: int, rows: int, square_m: float = SQUARE_M) -> F64:
    """Inner corners, row by row."""
    ids = np.arange(columns * rows)
    points: F64 = square_m * np.column_stack([ids % columns, ids // columns, 0 * ids]).astype(np.float64)
    return points


def exact_views(
    rig: KnownRig, count: int, noise_px: float, seed: int = 0, size: tuple[int, int] = (7, 5)
) -> list[BoardView]:
    """Views of a chessboard: exact corners with normal noise."""
    board_m = chessboard_points(*size)
    random, ids = np.random.default_rng(1000 + seed), np.arange(len(board_m))

    def corners(side: F64, pose: F64) -> Corners:
        exact = project(rig.model, side, pose, board_m).image_px
        return Corners(ids, board_m, exact + noise_px * random.normal(size=exact.shape))

    return [
        BoardView(f"view{number:02d}", SIZE, *(corners(*each) for each in _sides(rig, pose)))
        for number, pose in enumerate(poses(count, board_m, rig, seed))
    ]


def chessboard_print(columns: int, rows: int, cell_px: int = 40) -> tuple[U8, F64]:
    """A print of a board of inner corners, and where pixel (0, 0) lies on the board, in squares."""
    cells = np.indices((rows + 1, columns + 1)).sum(axis=0) % 2
    squares = np.kron(np.where(cells, 225, 30), np.ones((cell_px, cell_px))).astype(np.uint8)
    return _with_margin(squares, cell_px), np.array([-1 - _MARGIN, -1 - _MARGIN])


def charuco_print(columns: int, rows: int, marker: float, cell_px: int = 40) -> tuple[U8, F64]:
    """A print of a ChArUco board of squares; the board begins at the outer corner of its first square."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((columns, rows), 1.0, marker, dictionary)
    image = board.generateImage((columns * cell_px, rows * cell_px), marginSize=0, borderBits=1)
    return _with_margin(image, cell_px), np.array([-_MARGIN, -_MARGIN])


def aprilgrid_print(
    columns: int, rows: int, spacing: float, border_bits: int, turns: int = 0, tag_px: int = 80
) -> tuple[U8, F64]:
    """A print of a board in Kalibr's layout, with small black squares between the tags; flipped, as y points up."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    gap = round(spacing * tag_px)
    pitch = tag_px + gap
    image = np.full((rows * pitch + gap, columns * pitch + gap), 255, np.uint8)
    for row in range(rows + 1):
        for column in range(columns + 1):
            image[row * pitch : row * pitch + gap, column * pitch : column * pitch + gap] = 0
    for tag in range(columns * rows):
        side = (6 + 2 * border_bits) * (tag_px // (6 + 2 * border_bits))
        marker = cv2.aruco.generateImageMarker(dictionary, tag, side, borderBits=border_bits)
        marker = np.rot90(cv2.resize(marker, (tag_px, tag_px), interpolation=cv2.INTER_NEAREST), turns)
        y, x = gap + (rows - 1 - tag // columns) * pitch, gap + tag % columns * pitch
        image[y : y + tag_px, x : x + tag_px] = marker
    flipped = np.ascontiguousarray(image[::-1])
    return _with_margin(flipped, tag_px), np.array([-_MARGIN - spacing, -_MARGIN - spacing])


def _with_margin(image: U8, cell_px: int) -> U8:
    margin = round(_MARGIN * cell_px)
    return np.pad(image, margin, constant_values=235)


def photograph(
    print_: tuple[U8, F64], cell_px: int, cell_m: float, rig: KnownRig, pose: F64, noise: float = 2.0
) -> tuple[U8, U8]:
    """Left and right image of a print, FINE x FINE samples per pixel, with slight noise."""
    random = np.random.default_rng(round(1e6 * abs(pose[0])))
    images = []
    for side, at in _sides(rig, pose):
        exact = _seen(print_, cell_px, cell_m, rig.model, side, at)
        images.append(np.clip(exact + noise * random.normal(size=exact.shape), 0, 255).round().astype(np.uint8))
    return images[0], images[1]


@functools.cache
def chessboard_photographs() -> tuple[tuple[U8, U8], ...]:
    """Eight views of a board of 7x5 corners by both cameras of the fisheye rig; rendered once for all tests."""
    print_, board_m = chessboard_print(7, 5), chessboard_points(7, 5)
    return tuple(photograph(print_, 40, SQUARE_M, FISHEYE, pose) for pose in poses(8, board_m, FISHEYE, seed=3))


@functools.lru_cache(maxsize=2)  # both cameras of a rig
def _rays(model: str, camera: tuple[float, ...]) -> F64:
    """X and Y, at Z = 1, of the directions of the samples of an image, (N, 1, 2)."""
    side, (width, height) = np.array(camera), SIZE
    x, y = np.meshgrid((np.arange(width * FINE) + 0.5) / FINE - 0.5, (np.arange(height * FINE) + 0.5) / FINE - 0.5)
    pixels = np.column_stack([x.ravel(), y.ravel()]).reshape(-1, 1, 2)
    undistort = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
    return np.asarray(undistort(pixels, camera_matrix(side), side[4:]), np.float64)


def _seen(print_: tuple[U8, F64], cell_px: int, cell_m: float, model: str, side: F64, pose: F64) -> F64:
    image, origin = print_
    to_camera = np.column_stack([cv2.Rodrigues(pose[:3])[0][:, :2] * cell_m, pose[3:]])  # from cells of the board
    to_print = np.diag([cell_px, cell_px, 1.0])
    to_print[:2, 2] = -origin * cell_px - 0.5
    at = cv2.perspectiveTransform(_rays(model, tuple(side)), to_print @ np.linalg.inv(to_camera))
    maps = at.clip(-9, 30000).astype(np.float32).reshape(SIZE[1] * FINE, SIZE[0] * FINE, 2)
    fine_view = cv2.remap(image.astype(np.float32), maps, None, cv2.INTER_LINEAR, borderValue=110)
    return np.asarray(cv2.resize(fine_view, SIZE, interpolation=cv2.INTER_AREA), np.float64)
