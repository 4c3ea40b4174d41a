# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Colors of the projector that mix in the camera: estimated from edges whose change is known, and separated.

A camera sees the light of a projector as M times the projected color (Caspi, Kiryati and Shamir 1998, without the color
of the surface). A change of color is seen as M times the change, so that M follows from labeled edges.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from stereo_depth_ros.active.one_shot.edges import I32, ColorEdges
from stereo_depth_ros.active.one_shot.stripes import StripePattern
from stereo_depth_ros.core.types import F64, U8

__all__ = ["color_mixing", "separate_colors"]

_LEAST_EDGES = 100
_LARGEST_CONDITION = 8.0


def color_mixing(edges: ColorEdges, labels: I32, runs: U8, pattern: StripePattern) -> F64:
    """The matrix M of: change in the image = M times change in the pattern, by least squares.

    Edges in runs of twice the length that is unique are used.

    Returns:
        float64 (3, 3); the identity where fewer than 100 edges are known, or where they do not determine M.
    """
    row, k = np.nonzero((runs >= 2 * pattern.window) & (labels >= 0))
    if row.size < _LEAST_EDGES:
        return np.identity(3)
    projected = pattern.changes[labels[row, k]].astype(np.float64)
    seen = edges.changes[row, k].astype(np.float64)
    M = np.asarray(np.linalg.lstsq(projected, seen, rcond=None)[0].T, np.float64)
    return M if np.linalg.cond(M) <= _LARGEST_CONDITION else np.identity(3)


def separate_colors(edges: ColorEdges, M: F64) -> ColorEdges:
    """The edges as a camera would see them whose colors do not mix."""
    changes = edges.changes @ np.linalg.inv(M).T.astype(np.float32)
    changes /= np.maximum(np.abs(changes).max(axis=2, keepdims=True), np.float32(1e-6))
    return dataclasses.replace(edges, changes=np.ascontiguousarray(changes, np.float32))
