# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Image messages: every encoding against known pixels, every error, round trips in both message families."""

from __future__ import annotations

import array
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from test_message_types import RclpyTypes, assert_equal_bytes

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.errors import ConfigError, ImageError, MessageError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.types import U8, Frame
from stereo_depth_ros.messages.image import compressed_message, decode, decode_compressed, decode_image, image_message

STAMP_NS = 1_700_000_000_000_000_017
HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=1_700_000_000, nanosec=17), frame_id="left_optical")


@pytest.fixture(params=[RosbagsTypes, RclpyTypes])
def types(request: pytest.FixtureRequest) -> Any:
    return request.param()


def _message(rows: Any, encoding: str, width: int, height: int, *, padding: int = 0, bigendian: int = 0) -> Any:
    """An Image whose payload is the bytes of ``rows`` (one array per payload row), each followed by padding."""
    lines = [np.ascontiguousarray(row).tobytes() for row in rows]
    return SimpleNamespace(
        header=HEADER,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=bigendian,
        step=len(lines[0]) + padding,
        data=array.array("B", b"".join(line + b"\xee" * padding for line in lines)),
    )


def _ramp(height: int, width: int, channels: int) -> U8:
    """Different in every row, column and channel; uint8 (H, W) or (H, W, C)."""
    y, x, c = np.mgrid[:height, :width, :channels]
    ramp = (11 + 3 * x + 17 * y + 60 * c).astype(np.uint8)
    return ramp[..., 0] if channels == 1 else ramp


def _compressed(data: bytes, format: str) -> Any:
    return SimpleNamespace(header=HEADER, format=format, data=array.array("B", data))


def _encoded(pixels: Any, extension: str) -> bytes:
    return cv2.imencode(extension, pixels)[1].tobytes()


# ------------------------------------------------------------------------------------------------------------- Image


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "channels", "keep", "decoded"),
    [
        ("mono8", 1, slice(None), "mono8"),
        ("8UC1", 1, slice(None), "mono8"),
        ("rgb8", 3, slice(None), "rgb8"),
        ("bgr8", 3, slice(None), "bgr8"),
        ("8UC3", 3, slice(None), "bgr8"),
        ("rgba8", 4, slice(3), "rgb8"),
        ("bgra8", 4, slice(3), "bgr8"),
    ],
)
def test_8_bit_samples_keep_their_values_and_order(
    encoding: str, channels: int, keep: slice, decoded: str, padding: int
) -> None:
    stored = _ramp(5, 7, channels)
    frame = decode_image(_message(stored, encoding, 7, 5, padding=padding))
    expected = stored if channels == 1 else stored[..., keep]
    np.testing.assert_array_equal(frame.pixels, expected)
    assert frame.pixels.dtype == np.uint8
    assert (frame.encoding, frame.stamp_ns, frame.frame_id) == (decoded, STAMP_NS, "left_optical")


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize(("bigendian", "dtype"), [(0, "<u2"), (1, ">u2")])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_16_bit_is_rounded_to_8_in_either_byte_order(encoding: str, bigendian: int, dtype: str, padding: int) -> None:
    # 128 / 257 rounds to 0, 129 / 257 to 1; 0x0102 and 0x0201 distinguish the byte orders.
    stored = np.array([[0, 128, 129], [0x0102, 0x0201, 40000], [65535, 65406, 257], [256, 770, 51400]])
    expected = [[0, 0, 1], [1, 2, 156], [255, 254, 1], [1, 3, 200]]
    message = _message(stored.astype(dtype), encoding, 3, 4, padding=padding, bigendian=bigendian)
    frame = decode_image(message)
    np.testing.assert_array_equal(frame.pixels, expected)
    assert frame.encoding == "mono8"


def test_is_bigendian_does_not_touch_8_bit() -> None:
    stored = _ramp(3, 4, 3)
    np.testing.assert_array_equal(decode_image(_message(stored, "bgr8", 4, 3, bigendian=1)).pixels, stored)


def test_16_bit_scaling_of_every_value() -> None:
    stored = np.arange(65536, dtype="<u2").reshape(128, 512)
    # v * 255 / 65535 = v / 257, and 257 is odd: the nearest integer is never a tie.
    expected = (stored.astype(np.int64) + 128) // 257
    np.testing.assert_array_equal(decode_image(_message(stored, "mono16", 512, 128)).pixels, expected)


