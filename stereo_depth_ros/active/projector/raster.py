# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The raster of a projector: its pixels as pixels of an image of another size, as a rig stores it.

A rig has cameras of one size. Its projector is the camera whose image is the pattern, resized to that size.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64

__all__ = ["resized_camera", "resized_points"]

Size = tuple[int, int]  # width, height, px


def resized_points(points_px: F64, size: Size, new_size: Size) -> F64:
    """Pixels of an image after it was resized: x' + 1/2 = (x + 1/2) W' / W, as the centers of pixels are integers.

    Args:
        points_px: float64 (N, 2), columns x, y.
        size, new_size: width, height before and after, px.
    """
    scale = np.array(new_size, np.float64) / size
    resized: F64 = (points_px + 0.5) * scale - 0.5
    return resized


def resized_camera(camera: CameraModel, new_size: Size) -> CameraModel:
    """The raw camera of resized images, by the same rule; the distortion does not depend on the size."""
    size = camera.width, camera.height
    K = np.diag([new_size[0] / size[0], new_size[1] / size[1], 1.0]) @ camera.K
    K[:2, 2] = resized_points(camera.K[None, :2, 2], size, new_size)[0]
    return replace(camera, width=new_size[0], height=new_size[1], K=K)
