# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Image and CompressedImage messages to frames and from arrays, for rclpy and rosbags."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.camera import MAX_PIXELS
from stereo_depth_ros.core.errors import ConfigError, MessageError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import U8, Frame, StereoPair
from stereo_depth_ros.messages.encodings import (
    ENCODINGS,
    StoredEncoding,
    imdecode,
    payload_dtype,
    to_camera_image,
    to_decoded,
    to_gray_of_camera,
    without_alpha,
)
from stereo_depth_ros.messages.image_header import ImageHeader, read_header
from stereo_depth_ros.messages.types import MessageTypes, make_header
from stereo_depth_ros.messages.types import stamp_ns as stamp_of

__all__ = [
    "compressed_message",
    "decode",
    "decode_compressed",
    "decode_image",
    "decode_pair",
    "image_message",
    "image_size",
    "uncompressed_message",
]

# Deflate writes at most 1032 bytes for one (Gailly and Adler, zlib); the shortest jpeg has a bit for 64 pixels.
_MAX_BITS = 16  # of a sample; a tiff may have floating-point numbers
_MAX_PIXELS_PER_BYTE = {"png": 1032, "jpeg": 512}

_VIDEO = re.compile(r"(?P<H264>[hx]\.?264|avc)|(?P<H265>[hx]\.?265|hevc)|(?P<AV1>av1)|(?P<VP9>vp9)", re.IGNORECASE)


def decode(msg: Any, topic: str = "", depth: BitDepth | None = None) -> Frame:
    """The frame of a sensor_msgs/Image or sensor_msgs/CompressedImage, distinguished by their fields.

    Args:
        msg: the message, of any family.
        topic: its topic, for error messages.
        depth: of the stream, grows with the image; None is that of this image alone. Only 16-bit images have it.

    Raises:
        MessageError: neither of the two, or as :func:`decode_image` and :func:`decode_compressed`.
    """
    return _decode_all(((msg, topic),), depth)[0]


def decode_pair(left: Any, right: Any, topics: tuple[str, str], depth: BitDepth | None = None) -> StereoPair:
    """Both frames of a pair, as :func:`decode` with one bit depth for the two."""
    return StereoPair(*_decode_all(zip((left, right), topics, strict=True), depth))


def decode_image(msg: Any, *, topic: str = "") -> Frame:
    """The frame of a sensor_msgs/Image.

    Pixels are read-only. Unpadded mono8, rgb8 and bgr8 are a view on ``msg.data``, all others are copies: rgba8 becomes
    rgb8, other color bgr8, 16 bit is scaled to 8 by the bit depth, see :class:`BitDepth`. What the pixels have less
    than the message is in ``camera``.

    Raises:
        MessageError: unknown encoding, zero or impossible size, ``step`` below a row, or a payload that is not
            ``step * height`` bytes (including padding of the last row, as in cv_bridge).
    """
    return decode(msg, topic)


def image_size(msg: Any, topic: str = "") -> tuple[int, int]:
    """Width and height in pixels of an image that is not decoded; raises as :func:`decode`, but for damaged pixels."""
    _check_fields(msg, topic)
    if hasattr(msg, "encoding"):
        _checked_encoding(msg, topic)
        return msg.width, msg.height
    header = _checked_header(msg, bytes(msg.data), topic)
    return header.width, header.height


@dataclass(frozen=True)
class _Stored:
    """An image before its samples are scaled: uint8 or native uint16, as stored."""

    header: Any
    stored: NDArray[Any]
    encoding: StoredEncoding

    @cached_property
    def samples(self) -> NDArray[Any]:
        """Without alpha."""
        return without_alpha(self.stored)


def _decode_all(messages: Iterable[tuple[Any, str]], depth: BitDepth | None) -> list[Frame]:
    depth = depth or BitDepth()
    images = [_read(msg, topic) for msg, topic in messages]
    depth.include(*(image.samples for image in images))
    return [_frame(image, depth) for image in images]


def _read(msg: Any, topic: str) -> _Stored:
    _check_fields(msg, topic)
    return _read_image(msg, topic) if hasattr(msg, "encoding") else _read_compressed(msg, topic)


