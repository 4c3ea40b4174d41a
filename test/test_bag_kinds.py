# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stereo bag gives the same pairs, rig and depth in each form in which bags come."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from bag_kinds import KINDS, TYPES, foxglove_bytes, foxglove_values, write_kind
from mcap.writer import Writer
from stereo_bags import PARAMETERS, sequence

from stereo_depth_ros.bags.chunked_file import Channel, RawMessage
from stereo_depth_ros.bags.conversion import to_cdr
from stereo_depth_ros.bags.inflate import InflationBudget
from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import compressed_message, image_message
from stereo_depth_ros.offline.engine import process_bag

CONFIG = pipeline_config({"stereo_algorithm": 0, **PARAMETERS})


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two raw pairs with their camera infos."""
    path = tmp_path_factory.mktemp("plain") / "plain.mcap"
    write_pairs(path)
    return path


@pytest.fixture(scope="module")
def plain_depth(plain: Path) -> list[bytes]:
    return depth(plain, plain.with_name("plain_depth.mcap"))


def write_pairs(path: Path, compressed: bool = False) -> None:
    made = sequence(2)
    with BagWriter(path) as bag:
        for frame in made:
            for side, image, camera in (
                ("left", frame.pair.left, made.rig.left),
                ("right", frame.pair.right, made.rig.right),
            ):
                stamp_ns = image.stamp_ns
                bag.write(f"/{side}/camera_info", camera_info_message(TYPES, camera, stamp_ns), stamp_ns)
                message = (
                    compressed_message(TYPES, image.pixels, "mono8", "png", stamp_ns, image.frame_id)
                    if compressed
                    else image_message(TYPES, image.pixels, "mono8", stamp_ns, image.frame_id)
                )
                bag.write(f"/{side}/image_raw{'/compressed' * compressed}", message, stamp_ns)


def depth(path: Path, output: Path) -> list[bytes]:
    """The depth images that the offline engine computes."""
    report = process_bag(BagSelection(path), output, CONFIG)
    assert (report.pairs, report.skipped, report.warnings) == (2, 0, ())
    with BagReader(output) as reader:
        return [message.data for message in reader.messages(["/depth/image_rect"])]


def all_messages(path: Path) -> list[tuple[str, str, int, dict[str, Any]]]:
    with BagReader(path) as reader:
        assert reader.warning == ""
        return [(m.topic, m.msgtype, m.log_time_ns, values(reader.deserialize(m))) for m in reader.messages()]


def values(message: Any) -> dict[str, Any]:
    """All fields of a message, nested ones too, as values that compare."""
    return {
        name: values(value) if hasattr(value, "__msgtype__") else np.asarray(value).tolist()
        for name, value in vars(message).items()
        if name != "__msgtype__"
    }


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_gives_the_messages_of_the_plain_bag(plain: Path, tmp_path: Path, kind: str) -> None:
    assert all_messages(write_kind(kind, plain, tmp_path)) == all_messages(plain)


@pytest.mark.parametrize("kind", ["messages compressed, .mcap", "mcap of ros1", "foxglove, protobuf", "foxglove, json"])
def test_depth_is_that_of_the_plain_bag(plain: Path, plain_depth: list[bytes], tmp_path: Path, kind: str) -> None:
    assert depth(write_kind(kind, plain, tmp_path), tmp_path / "depth.mcap") == plain_depth


def test_compressed_images(tmp_path: Path) -> None:
    write_pairs(tmp_path / "plain.mcap", compressed=True)
    for kind in ("foxglove, protobuf", "foxglove, json"):
        found = all_messages(write_kind(kind, tmp_path / "plain.mcap", tmp_path))
        assert found == all_messages(tmp_path / "plain.mcap")


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_info_says_that_it_is_of_foxglove(plain: Path, tmp_path: Path, encoding: str) -> None:
    path = write_kind(f"foxglove, {encoding}", plain, tmp_path)
    info = inspect_bag(path)
    assert info.usable and info.topics["/left/image_raw"].msgtype == f"foxglove.RawImage ({encoding})"
    assert info.topics["/left/camera_info"].msgtype == f"foxglove.CameraCalibration ({encoding})"
    assert info.rig is not None and info.exact_pairs == 2


def test_pairs_in_a_folder_whose_recorder_was_killed_while_it_compressed(plain: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    data = plain.read_bytes()
    (folder / "bag_0.mcap").write_bytes(data)
    (folder / "bag_0.mcap.zstd").write_bytes(zstandard.compress(data)[:-100])  # not yet complete
    assert all_messages(folder) == all_messages(plain)


def test_a_file_that_was_decompressed_is_found_by_the_metadata(plain: Path, tmp_path: Path) -> None:
    folder = write_kind("files compressed, metadata", plain, tmp_path)
    (file,) = folder.glob("*.zstd")
    with file.open("rb") as source, file.with_suffix("").open("wb") as target:
        zstandard.ZstdDecompressor().copy_stream(source, target)
    file.unlink()
    assert all_messages(folder) == all_messages(plain)


def converted(name: str, encoding: str, data: bytes) -> Any:
    message = RawMessage(Channel("/a", f"foxglove.{name}", encoding), 0, data, (0, 0))
    kind = {"RawImage": "Image", "CompressedImage": "CompressedImage", "CameraCalibration": "CameraInfo"}[name]
    return TYPES.deserialize(to_cdr(TYPES, message, InflationBudget(0)), f"sensor_msgs/msg/{kind}")


def test_bytes_of_the_library_of_protocol_buffers() -> None:
    """Messages that Google's library serialized."""
    stamp = "0a0b0880e2cfaa0610959aef3a"
    data = bytes.fromhex(stamp + "15030000001d0200000022056d6f6e6f382d04000000320800010203040506073a046c656674")
    raw = converted("RawImage", "protobuf", data)
    assert foxglove_values(raw) == {
        **{"stamp_ns": 1700000000123456789, "frame_id": "left", "width": 3, "height": 2, "encoding": "mono8"},
        **{"step": 4, "data": bytes(range(8))},
    }
    data = bytes.fromhex("0a020805120489504e471a03706e6722016ca20603616263")  # with a field of newer versions
    packed = converted("CompressedImage", "protobuf", data)
    assert foxglove_values(packed) == {"stamp_ns": 5 * 10**9, "frame_id": "l", "format": "png", "data": b"\x89PNG"}
    d, k = "2a10333333333333d3bf000000000000c03f", "31000000000000f03f" * 9  # packed, and one by one
    data = bytes.fromhex(f"{stamp}15800200001de00100002209706c756d625f626f62{d}{k}4a057269676874")
    info = converted("CameraCalibration", "protobuf", data)
    assert foxglove_values(info) == {
        **{"stamp_ns": 1700000000123456789, "frame_id": "right", "width": 640, "height": 480},
        **{"distortion_model": "plumb_bob", "D": [-0.3, 0.125], "K": [1.0] * 9, "R": [0.0] * 9, "P": [0.0] * 12},
    }


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_foxglove_calibration_of_one_camera(encoding: str) -> None:
    """R is empty for one camera; kannala_brandt is the equidistant model of ROS; times before 1970 are negative."""
    values = {
        "stamp_ns": -3 * 10**9 + 5,
        "frame_id": "camera",
        "width": 640,
        "height": 480,
        "distortion_model": "kannala_brandt",
        "D": [0.1, -0.2, 0.3, -0.4],
        "K": [400.0, 0.0, 320.5, 0.0, 410.0, 240.25, 0.0, 0.0, 1.0],
        "P": [405.0, 0.0, 321.0, -48.0, 0.0, 405.0, 241.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    info = converted("CameraCalibration", encoding, foxglove_bytes("CameraCalibration", values, encoding))
    assert info.distortion_model == "equidistant" and not info.r.any()
    assert {**foxglove_values(info), "distortion_model": "kannala_brandt"} == {**values, "R": [0.0] * 9}


@pytest.mark.parametrize(
    ("name", "encoding", "data", "cause"),
    [
        ("RawImage", "protobuf", b"\x08\x01", "field 1, timestamp, has the wire type 0"),
        ("RawImage", "protobuf", b"\x32\xff\xff\xff\xff\x7f", "field 6 ends after the message"),
        ("RawImage", "protobuf", b"\xff" * 11, "a number of more than 10 bytes"),
        ("RawImage", "protobuf", b"\x0b", "field 1 has the wire type 3"),
        ("RawImage", "json", b"[1, 2]", "not a JSON object"),
        ("RawImage", "json", b"[" * 100_000, "nested too deep"),
        ("RawImage", "json", b'{"data": "a"}', "base64"),
        ("RawImage", "json", b'{"width": "640"}', 'width is "640"'),
        ("RawImage", "json", b'{"timestamp": {"sec": 99999999999}}', "the time 99999999999 s, 0 ns does not fit"),
        ("CameraCalibration", "json", b'{"K": [1, 2]}', "K has 2 numbers, not 9"),
    ],
)
def test_bytes_that_are_not_a_foxglove_message_say_why(name: str, encoding: str, data: bytes, cause: str) -> None:
    with pytest.raises(Exception, match=cause):
        converted(name, encoding, data)


def test_a_bag_of_bytes_that_are_no_foxglove_messages_is_named(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.RawImage", "protobuf", b"")
        for side in ("left", "right"):
            channel = writer.register_channel(f"/{side}/image_raw", "protobuf", schema)
            writer.add_message(channel, 10, b"\x08\x01", 10)
        writer.finish()
    damage, missing = map(str, inspect_bag(path).problems)
    assert "2 bytes are not a foxglove.RawImage of protobuf: field 1, timestamp, has" in damage
    assert "no CameraInfo topic belongs to /left/image_raw" in missing
    findings = [finding for finding in survey_bag(BagSelection(path)).findings if finding.check == "bag"]
    assert len(findings) == 1 and "2 bytes are not a foxglove.RawImage" in findings[0].value