def _planes(height: int, width: int) -> dict[str, Any]:
    """Three color planes linear in x and y, on which bilinear demosaicing is exact."""
    y, x = np.mgrid[:height, :width]
    return {"r": 20 + 5 * x + 3 * y, "g": 200 - 4 * x - 2 * y, "b": 60 + x + 7 * y}


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("bits", ["8", "16 little", "16 big"])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_mosaic_is_demosaiced(pattern: str, bits: str, padding: int) -> None:
    height, width = 9, 12
    planes = _planes(height, width)
    mosaic = np.empty((height, width), np.int64)
    for i, color in enumerate(pattern):
        mosaic[i // 2 :: 2, i % 2 :: 2] = planes[color][i // 2 :: 2, i % 2 :: 2]
    depth, _, order = bits.partition(" ")
    stored = mosaic.astype("u1") if depth == "8" else (257 * mosaic).astype(">u2" if order == "big" else "<u2")
    message = _message(stored, f"bayer_{pattern}{depth}", width, height, padding=padding, bigendian=int(order == "big"))
    frame = decode_image(message)
    assert (frame.encoding, frame.pixels.shape) == ("bgr8", (height, width, 3))
    truth = np.stack([planes["b"], planes["g"], planes["r"]], axis=-1)
    # The outermost pixels are copies of their neighbors.
    np.testing.assert_array_equal(frame.pixels[1:-1, 1:-1], truth[1:-1, 1:-1])


@pytest.mark.parametrize("bits", ["8", "16"])
@pytest.mark.parametrize(
    ("pattern", "code"),
    [
        ("rggb", cv2.COLOR_BayerBG2GRAY),
        ("bggr", cv2.COLOR_BayerRG2GRAY),
        ("gbrg", cv2.COLOR_BayerGR2GRAY),
        ("grbg", cv2.COLOR_BayerGB2GRAY),
    ],
)
def test_gray_of_a_mosaic_is_that_of_cv_bridge(pattern: str, code: int, bits: str) -> None:
    mosaic = np.random.default_rng(5).integers(0, 256, (48, 64), dtype=np.uint8)
    mosaic[0, 0] = 255  # the depth is 16
    stored = mosaic if bits == "8" else mosaic.astype("<u2") * 257
    frame = decode_image(_message(stored, f"bayer_{pattern}{bits}", 64, 48))
    np.testing.assert_array_equal(to_gray(frame), cv2.cvtColor(mosaic, code))
    assert not to_gray(frame).flags.writeable


def _bgr_of_yuv(luma: Any, u: Any, v: Any) -> Any:
    """ITU-R BT.601, video range."""
    y = 255 / 219 * (luma.astype(float) - 16)
    u, v = u.astype(float) - 128, v.astype(float) - 128
    return np.stack([y + 2.018 * u, y - 0.391 * u - 0.813 * v, y + 1.596 * v], axis=-1)


def _yuv(height: int, width: int, chroma_rows: int) -> tuple[Any, Any, Any]:
    """Luma (H, W) and chroma u, v (chroma_rows, W / 2) that stay inside 0..255 as RGB."""
    y, x = np.mgrid[:height, :width]
    cy, cx = np.mgrid[:chroma_rows, : width // 2]
    return (100 + 4 * x + 7 * y).astype("u1"), (105 + 3 * cx + cy).astype("u1"), (150 - 2 * cx - 3 * cy).astype("u1")


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("encoding", ["yuv422", "uyvy", "yuv422_yuy2", "yuyv"])
def test_yuv422_becomes_bgr(encoding: str, padding: int) -> None:
    luma, u, v = _yuv(3, 8, 3)
    chroma = np.stack([u, v], axis=-1).reshape(3, 8)
    samples = (chroma, luma) if encoding in ("yuv422", "uyvy") else (luma, chroma)
    frame = decode_image(_message(np.stack(samples, axis=-1), encoding, 8, 3, padding=padding))
    expected = _bgr_of_yuv(luma, u.repeat(2, axis=1), v.repeat(2, axis=1))
    np.testing.assert_array_equal(to_gray(frame), luma)  # as in cv_bridge
    assert frame.encoding == "bgr8"
    np.testing.assert_allclose(frame.pixels, expected, atol=1.0)  # fixed-point arithmetic and rounding


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("encoding", ["nv12", "nv21"])
def test_yuv420_becomes_bgr(encoding: str, padding: int) -> None:
    luma, u, v = _yuv(6, 8, 3)
    chroma = np.stack([u, v] if encoding == "nv12" else [v, u], axis=-1).reshape(3, 8)
    frame = decode_image(_message(np.vstack([luma, chroma]), encoding, 8, 6, padding=padding))
    expected = _bgr_of_yuv(luma, *(plane.repeat(2, axis=0).repeat(2, axis=1) for plane in (u, v)))
    np.testing.assert_array_equal(to_gray(frame), luma)
    assert (frame.encoding, frame.pixels.shape) == ("bgr8", (6, 8, 3))
    np.testing.assert_allclose(frame.pixels, expected, atol=1.0)  # fixed-point arithmetic and rounding


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8"])
@pytest.mark.parametrize("family", [bytes, np.array, lambda data: data])
def test_unpadded_8_bit_is_a_view_on_the_payload(encoding: str, family: Any) -> None:
    message = _message(_ramp(5, 7, 1 if encoding == "mono8" else 3), encoding, 7, 5)
    message.data = family(message.data)
    assert np.shares_memory(decode_image(message).pixels, np.frombuffer(message.data, np.uint8))


@pytest.mark.parametrize(("encoding", "padding"), [("mono8", 0), ("mono8", 2), ("bgra8", 0), ("rgb8", 1)])
def test_pixels_are_contiguous_and_read_only_and_the_message_stays_writable(encoding: str, padding: int) -> None:
    channels = {"mono8": 1, "rgb8": 3, "bgra8": 4}[encoding]
    message = _message(_ramp(5, 7, channels), encoding, 7, 5, padding=padding)
    frame = decode_image(message)
    assert frame.pixels.flags.c_contiguous
    with pytest.raises(ValueError, match="read-only"):
        frame.pixels[0, 0] = 1
    message.data[0] = 99


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            {"encoding": "32FC1"},
            r"image of /cam/left: encoding = '32FC1' is not supported: publish one of mono8, .*nv21$",
        ),
        ({"encoding": ""}, r"image of /cam/left: encoding = '' is not supported"),
        (
            {"width": 0},
            r"image of /cam/left: width = 0 px cannot be rgb8, .* from 1 on: check the image size of the driver",
        ),
        (
            {"height": 0},
            r"image of /cam/left: height = 0 px cannot be rgb8, .* from 1 on: check the image size of the driver",
        ),
        ({"step": 20}, r"/cam/left: step = 20 bytes is below a row of width 7 px \* 3 = 21 bytes of rgb8: set step"),
        ({"step": 0}, r"/cam/left: step = 0 bytes is below"),
        ({"step": 22}, r"/cam/left: data has 105 bytes, step 22 \* height 5 of rgb8 takes 110: send complete rows"),
        ({"height": 4}, r"/cam/left: data has 105 bytes, step 21 \* height 4 of rgb8 takes 84"),
        ({"data": b""}, r"/cam/left: data has 0 bytes, step 21 \* height 5 of rgb8 takes 105"),
        ({"encoding": "uyvy"}, r"width = 7 px cannot be uyvy, which takes multiples of 2 from 2 on"),
        ({"encoding": "nv12", "width": 8}, r"height = 5 px cannot be nv12, which takes multiples of 2 from 2 on"),
        ({"encoding": "nv12", "height": 6}, r"width = 7 px cannot be nv12, which takes multiples of 2 from 2 on"),
        ({"encoding": "nv12", "width": 8, "height": 6}, r"data has 105 bytes, step 21 \* height 6 of nv12 takes 189"),
        ({"encoding": "bayer_rggb8", "height": 2}, r"height = 2 px cannot be bayer_rggb8, .* from 3 on"),
        ({"encoding": "bayer_rggb16", "width": 11}, r"step = 21 bytes is below a row of width 11 px \* 2 = 22 bytes"),
    ],
)
def test_contradictory_fields(change: dict[str, Any], text: str) -> None:
    message = _message(_ramp(5, 7, 3), "rgb8", 7, 5)
    message.__dict__.update(change)
    with pytest.raises(MessageError, match=text):
        decode_image(message, topic="/cam/left")


