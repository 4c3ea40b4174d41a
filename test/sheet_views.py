# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A block on a printed sheet of dots, as a range camera sees it from around, with exact poses."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.surfaces.range_image import RangeImage

WIDTH, HEIGHT = 300, 230
FX, FY, CX, CY = 395.0, 401.0, 152.0, 111.0
K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
CAMERA = CameraModel(WIDTH, HEIGHT, "plumb_bob", K, np.zeros(5), np.identity(3), np.column_stack((K, np.zeros(3))))
SHEET_SIZE = (600, 520)
METERS_PER_PX = 0.00035
DIAMETER_PX = 17.0
_COLUMNS = (60, 150, 310, 420, 545, 40, 115, 560, 500, 60, 140, 255, 370, 470, 560, 30)
_ROWS = (50, 70, 35, 80, 60, 190, 260, 170, 300, 380, 470, 440, 480, 410, 470, 480)
DOTS_PX = np.stack((_COLUMNS, _ROWS), axis=1).astype(np.float64)
BLOCK = (np.array([-0.028, -0.018, 0.0]), np.array([0.03, 0.021, 0.042]))
SIGMA_1M = 0.004


def sheet_image(dots: F64 = DOTS_PX) -> U8:
    """The image of the sheet, uint8 (H, W)."""
    image = np.full(SHEET_SIZE[::-1], 255, np.uint8)
    for x, y in dots:
        cv2.circle(image, (round(16 * x), round(16 * y)), round(8 * DIAMETER_PX), 0, -1, cv2.LINE_AA, 4)
    return image


@functools.cache
def _printed() -> npt.NDArray[np.bool_]:
    """Where the sheet is white, four samples for each of its pixels and axis."""
    white = np.ones((4 * SHEET_SIZE[1], 4 * SHEET_SIZE[0]), bool)
    rows, columns = np.indices(white.shape, np.float32)
    for x, y in DOTS_PX:
        around = np.s_[round(4 * (y - DIAMETER_PX)) : round(4 * (y + DIAMETER_PX)), :]
        inside = np.hypot(columns[around] / 4 - x, rows[around] / 4 - y) < DIAMETER_PX / 2
        white[around] &= ~inside
    return white


def dots_m(dots: F64 = DOTS_PX) -> F64:
    """Centers of the dots in the frame of the sheet, float64 (M, 3)."""
    middle = (np.array(SHEET_SIZE) - 1) / 2
    return np.column_stack(((dots - middle) * np.array([1, -1]) * METERS_PER_PX, np.zeros(len(dots))))


def poses_around(count: int, distance_m: float = 0.36, height_m: float = 0.22) -> list[Pose]:
    """From cameras around the sheet, not in equal steps, to the sheet."""
    poses = []
    for n in range(count):
        angle = 2 * math.pi * n / count + 0.2 * math.sin(3.0 * n)
        place = np.array([distance_m * math.cos(angle), distance_m * math.sin(angle), height_m + 0.01 * (n % 3)])
        z = np.array([0.004, -0.003, 0.012]) - place
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.03, 0.02, 1.0])
        x /= np.linalg.norm(x)
        poses.append(Pose(np.stack((x, np.cross(z, x), z), axis=1), place))
    return poses


def seen(pose: Pose, u: F64, v: F64, block: bool = True) -> tuple[F64, F64]:
    """Depth and gray level at positions in the image, float64."""
    rays = np.stack(((u - CX) / FX, (v - CY) / FY, np.ones(u.shape)), axis=-1) @ pose.rotation.T
    origin = pose.translation_m
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -origin[2] / rays[..., 2]
        one, other = (BLOCK[0] - origin) / rays, (BLOCK[1] - origin) / rays
    depth = np.where(depth > 0, depth, 2.0)
    depth = np.minimum(depth, 2.0)  # a wall
    points = origin + depth[..., None] * rays
    half = np.array(SHEET_SIZE) * METERS_PER_PX / 2
    on_sheet = (np.abs(points[..., :2]) < half).all(axis=-1) & (np.abs(points[..., 2]) < 1e-9)
    x, y = (points[..., 0] / METERS_PER_PX, -points[..., 1] / METERS_PER_PX)
    printed = _printed()
    column = np.clip(np.rint(4 * (x + (SHEET_SIZE[0] - 1) / 2)), 0, printed.shape[1] - 1).astype(int)
    row = np.clip(np.rint(4 * (y + (SHEET_SIZE[1] - 1) / 2)), 0, printed.shape[0] - 1).astype(int)
    level = np.where(on_sheet, 30.0 + 205.0 * printed[row, column], 150.0)
    into, out = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    hit = (into < out) & (into > 0) & (into < depth) & block
    return np.where(hit, into, depth), np.where(hit, 170.0, level)


def view(pose: Pose, seed: int, *, block: bool = True) -> RangeImage:
    """A range image with the noise of a range camera, and a color image of pixels that average over their area."""
    y, x = np.indices((HEIGHT, WIDTH)).astype(np.float64)
    offsets = (np.arange(3) - 1.0) / 3
    levels = [seen(pose, x + a, y + b, block)[1] for a in offsets for b in offsets]
    rng = np.random.default_rng(seed)
    gray = np.mean(levels, axis=0) + rng.normal(0, 1.5, x.shape)
    depth = seen(pose, x, y, block)[0]
    sigma = SIGMA_1M * depth**2
    depth = depth + rng.normal(0, 1, depth.shape) * sigma
    gray8 = np.clip(np.rint(gray), 0, 255).astype(np.uint8)
    color = np.stack((gray8, gray8, np.minimum(gray8, 240)), axis=2)
    geometry = Triangulation(FX, FY, CX, CY, 0.0, 0.0)
    return RangeImage(depth.astype(np.float32), sigma.astype(np.float32), geometry, color)


def write_views(folder: Path, images: Sequence[RangeImage], first: int = 0) -> None:
    """rgb_N.png and depth_N.png in millimeters."""
    folder.mkdir(exist_ok=True)
    for number, image in enumerate(images, start=first):
        cv2.imwrite(str(folder / f"rgb_{number}.png"), np.ascontiguousarray(image.color[:, :, ::-1]))
        depth_mm = np.rint(1000 * np.nan_to_num(image.depth_m)).astype(np.uint16)
        cv2.imwrite(str(folder / f"depth_{number}.png"), depth_mm)


def write_toy(folder: Path) -> None:
    """Five views, the image of their sheet and their camera."""
    write_views(folder, [view(pose, seed) for seed, pose in enumerate(poses_around(5))])
    cv2.imwrite(str(folder / "sheet.png"), sheet_image())
    write_camera(folder / "camera.yaml", CAMERA, "color")
