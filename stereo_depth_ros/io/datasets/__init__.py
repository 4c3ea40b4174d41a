# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all datasets have in common: a rig, and pairs of frames with the true disparities where they are known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.camera_model import CameraModel
from stereo_depth_ros.errors import BagError
from stereo_depth_ros.stereo_rig import StereoRig
from stereo_depth_ros.types import F32, U8, Frame

__all__ = ["DatasetFrame", "StereoDataset", "check_sizes", "list_images", "read_frame", "read_image", "read_picture"]

IMAGE_SUFFIXES = (".png", ".ppm", ".pgm", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True)
class DatasetFrame:
    """One pair.

    Attributes:
        left, right: the images as the dataset has them: raw or rectified, as the rig of the dataset says.
        truth_disparity_px: float32 (H, W), x_left - x_right of the rectified left image, NaN where unknown; None where
            the dataset has no truth for this pair.
    """

    left: Frame
    right: Frame
    truth_disparity_px: F32 | None = None


class StereoDataset(Protocol):
    """A folder of pairs that one calibration describes.

    Attributes:
        rig: the calibration.
        has_stamps: the stamps of the frames are times; otherwise all are 0, and who needs times counts the frames.
    """

    rig: StereoRig
    has_stamps: bool

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[DatasetFrame]: ...


def list_images(folder: Path, pattern: str = "*") -> list[Path]:
    """Image files of a folder, sorted by name."""
    return sorted(path for path in folder.glob(pattern) if path.suffix.lower() in IMAGE_SUFFIXES)


def read_image(path: Path) -> U8:
    """uint8, (H, W) grey or (H, W, 3) in the order blue, green, red; deeper images are scaled to 8 bits.

    Raises:
        BagError: not a readable image.
    """
    return np.asarray(_read(path, cv2.IMREAD_ANYCOLOR), np.uint8)


def read_picture(path: Path) -> npt.NDArray[Any]:
    """The one channel of a picture of disparities, (H, W), of the type that the file has.

    Raises:
        BagError: not a readable image of one channel.
    """
    picture = _read(path, cv2.IMREAD_UNCHANGED)
    if picture.ndim != 2:
        raise BagError(f"{path} has {picture.shape[2]} channels, a disparity image has one: copy it again")
    return picture


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
