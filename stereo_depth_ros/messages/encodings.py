# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory layout of the ROS image encodings, and conversion to mono8, rgb8 or bgr8 and to what image_proc publishes."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereo_depth_ros.core.camera_image import CameraImage
from stereo_depth_ros.core.errors import ImageError, MessageError
from stereo_depth_ros.core.types import U8

__all__ = [
    "ENCODINGS",
    "StoredEncoding",
    "decode_file",
    "imdecode",
    "payload_dtype",
    "to_camera_image",
    "to_decoded",
    "to_gray_of_camera",
    "without_alpha",
]


@dataclass(frozen=True)
class StoredEncoding:
    """Layout of one encoding in the payload of a sensor_msgs/Image.

    Attributes:
        decoded: result of decoding: "mono8", "rgb8" or "bgr8".
        samples: samples per pixel of a row.
        sample_bytes: bytes per sample, 1 or 2.
        cvt_code: cv2.cvtColor code of the conversion of 8-bit samples to ``decoded``, None if none is needed.
        gray_code: cv2.cvtColor code of the conversion to gray, None where gray is computed from ``decoded``.
        fine_cvt_code: cv2.cvtColor code of a better conversion of 8-bit samples than ``cvt_code``; None without one.
        multiple: (height, width) of the block with all colors; image sizes are multiples of it.
        smallest: minimum height and width.
        payload_rows: payload rows per two image rows; above 2 if a chroma plane follows the luma plane.
    """

    decoded: str
    samples: int = 1
    sample_bytes: int = 1
    cvt_code: int | None = None
    gray_code: int | None = None
    fine_cvt_code: int | None = None
    multiple: tuple[int, int] = (1, 1)
    smallest: int = 1
    payload_rows: int = 2


def _bayer(codes: tuple[int, int, int], sample_bytes: int) -> StoredEncoding:
    # OpenCV interpolates from neighbors; an image without interior pixels would be black.
    return StoredEncoding("bgr8", 1, sample_bytes, *codes, smallest=3)


def _yuv422(cvt_code: int, gray_code: int) -> StoredEncoding:
    return StoredEncoding("bgr8", 2, 1, cvt_code, gray_code, multiple=(1, 2))


def _yuv420(cvt_code: int) -> StoredEncoding:
    return StoredEncoding("bgr8", 1, 1, cvt_code, cv2.COLOR_YUV2GRAY_420, multiple=(2, 2), payload_rows=3)


# ROS names a mosaic by the first two pixels of the first two rows. The short names of OpenCV (BayerBG) start one row
# and one column later, the long names (BayerRGGB) are those of ROS.
#
# Gray comes from the mosaic itself, as in cv_bridge: each pixel is rounded once, in half the time of gray from colors.
# Over mosaics of eleven Middlebury pairs the pixels that are missing or wrong by more than 1 px went from 12.9 to
# 12.3 % (sgm) and from 36.6 to 36.3 % (bm). The pixels of a frame are bilinear, 0.1 ms for 640x480; the published
# colors are _VNG, the default of image_proc, which OpenCV has for 8 bits: 3 dB less error for 25 times the time. Gray
# from it would give 11.7 % (sgm) and 37.2 % (bm) for 4.6 ms a pair, and would not be the image_rect of image_proc.
_BAYER_CODES = {
    "bayer_rggb": (cv2.COLOR_BayerRGGB2BGR, cv2.COLOR_BayerRGGB2GRAY, cv2.COLOR_BayerRGGB2BGR_VNG),
    "bayer_bggr": (cv2.COLOR_BayerBGGR2BGR, cv2.COLOR_BayerBGGR2GRAY, cv2.COLOR_BayerBGGR2BGR_VNG),
    "bayer_gbrg": (cv2.COLOR_BayerGBRG2BGR, cv2.COLOR_BayerGBRG2GRAY, cv2.COLOR_BayerGBRG2BGR_VNG),
    "bayer_grbg": (cv2.COLOR_BayerGRBG2BGR, cv2.COLOR_BayerGRBG2GRAY, cv2.COLOR_BayerGRBG2BGR_VNG),
}
_UYVY = _yuv422(cv2.COLOR_YUV2BGR_UYVY, cv2.COLOR_YUV2GRAY_UYVY)
_YUY2 = _yuv422(cv2.COLOR_YUV2BGR_YUY2, cv2.COLOR_YUV2GRAY_YUY2)

