# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A small synthetic scan with its files: images of a board on a linear stage, the light plane, the motion."""

from __future__ import annotations

import functools
from pathlib import Path

import cv2
import numpy as np

from stereo_depth_ros.active.light_stripe.light_plane import LightPlane
from stereo_depth_ros.active.light_stripe.motion import StripeMotion
from stereo_depth_ros.active.light_stripe.plane_file import write_plane
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.synthetic.light_stripe import PLANE, SyntheticStripe

__all__ = ["AXIS", "STEPS_M", "exact_plane", "scan_images", "scanner", "write_scan"]

AXIS, STEPS_M = np.array([1.0, 0.0, 0.0]), (0.0, 0.01, 0.02)


@functools.cache
def scanner() -> SyntheticStripe:
    return SyntheticStripe(160, 120, sigma_m=0.009)


def exact_plane() -> LightPlane:
    return LightPlane.exact(PLANE[:3], float(PLANE[3]))


@functools.cache
def scan_images() -> tuple[tuple[U8, U8], ...]:
    """Left and right raw images, RGB, of the object at each step."""
    motion = StripeMotion("linear", "object", AXIS)
    return tuple(scanner().capture(motion.matrix(np.array([step])), None, n) for n, step in enumerate(STEPS_M))


def write_scan(folder: Path) -> Path:
    """laser.yaml, motion.csv and left images in images/; the folder."""
    (folder / "images").mkdir(parents=True)
    for number, (left, _) in enumerate(scan_images()):
        cv2.imwrite(str(folder / "images" / f"step{9 + number}.png"), left[..., ::-1])
    write_plane(folder / "laser.yaml", exact_plane(), scanner().rig.left)
    rows = [f"step{9 + number}.png,{1e3 * step}" for number, step in enumerate(STEPS_M)]
    (folder / "motion.csv").write_text("\n".join(["image,position_mm", *rows, ""]))
    return folder
