# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs with true disparities of DrivingStereo, Sintel stereo and TartanAir, with a folder for each kind of file.

- DrivingStereo (Yang et al., CVPR 2019): PNG of 16 bits, 256 levels per pixel at half size, 128 at full size.
- Sintel stereo (Butler et al., ECCV 2012): PNG of three channels, d = 4 R + G / 2^6 + B / 2^14; masks of pixels that
  are hidden from the right camera or outside of its image.
- TartanAir (Wang et al., IROS 2020): depth in meters, d = 80 m px / Z, as f = 320 px and B = 0.25 m; an array in the
  first version, float32 in the four channels of a PNG in the second.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.datasets.image_files import IMAGE_SUFFIXES, read_channels, read_disparity_image
from stereo_depth_ros.datasets.npz import read_array

__all__ = ["TruthPair", "truth_pairs"]

_TARTAN_AIR = 80.0  # f B, px m
_SINTEL_HIDDEN = ("occlusions", "outofframe")


class TruthPair(NamedTuple):
    """A pair and how its truth is read.

    Attributes:
        name: within its folder.
        left, right, truth: the files.
        hidden: masks, not 0 where the right camera does not see the point of a left pixel; those that exist.
        read: reads the truth: float32 (H, W), x_left - x_right in px, NaN where it is not known; BagError.
    """

    name: str
    left: Path
    right: Path
    truth: Path
    hidden: tuple[Path, ...]
    read: Callable[[Path], F32]


class _Layout(NamedTuple):
    """Folders of the files, the ends of their names that differ from that of the truth, and how this is read."""

    left: str
    right: str
    truth: str
    ends: tuple[str, str, str]
    read: Callable[[Path], F32]


def _levels(path: Path, per_px: int) -> F32:
    levels = read_disparity_image(path)
    return np.where(levels > 0, levels / np.float32(per_px), np.float32(np.nan)).astype(np.float32)


def _sintel(path: Path) -> F32:
    blue, green, red = np.moveaxis(read_channels(path, 3).astype(np.float64), -1, 0)
    return np.asarray(4 * red + green / 2**6 + blue / 2**14, np.float32)


def _depth_array(path: Path) -> F32:
    return _of_depth(read_array(path))


def _depth_in_channels(path: Path) -> F32:
    return _of_depth(np.ascontiguousarray(read_channels(path, 4)).view("<f4")[..., 0])


def _of_depth(depth_m: F32) -> F32:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(depth_m > 0, np.float32(_TARTAN_AIR) / depth_m, np.float32(np.nan)).astype(np.float32)


_HALF, _FULL = functools.partial(_levels, per_px=256), functools.partial(_levels, per_px=128)
_SAME = ("", "", "")
_LAYOUTS = (
    _Layout("left-image-half-size", "right-image-half-size", "disparity-map-half-size", _SAME, _HALF),
    _Layout("left-image-full-size", "right-image-full-size", "disparity-map-full-size", _SAME, _FULL),
    _Layout("train-left-image", "train-right-image", "train-disparity-map", _SAME, _HALF),
    _Layout("test-left-image", "test-right-image", "test-disparity-map", _SAME, _HALF),
    _Layout("final_left", "final_right", "disparities", _SAME, _sintel),
    _Layout("clean_left", "clean_right", "disparities", _SAME, _sintel),
    _Layout("image_left", "image_right", "depth_left", ("_left", "_right", "_left_depth"), _depth_array),
    _Layout(
        "image_lcam_front",
        "image_rcam_front",
        "depth_lcam_front",
        ("_lcam_front", "_rcam_front", "_lcam_front_depth"),
        _depth_in_channels,
    ),
)


def truth_pairs(folder: Path) -> list[TruthPair]:
    """The pairs of a folder with these folders in it; none where it has no such folders.

    Raises:
        BagError: a truth without its images.
    """
    found: list[TruthPair] = []
    for layout in _LAYOUTS:
        if all((folder / name).is_dir() for name in (layout.left, layout.right, layout.truth)):
            several = sum((folder / other.left).is_dir() for other in _LAYOUTS if other.truth == layout.truth) > 1
            prefix = f"{layout.left.partition('_')[0]}/" if several else ""  # final or clean
            for truth in sorted(path for path in (folder / layout.truth).rglob("*") if path.is_file()):
                found.append(_pair(folder, layout, truth, prefix))
    return found


def _pair(folder: Path, layout: _Layout, truth: Path, prefix: str) -> TruthPair:
    left_end, right_end, truth_end = layout.ends
    below = truth.relative_to(folder / layout.truth)
    stem = below.stem.removesuffix(truth_end)
    left = _image(folder / layout.left / below.parent, stem + left_end, truth)
    right = _image(folder / layout.right / below.parent, stem + right_end, truth)
    masks = (folder / name / below for name in _SINTEL_HIDDEN)
    name = f"{prefix}{below.parent / stem}".replace("\\", "/")
    return TruthPair(name, left, right, truth, tuple(mask for mask in masks if mask.is_file()), layout.read)


def _image(folder: Path, stem: str, truth: Path) -> Path:
    for suffix in IMAGE_SUFFIXES:
        if (path := folder / f"{stem}{suffix}").is_file():
            return path
    raise BagError(
        f"has a truth, but there is no image {folder / stem} with one of {', '.join(IMAGE_SUFFIXES)}",
        subject=str(truth),
        value=str(folder / stem),
        remedy="copy the images too, or remove the truth",
    )