def test_a_missing_last_padding_is_refused() -> None:
    message = _message(_ramp(5, 7, 1), "mono8", 7, 5, padding=2)
    message.data = message.data[:-2]
    with pytest.raises(MessageError, match=r"^image: data has 43 bytes, step 9 \* height 5 .* padding of the last one"):
        decode_image(message)


# --------------------------------------------------------------------------------------------------- CompressedImage


@pytest.mark.parametrize("format", ["png", "mono8; png compressed", "mono8; png compressed ", ""])
def test_gray_png_stays_gray(format: str) -> None:
    stored = _ramp(5, 7, 1)
    frame = decode_compressed(_compressed(_encoded(stored, ".png"), format))
    np.testing.assert_array_equal(frame.pixels, stored)
    assert (frame.encoding, frame.stamp_ns, frame.frame_id) == ("mono8", STAMP_NS, "left_optical")
    assert not frame.pixels.flags.writeable


@pytest.mark.parametrize(
    ("format", "encoding"),
    [
        ("png", "bgr8"),
        ("bgr8; png compressed bgr8", "bgr8"),
        ("rgb8; png compressed bgr8", "bgr8"),
        ("rgb8; png compressed rgb8", "rgb8"),
    ],
)
def test_color_png_has_the_order_of_its_format(format: str, encoding: str) -> None:
    stored = _ramp(5, 7, 3)
    frame = decode_compressed(_compressed(_encoded(stored, ".png"), format))
    np.testing.assert_array_equal(frame.pixels, stored)
    assert frame.encoding == encoding


