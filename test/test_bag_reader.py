# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of every format and condition: complete, cut, empty, old, compressed."""

from __future__ import annotations

import re
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from rosbags import rosbag1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from stereo_depth_ros.bags.chunked_file import StoredMessage, Waiting
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader, TopicInfo
from stereo_depth_ros.bags.sources import is_bag
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import BagError, MessageError
from stereo_depth_ros.messages.image import image_message

TYPES = RosbagsTypes()
IMAGE = "sensor_msgs/msg/Image"
STAMPS = {"/a": [10, 30, 50, 70], "/b": [20, 40, 60]}
IN_ORDER = [("/a", 10), ("/b", 20), ("/a", 30), ("/b", 40), ("/a", 50), ("/b", 60), ("/a", 70)]


def cdr(stamp_ns: int) -> bytes:
    noise = np.random.default_rng(stamp_ns).integers(0, 256, (30, 41), dtype=np.uint8)  # does not compress
    return TYPES.serialize(image_message(TYPES, noise, "mono8", stamp_ns, "camera"))


def write_mcap(path: Path, compression: str = "zstd", chunk_size: int = 3000) -> Path:
    with BagWriter(path, compression=compression, chunk_size=chunk_size) as bag:
        for topic, stamp in [*IN_ORDER[1:], IN_ORDER[0]]:  # the first message is written last
            bag.write_raw(topic, IMAGE, cdr(stamp), stamp)
    return path


def write_rosbag2(path: Path, mode: CompressionMode = CompressionMode.NONE, mcap: bool = False) -> Path:
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    writer = Rosbag2Writer(path, version=9, storage_plugin=plugin)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {topic: writer.add_connection(topic, IMAGE, typestore=TYPES.typestore) for topic in STAMPS}
        for topic, stamp in IN_ORDER:
            writer.write(connections[topic], stamp, cdr(stamp))
    return path


def read(path: Path) -> list[tuple[str, int]]:
    with BagReader(path) as reader:
        messages = list(reader.messages())
    assert all(message.data == cdr(message.log_time_ns) for message in messages)
    assert {message.msgtype for message in messages} <= {IMAGE}
    return [(message.topic, message.log_time_ns) for message in messages]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_mcap_is_read_in_log_time_order(tmp_path: Path, compression: str) -> None:
    assert read(write_mcap(tmp_path / "bag.mcap", compression)) == IN_ORDER


@pytest.mark.parametrize("mcap", [False, True])
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_rosbag2_folders_are_read(tmp_path: Path, mode: CompressionMode, mcap: bool) -> None:
    assert read(write_rosbag2(tmp_path / "bag", mode, mcap)) == IN_ORDER


def test_a_folder_without_metadata_and_its_bare_file_are_read(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "bag")
    (folder / "metadata.yaml").unlink()
    assert read(folder) == IN_ORDER
    assert read(folder / "bag.db3") == IN_ORDER


def test_all_messages_are_read_where_metadata_has_another_qos_than_the_file(tmp_path: Path) -> None:
    metadata = write_rosbag2(tmp_path / "bag") / "metadata.yaml"
    qos = "offered_qos_profiles: '- {history: 3, depth: 7, reliability: 1, durability: 2}'"
    metadata.write_text(metadata.read_text().replace("offered_qos_profiles: []", qos))
    assert qos in metadata.read_text()
    assert read(tmp_path / "bag") == IN_ORDER


def test_several_files_of_a_folder_are_merged(tmp_path: Path) -> None:
    for name, topic in (("x", "/a"), ("y", "/b")):
        with BagWriter(tmp_path / f"{name}.mcap") as bag:
            for stamp in STAMPS[topic]:
                bag.write_raw(topic, IMAGE, cdr(stamp), stamp)
    assert read(tmp_path) == IN_ORDER