ENCODINGS: dict[str, StoredEncoding] = {
    "mono8": StoredEncoding("mono8"),
    "8UC1": StoredEncoding("mono8"),
    "mono16": StoredEncoding("mono8", 1, 2),
    "16UC1": StoredEncoding("mono8", 1, 2),
    "rgb8": StoredEncoding("rgb8", 3),
    "bgr8": StoredEncoding("bgr8", 3),
    "8UC3": StoredEncoding("bgr8", 3),
    "rgba8": StoredEncoding("rgb8", 4),
    "bgra8": StoredEncoding("bgr8", 4),
    "rgb16": StoredEncoding("rgb8", 3, 2),
    "bgr16": StoredEncoding("bgr8", 3, 2),
    "rgba16": StoredEncoding("rgb8", 4, 2),
    "bgra16": StoredEncoding("bgr8", 4, 2),
    **{f"{name}8": _bayer(codes, 1) for name, codes in _BAYER_CODES.items()},
    **{f"{name}16": _bayer(codes, 2) for name, codes in _BAYER_CODES.items()},
    "yuv422": _UYVY,
    "uyvy": _UYVY,
    "yuv422_yuy2": _YUY2,
    "yuyv": _YUY2,
    "nv12": _yuv420(cv2.COLOR_YUV2BGR_NV12),
    "nv21": _yuv420(cv2.COLOR_YUV2BGR_NV21),
}


# encoding: (little-endian dtype in the payload, channels)
_WRITTEN = {
    **{"mono8": ("u1", 1), "rgb8": ("u1", 3), "bgr8": ("u1", 3), "rgba8": ("u1", 4), "bgra8": ("u1", 4)},
    **{"mono16": ("<u2", 1), "rgb16": ("<u2", 3), "bgr16": ("<u2", 3), "rgba16": ("<u2", 4), "bgra16": ("<u2", 4)},
    **{"16UC1": ("<u2", 1), "32FC1": ("<f4", 1)},
}


def payload_dtype(pixels: NDArray[Any], encoding: str) -> np.dtype[Any]:
    """The dtype of ``pixels`` of ``encoding`` in the payload of a written message, little-endian.

    Raises:
        MessageError: not mono, rgb, bgr, rgba or bgra of 8 or 16 bits, 16UC1 or 32FC1.
        ImageError: pixels of another type or shape than the encoding has.
    """
    if encoding not in _WRITTEN:
        raise MessageError(
            f"encoding = {encoding!r} is not supported for writing",
            value=encoding,
            limit=tuple(_WRITTEN),
            remedy=f"use one of {', '.join(_WRITTEN)}",
        )
    name, channels = _WRITTEN[encoding]
    dtype = np.dtype(name)
    native = dtype.newbyteorder("=")
    trailing = (channels,) if channels > 1 else ()
    if pixels.dtype != native or pixels.ndim < 2 or pixels.shape[2:] != trailing or not pixels.size:
        shape = f"(H, W, {channels})" if trailing else "(H, W)"
        raise ImageError(
            f"pixels are {pixels.dtype} {pixels.shape}, {encoding} takes {native} {shape} of at least one pixel",
            value=(str(pixels.dtype), pixels.shape),
            limit=(str(native), shape),
            remedy="convert them, or name the encoding they have",
        )
    return dtype


def without_alpha(samples: NDArray[Any]) -> NDArray[Any]:
    """(H, W, 3) of (H, W, 4) samples, contiguous; other shapes are returned as is. The order of the colors is kept."""
    if samples.ndim == 3 and samples.shape[2] == 4:
        return np.asarray(cv2.cvtColor(samples, cv2.COLOR_BGRA2BGR))
    return samples