def test_alpha_of_png_is_dropped() -> None:
    stored = _ramp(5, 7, 4)
    frame = decode_compressed(_compressed(_encoded(stored, ".png"), "bgra8; png compressed bgr8"))
    np.testing.assert_array_equal(frame.pixels, stored[..., :3])
    assert frame.encoding == "bgr8"


@pytest.mark.parametrize("channels", [1, 3])
def test_16_bit_png_is_rounded_to_8(channels: int) -> None:
    expected = _ramp(5, 7, channels)
    stored = expected.astype(np.uint16) * 257 + 100
    frame = decode_compressed(_compressed(_encoded(stored, ".png"), "mono16; png compressed"))
    np.testing.assert_array_equal(frame.pixels, expected)
    assert frame.encoding == ("mono8" if channels == 1 else "bgr8")


@pytest.mark.parametrize("format", ["jpeg", "bgr8; jpeg compressed bgr8", "rgb8; jpeg compressed bgr8"])
def test_color_jpeg_is_bgr(format: str) -> None:
    stored = np.empty((16, 24, 3), np.uint8)
    stored[:] = (200, 120, 40)  # blue first; a flat image survives jpeg but for the rounding of its color space
    frame = decode_compressed(_compressed(_encoded(stored, ".jpg"), format))
    np.testing.assert_allclose(frame.pixels, stored, atol=3)
    assert frame.encoding == "bgr8"


def test_gray_jpeg_stays_gray() -> None:
    y, x = np.mgrid[:16, :24]
    stored = (40 + 3 * x + 5 * y).astype(np.uint8)
    frame = decode_compressed(_compressed(_encoded(stored, ".jpg"), "mono8; jpeg compressed "))
    np.testing.assert_allclose(frame.pixels, stored, atol=4)  # quantization at OpenCV's quality 95
    assert frame.encoding == "mono8"