def test_files_of_a_long_bag_are_opened_one_after_the_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A chunk of each file would not fit into the memory."""
    for number, topic in enumerate(("/a", "/b") * 3):
        with BagWriter(tmp_path / f"bag_{number}.mcap") as bag:
            for stamp in (10 * number, 10 * number + 5):
                bag.write_raw(topic, IMAGE, cdr(stamp), stamp)
    held: list[int] = []

    class Counting(Waiting):
        def add(self, message: StoredMessage) -> None:
            super().add(message)
            held.append(self._bytes)

    monkeypatch.setattr("stereo_depth_ros.bags.reader.Waiting", Counting)
    assert len(read(tmp_path)) == 12
    assert len(held) == 12 and max(held) < 3 * len(cdr(0)) + 1000


def test_topics_span_and_selection(tmp_path: Path) -> None:
    with BagReader(write_mcap(tmp_path / "bag.mcap")) as reader:
        assert reader.topics == {"/a": TopicInfo(IMAGE, 4), "/b": TopicInfo(IMAGE, 3)}
        assert (reader.start_ns, reader.end_ns) == (10, 70)
        assert (reader.truncated, reader.warning) == (False, "")
        assert [m.log_time_ns for m in reader.messages(["/b"])] == STAMPS["/b"]
        assert [m.log_time_ns for m in reader.messages(None, 30, 60)] == [30, 40, 50, 60]
        assert not list(reader.messages([]))
        with pytest.raises(BagError, match=r"bag.mcap: has no topic /c: choose among /a, /b"):
            reader.messages(["/a", "/c"])


def test_messages_become_objects(tmp_path: Path) -> None:
    with BagReader(write_mcap(tmp_path / "bag.mcap")) as reader:
        image = reader.deserialize(next(reader.messages()))
    assert (image.height, image.width, image.header.stamp.nanosec) == (30, 41, 10)


def test_a_cut_mcap_gives_every_complete_message_before_the_cut(tmp_path: Path) -> None:
    whole = write_mcap(tmp_path / "bag.mcap", "none", chunk_size=10**6).read_bytes()  # one chunk, cut inside
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: whole.index(cdr(50)) + 500])
    with BagReader(cut) as reader:
        assert reader.truncated
        assert reader.warning == f"{cut} is cut in the middle: the 3 messages before the cut are read"
        assert (reader.start_ns, reader.end_ns) == (20, 40)
        assert reader.topics == {"/a": TopicInfo(IMAGE, 1), "/b": TopicInfo(IMAGE, 2)}
        assert [m.data for m in reader.messages()] == [cdr(20), cdr(30), cdr(40)]
        assert reader.deserialize(next(reader.messages(["/a"]))).width == 41


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_cut_chunk_gives_its_beginning(tmp_path: Path, compression: str) -> None:
    rng = np.random.default_rng(3)  # noise: where a compressed block ends does not depend on the version of the library
    data = [rng.bytes(1300) for _ in range(400)]  # 500 kB, above the 128 kB that zstd and the 64 kB of lz4 in one step
    with BagWriter(tmp_path / "bag.mcap", compression=compression, chunk_size=10**6) as bag:
        for stamp, payload in enumerate(data):
            bag.write_raw("/a", IMAGE, payload, stamp)
    whole = (tmp_path / "bag.mcap").read_bytes()
    assert whole.count(compression.encode()) == 2  # one chunk and its index
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 9 // 20])
    with BagReader(cut) as reader:
        messages = list(reader.messages())
    # less than half of the file, without the block that is cut
    assert 80 < len(messages) < 200
    assert all(m.log_time_ns == index and m.data == data[index] for index, m in enumerate(messages))


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_an_mcap_cut_anywhere_gives_a_prefix_of_its_messages(tmp_path: Path, compression: str) -> None:
    whole = write_mcap(tmp_path / "bag.mcap", compression).read_bytes()
    cut = tmp_path / "cut.mcap"
    counts = []
    for size in range(len(whole) - 1, 8, -173):
        cut.write_bytes(whole[:size])
        try:
            counts.append(len(read(cut)))  # compares every byte
        except BagError as error:
            assert "holds no messages before the cut" in str(error)
            counts.append(0)
    assert counts == sorted(counts, reverse=True)
    assert (counts[0], counts[-1]) == (7, 0)


def test_a_cut_mcap_without_chunks_and_a_tail_of_zeros(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start(profile="ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(IMAGE, "ros2msg", b"x"))
        for stamp in (30, 10, 20):
            writer.add_message(channel, stamp, cdr(stamp), stamp)
        size = file.tell()
    path.write_bytes(path.read_bytes()[:size] + bytes(1000))
    assert read(path) == [("/a", 10), ("/a", 20), ("/a", 30)]


def damaged_chunk(path: Path, damage: str, indexed: bool) -> None:
    """An MCAP of one message per chunk whose second chunk, that of /a at 30, is damaged."""
    data = bytearray(write_mcap(path, chunk_size=1).read_bytes())
    second = data.index(b"\x28\xb5\x2f\xfd", data.index(b"\x28\xb5\x2f\xfd") + 1)  # magic of zstd
    if damage == "magic":
        data[second : second + 4] = b"\0\0\0\0"
    elif damage == "bit":
        data[second + 600] ^= 4  # in the pixels: only the CRC tells
    else:
        data[second - 28 : second - 20] = (2**33).to_bytes(8, "little")  # the size that it inflates to
    path.write_bytes(data if indexed else data[:-30])


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("damage", ["magic", "bit", "bomb"])
def test_a_damaged_chunk_loses_its_own_messages_only(tmp_path: Path, damage: str, indexed: bool) -> None:
    path = tmp_path / "bag.mcap"
    damaged_chunk(path, damage, indexed)
    with BagReader(path) as reader:
        for _ in range(2):  # what is lost counts once, however often the bag is read
            messages = list(reader.messages())
            assert [m.log_time_ns for m in messages] == [10, 20, 40, 50, 60, 70]
            assert all(m.data == cdr(m.log_time_ns) for m in messages)
            assert re.fullmatch(
                rf"{path} is damaged: 1 chunk is damaged \(.+\): 1 message is lost, /a 1", reader.warning
            ), reader.warning
        assert reader.topics == {"/a": TopicInfo(IMAGE, 4), "/b": TopicInfo(IMAGE, 3)}
        assert not reader.truncated
        with pytest.raises(BagError, match=r"bag\.mcap: is damaged: 1 chunk is damaged .*: record or copy it again"):
            list(reader.messages(["/a"], 30, 30))
        assert (
            damage != "bomb" or "8589934592 bytes in one chunk or message, the maximum is 268435456" in reader.warning
        )


def test_an_mcap_without_the_ros2_profile_is_read_completely(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start()
        channel = writer.register_channel("/a", "cdr", writer.register_schema(IMAGE, "ros2msg", b"x"))
        writer.add_message(channel, 10, cdr(10), 10)
        writer.finish()
    with BagReader(path) as reader:
        assert not reader.truncated
        assert [m.data for m in reader.messages()] == [cdr(10)]


def test_a_cut_mcap_inside_a_folder(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "bag", mcap=True)
    file = folder / "bag.mcap"
    whole = file.read_bytes()
    file.write_bytes(whole[:-100])  # only the index is lost
    with BagReader(folder) as reader:
        assert (reader.truncated, len(list(reader.messages()))) == (False, 7)
    file.write_bytes(whole[: whole.index(b"\x0f" + (4).to_bytes(8, "little"))])  # and the end of the data
    with BagReader(folder) as reader:
        assert (reader.truncated, len(list(reader.messages()))) == (True, 7)


def test_a_cut_sqlite_file_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    file = write_rosbag2(tmp_path / "bag") / "bag.db3"
    data = file.read_bytes()
    for size in (len(data) // 2, 3000, 90):
        file.write_bytes(data[:size])
        with pytest.raises(BagError, match=r"bag\.db3: is (cut or )?damaged.*") as caught, BagReader(file) as reader:
            list(reader.messages())
        assert "bag.db3" in str(caught.value)


def test_custom_types_are_topics_like_others(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("int32 value", "my_msgs/msg/Thing"))
    with Rosbag2Writer(tmp_path / "bag", version=9) as writer:
        thing = writer.add_connection("/thing", "my_msgs/msg/Thing", typestore=store)
        image = writer.add_connection("/a", IMAGE, typestore=store)
        writer.write(thing, 5, b"\0\1\0\0\7\0\0\0")
        writer.write(image, 10, cdr(10))
    with BagReader(tmp_path / "bag") as reader:
        assert reader.topics["/thing"] == TopicInfo("my_msgs/msg/Thing", 1)
        first, second = reader.messages()
        assert second.data == cdr(10)
        with pytest.raises(MessageError, match=r"/thing at 5 ns: message type 'my_msgs/msg/Thing'"):
            reader.deserialize(first)


def test_old_bags_have_short_type_names_and_no_qos(tmp_path: Path) -> None:
    path = tmp_path / "old.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)")
        database.execute("INSERT INTO topics VALUES(1, '/a', 'sensor_msgs/Image', 'cdr')")
        database.execute("INSERT INTO messages VALUES(1, 1, 10, ?)", (cdr(10),))
    database.close()
    assert read(path) == [("/a", 10)]


def test_ros1_messages_become_cdr(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    time, header, image = (store.types[n] for n in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", IMAGE))
    pixels = np.arange(6, dtype=np.uint8)
    message = image(header(9, time(1, 2), "left"), 2, 3, "mono8", 0, 3, pixels)
    with rosbag1.Writer(tmp_path / "old.bag") as writer:
        connection = writer.add_connection("/a", IMAGE, typestore=store)
        writer.write(connection, 10, store.serialize_ros1(message, IMAGE))
        log = writer.add_connection("/log", "rosgraph_msgs/msg/Log", typestore=store)
        writer.write(log, 11, b"")
    with BagReader(tmp_path / "old.bag") as reader:
        read_back = reader.deserialize(next(reader.messages(["/a"])))
        with pytest.raises(BagError, match=r"/log of type rosgraph_msgs/msg/Log has no ROS 2 Jazzy equivalent"):
            list(reader.messages())
    assert (read_back.height, read_back.width, read_back.header.stamp.sec) == (2, 3, 1)
    assert read_back.header.frame_id == "left" and np.array_equal(read_back.data, pixels)


def test_a_path_that_is_not_a_bag_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"nowhere\.mcap: does not exist"):
        BagReader(tmp_path / "nowhere.mcap")
    with pytest.raises(BagError, match=r"is not a bag, it holds no \.mcap or \.db3 file"):
        BagReader(tmp_path)
    for name, content, reason in (
        ("image.png", b"x", "is not a bag"),
        ("empty.mcap", b"", "is empty"),
        ("empty.db3", b"", "is empty"),
        ("text.mcap", b"just text" * 9, "is not an MCAP file"),
        ("text.db3", b"just text" * 90, "is not an SQLite file"),
        ("cut.db3", b"SQLite format 3\0" + bytes(90), r"is cut or damaged.*sqlite3 cut\.db3 \.recover"),
        ("text.bag", b"just text" * 9, r"is not a ROS 1 bag, it does not begin with #ROSBAG V2\.0"),
        ("text.db3.zstd", b"just text" * 9, "cannot be decompressed"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BagError, match=f"{name}: {reason}"):
            BagReader(tmp_path / name)


def test_a_bag_without_messages_and_a_folder_without_its_file(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "none.mcap"):
        pass
    with pytest.raises(BagError, match=r"none\.mcap: holds no messages: record it again"):
        BagReader(tmp_path / "none.mcap")
    folder = write_rosbag2(tmp_path / "bag")
    (folder / "bag.db3").rename(folder / "other.db3")
    with pytest.raises(BagError, match=r"bag: lacks bag\.db3, which its metadata\.yaml lists"):
        BagReader(folder)


def test_a_compressed_file_without_metadata(tmp_path: Path) -> None:
    whole = write_mcap(tmp_path / "bag.mcap").read_bytes()
    (tmp_path / "bag.mcap.zstd").write_bytes(zstandard.compress(whole))
    assert read(tmp_path / "bag.mcap.zstd") == IN_ORDER


def test_bags_are_recognized_by_their_file_names(tmp_path: Path) -> None:
    assert not is_bag(tmp_path / "nowhere.mcap")
    for number, name in enumerate(("x.mcap", "x.db3", "x.mcap.zstd", "x.db3.zstd")):
        folder = tmp_path / f"bag{number}"
        folder.mkdir()
        assert not is_bag(folder)
        (folder / name).touch()
        assert is_bag(folder) and is_bag(folder / name)
    others = tmp_path / "others"
    others.mkdir()
    for name in ("x.png", "x.zstd", "x.bag", "x.mcap.png"):
        (others / name).touch()
        assert is_bag(others / name) == (name == "x.bag")
    assert not is_bag(others), "a ROS 1 bag is one file"


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "topic", "info", "total"),
    [
        ("rosbag2js_sample/sample.db3", "/image", TopicInfo(IMAGE, 1), 5),
        ("mvtb_test_ros2", "/camera/compressed", TopicInfo("sensor_msgs/msg/CompressedImage", 3), 9),
        ("rosbag2_py_resources/mcap/talker", "/topic", TopicInfo("std_msgs/msg/String", 10), 20),
        ("rosbag2_py_resources/sqlite3/talker", "/topic", TopicInfo("std_msgs/msg/String", 10), 20),
    ],
)
def test_bags_of_other_projects(stereo_data: Path, name: str, topic: str, info: TopicInfo, total: int) -> None:
    with BagReader(stereo_data / "bags" / name) as reader:
        assert reader.topics[topic] == info
        messages = list(reader.messages())
        assert len(messages) == total
        assert [m.log_time_ns for m in messages] == sorted(m.log_time_ns for m in messages)
        for message in messages:
            if message.topic == topic:
                reader.deserialize(message)
