# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plot of a fused surface: its triangles cover the pixels between their points, and near ones hide far ones."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.plots.fused import fused_plot
from stereo_depth_ros.surfaces.mesh import Mesh

RED, BLUE = (200, 0, 0), (0, 0, 200)


def walls(near_m: float, far_m: float) -> Mesh:
    """A red wall of 1 m x 2 m and a blue one of 2 m x 2 m that reaches beyond it on the right, two triangles each."""

    def corners(left_m: float, depth_m: float) -> list[tuple[float, float, float]]:
        return [(left_m, -1, depth_m), (1, -1, depth_m), (1, 1, depth_m), (left_m, 1, depth_m)]

    points = np.array(corners(0.0, near_m) + corners(-1.0, far_m), np.float32)
    triangles = np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)], np.int32)
    normals = np.tile(np.array([0, 0, -1], np.float32), (8, 1))
    colors = np.array([RED] * 4 + [BLUE] * 4, np.uint8)
    return Mesh(points, triangles, normals, colors, np.full(8, 0.01, np.float32))


def from_behind(image: U8) -> U8:
    return image[36 : 36 + 480, 2 * 16 + 480 : 2 * (16 + 480), ::-1]


def test_large_triangles_have_no_gaps_and_hide_what_is_behind() -> None:
    panel = from_behind(fused_plot(walls(3.0, 3.2), "walls"))
    middle = panel[100:380]
    assert (middle[:, 250:450] == RED).all()  # the walls are 460 px wide
    assert (middle[:, 30:230] == BLUE).all()


def test_the_other_way_round() -> None:
    panel = from_behind(fused_plot(walls(3.2, 3.0), "walls"))
    assert (panel[100:380, 30:450] == BLUE).all()
