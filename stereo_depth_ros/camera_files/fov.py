# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The lens model FOV as equidistant, where that is the same within a tenth of a pixel.

Devernay and Faugeras, "Straight lines have to be straight", MVA 2001: a ray at the angle t is at the radius
atan(2 tan(t) tan(w / 2)) / w.
"""

from __future__ import annotations

import math

import numpy as np

from stereo_depth_ros.camera_files.stored import Size
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64

__all__ = ["fov_as_equidistant"]

_MAX_ERROR_PX = 0.1
_WIDEST = math.radians(85)
_SAMPLES = 400


def fov_as_equidistant(K: F64, w: float, size: Size) -> tuple[F64, F64]:
    """The camera matrix and coefficients of the equidistant camera that is nearest in the image.

    Args:
        K: float64 (3, 3), of the camera with the FOV model, px.
        w: its parameter, radians.
        size: of the image, px.

    Returns:
        K, float64 (3, 3), px, and k1 to k4, float64 (4,).

    Raises:
        CalibrationError: w is not in 0 to 180 degrees, or the two models differ by more than 0.1 px.
    """
    if not 0 < w < math.pi:
        raise CalibrationError(
            f"w of the FOV model is {w:g}, not 0 to pi", value=w, limit=(0, math.pi), remedy="calibrate again"
        )
    slope = 2 * math.tan(w / 2) / w
    corners = np.array([[x, y] for x in (0, size[0]) for y in (0, size[1])]) - K[:2, 2]
    radius = float(np.linalg.norm(corners / [K[0, 0], K[1, 1]], axis=1).max())
    widest = math.atan(math.tan(radius * w) / (slope * w)) if radius * w < math.pi / 2 else _WIDEST
    angles = np.linspace(0, min(widest, _WIDEST), _SAMPLES)
    wanted = np.arctan(slope * w * np.tan(angles)) / (w * slope)
    powers = angles[:, None] ** np.array([3, 5, 7, 9])
    k = np.linalg.lstsq(powers, wanted - angles, rcond=None)[0]
    error_px = float(np.abs(powers @ k - (wanted - angles)).max() * slope * max(K[0, 0], K[1, 1]))
    if not error_px <= _MAX_ERROR_PX:
        raise CalibrationError(
            f"the FOV model (w = {w:g}) is not that of an equidistant camera, the nearest one differs by "
            f"{error_px:.2g} px, limit {_MAX_ERROR_PX} px",
            value=error_px,
            limit=_MAX_ERROR_PX,
            remedy="calibrate with pinhole-equi",
        )
    return np.array([[K[0, 0] * slope, 0, K[0, 2]], [0, K[1, 1] * slope, K[1, 2]], [0, 0, 1]], np.float64), k