def to_decoded(pixels: U8, encoding: StoredEncoding) -> U8:
    """uint8 (H, W) or (H, W, 3) pixels in ``encoding.decoded`` order of 8-bit samples without alpha."""
    return pixels if encoding.cvt_code is None else np.asarray(cv2.cvtColor(pixels, encoding.cvt_code), np.uint8)


def to_gray_of_camera(pixels: U8, encoding: StoredEncoding) -> U8 | None:
    """uint8 (H, W), gray of 8-bit samples of a mosaic or with a luma plane; None where gray is that of the colors."""
    return None if encoding.gray_code is None else np.asarray(cv2.cvtColor(pixels, encoding.gray_code), np.uint8)


_COLOR_TO_GRAY = {
    ("rgb8", 3): cv2.COLOR_RGB2GRAY,
    ("bgr8", 3): cv2.COLOR_BGR2GRAY,
    ("rgb8", 4): cv2.COLOR_RGBA2GRAY,
    ("bgr8", 4): cv2.COLOR_BGRA2GRAY,
}


def to_camera_image(samples: NDArray[Any], encoding: StoredEncoding) -> CameraImage | None:
    """The image as it is published, with its bits and alpha; None where that is :func:`to_decoded`.

    Args:
        samples: uint8 or native uint16, as stored.
        encoding: of them.
    """
    channels = samples.shape[2] if samples.ndim == 3 else 1
    has_16_bits, has_alpha = samples.dtype == np.uint16, channels == 4
    if not has_16_bits and not has_alpha and encoding.fine_cvt_code is None:
        return None
    name = encoding.decoded.removesuffix("8") + "a" * has_alpha + ("16" if has_16_bits else "8")
    gray_code = _COLOR_TO_GRAY.get((encoding.decoded, channels), encoding.gray_code)
    return CameraImage(samples, name, gray_code, encoding.cvt_code, None if has_16_bits else encoding.fine_cvt_code)


_SILENT = 0  # log level
_LOGGING: Any = getattr(cv2.utils, "logging", cv2)  # older versions have it in cv2
_PNG_START, _PNG_CHUNK = b"\x89PNG\r\n\x1a\n", 12  # bytes of a chunk beside its content
_JPEG_START, _JPEG_SCAN, _JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"


def imdecode(data: Any) -> NDArray[Any] | None:
    """uint8 or uint16 (H, W), (H, W, 3) or (H, W, 4) as stored; None if ``data`` is not a complete image of these."""
    stored = decode_file(bytes(data), cv2.IMREAD_UNCHANGED)
    return stored if stored is not None and stored.dtype in (np.uint8, np.uint16) else None


def decode_file(content: bytes, flags: int) -> NDArray[Any] | None:
    """The pixels in the content of an image file, by the flags of cv2.imread; None if it is not a complete image.

    The size in the header must have been checked: memory for it is allocated.
    """
    if content.startswith(_JPEG_START) and not _jpeg_is_complete(content):
        return None
    if content.startswith(_PNG_START) and not _png_is_complete(content):
        return None
    level = _LOGGING.getLogLevel()
    _LOGGING.setLogLevel(_SILENT)  # OpenCV writes a line or more to stderr for each image that it cannot read
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except (cv2.error, MemoryError):
        return None
    finally:
        _LOGGING.setLogLevel(level)
    return None if pixels is None else np.asarray(pixels)


def _jpeg_is_complete(content: bytes) -> bool:
    """Whether the end marker comes after the start of the last scan, inside of which markers do not occur.

    Some versions of OpenCV silently fill the missing part of a truncated jpeg with gray.
    """
    return content.rfind(_JPEG_END) >= content.rfind(_JPEG_SCAN)


def _png_is_complete(content: bytes) -> bool:
    """Whether all chunks are inside the file; OpenCV 5 allocates what the length of a chunk says, up to 2 GiB."""
    at = len(_PNG_START)
    while at + _PNG_CHUNK <= len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        at += length + _PNG_CHUNK
        if kind == b"IEND":
            return bool(at <= len(content))
    return False