def _check_fields(msg: Any, topic: str) -> None:
    if not hasattr(msg, "encoding") and not hasattr(msg, "format"):
        raise MessageError(
            f"is a {type(msg).__name__} without field 'encoding' or 'format'",
            subject=_subject(topic),
            value=type(msg).__name__,
            limit=("encoding", "format"),
            remedy="use a topic of type sensor_msgs/Image or sensor_msgs/CompressedImage",
        )


def _read_image(msg: Any, topic: str) -> _Stored:
    encoding = _checked_encoding(msg, topic)
    rows = msg.height * encoding.payload_rows // 2
    row_bytes = msg.width * encoding.samples * encoding.sample_bytes
    samples: NDArray[Any] = np.frombuffer(msg.data, np.uint8).reshape(rows, msg.step)[:, :row_bytes]
    if encoding.sample_bytes == 2:
        samples = samples.view(">u2" if msg.is_bigendian else "<u2")
    if encoding.samples > 1:
        samples = samples.reshape(rows, msg.width, encoding.samples)
    # Native contiguous layout, which the compiled kernels require.
    samples = np.require(samples, samples.dtype.newbyteorder("="), ["C", "A"])
    return _Stored(msg.header, samples, encoding)


def _checked_encoding(msg: Any, topic: str) -> StoredEncoding:
    """The layout of ``msg``, after a consistency check of its fields; no pixel is read."""
    subject = _subject(topic)
    encoding = ENCODINGS.get(msg.encoding)
    if encoding is None:
        _refuse_video(msg.encoding, f"encoding = {quoted(msg.encoding)}", subject)
        raise MessageError(
            f"encoding = {quoted(msg.encoding)} is not supported",
            subject=subject,
            value=msg.encoding,
            limit=tuple(ENCODINGS),
            remedy=f"publish one of {', '.join(ENCODINGS)}",
        )
    for name, value, multiple in zip(("height", "width"), (msg.height, msg.width), encoding.multiple, strict=True):
        if value < encoding.smallest or value % multiple:
            raise MessageError(
                f"{name} = {value} px cannot be {msg.encoding}, which takes multiples of {multiple} "
                f"from {max(encoding.smallest, multiple)} on",
                subject=subject,
                value=value,
                limit=max(encoding.smallest, multiple),
                remedy="check the image size of the driver",
            )
    pixel_bytes = encoding.samples * encoding.sample_bytes
    if msg.step < msg.width * pixel_bytes:
        raise MessageError(
            f"step = {msg.step} bytes is below a row of width {msg.width} px * {pixel_bytes} = "
            f"{msg.width * pixel_bytes} bytes of {msg.encoding}",
            subject=subject,
            value=msg.step,
            limit=msg.width * pixel_bytes,
            remedy="set step to the bytes from row to row",
        )
    size, wanted = memoryview(msg.data).nbytes, msg.step * msg.height * encoding.payload_rows // 2
    if size != wanted:
        raise MessageError(
            f"data has {size} bytes, step {msg.step} * height {msg.height} of {msg.encoding} takes {wanted}",
            subject=subject,
            value=size,
            limit=wanted,
            remedy="send complete rows, including padding of the last one",
        )
    return encoding


def decode_compressed(msg: Any, *, topic: str = "") -> Frame:
    """The frame of a sensor_msgs/CompressedImage (jpeg, png).

    One channel is mono8 (bgr8 if ``format`` names a Bayer mosaic), color is bgr8, as image_transport stores it, or rgb8
    if ``format`` has "... compressed rgb8". 16 bit is scaled to 8 as in :func:`decode_image`. Pixels are a read-only
    copy.

    Raises:
        MessageError: video, compressedDepth, a header that declares more than :data:`MAX_PIXELS` or more than the data
            can hold, or data that are empty, truncated, damaged or of another format.
    """
    return decode(msg, topic)


def _read_compressed(msg: Any, topic: str) -> _Stored:
    stored = _decompressed(msg, topic)
    return _Stored(msg.header, stored, ENCODINGS[_compressed_encoding(msg.format, stored.ndim)])


