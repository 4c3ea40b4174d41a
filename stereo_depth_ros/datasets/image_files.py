# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lists and reads image files, and checks their size against a calibration."""

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
    """The pixels, uint8, (H, W) gray or (H, W, 3) BGR; images of more than 8 bits are scaled to 8 bits.

    Raises:
        BagError: not a readable image.
    """
    return np.asarray(_read(path, cv2.IMREAD_ANYCOLOR), np.uint8)


def read_disparity_image(path: Path) -> npt.NDArray[Any]:
    """The levels of a disparity image, (H, W), in the dtype of the file.

    Raises:
        BagError: not a readable image of one channel.
    """
    image = _read(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2:
        raise BagError(
            f"has {image.shape[2]} channels, a disparity image has one",
            subject=str(path),
            value=image.shape[2],
            limit=1,
            remedy="copy it again",
        )
    return image


def _read(path: Path, flags: int) -> npt.NDArray[Any]:
    try:
        pixels = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), flags)
    except OSError as error:
        raise BagError(
            f"is not a readable image ({error.strerror})", subject=str(path), remedy="check the path"
        ) from error
    except cv2.error:  # an empty file, for example; the text of OpenCV is not for users
        pixels = None
    if pixels is None:
        raise BagError("is not a readable image", subject=str(path), remedy="copy it again")
    return np.asarray(pixels)


def read_frame(path: Path, camera: CameraModel, stamp_ns: int = 0) -> Frame:
    """The image as a frame of ``camera``, mono8 or bgr8.

    Raises:
        BagError: not a readable image.
    """
    pixels = read_image(path)
    return Frame(pixels, stamp_ns, camera.frame_id, "mono8" if pixels.ndim == 2 else "bgr8")


def check_sizes(rig: StereoRig, path: Path) -> None:
    """Checks that the rig is calibrated for the size of the image ``path``.

    Raises:
        BagError: not a readable image.
        CalibrationError: the sizes differ.
    """
    height, width = read_image(path).shape[:2]
    rig.check_image(width, height, str(path))
