# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tsukuba and Venus, the pairs on which matching methods are compared (Scharstein and Szeliski 2002), and others."""

from __future__ import annotations

import functools
import time
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.matching import create_matcher

__all__ = ["Matched", "Scene", "bad", "matched", "part", "scene"]

# Folder, left, right, truth of the left, gray levels of the truth per pixel of disparity, disparities to search.
FILES = {
    "tsukuba": (
        *("middlebury2001/tsukuba", "scene1.row3.col3.ppm", "scene1.row3.col4.ppm"),
        *("truedisp.row3.col3.pgm", 16, 32),
    ),
    "venus": ("middlebury2001/venus", "im2.ppm", "im6.ppm", "disp2.pgm", 8, 32),
    "Baby1": ("middlebury2006/Baby1", "view1.png", "view5.png", "disp1.png", 3, 96),
    "Reindeer": ("middlebury2005/Reindeer", "view1.png", "view5.png", "disp1.png", 3, 96),
}
EDGE_PX = 18  # the truth of Tsukuba has none there; left out of all scenes, as is usual


class Scene(NamedTuple):
    """A real pair: gray uint8 (H, W), truth float32 px with NaN where unknown, and the pixels that are counted."""

    left: U8
    right: U8
    truth_px: F32
    mask: npt.NDArray[np.bool_]
    num_disparities: int


class Matched(NamedTuple):
    """What a method makes of a scene."""

    result: MatchResult
    energies: list[float]
    seconds: float


@functools.cache
def scene(name: str, stereo_data: Path) -> Scene:
    """The scene; counted are pixels with a truth that the right camera sees, outside a border of 18 px."""
    folder, left_name, right_name, truth_name, levels, num_disparities = FILES[name]
    left, right, truth = (
        cv2.imread(str(stereo_data / folder / file), cv2.IMREAD_GRAYSCALE)
        for file in (left_name, right_name, truth_name)
    )
    truth_px = np.where(truth > 0, truth.astype(np.float32) / levels, np.float32(np.nan))
    counted = np.isfinite(truth_px) & ~_occluded(truth_px)
    inner = np.zeros(left.shape, np.bool_)
    inner[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX] = True
    return Scene(left, right, truth_px, counted & inner, num_disparities)


@functools.cache
def matched(method: str, name: str, stereo_data: Path, **fields: Any) -> Matched:
    """A scene matched once per session, without the checks that leave holes."""
    left, right, _, _, num_disparities = scene(name, stereo_data)
    unchecked = {"num_disparities": num_disparities, "speckle_size": 0, "uniqueness_ratio": 0.0}
    matcher = create_matcher(method, **{**unchecked, **fields})
    begin = time.perf_counter()
    result = matcher.match(left, right)
    return Matched(result, getattr(matcher, "energies", []), time.perf_counter() - begin)


def part(of: Scene, rows: slice) -> Scene:
    """Some rows of a scene, to save time."""
    return Scene(*(np.ascontiguousarray(image[rows]) for image in of[:4]), of.num_disparities)


def bad(disparity_px: F32, of: Scene, limit_px: float = 1.0) -> float:
    """Percent of the counted pixels that are wrong by more than ``limit_px`` or have no disparity."""
    error = np.abs(disparity_px - of.truth_px)[of.mask]
    return 100 * float(np.mean(~(error <= limit_px)))


def _occluded(truth_px: F32) -> npt.NDArray[np.bool_]:
    """Pixels that leave the right image, or land there on a pixel that a nearer one of their row covers."""
    width = truth_px.shape[1]
    rows, columns = np.nonzero(np.isfinite(truth_px))
    disparity = truth_px[rows, columns]
    landing = columns - disparity
    nearest = np.full(truth_px.shape, -np.inf, np.float32)
    # Both neighbors of a fractional landing are covered, so that surfaces stretched by their slant have no holes.
    for at in (np.floor(landing).astype(int), np.ceil(landing).astype(int)):
        inside = (at >= 0) & (at < width)
        np.maximum.at(nearest, (rows[inside], at[inside]), disparity[inside])
    at = np.rint(landing).astype(int)
    outside = (at < 0) | (at >= width)
    covering = nearest[rows, np.clip(at, 0, width - 1)]
    occluded = np.zeros(truth_px.shape, np.bool_)
    # Neighbors on a slanted surface may share a landing; half a pixel nearer is another surface.
    occluded[rows, columns] = outside | (covering > disparity + 0.5)
    return occluded
