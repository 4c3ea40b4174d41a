# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A small synthetic focal stack, rendered once, and its files."""

from __future__ import annotations

import functools
from pathlib import Path

import cv2

from stereo_depth_ros.active.focus.distances import even_distances
from stereo_depth_ros.synthetic.focal_stack import FocalStack, focal_stack

__all__ = ["FAR_M", "FIRST_M", "IMAGES", "LAST_M", "NEAR_M", "stack", "write_distances", "write_stack"]

NEAR_M, FAR_M = 0.45, 1.05  # of the scene
FIRST_M, LAST_M = 1.2, 0.4  # of the focus, from far to near
IMAGES = 12


@functools.cache
def stack() -> FocalStack:
    distances_m = even_distances(LAST_M, FIRST_M, IMAGES, "inverse", "far-to-near")
    return focal_stack(160, 120, distances_m, near_m=NEAR_M, far_m=FAR_M, breathing=0.05, seed=3)


def write_stack(folder: Path) -> Path:
    """Images focus8.png to focus19.png, which are not in this order as text; the folder."""
    folder.mkdir(parents=True)
    for number, frame in enumerate(stack().frames):
        cv2.imwrite(str(folder / f"focus{8 + number}.png"), frame.pixels)
    return folder


def write_distances(path: Path) -> None:
    """A table of the focus distances of these images."""
    rows = [f"focus{8 + number}.png,{1e3 * distance}" for number, distance in enumerate(stack().distances_m)]
    path.write_text("\n".join(["image,distance_mm", *rows, ""]))
