# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Image files: found, read, and held against a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8, Frame

__all__ = ["IMAGE_SUFFIXES", "check_sizes", "list_images", "read_disparity_image", "read_frame", "read_image"]


IMAGE_SUFFIXES = (".png", ".ppm", ".pgm", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def list_images(folder: Path, pattern: str = "*") -> list[Path]:
    """Image files of a folder, sorted by name."""
    return sorted(path for path in folder.glob(pattern) if path.suffix.lower() in IMAGE_SUFFIXES)


def read_image(path: Path) -> U8:
    """uint8, (H, W) gray or (H, W, 3) in the order blue, green, red; deeper images are scaled to 8 bits.

    Raises:
        BagError: not a readable image.
    """
    return np.asarray(_read(path, cv2.IMREAD_ANYCOLOR), np.uint8)


def read_disparity_image(path: Path) -> npt.NDArray[Any]:
    """The one channel of an image of disparities, (H, W), of the type that the file has.

    Raises:
        BagError: not a readable image of one channel.
    """
    image = _read(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2:
        raise BagError(f"{path} has {image.shape[2]} channels, a disparity image has one: copy it again")
    return image


def _read(path: Path, flags: int) -> npt.NDArray[Any]:
    try:
        pixels = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), flags)
    except (OSError, cv2.error) as error:
        raise BagError(f"{path} is not a readable image ({error}): copy it again") from error
    if pixels is None:
        raise BagError(f"{path} is not a readable image: copy it again")
    return np.asarray(pixels)


def read_frame(path: Path, camera: CameraModel, stamp_ns: int = 0) -> Frame:
    """The image as a frame of ``camera``."""
    pixels = read_image(path)
    return Frame(pixels, stamp_ns, camera.frame_id, "mono8" if pixels.ndim == 2 else "bgr8")


def check_sizes(rig: StereoRig, path: Path) -> None:
    """Refuses a calibration for images of another size than ``path`` has.

    Raises:
        BagError: not a readable image.
        CalibrationError: the sizes differ.
    """
    height, width = read_image(path).shape[:2]
    rig.check_image(width, height, str(path))
