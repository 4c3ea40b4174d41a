# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads files that hold disparities in pixels: .pfm and .npz."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereo_depth_ros.core.types import F32
from stereo_depth_ros.datasets.image_files import read_disparity_image
from stereo_depth_ros.datasets.npz import read_npz

__all__ = ["MAP_SUFFIXES", "read_disparity_map"]

MAP_SUFFIXES = (".pfm", ".npz")


def read_disparity_map(path: Path) -> F32:
    """The disparities, float32 (H, W), px, as in the file; Middlebury and ETH3D have inf where they are unknown.

    Raises:
        BagError: the file cannot be read, or has no map of one channel.
    """
    if path.suffix.lower() == ".npz":
        return read_npz(path)
    return np.asarray(read_disparity_image(path), np.float32)
