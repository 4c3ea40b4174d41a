# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distortion models and their coefficients, as drivers write them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stereo_depth_ros.core.types import F64

__all__ = ["COEFFICIENTS", "known_distortion"]

COEFFICIENTS: Mapping[str, tuple[int, ...]] = {
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
_OPENCV = (4, 5, 8, 12, 14)  # counts of OpenCV: k1, k2, p1, p2, then k3, then k4, k5, k6, and so on
_NO_DISTORTION = ("", "none")


def known_distortion(model: str, D: F64) -> tuple[str, F64]:
    """One of the models of :data:`COEFFICIENTS` with a count that it takes, where the numbers have one meaning.

    - plumb_bob is the beginning of rational_polynomial: the coefficients that are not 0 decide which of the two it is,
      as in OpenCV and image_geometry. Zeros at the end are added or removed.
    - equidistant may have zeros after its four coefficients; kannala_brandt is another name of it.
    - No model, or "none", without a coefficient other than 0 is an image without distortion.

    Args:
        model: the distortion_model of a camera info.
        D: float64 (n,), its coefficients.

    Returns:
        The model and its coefficients, float64; both unchanged where they could mean different things.
    """
    used = int(np.flatnonzero(D)[-1]) + 1 if D.any() else 0
    if model.lower() in _NO_DISTORTION and not used:
        return "plumb_bob", np.zeros(5)
    if model.lower() == "kannala_brandt" and D.size >= 4 and used <= 4:
        model = "equidistant"
    if model == "equidistant" and D.size > 4 and used <= 4:
        return model, D[:4]
    if model in ("plumb_bob", "rational_polynomial"):
        return _polynomial(model, D, used)
    return model, D


def _polynomial(model: str, D: F64, used: int) -> tuple[str, F64]:
    if D.size in COEFFICIENTS[model]:
        return model, D
    if D.size not in _OPENCV and not max(used, 4) < D.size:
        return model, D
    count = next((count for count in _OPENCV if used <= count), None)
    if count is None:
        return model, D
    least = 5 if model == "plumb_bob" else 8
    padded = np.zeros(max(count, least))
    padded[:used] = D[:used]
    return "plumb_bob" if padded.size == 5 else "rational_polynomial", padded
