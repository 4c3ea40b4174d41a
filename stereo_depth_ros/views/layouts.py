# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Layouts of both images in one: side by side for parallel or crossed viewing, and interlaced rows."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import U8

__all__ = ["LAYOUTS", "arranged", "check_layout"]

LAYOUTS = ("parallel", "cross", "interlaced")


def arranged(left: U8, right: U8, layout: str) -> U8:
    """Both images in one.

    Args:
        left, right: uint8 (H, W) or (H, W, 3), converged.
        layout: parallel has the left image on the left, cross on the right; interlaced has the rows 0, 2, 4, ... of the
            left image and the rows in between of the right one, for screens with polarized rows.

    Returns:
        uint8 (H, 2W[, 3]), or (H, W[, 3]) interlaced.

    Raises:
        ConfigError: unknown layout.
        ImageError: the shapes differ.
    """
    check_layout(layout)
    if left.shape != right.shape:
        raise ImageError(
            f"left {left.shape} and right {right.shape} differ in shape",
            subject="layout",
            value=right.shape,
            limit=left.shape,
            remedy="use two images of one kind",
        )
    if layout == "parallel":
        return np.hstack((left, right))
    if layout == "cross":
        return np.hstack((right, left))
    rows = left.copy()
    rows[1::2] = right[1::2]
    return rows


def check_layout(layout: str) -> None:
    """Refuse an unknown layout.

    Raises:
        ConfigError: it is not one of ``LAYOUTS``.
    """
    if layout not in LAYOUTS:
        raise ConfigError(
            f"layout {layout!r} is not one of {', '.join(LAYOUTS)}",
            value=layout,
            limit=LAYOUTS,
            remedy="use one of them",
            settings=("layout",),
        )
