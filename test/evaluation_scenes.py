# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small scenes with truth for tests of the evaluation, in the layouts of datasets."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from stereo_depth_ros.core.types import F32, U8

WIDTH, HEIGHT = 170, 96
FAR_PX, NEAR_PX = 6, 20


def pair(seed: int = 1) -> tuple[U8, U8, F32]:
    """Left, right and truth: a near rectangle in front of a far plane, both with a noise texture."""
    rng = np.random.default_rng(seed)
    far, near = (rng.integers(20, 230, (HEIGHT, WIDTH + NEAR_PX), np.uint8) for _ in range(2))
    truth_px = np.full((HEIGHT, WIDTH), FAR_PX, np.float32)
    truth_px[30:80, 60:130] = NEAR_PX
    left = np.where(truth_px == NEAR_PX, near[:, :WIDTH], far[:, :WIDTH])
    right = far[:, FAR_PX : WIDTH + FAR_PX].copy()
    right[30:80, 60 - NEAR_PX : 130 - NEAR_PX] = near[30:80, 60:130]
    return left, right, truth_px


def write(path: Path, pixels: U8 | F32) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels)


def write_scene(folder: Path, seed: int = 1) -> Path:
    """Layout of 2014, without calibration."""
    left, right, truth_px = pair(seed)
    for name, pixels in (("im0.png", left), ("im1.png", right), ("disp0.pfm", truth_px)):
        write(folder / name, pixels)
    return folder


def write_kitti(folder: Path) -> Path:
    """KITTI 2015: one pair with truth, one frame without; occluded pixels; an object."""
    left, right, truth_px = pair()
    for name in ("000000_10.png", "000000_11.png"):
        write(folder / "image_2" / name, left)
        write(folder / "image_3" / name, right)
    levels = (256 * truth_px).astype(np.uint16)
    levels[:10] = 0
    write(folder / "disp_occ_0" / "000000_10.png", levels)
    levels[:, :FAR_PX] = 0
    write(folder / "disp_noc_0" / "000000_10.png", levels)
    write(folder / "obj_map" / "000000_10.png", np.where(truth_px == NEAR_PX, 3, 0).astype(np.uint8))
    return folder
