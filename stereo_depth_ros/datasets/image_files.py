# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lists and reads image files, and checks their size against a calibration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.camera import MAX_PIXELS, CameraModel
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.text_files import read_bytes
from stereo_depth_ros.core.types import F32, U8, Frame
from stereo_depth_ros.messages.encodings import decode_file
from stereo_depth_ros.messages.image_header import read_file_header

__all__ = [
    "IMAGE_SUFFIXES",
    "check_sizes",
    "checked_truth",
    "extended",
    "framed",
    "image_frame",
    "image_size",
    "list_images",
    "plain_frame",
    "read_disparity_image",
    "read_frame",
    "read_image",
    "read_level_image",
    "read_pair",
]


MAX_BYTES = 2**30  # of an image file
_FORMATS = ("png", "jpeg", "pnm", "bmp", "tiff", "webp", "pfm")
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


def read_pair(left: Path, right: Path) -> tuple[U8, U8]:
    """Both images as of :func:`read_image`; of one file for both, its left and its right half.

    Raises:
        BagError: not a readable image, or the width of one file for both is odd.
    """
    if left != right:
        return read_image(left), read_image(right)
    pixels = read_image(left)
    height, width = pixels.shape[:2]
    if width % 2:
        raise BagError(
            f"is {width}x{height}, an odd width has no two halves",
            subject=str(left),
            value=width,
            limit="an even width",
            remedy="side by side are two images of equal widths",
        )
    return np.ascontiguousarray(pixels[:, : width // 2]), np.ascontiguousarray(pixels[:, width // 2 :])


def read_disparity_image(path: Path) -> npt.NDArray[Any]:
    """The levels of a disparity image, as of :func:`read_level_image`."""
    return read_level_image(path, "a disparity image")


def read_level_image(path: Path, kind: str) -> npt.NDArray[Any]:
    """The levels of an image of one channel, (H, W), in the dtype of the file.

    Args:
        path: the file.
        kind: what it should be, for errors, such as "a depth image".

    Raises:
        BagError: not a readable image of one channel.
    """
    image = _read(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2:
        raise BagError(
            f"has {image.shape[2]} channels, {kind} has one",
            subject=str(path),
            value=image.shape[2],
            limit=1,
            remedy="copy it again",
        )
    return image


def read_channels(path: Path, count: int) -> U8:
    """The bytes of an image of 8 bits and some channels, uint8 (H, W, count), blue first.

    Raises:
        BagError: not a readable image of so many channels.
    """
    image = _read(path, cv2.IMREAD_UNCHANGED)
    found = 1 if image.ndim == 2 else image.shape[2]
    if found != count or image.dtype != np.uint8:
        raise BagError(
            f"has {found} channel(s) of {image.dtype}, {count} of uint8 are expected",
            subject=str(path),
            value=(found, str(image.dtype)),
            limit=count,
            remedy="copy it again",
        )
    return np.asarray(image, np.uint8)


def _read(path: Path, flags: int) -> npt.NDArray[Any]:
    content = read_bytes(path, BagError, "check the path", MAX_BYTES)
    header = read_file_header(content)
    if header is None:
        kinds = f", which is {', '.join(_FORMATS)}" if content else ", it is empty"
        raise BagError(f"is not a readable image{kinds}", subject=str(path), limit=_FORMATS, remedy="copy it again")
    if header.width * header.height > MAX_PIXELS:
        raise BagError(
            f"is not a readable image, its header declares {header.width}x{header.height} px and {MAX_PIXELS} px are "
            "the limit",
            subject=str(path),
            value=(header.width, header.height),
            limit=MAX_PIXELS,
            remedy="copy it again, or scale it down",
        )
    pixels = decode_file(content, flags)
    if pixels is None:
        raise BagError(
            f"is not a readable image, its {header.format} is damaged", subject=str(path), remedy="copy it again"
        )
    return pixels


def read_frame(path: Path, camera: CameraModel, stamp_ns: int = 0) -> Frame:
    """The image as a frame of ``camera``, mono8 or bgr8.

    Raises:
        BagError: not a readable image.
    """
    return image_frame(read_image(path), camera, stamp_ns)


def image_frame(pixels: U8, camera: CameraModel, stamp_ns: int = 0) -> Frame:
    """The pixels of :func:`read_image` as a frame of ``camera``, mono8 or bgr8."""
    return plain_frame(pixels, stamp_ns, camera.frame_id)


def plain_frame(pixels: U8, stamp_ns: int, frame_id: str) -> Frame:
    """The pixels of :func:`read_image` as a frame, mono8 or bgr8."""
    return Frame(pixels, stamp_ns, frame_id, "mono8" if pixels.ndim == 2 else "bgr8")


def image_size(pixels: U8) -> tuple[int, int]:
    """Width and height, px."""
    return pixels.shape[1], pixels.shape[0]


def extended(pixels: U8, camera: CameraModel) -> U8:
    """The pixels with black at the right and at the bottom, in the size of a camera that is not smaller."""
    height, width = pixels.shape[:2]
    black = cv2.copyMakeBorder(pixels, 0, camera.height - height, 0, camera.width - width, cv2.BORDER_CONSTANT)
    return np.asarray(black, np.uint8)


def framed(rig: StereoRig) -> StereoRig:
    """The same rig with the frame_id of the left camera: calibration files have none."""
    left, right = (replace(camera, frame_id="left_optical_frame") for camera in (rig.left, rig.right))
    return replace(rig, left=left, right=right)


def check_sizes(rig: StereoRig, path: Path) -> None:
    """Checks that the rig is calibrated for the size of the image ``path``.

    Raises:
        BagError: not a readable image.
        CalibrationError: the sizes differ.
    """
    height, width = read_image(path).shape[:2]
    rig.check_image(width, height, str(path))


def checked_truth(truth_px: F32, size: tuple[int, int], path: Path) -> F32:
    """True disparities, float32 (H, W), of the file ``path``.

    Raises:
        BagError: another width and height than those of the images.
    """
    height, width = truth_px.shape
    if (width, height) != size:
        raise BagError(
            f"its disparities are {width}x{height}, the images are {size[0]}x{size[1]}",
            subject=str(path),
            value=(width, height),
            limit=size,
            remedy="use images and truth of one resolution",
        )
    return truth_px