def test_compressed_bayer_mosaic_is_not_gray() -> None:
    planes = _planes(9, 12)
    mosaic = np.empty((9, 12), np.uint8)
    for i, color in enumerate("gbrg"):
        mosaic[i // 2 :: 2, i % 2 :: 2] = planes[color][i // 2 :: 2, i % 2 :: 2]
    frame = decode_compressed(_compressed(_encoded(mosaic, ".png"), "bayer_gbrg8; png compressed "))
    assert frame.encoding == "bgr8"
    truth = np.stack([planes["b"], planes["g"], planes["r"]], axis=-1)
    np.testing.assert_array_equal(frame.pixels[1:-1, 1:-1], truth[1:-1, 1:-1])


@pytest.mark.parametrize("kind", ["empty", "text", "half jpeg", "jpeg without end", "half png", "float tiff"])
def test_broken_compressed_data(kind: str) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    jpeg, png = _encoded(noise, ".jpg"), _encoded(noise, ".png")
    data = {
        "empty": b"",
        "text": b"no image at all",
        "half jpeg": jpeg[: len(jpeg) // 2],
        "jpeg without end": jpeg[:-2],
        "half png": png[: len(png) // 2],
        "float tiff": _encoded(noise[..., 0].astype(np.float32), ".tiff"),
    }[kind]
    start = rf"^image of /cam/left/compressed: data of {len(data)} bytes with format 'jpeg' "
    text = rf"{start}is not a complete jpeg or png .*check"
    with pytest.raises(MessageError, match=text):
        decode_compressed(_compressed(data, "jpeg"), topic="/cam/left/compressed")


def test_jpeg_with_padding_after_its_end() -> None:
    frame = decode_compressed(_compressed(_encoded(_ramp(16, 24, 1), ".jpg") + bytes(7), "jpeg"))
    assert frame.pixels.shape == (16, 24)


def test_compressed_depth_is_refused() -> None:
    with pytest.raises(MessageError, match=r"^image of /depth: format = '16UC1; compressedDepth png' is a depth image"):
        decode_compressed(_compressed(b"x", "16UC1; compressedDepth png"), topic="/depth")


# ------------------------------------------------------------------------------------------------- decode, round trips


def test_decode_refuses_other_messages() -> None:
    with pytest.raises(
        MessageError, match=r"^image of /scan: is a SimpleNamespace without field 'encoding' or 'format'"
    ):
        decode(SimpleNamespace(header=HEADER), "/scan")


def test_decode_names_the_topic_for_both_messages() -> None:
    with pytest.raises(MessageError, match=r"^image of /a: encoding = 'h264'"):
        decode(_message(_ramp(5, 7, 1), "h264", 7, 5), "/a")
    with pytest.raises(MessageError, match=r"^image of /b: data of 1 bytes"):
        decode(_compressed(b"x", "h264"), "/b")


@pytest.mark.parametrize(("encoding", "channels"), [("mono8", 1), ("rgb8", 3), ("bgr8", 3)])
def test_image_round_trip(types: Any, encoding: str, channels: int) -> None:
    pixels = _ramp(5, 7, channels)
    message = image_message(types, pixels, encoding, STAMP_NS, "left_optical")
    assert (message.height, message.width, message.step, message.is_bigendian) == (5, 7, 7 * channels, 0)
    frame = decode(message)
    np.testing.assert_array_equal(frame.pixels, pixels)
    assert (frame.encoding, frame.stamp_ns, frame.frame_id) == (encoding, STAMP_NS, "left_optical")


def test_image_survives_serialization() -> None:
    types = RosbagsTypes()
    pixels = _ramp(5, 7, 3)
    data = types.serialize(image_message(types, pixels, "rgb8", STAMP_NS, "left_optical"))
    frame = decode(types.deserialize(data, "sensor_msgs/msg/Image"))
    np.testing.assert_array_equal(frame.pixels, pixels)
    assert (frame.encoding, frame.stamp_ns, frame.frame_id) == ("rgb8", STAMP_NS, "left_optical")


def test_live_and_offline_images_have_equal_bytes() -> None:
    depth = np.array([[1.5, np.nan, 2.0], [np.inf, 0.25, -1.0]], np.float32)
    live, offline = (image_message(t, depth, "32FC1", STAMP_NS, "left") for t in (RclpyTypes(), RosbagsTypes()))
    assert_equal_bytes(live, offline)


def test_depth_payloads_are_little_endian(types: Any) -> None:
    meters = image_message(types, np.array([[1.5], [np.nan]], np.float32), "32FC1", 0, "l")
    assert bytes(meters.data) == b"\x00\x00\xc0\x3f\x00\x00\xc0\x7f"
    assert (meters.height, meters.width, meters.step) == (2, 1, 4)
    millimeters = image_message(types, np.array([[0x0102, 3, 0xFFFE]], np.uint16), "16UC1", 0, "l")
    assert bytes(millimeters.data) == b"\x02\x01\x03\x00\xfe\xff"
    assert (millimeters.height, millimeters.width, millimeters.step) == (1, 3, 6)


def test_strided_pixels_are_written_without_their_gaps(types: Any) -> None:
    pixels = _ramp(6, 14, 1)[::2, ::-2]
    np.testing.assert_array_equal(decode(image_message(types, pixels, "mono8", 0, "l")).pixels, pixels)


def test_reused_payload_takes_the_new_pixels(types: Any) -> None:
    payload = types.payload(4 * 15)
    for scale in (1.0, -2.0):
        depth = scale * np.arange(15, dtype=np.float32).reshape(3, 5)
        message = image_message(types, depth, "32FC1", 0, "l", payload)
        assert message.data is payload[0]
        np.testing.assert_array_equal(np.frombuffer(message.data, np.float32).reshape(3, 5), depth)


def test_pixels_already_in_the_payload_are_not_copied(types: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    payload = types.payload(4 * 15)
    depth = payload[1].view(np.float32).reshape(3, 5)
    depth[:] = np.arange(15).reshape(3, 5)
    monkeypatch.setattr(np, "copyto", lambda *_: pytest.fail("copied"))
    message = image_message(types, depth, "32FC1", 0, "l", payload)
    np.testing.assert_array_equal(np.frombuffer(message.data, np.float32), np.arange(15))


def test_other_order_of_the_payload_is_copied(types: Any) -> None:
    payload = types.payload(15)
    payload[1][:] = np.arange(15)
    transposed = payload[1].reshape(5, 3).T  # (3, 5), begins at the same address
    expected = transposed.copy()
    message = image_message(types, transposed, "mono8", 0, "l", payload)
    np.testing.assert_array_equal(decode(message).pixels, expected)


def test_payload_of_another_size_is_refused(types: Any) -> None:
    with pytest.raises(MessageError, match=r"payload has 14 bytes, mono8 pixels \(3, 5\) take 15: .*payload\(15\)"):
        image_message(types, _ramp(3, 5, 1), "mono8", 0, "l", types.payload(14))


def test_unknown_encoding_is_not_written() -> None:
    with pytest.raises(
        MessageError, match=r"encoding = '32SC1' is not supported for writing: use one of mono8, rgb8, bgr8, .*16UC1"
    ):
        image_message(RosbagsTypes(), np.zeros((3, 5), np.uint16), "32SC1", 0, "l")


@pytest.mark.parametrize(
    ("pixels", "encoding", "text"),
    [
        (np.zeros((3, 5), np.float64), "32FC1", r"pixels are float64 \(3, 5\), 32FC1 takes float32 \(H, W\)"),
        (np.zeros((3, 5), ">f4"), "32FC1", r"pixels are >f4 \(3, 5\), 32FC1 takes float32 \(H, W\)"),
        (np.zeros((3, 5), np.int16), "16UC1", r"pixels are int16 \(3, 5\), 16UC1 takes uint16 \(H, W\)"),
        (np.zeros((3, 5), np.uint8), "bgr8", r"pixels are uint8 \(3, 5\), bgr8 takes uint8 \(H, W, 3\)"),
        (np.zeros((3, 5, 3), np.uint8), "mono8", r"pixels are uint8 \(3, 5, 3\), mono8 takes uint8 \(H, W\)"),
        (np.zeros((3, 5, 4), np.uint8), "rgb8", r"pixels are uint8 \(3, 5, 4\), rgb8 takes uint8 \(H, W, 3\)"),
        (np.zeros(15, np.uint8), "mono8", r"pixels are uint8 \(15,\), mono8 takes"),
        (np.zeros((0, 5), np.uint8), "mono8", r"pixels are uint8 \(0, 5\), mono8 takes .* at least one pixel"),
    ],
)
def test_pixels_unlike_their_encoding_are_refused(pixels: Any, encoding: str, text: str) -> None:
    with pytest.raises(ImageError, match=text):
        image_message(RosbagsTypes(), pixels, encoding, 0, "l")


@pytest.mark.parametrize(
    ("encoding", "channels", "format"),
    [
        ("mono8", 1, "mono8; png compressed"),
        ("bgr8", 3, "bgr8; png compressed bgr8"),
        ("rgb8", 3, "rgb8; png compressed bgr8"),
    ],
)
def test_compressed_png_round_trip(types: Any, encoding: str, channels: int, format: str) -> None:
    pixels = _ramp(5, 7, channels)
    message = compressed_message(types, pixels, encoding, "png", STAMP_NS, "left_optical")
    assert message.format == format
    frame = decode(message)
    np.testing.assert_array_equal(frame.pixels, pixels[..., ::-1] if encoding == "rgb8" else pixels)
    assert frame.encoding == ("mono8" if channels == 1 else "bgr8")
    assert (frame.stamp_ns, frame.frame_id) == (STAMP_NS, "left_optical")


def test_higher_jpeg_quality_is_larger_and_more_accurate(types: Any) -> None:
    pixels = cv2.GaussianBlur(np.random.default_rng(3).integers(0, 256, (48, 64), dtype=np.uint8), (0, 0), 1.5)
    sizes, errors = [], []
    for quality in (10, 90):
        message = compressed_message(types, pixels, "mono8", "jpeg", 0, "l", quality)
        assert message.format == "mono8; jpeg compressed"
        sizes.append(len(message.data))
        errors.append(np.abs(decode(message).pixels.astype(int) - pixels).mean())
    assert sizes[0] < sizes[1]
    assert errors[1] < errors[0] / 2
    assert errors[1] < 2.0  # gray levels; the quantizer steps at quality 90 are 2 to 24


@pytest.mark.parametrize(
    ("encoding", "format", "quality", "error", "text"),
    [
        ("mono8", "webp", 90, MessageError, "format = 'webp' is not supported for writing: use one of jpeg, png"),
        ("mono8", "jpeg", 101, ConfigError, r"quality = 101 is outside 0\.\.100"),
        ("mono8", "jpeg", -1, ConfigError, r"quality = -1 is outside 0\.\.100"),
        ("bgr8", "jpeg", 90, ImageError, r"pixels are uint8 \(3, 5\), bgr8 takes uint8 \(H, W, 3\)"),
        ("bayer_rggb8", "jpeg", 90, MessageError, "encoding = 'bayer_rggb8' is not supported for writing"),
    ],
)
def test_compressed_message_refuses(encoding: str, format: Any, quality: int, error: type, text: str) -> None:
    with pytest.raises(error, match=text):
        compressed_message(RosbagsTypes(), _ramp(3, 5, 1), encoding, format, 0, "l", quality)


def test_depth_is_not_compressed() -> None:
    pixels: Any = np.zeros((3, 5), np.uint16)
    with pytest.raises(
        MessageError, match="encoding = '16UC1' is not supported for compression: use one of mono8, rgb8, bgr8"
    ):
        compressed_message(RosbagsTypes(), pixels, "16UC1", "png", 0, "l")


# -------------------------------------------------------------------------------------------------------------- gray


def test_gray_of_gray_is_the_frame_itself() -> None:
    frame = Frame(_ramp(5, 7, 1), 0, "l", "mono8")
    assert to_gray(frame) is frame.pixels


@pytest.mark.parametrize(("encoding", "weights"), [("rgb8", (0.299, 0.587, 0.114)), ("bgr8", (0.114, 0.587, 0.299))])
@pytest.mark.parametrize("with_out", [False, True])
def test_gray_of_color_has_the_weights_of_rec_601(encoding: str, weights: Any, with_out: bool) -> None:
    pixels = _ramp(5, 7, 3)
    out = np.zeros((5, 7), np.uint8) if with_out else None
    gray = to_gray(Frame(pixels, 0, "l", encoding), out)
    assert gray.shape == (5, 7)
    np.testing.assert_allclose(gray, pixels @ np.array(weights), atol=0.51)  # rounding
    assert out is None or gray is out


@pytest.mark.parametrize(
    "out",
    [np.zeros((7, 5), np.uint8), np.zeros((5, 7), np.float32), np.zeros((5, 14), np.uint8)[:, ::2]],
)
def test_a_gray_buffer_that_does_not_fit_is_refused(out: Any) -> None:
    with pytest.raises(
        ImageError, match=r"^out: buffer is .* takes contiguous uint8 \(5, 7\): allocate the buffer again"
    ):
        to_gray(Frame(_ramp(5, 7, 3), 0, "l", "bgr8"), out)
