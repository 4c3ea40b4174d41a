# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where stereo is hardest: the pixels near the depth edges of the truth, and those of its thin structures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32
from stereo_depth_ros.matching.filters.hole_filling import fill_holes

__all__ = ["EDGE_DISTANCE_PX", "THIN_PX", "HardRegions", "hard_regions"]

Mask: TypeAlias = npt.NDArray[np.bool_]

STEP_PX = 2.0  # a larger difference of neighbors is a depth edge
EDGE_DISTANCE_PX = 4
THIN_PX = 8


@dataclass(frozen=True)
class HardRegions:
    """Two masks of the left image, bool (H, W), false where the truth is unknown; a pixel may be in both.

    Attributes:
        edges: pixels within 4 px of a depth edge.
        thin: pixels of structures thinner than 8 px.
    """

    edges: Mask
    thin: Mask


def hard_regions(truth_px: F32) -> HardRegions:
    """The pixels near depth edges and those of thin structures, by the true disparities of the left image.

    Unknown truth counts as background: it is filled with the smaller of the nearest disparities of its row, as
    occluded pixels lie behind what occludes them.

    - A depth edge is a pixel with a neighbor above, below, left or right whose disparity differs by more than 2 px. A
      pixel is near it within 4 px along rows and along columns, a window of 9 x 9 px. These are the regions near depth
      discontinuities of Scharstein and Szeliski (2002, section 5.1; eval_disp_gap 2 and eval_discont_width 9).
    - A thin structure is what a morphological opening of the disparities by a disc with a diameter of 8 px lowers by
      more than 2 px: surfaces that stand out before all that is around them, and that no such disc fits into. Beyond
      the border of the image, surfaces go on. The disc does not reach into sharp corners of larger things either: a
      right angle has three such pixels.

    Args:
        truth_px: float32 (H, W), x_left - x_right in pixels, not finite where unknown.
    """
    known = np.isfinite(truth_px)
    filled = np.where(known, truth_px, np.float32(np.nan)).astype(np.float32)
    fill_holes(filled, np.zeros(filled.shape, np.uint8))
    side = 2 * EDGE_DISTANCE_PX + 1
    near = cv2.dilate(_depth_edges(filled).astype(np.uint8), np.ones((side, side), np.uint8)) != 0
    thin = filled - _opened(filled) > STEP_PX
    return HardRegions(known & near, known & thin)


def _depth_edges(disparity_px: F32) -> Mask:
    edges: Mask = np.zeros(disparity_px.shape, np.bool_)
    for this, other in (
        ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
        ((slice(1, None), slice(None)), (slice(None, -1), slice(None))),
    ):
        step = np.abs(disparity_px[this] - disparity_px[other]) > STEP_PX
        edges[this] |= step
        edges[other] |= step
    return edges


def _opened(disparity_px: F32) -> F32:
    """Opening by a disc: the minimum over each place of it, then the maximum over the places that cover a pixel."""
    padded = np.pad(disparity_px, THIN_PX, mode="edge")
    offset = np.arange(THIN_PX) - (THIN_PX - 1) / 2
    disc = (np.hypot(offset, offset[:, None]) <= THIN_PX / 2).astype(np.uint8)
    half = THIN_PX // 2  # of an even width: the maximum is over the mirrored disc
    eroded = cv2.erode(padded, disc, anchor=(half, half))
    opened = cv2.dilate(eroded, disc, anchor=(THIN_PX - 1 - half, THIN_PX - 1 - half))
    return np.asarray(opened[THIN_PX:-THIN_PX, THIN_PX:-THIN_PX], np.float32)
