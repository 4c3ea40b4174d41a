# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Headers of compressed images: declared sizes, and images refused by them before anything is decoded."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from stereo_bags import HEIGHT, PARAMETERS, WIDTH, messages_of, sequence

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import compressed_message, decode
from stereo_depth_ros.messages.image_header import read_header
from stereo_depth_ros.offline.engine import process_bag

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=2), frame_id="l")


def message(data: bytes, format: str = "jpeg") -> Any:
    return SimpleNamespace(header=HEADER, format=format, data=data)


def encoded(width: int, height: int, kind: str, dtype: Any = np.uint8, options: tuple[int, ...] = ()) -> bytes:
    pixels = np.random.default_rng(3).integers(0, 256, (height, width, 3)).astype(dtype)
    return cv2.imencode(f".{kind}", pixels, options)[1].tobytes()


def png_of(width: int, height: int, bytes_of_rows: int) -> bytes:
    """A gray png of a declared size, with so many bytes of noise as rows."""
    noise = np.random.default_rng(3).integers(0, 256, bytes_of_rows, np.uint8).tobytes()

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(noise)) + chunk(b"IEND", b"")


def jpeg_of(width: int, height: int, size: int) -> bytes:
    """A jpeg of a declared size, padded in front of its frame to a size in bytes."""
    data = encoded(16, 16, "jpg")
    frame = data.index(b"\xff\xc0")
    declared = data[: frame + 5] + struct.pack(">HH", height, width) + data[frame + 9 :]
    comment = b"\xff\xfe" + struct.pack(">H", size - len(data) - 2) + bytes(size - len(data) - 4)
    return declared[:2] + comment + declared[2:]


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of what cv2.imdecode is given."""
    sizes: list[int] = []
    real = cv2.imdecode

    def imdecode(data: Any, flags: int) -> Any:
        sizes.append(len(data))
        return real(data, flags)

    monkeypatch.setattr(cv2, "imdecode", imdecode)
    return sizes


@pytest.mark.parametrize(
    ("kind", "dtype", "options"),
    [
        ("jpg", np.uint8, ()),
        ("jpg", np.uint8, (cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 2)),
        ("png", np.uint8, ()),
        ("png", np.uint16, ()),
        ("tiff", np.uint8, ()),
        ("tiff", np.uint16, ()),
        ("webp", np.uint8, (cv2.IMWRITE_WEBP_QUALITY, 80)),
        ("webp", np.uint8, (cv2.IMWRITE_WEBP_QUALITY, 101)),  # lossless
        ("bmp", np.uint8, ()),
    ],
)
def test_header_of_every_format(kind: str, dtype: Any, options: tuple[int, ...]) -> None:
    header = read_header(encoded(53, 37, kind, dtype, options))
    assert header is not None
    assert (header.width, header.height, header.bits) == (53, 37, 8 * np.dtype(dtype).itemsize)


@pytest.mark.parametrize("kind", ["jpg", "png", "tiff", "webp", "bmp"])
def test_a_cut_header_is_none_or_the_whole_one(kind: str) -> None:
    data = encoded(53, 37, kind)
    found = [read_header(data[:size]) for size in range(min(len(data), 700))]
    assert found[0] is found[11] is None
    assert {(header.width, header.height) for header in found if header is not None} <= {(53, 37)}


@pytest.mark.parametrize(
    ("data", "limit"),
    [
        (png_of(20000, 20000, 2900), r"\d+ px are the most in \d+ bytes"),
        (jpeg_of(20000, 20000, 3000), "1536000 px are the most in 3000 bytes"),
        (jpeg_of(2000, 2000, 3000), "1536000 px are the most in 3000 bytes"),
        (png_of(20000, 20000, 500_000), "67108864 px are the limit of a compressed image"),
        (png_of(2**31 - 1, 2**31 - 1, 100), "px are the most in"),
        (encoded(16, 16, "bmp").replace(struct.pack("<ii", 16, 16), struct.pack("<ii", 20000, 20000)), "67108864 px"),
    ],
    ids=["png", "jpeg", "smaller jpeg", "long png", "largest png", "bmp"],
)  # fmt: skip
def test_image_bomb_is_refused_by_its_header(data: bytes, limit: str, decoded: list[int]) -> None:
    text = rf"^image of /cam: the header of the (png|jpeg|bmp) declares \d+x\d+ px, .*{limit}.*: check the publisher"
    with pytest.raises(MessageError, match=text):
        decode(message(data), "/cam")
    assert decoded == []


@pytest.mark.parametrize("kind", ["png", "jpg"])
def test_images_without_content_are_no_bombs(kind: str) -> None:
    data = cv2.imencode(f".{kind}", np.zeros((2160, 3840), np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
    assert decode(message(data)).pixels.shape == (2160, 3840)


@pytest.mark.parametrize(
    "data",
    [b"P5 20000 20000 255\n" + bytes(2900), b"\xff\xd8\xff\xd9", b"II*\0" + b"\xff" * 40, b"RIFF" + bytes(50)],
    ids=["pgm", "jpeg", "tiff", "webp"],
)
def test_other_formats_and_broken_headers_are_not_decoded(data: bytes, decoded: list[int]) -> None:
    with pytest.raises(MessageError, match="is not a complete jpeg or png"):
        decode(message(data), "/cam")
    assert decoded == []


def test_image_of_another_size_than_its_camera_info_is_not_decoded(tmp_path: Path, decoded: list[int]) -> None:
    made, types = sequence(2), RosbagsTypes()
    with BagWriter(tmp_path / "in.mcap") as bag:
        for index, frame in enumerate(made):
            stamp = frame.pair.left.stamp_ns
            for side in ("left", "right"):
                one, camera = getattr(frame.pair, side), getattr(made.rig, side)
                pixels = cv2.resize(one.pixels, (4000, 3000)) if index and side == "right" else one.pixels
                image = compressed_message(types, pixels, "mono8", "png", stamp, one.frame_id)
                bag.write(f"/{side}/camera_info", camera_info_message(types, camera, stamp), stamp)
                bag.write(f"/{side}/image_raw/compressed", image, stamp)
    report = process_bag(BagSelection(tmp_path / "in.mcap"), tmp_path / "out.mcap", pipeline_config(PARAMETERS))
    assert list(messages_of(tmp_path / "out.mcap", "/disparity")) == [made.stamp_ns(0)]
    assert f"the image is 4000x3000, its camera info is for {WIDTH}x{HEIGHT}" in report.warnings[0]
    assert len(set(decoded)) == 2  # the first pair, for a look at it and for its depth


@pytest.mark.graph
def test_node_does_not_decode_an_image_of_another_size(decoded: list[int]) -> None:
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    from graph_harness import Graph, StereoCamera
    from stereo_msgs.msg import DisparityImage

    from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode

    camera = StereoCamera(frames=1)
    messages = camera.infos(10**18)
    for side, size in (("left", (200, 120)), ("right", (4000, 3000))):
        pixels = np.zeros(size[::-1], np.uint8)
        image = compressed_message(camera.types, pixels, "mono8", "png", 10**18, f"{side}_camera_optical_frame")
        messages[f"{side}/image_raw/compressed"] = image
    with Graph(StereoDepthNode, parameters={**PARAMETERS, "image_transport": "compressed"}) as graph:
        graph.listen("disparity", DisparityImage)
        graph.send(messages)
        graph.wait_error("/right/image_raw: the image is 4000x3000, its camera info is for 200x120")
    assert decoded == []


@pytest.mark.parametrize(
    ("name", "codec"),
    [("h264", "H.264"), ("H.264", "H.264"), ("libx264", "H.264"), ("hevc_nvenc", "H.265"), ("h265", "H.265"),
     ("libx265;yuv420p", "H.265"), ("vp9", "VP9"), ("av1", "AV1")],
)  # fmt: skip
def test_video_is_refused_by_name(name: str, codec: str) -> None:
    text = rf"is {codec} video, .*: use the raw or compressed topic, or decode it by ros2 run image_transport republish"
    with pytest.raises(MessageError, match=text):
        decode(message(b"\0\0\0\1\x67", name), "/cam")
    video = SimpleNamespace(header=HEADER, width=640, height=480, encoding=name, data=b"\0\0\0\1\x67")
    with pytest.raises(MessageError, match=text):
        decode(video, "/cam")


def test_a_png_with_a_chunk_that_ends_after_the_file_is_not_decoded(decoded: list[int]) -> None:
    data = encoded(53, 37, "png")
    assert decode(message(data, "png")).pixels.shape == (37, 53, 3)
    data = data[:-12] + struct.pack(">I4s", 2**30, b"tEXt") + data[-12:]
    with pytest.raises(MessageError, match="is not a complete jpeg or png"):
        decode(message(data, "png"))
    assert len(decoded) == 1
