# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writing of bags: conventions of the format, and what an interrupted run leaves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.messages.image import image_message

TYPES = RosbagsTypes()
IMAGE = "sensor_msgs/msg/Image"


def make_image(stamp_ns: int) -> object:
    pixels = np.arange(5 * 7, dtype=np.uint8).reshape(5, 7)
    return image_message(TYPES, pixels, "mono8", stamp_ns, "left_optical_frame")


def test_a_bag_follows_the_conventions_of_ros2_and_mcap(tmp_path: Path) -> None:
    path = tmp_path / "new" / "out.mcap"
    with BagWriter(path) as bag:
        bag.write("/left/image_raw", make_image(10), 10)
        bag.write_raw("/left/image_raw", IMAGE, TYPES.serialize(make_image(20)), 25, publish_time_ns=20)
        bag.write_metadata("stereo_depth", {"version": "1", "config": "P1: 8"})
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        items = list(reader.iter_messages())
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    schema, channel, first = items[0]
    assert (schema.name, schema.encoding, channel.message_encoding) == (IMAGE, "ros2msg", "cdr")
    assert channel.metadata["offered_qos_profiles"] == ""
    # the hash of ROS 2 Jazzy for sensor_msgs/msg/Image
    assert channel.metadata["topic_type_hash"] == (
        "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
    )
    assert [(m.sequence, m.log_time, m.publish_time) for _, _, m in items] == [(1, 10, 10), (2, 25, 20)]
    assert first.data == TYPES.serialize(make_image(10))
    assert metadata == {"stereo_depth": {"version": "1", "config": "P1: 8"}}


def test_a_schema_holds_every_nested_definition(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    with BagWriter(path) as bag:
        bag.write("/image", make_image(1), 1)
    with path.open("rb") as file:
        schema, _, _ = next(make_reader(file).iter_messages())
    main, *nested = schema.data.decode().split("=" * 80 + "\n")
    assert main.splitlines()[:2] == ["std_msgs/Header header", "uint32 height"]
    assert {part.splitlines()[0] for part in nested} == {"MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"}


@pytest.mark.parametrize(("compression", "stored"), [("zstd", "zstd"), ("lz4", "lz4"), ("none", "")])
def test_chunks_have_the_requested_compression_and_rosbags_reads_them(
    tmp_path: Path, compression: str, stored: str
) -> None:
    path = tmp_path / "out.mcap"
    with BagWriter(path, compression=compression, chunk_size=200) as bag:
        for stamp in range(1, 6):
            bag.write("/image", make_image(stamp), stamp)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {chunk.compression for chunk in summary.chunk_indexes} == {stored}
    assert len(summary.chunk_indexes) > 1
    with Reader(path) as reader:
        assert [(c.topic, c.msgtype, stamp) for c, stamp, _ in reader.messages()] == [
            ("/image", IMAGE, stamp) for stamp in range(1, 6)
        ]


def test_an_existing_bag_is_replaced_only_on_request(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    path.write_bytes(b"old")
    with pytest.raises(BagError, match=r"out\.mcap: already exists: remove it"):
        BagWriter(path)
    with BagWriter(path, overwrite=True) as bag:
        bag.write("/image", make_image(1), 1)
        assert path.read_bytes() == b"old"  # until the new one is complete
    with Reader(path) as reader:
        assert reader.message_count == 1


def test_an_interrupted_run_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    with pytest.raises(KeyboardInterrupt), BagWriter(path) as bag:
        bag.write("/image", make_image(1), 1)
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_run_interrupted_before_its_first_message_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "out.mcap"):
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_closing_twice_is_harmless(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "out.mcap")
    bag.write("/image", make_image(1), 1)
    bag.close()
    bag.close()
    assert bag.message_count == 1 and (tmp_path / "out.mcap").exists()


def test_bad_arguments_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="compression 'gzip' is not one of zstd, lz4, none"):
        BagWriter(tmp_path / "out.mcap", compression="gzip")
    with pytest.raises(BagError, match=r"out\.bag: cannot be written, bags are written as MCAP"):
        BagWriter(tmp_path / "out.bag")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(BagError, match=r"file/out\.mcap: cannot be written"):
        BagWriter(tmp_path / "file" / "out.mcap")


def test_unknown_and_changing_types_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "out.mcap") as bag:
        with pytest.raises(BagError, match="no definition of message type 'my_msgs/msg/Thing'"):
            bag.write_raw("/thing", "my_msgs/msg/Thing", b"", 1)
        bag.write("/image", make_image(1), 1)
        with pytest.raises(BagError, match=r"topic /image carries sensor_msgs/msg/Image, not std_msgs/msg/String"):
            bag.write_raw("/image", "std_msgs/msg/String", b"", 2)
