# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Image and CompressedImage messages to frames and from arrays, for rclpy and rosbags."""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from stereo_depth_ros.core.errors import ConfigError, MessageError
from stereo_depth_ros.core.types import U8, Frame
from stereo_depth_ros.messages.encodings import ENCODINGS, StoredEncoding, imdecode, payload_dtype, to_8_bit, to_decoded
from stereo_depth_ros.messages.types import MessageTypes, make_header
from stereo_depth_ros.messages.types import stamp_ns as stamp_of

__all__ = ["compressed_message", "decode", "decode_compressed", "decode_image", "image_message"]


def decode(msg: Any, topic: str = "") -> Frame:
    """The frame of a sensor_msgs/Image or sensor_msgs/CompressedImage, distinguished by their fields.

    Args:
        msg: the message, of any family.
        topic: its topic, for error messages.

    Raises:
        MessageError: neither of the two, or as :func:`decode_image` and :func:`decode_compressed`.
    """
    if hasattr(msg, "encoding"):
        return decode_image(msg, topic=topic)
    if hasattr(msg, "format"):
        return decode_compressed(msg, topic=topic)
    raise MessageError(
        f"is a {type(msg).__name__} without field 'encoding' or 'format'",
        subject=_subject(topic),
        value=type(msg).__name__,
        limit=("encoding", "format"),
        remedy="use a topic of type sensor_msgs/Image or sensor_msgs/CompressedImage",
    )


def decode_image(msg: Any, *, topic: str = "") -> Frame:
    """The frame of a sensor_msgs/Image.

    Pixels are read-only. Unpadded mono8, rgb8 and bgr8 are a view on ``msg.data``, all others are copies:
    rgba8 becomes rgb8, other color bgr8, 16 bit is scaled to 8 (65535 becomes 255).

    Raises:
        MessageError: unknown encoding, zero or impossible size, ``step`` below a row, or a payload that is not
            ``step * height`` bytes (including padding of the last row, as in cv_bridge).
    """
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
    return _frame(msg.header, to_decoded(samples, encoding), encoding.decoded)


def _checked_encoding(msg: Any, topic: str) -> StoredEncoding:
    """The layout of ``msg``, after a consistency check of its fields; no pixel is read."""
    subject = _subject(topic)
    encoding = ENCODINGS.get(msg.encoding)
    if encoding is None:
        raise MessageError(
            f"encoding = {msg.encoding!r} is not supported",
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
        MessageError: compressedDepth, or data that is empty, truncated, damaged or of another format.
    """
    subject = _subject(topic)
    if "compressedDepth" in msg.format:
        raise MessageError(
            f"format = {msg.format!r} is a depth image, jpeg or png of a camera is expected",
            subject=subject,
            value=msg.format,
            limit=("jpeg", "png"),
            remedy="use the topic that ends in /compressed",
        )
    stored = imdecode(msg.data)
    if stored is None:
        raise MessageError(
            f"data of {memoryview(msg.data).nbytes} bytes with format {msg.format!r} is not a complete jpeg or png of "
            "8 or 16 bit",
            subject=subject,
            value=msg.format,
            limit=("jpeg", "png"),
            remedy="check the format of the publisher, and the recording",
        )
    pixels = to_8_bit(stored)
    if pixels.ndim == 2:
        source = msg.format.partition(";")[0].strip()
        encoding = ENCODINGS[source if source.startswith("bayer_") and source in ENCODINGS else "mono8"]
        return _frame(msg.header, to_decoded(pixels, encoding), encoding.decoded)
    if pixels.shape[2] == 4:
        pixels = to_decoded(pixels, ENCODINGS["bgra8"])
    return _frame(msg.header, pixels, "rgb8" if "compressed rgb" in msg.format else "bgr8")


def _frame(header: Any, pixels: U8, encoding: str) -> Frame:
    # Views on a message must not be written to, live or offline.
    pixels.setflags(write=False)
    return Frame(pixels, stamp_of(header), header.frame_id, encoding)


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
        pixels: (H, W) uint8 for mono8, uint16 for 16UC1, float32 for 32FC1; (H, W, 3) uint8 for rgb8 and bgr8.
        encoding: one of these five.
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
    if payload_dtype(pixels, encoding) != np.uint8:
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
