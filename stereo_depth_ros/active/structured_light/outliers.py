# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Outliers of a projector map: small groups of pixels whose coordinates are not near those around them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.filters.speckle_filter import SpeckleFilter

__all__ = ["mark_outliers"]

_MOST_PIXELS = 12  # of a group that is marked
_STEPS = 32000  # of the coordinates, in 16 bits


def mark_outliers(coordinate: npt.NDArray[Any], most_apart: float, reasons: U8) -> None:
    """Mark groups of a few pixels that differ from their neighbors, as SPECKLE.

    Args:
        coordinate: (H, W), any value where ``reasons`` is not 0.
        most_apart: neighbors of one group are not farther apart.
        reasons: uint8 (H, W), in and out.
    """
    valid = reasons == 0
    if not valid.any():
        return
    known = coordinate[valid]
    low, high = float(known.min()), float(known.max())
    scale = _STEPS / max(high - low, 4.0 * most_apart)
    steps = ((np.where(valid, coordinate, low) - low) * scale - _STEPS / 2).astype(np.int16)
    SpeckleFilter(_MOST_PIXELS, int(most_apart * scale))(steps, reasons)