def _decompressed(msg: Any, topic: str) -> NDArray[Any]:
    """The samples as stored, uint8 or uint16, (H, W) or (H, W, 3) or with alpha (H, W, 4)."""
    content = bytes(msg.data)
    _checked_header(msg, content, topic)  # before memory for the declared size is allocated
    stored = imdecode(content)
    if stored is None:
        raise _damaged(msg, content, topic)
    return stored


def _compressed_encoding(format: str, ndim: int) -> str:
    if ndim == 3:
        return "rgb8" if "compressed rgb" in format else "bgr8"
    source = format.partition(";")[0].strip()
    return source if source.startswith("bayer_") and source in ENCODINGS else "mono8"


def uncompressed_message(types: MessageTypes, msg: Any, topic: str = "") -> Any:
    """The sensor_msgs/Image that decodes to the same frame as a sensor_msgs/CompressedImage.

    Args:
        types: the family of messages.
        msg: the compressed image, of any family.
        topic: its topic, for error messages.

    Raises:
        MessageError: as :func:`decode_compressed`.
    """
    stored = _decompressed(msg, topic)
    encoding = _compressed_encoding(msg.format, stored.ndim)
    if stored.shape[2:] == (4,):
        encoding = encoding.replace("8", "a8")
    if stored.dtype == np.uint16:
        encoding = encoding.replace("8", "16")
    data, view = types.payload(stored.nbytes)
    view[:] = np.ascontiguousarray(stored, stored.dtype.newbyteorder("<")).view(np.uint8).ravel()
    return types.Image(
        header=msg.header,
        height=stored.shape[0],
        width=stored.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=stored.nbytes // stored.shape[0],
        data=data,
    )


def _checked_header(msg: Any, content: bytes, topic: str) -> ImageHeader:
    """The header of a compressed image, after a check of format and size; no pixel is read."""
    subject = _subject(topic)
    _refuse_video(msg.format, f"data of {len(content)} bytes with format {quoted(msg.format)}", subject)
    if "compressedDepth" in msg.format:
        raise MessageError(
            f"format = {quoted(msg.format)} is a depth image, jpeg or png of a camera is expected",
            subject=subject,
            value=msg.format,
            limit=("jpeg", "png"),
            remedy="use the topic that ends in /compressed",
        )
    header = read_header(content)
    if header is None:
        raise _damaged(msg, content, topic)
    if header.bits > _MAX_BITS:
        raise _damaged(msg, content, topic)
    possible = len(content) * _MAX_PIXELS_PER_BYTE.get(header.format, MAX_PIXELS)
    limit = min(MAX_PIXELS, possible)
    if header.width * header.height > limit:
        what = "the limit of a compressed image" if limit == MAX_PIXELS else f"the most in {len(content)} bytes"
        raise MessageError(
            f"the header of the {header.format} declares {header.width}x{header.height} px, {limit} px are {what}",
            subject=subject,
            value=(header.width, header.height),
            limit=limit,
            remedy="check the publisher and the recording, the message is damaged or not from a camera",
        )
    return header


def _damaged(msg: Any, content: bytes, topic: str) -> MessageError:
    return MessageError(
        f"data of {len(content)} bytes with format {quoted(msg.format)} is not a complete jpeg or png of 8 or 16 bit",
        subject=_subject(topic),
        value=msg.format,
        limit=("jpeg", "png"),
        remedy="check the format of the publisher, and the recording",
    )


def _refuse_video(name: str, what: str, subject: str) -> None:
    """Raise MessageError where an encoding or format names a video codec."""
    if found := _VIDEO.search(name):
        codec = {"H264": "H.264", "H265": "H.265"}.get(found.lastgroup or "", found.lastgroup)
        raise MessageError(
            f"{what} is {codec} video, whose images need those before them",
            subject=subject,
            value=name,
            limit=("raw", "jpeg", "png"),
            remedy="use the raw or compressed topic, or decode it by ros2 run image_transport republish",
        )


def _frame(image: _Stored, depth: BitDepth) -> Frame:
    samples = depth.to_8_bit(image.samples)
    pixels, gray = to_decoded(samples, image.encoding), to_gray_of_camera(samples, image.encoding)
    # Views on a message must not be written to, live or offline.
    pixels.setflags(write=False)
    image.stored.setflags(write=False)
    camera = to_camera_image(image.stored, image.encoding)
    return Frame(pixels, stamp_of(image.header), image.header.frame_id, image.encoding.decoded, gray, camera)


