# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots a fused surface in its colors, from above, from the front and from the side."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.plots.drawing import FAINT, canvas, draw_text
from stereo_depth_ros.surfaces.mesh import Mesh

__all__ = ["fused_plot"]

_PANEL, _MARGIN, _TITLE, _CAPTION = 480, 16, 36, 30
_OUTSIDE = 0.5  # % of the points on each side that the frame may cut off
_LIGHTEST, _DARKEST = 1.0, 0.35  # share of the color, by the angle between the normal and the line of sight
_FINEST = 2 * _PANEL  # parts of an edge; longer ones reach beyond the panel


def fused_plot(mesh: Mesh, title: str, *, z_up: bool = False) -> U8:
    """Three panels, uint8 (H', W', 3) BGR, orthographic, the nearest points in front; shaded by their normals.

    Args:
        mesh: the surface; without points the panels are empty.
        title: one line above.
        z_up: its axes are x forward, y left, z up; otherwise x right, y down, z forward.
    """
    right, down, ahead = (-mesh.points_m[:, 1], -mesh.points_m[:, 2], mesh.points_m[:, 0]) if z_up else mesh.points_m.T
    points = np.stack((right, down, ahead), axis=1).astype(np.float64)
    n = mesh.normals
    normals = np.stack((-n[:, 1], -n[:, 2], n[:, 0]), axis=1) if z_up else n
    image = canvas(3 * _PANEL + 4 * _MARGIN, _TITLE + _PANEL + _CAPTION)
    views = (("from above", 0, 2, 1, -1), ("from behind", 0, 1, 2, 1), ("from the right", 2, 1, 0, -1))
    size_m = 1.0
    if len(points):
        low, high = np.percentile(points, [_OUTSIDE, 100 - _OUTSIDE], axis=0)
        size_m = max(float((high - low).max()), 1e-6)
    for number, (caption, across, along, depth, sign) in enumerate(views):
        x = _MARGIN + number * (_PANEL + _MARGIN)
        panel = image[_TITLE : _TITLE + _PANEL, x : x + _PANEL]
        if len(points):
            center = (low + high)[[across, along]] / 2
            seen = points[:, [across, along]]
            flip = -1.0 if caption == "from above" else 1.0  # ahead is up
            place = np.stack((seen[:, 0] - center[0], flip * (seen[:, 1] - center[1])), axis=1) / (1.04 * size_m)
            near = points[:, depth] if caption == "from above" else sign * points[:, depth]
            values = np.column_stack((place, near, np.abs(normals[:, depth]), mesh.colors))
            _draw(panel, _as_dense_as_pixels(values, mesh.triangles))
        draw_text(image, f"{caption}, {size_m:.2f} m wide", (x, _TITLE + _PANEL + 18), color=FAINT)
    draw_text(image, title, (_MARGIN, 25), 0.55)
    return image


def _as_dense_as_pixels(values: F64, triangles: npt.NDArray[np.int32]) -> F64:
    """Values, float64 (N, C), with x and y in panels first, of the points and of what lies between those of triangles.

    The edges of a triangle are parted so that no part is longer than a pixel.
    """
    corners = values[triangles]
    edges = corners[:, :, :2] - corners[:, (1, 2, 0), :2]
    parts = np.ceil(np.hypot(edges[..., 0], edges[..., 1]).max(axis=1, initial=0.0) * _PANEL)
    parts = np.clip(parts, 1, _FINEST).astype(int)
    found = [values]
    for count in np.unique(parts[parts > 1]):
        i, j = np.divmod(np.arange((count + 1) ** 2), count + 1)
        weights = np.stack((i, j, count - i - j), axis=1)[i + j <= count] / count
        found.append(np.einsum("pk,tkc->tpc", weights, corners[parts == count]).reshape(-1, values.shape[1]))
    return np.concatenate(found)


def _draw(panel: U8, values: F64) -> None:
    """Paint points, float64 (N, 7): x, y, depth, facing, red, green, blue; the nearest ones last."""
    values = values[np.argsort(-values[:, 2])]
    columns, rows = np.rint((values[:, :2].T + 0.5) * (_PANEL - 1)).astype(int)
    inside = (columns >= 0) & (columns < _PANEL) & (rows >= 0) & (rows < _PANEL)
    shade = _DARKEST + (_LIGHTEST - _DARKEST) * values[inside, 3:4]
    panel[rows[inside], columns[inside]] = np.rint(values[inside, :3:-1] * shade).astype(np.uint8)
