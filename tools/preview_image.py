# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes docs/preview.png: the left image of the sample bag, its depth, and its point cloud from another viewpoint."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.offline.pairs import read_pairs
from stereo_depth_ros.pipeline import StereoPipeline, StereoResult
from stereo_depth_ros.plots.drawing import FAINT, canvas, draw_color_bar, draw_text
from stereo_depth_ros.plots.preview import color_depth, legend_ticks

__all__ = ["draw_cloud", "draw_panels", "first_result", "write_preview_image"]

WIDTH, HEIGHT = 420, 315
MARGIN, CAPTION, LEGEND = 12, 26, 80
FINE = 2  # the cloud is drawn at this multiple of its size
VIEWPOINT_M, TARGET_M = np.array([1.9, -1.3, -0.6]), np.array([0.1, 0.25, 3.6])  # beside and above the left camera
FOCAL = 0.78  # of the view, as a fraction of its width


def first_result(bag: Path) -> StereoResult:
    """The first pair of a bag with default parameters."""
    pair, rig = next(read_pairs(bag))
    return StereoPipeline(PipelineConfig(), rig).process(pair)


def draw_panels(result: StereoResult) -> U8:
    """Left image, depth and cloud in one row, with a legend; uint8 (H, W, 3) BGR."""
    near_m, far_m = (float(value) for value in np.nanpercentile(result.depth_m, (1, 99)))
    left = np.asarray(cv2.cvtColor(result.rectified.left, cv2.COLOR_GRAY2BGR), np.uint8)
    colors = color_depth(result.depth_m, near_m, far_m)
    shaded = (colors * (0.35 + 0.65 / 255 * left.astype(np.float32))).astype(np.uint8)
    panels = (
        (left, "left image, rectified"),
        (colors, f"depth, {100 * result.disparity.valid_fraction:.0f} % of the pixels"),
        (draw_cloud(result.points(), shaded), "points, seen from the right"),
    )
    image = canvas(3 * WIDTH + 4 * MARGIN + LEGEND, HEIGHT + 2 * MARGIN + CAPTION)
    for index, (panel, caption) in enumerate(panels):
        x = MARGIN + index * (WIDTH + MARGIN)
        image[MARGIN : MARGIN + HEIGHT, x : x + WIDTH] = cv2.resize(
            panel, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA
        )
        draw_text(image, caption, (x, MARGIN + HEIGHT + 20), color=FAINT)
    near, far = 1 / near_m, 1 / far_m
    ticks = [((1 / tick - far) / (near - far), f"{tick:g} m") for tick in legend_ticks(near_m, far_m, HEIGHT)]
    draw_color_bar(image, 3 * WIDTH + 4 * MARGIN, MARGIN, HEIGHT, ticks)
    return image


def draw_cloud(points_m: F32, colors: U8) -> U8:
    """Points (H, W, 3), meters, with their colors (H, W, 3) as squares, near ones in front of far ones."""
    width, height = FINE * WIDTH, FINE * HEIGHT
    valid = np.isfinite(points_m).all(axis=2)
    seen_m = (points_m[valid] - VIEWPOINT_M) @ _rotation().T
    order = np.argsort(-seen_m[:, 2], kind="stable")  # of equal pixels the last one is drawn
    order = order[seen_m[order, 2] > 0.1]
    at = FOCAL * width * seen_m[order, :2] / seen_m[order, 2:] + (width / 2, height / 2)
    square = np.array([(x, y) for y in range(FINE) for x in range(FINE)])
    x, y = (np.floor(at).astype(int)[:, None] + square).reshape(-1, 2).T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    image = canvas(width, height)
    image[y[inside], x[inside]] = np.repeat(colors[valid][order], len(square), axis=0)[inside]
    return image


def _rotation() -> F64:
    """From the left optical frame to a view from the viewpoint to the target, rows x, y, z."""
    z = (TARGET_M - VIEWPOINT_M) / np.linalg.norm(TARGET_M - VIEWPOINT_M)
    x = np.cross((0.0, 1.0, 0.0), z) / np.linalg.norm(np.cross((0.0, 1.0, 0.0), z))
    return np.stack((x, np.cross(z, x), z))


def write_preview_image(root: Path) -> None:
    """Writes the image of the source tree ``root``, as small as PNG compresses it."""
    image = draw_panels(first_result(root / "bags" / "synthetic_room.mcap"))
    encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    write_file(root / "docs" / "preview.png", encoded.tobytes(), overwrite=True)


if __name__ == "__main__":
    write_preview_image(Path(__file__).resolve().parents[1])