def _subject(topic: str) -> str:
    return f"image of {topic}" if topic else "image"


def image_message(
    types: MessageTypes,
    pixels: NDArray[Any],
    encoding: str,
    stamp_ns: int,
    frame_id: str,
    payload: tuple[Any, U8] | None = None,
) -> Any:
    """A sensor_msgs/Image of an array: no row padding, little-endian on every host.

    Args:
        types: the family of messages.
        pixels: (H, W) uint8 for mono8, uint16 for mono16 and 16UC1, float32 for 32FC1; (H, W, 3) uint8 for rgb8 and
            bgr8, uint16 for rgb16 and bgr16; (H, W, 4) with alpha, for rgba8, bgra8, rgba16 and bgra16.
        encoding: one of these.
        stamp_ns: header stamp, integer nanoseconds.
        frame_id: header frame.
        payload: a ``types.payload(pixels.nbytes)`` to reuse; not copied if ``pixels`` is a view of it.

    Raises:
        MessageError: another encoding, or a payload of another size.
        ImageError: pixels of another type or shape than the encoding has.
    """
    dtype = payload_dtype(pixels, encoding)
    data, view = payload or types.payload(pixels.nbytes)
    if view.nbytes != pixels.nbytes:
        raise MessageError(
            f"payload has {view.nbytes} bytes, {encoding} pixels {pixels.shape} take {pixels.nbytes}",
            value=view.nbytes,
            limit=pixels.nbytes,
            remedy=f"allocate it by types.payload({pixels.nbytes})",
        )
    stored = view.view(dtype).reshape(pixels.shape)
    if not _same_memory(stored, pixels):
        np.copyto(stored, pixels)
    return types.Image(
        header=make_header(types, stamp_ns, frame_id),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=pixels.nbytes // pixels.shape[0],
        data=data,
    )


def _same_memory(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether two arrays of one shape are the same elements at the same addresses."""
    return a.ctypes.data == b.ctypes.data and a.strides == b.strides and a.dtype == b.dtype


def compressed_message(
    types: MessageTypes,
    pixels: U8,
    encoding: str,
    format: Literal["jpeg", "png"],
    stamp_ns: int,
    frame_id: str,
    quality: int = 90,
) -> Any:
    """A sensor_msgs/CompressedImage in the format of image_transport (color is stored as bgr8).

    Args:
        types: the family of messages.
        pixels: uint8, (H, W) for mono8, (H, W, 3) for rgb8 and bgr8.
        encoding: one of these three.
        format: codec.
        stamp_ns: header stamp, integer nanoseconds.
        frame_id: header frame.
        quality: of jpeg, 0..100; png is lossless.

    Raises:
        MessageError: another encoding or codec.
        ImageError: pixels of another type or shape than the encoding has.
        ConfigError: quality out of range.
    """
    if payload_dtype(pixels, encoding) != np.uint8 or pixels.shape[2:] == (4,):
        raise MessageError(
            f"encoding = {encoding!r} is not supported for compression",
            value=encoding,
            limit=("mono8", "rgb8", "bgr8"),
            remedy="use one of mono8, rgb8, bgr8",
        )
    if format not in ("jpeg", "png"):
        raise MessageError(
            f"format = {format!r} is not supported for writing",
            value=format,
            limit=("jpeg", "png"),
            remedy="use one of jpeg, png",
        )
    if not 0 <= quality <= 100:
        raise ConfigError(
            f"quality = {quality} is outside 0..100",
            value=quality,
            limit=(0, 100),
            remedy="set it inside that range",
            settings=("quality",),
        )
    stored = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if encoding == "rgb8" else pixels
    parameters = [cv2.IMWRITE_JPEG_QUALITY, quality] if format == "jpeg" else []
    _, encoded = cv2.imencode(f".{format}", stored, parameters)
    data, view = types.payload(encoded.size)
    view[:] = encoded.ravel()
    stored_name = "" if encoding == "mono8" else " bgr8"
    return types.CompressedImage(
        header=make_header(types, stamp_ns, frame_id), format=f"{encoding}; {format} compressed{stored_name}", data=data
    )
