# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images of folders in the order of the numbers in their names."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.types import Frame
from stereo_depth_ros.datasets.image_files import list_images, plain_frame, read_image

__all__ = ["numbered_images", "read_plain_frame"]


def numbered_images(places: Iterable[Path], pattern: str = "*") -> list[Path]:
    """Image files, and those of folders, each folder in the order of the numbers in the names: 2.png before 10.png.

    Args:
        places: image files, and folders.
        pattern: of the names of the images in a folder.

    Raises:
        BagError: a place that does not exist, or a folder without images.
    """
    found: list[Path] = []
    for place in places:
        if not place.exists():
            raise BagError("does not exist", subject=str(place), remedy="name a folder of images")
        images = sorted(list_images(place, pattern), key=_order) if place.is_dir() else [place]
        if not images:
            what = "images" if pattern == "*" else f"images {pattern}"
            raise BagError(f"holds no {what}", subject=str(place), remedy="name a folder of images")
        found += images
    return found


def read_plain_frame(path: Path, stamp_ns: int = 0, frame_id: str = "camera_optical_frame") -> Frame:
    """The image as a frame, mono8 or bgr8.

    Raises:
        BagError: not a readable image.
    """
    return plain_frame(read_image(path), stamp_ns, frame_id)


def _order(path: Path) -> tuple[tuple[int, str], ...]:
    """Numbers by value, other parts by their text."""
    parts = re.findall(r"\d+|\D+", path.name)
    return tuple((int(part), "") if part.isdecimal() else (-1, part) for part in parts)
