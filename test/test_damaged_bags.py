# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged bags of every format lose what is damaged and nothing else, and each command says the same of it."""

from __future__ import annotations

import json
import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard
from bag_kinds import TYPES
from command_line import CommandLine
from mcap.writer import CompressionType, Writer
from rosbags import rosbag1
from stereo_bags import sequence, write_truth_bag
from test_bag_reader import IMAGE, IN_ORDER, cdr, write_mcap, write_rosbag2

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.datasets.stereo_images import open_stereo_images
from stereo_depth_ros.messages.image import image_message

ALL = [10, 20, 30, 40, 50, 60, 70]


def read(path: Path) -> tuple[list[int], str]:
    """Log times of the messages, whose bytes are right, and the warning without the path in front."""
    with BagReader(path) as reader:
        messages = list(reader.messages())
        warning = reader.warning
    assert all(message.data == cdr(message.log_time_ns) for message in messages)
    assert not warning or warning.startswith(f"{path} ")
    return [message.log_time_ns for message in messages], warning.removeprefix(f"{path} ")


def flipped(path: Path, at: int, bit: int = 4) -> Path:
    data = bytearray(path.read_bytes())
    data[at] ^= bit
    path.write_bytes(data)
    return path


def write_ros1(path: Path) -> Path:
    """A message of /a or /b in each chunk."""
    with rosbag1.Writer(path) as writer:
        writer.chunk_threshold = 1
        connections = {t: writer.add_connection(t, IMAGE, typestore=TYPES.typestore) for t in ("/a", "/b")}
        for topic, stamp in IN_ORDER:
            writer.write(connections[topic], stamp, bytes(TYPES.typestore.cdr_to_ros1(cdr(stamp), IMAGE)))
    return path


def test_a_damaged_summary_loses_nothing(tmp_path: Path) -> None:
    whole = write_mcap(tmp_path / "bag.mcap").read_bytes()
    summary = struct.unpack_from("<Q", whole, len(whole) - 28)[0]
    for at in range(summary, len(whole), 29):
        (tmp_path / "bag.mcap").write_bytes(whole)
        assert read(flipped(tmp_path / "bag.mcap", at)) == (ALL, ""), at


def test_a_damaged_magic_loses_nothing(tmp_path: Path) -> None:
    assert read(flipped(write_mcap(tmp_path / "bag.mcap"), 2)) == (ALL, "")


def test_a_summary_without_crc_is_compared_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1, enable_crcs=False)
        writer.start(profile="ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(IMAGE, "ros2msg", b"x"))
        for stamp in ALL:
            writer.add_message(channel, stamp, cdr(stamp), stamp)
        writer.finish()
    whole = path.read_bytes()
    assert read(path) == (ALL, "")
    index = struct.unpack_from("<Q", whole, len(whole) - 28)[0]
    while whole[index] != 8:  # the first chunk index
        index += 9 + struct.unpack_from("<Q", whole, index + 1)[0]
    assert read(flipped(path, index + 9 + 16)) == (ALL, "")  # the offset of its chunk


def test_a_damaged_message_in_a_chunk_that_is_not_compressed(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "bag.mcap", "none")
    times, warning = read(flipped(path, path.read_bytes().index(cdr(30)) + 200))
    assert times == [10, 40, 50, 60, 70] or 30 not in times
    assert "1 chunk is damaged (its CRC is " in warning and "/a 1" in warning


def test_a_damaged_message_of_a_recording_with_compressed_messages(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start(profile="ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(IMAGE, "ros2msg", b"x"))
        for stamp in ALL:
            data = zstandard.compress(cdr(stamp)) if stamp != 30 else zstandard.compress(cdr(stamp))[:-50]
            writer.add_message(channel, stamp, data, stamp)
        writer.finish()
    times, warning = read(path)
    assert times == [10, 20, 40, 50, 60, 70]
    assert warning.startswith("is damaged: 1 message is lost, /a 1 (")


@pytest.mark.parametrize("part", ["first", "last"])
def test_a_ros1_bag_with_a_damaged_chunk(tmp_path: Path, part: str) -> None:
    path = write_ros1(tmp_path / "bag.bag")
    assert read(path) == (ALL, "")
    data = path.read_bytes()
    chunk = data.index(b"op=\x05") if part == "first" else data.rindex(b"op=\x05")
    times, warning = read(flipped(path, chunk + 3))  # it is no longer a chunk
    assert times == (ALL[1:] if part == "first" else ALL[:-1])
    topic = "/a"
    assert warning.startswith("is damaged: 1 chunk is damaged (") and warning.endswith(f"1 message is lost, {topic} 1")


def test_a_ros1_bag_without_index_is_read(tmp_path: Path) -> None:
    path = write_ros1(tmp_path / "bag.bag")
    data = path.read_bytes()
    index = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)[0]
    damaged = data.index(b"op=\x07", index)
    assert read(flipped(path, damaged + 3)) == (ALL, "")  # a connection of the index
    path = path.rename(tmp_path / "bag.bag.active")
    path.write_bytes(data[: data.rindex(b"op=\x05") + 500])  # as of a killed recorder: no index, last chunk cut
    times, warning = read(path)
    assert times == ALL[:-1] and warning == "is cut in the middle: the 6 messages before the cut are read"


def test_a_ros1_index_of_a_connection_that_is_not_there(tmp_path: Path) -> None:
    path = write_ros1(tmp_path / "bag.bag")
    assert read(flipped(path, len(path.read_bytes()) - 8, 64)) == (ALL, "")  # that of the messages of the last chunk


def test_a_message_with_a_damaged_log_time_is_at_its_chunk(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1, enable_crcs=False, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(IMAGE, "ros2msg", b"x"))
        for stamp in ALL:
            writer.add_message(channel, stamp, cdr(stamp), stamp, sequence=99)
        writer.finish()
    flipped(path, path.read_bytes().index(struct.pack("<IQ", 99, 30)) + 10)
    assert read(path) == (ALL, "")
    with BagReader(path) as reader:
        assert [message.data for message in reader.messages(["/a"], 30, 30)] == [cdr(30)]


def write_sqlite(path: Path) -> bytes:
    """100 messages in pages of 1 kB."""
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA page_size = 1024")
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)")
        database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        database.execute("INSERT INTO topics VALUES(1, '/a', ?, 'cdr')", (IMAGE,))
        database.executemany("INSERT INTO messages VALUES(?, 1, ?, ?)", [(at, at, cdr(at)) for at in range(1, 101)])
    database.close()
    return path.read_bytes()


def test_a_damaged_page_of_sqlite_loses_its_messages(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    whole = write_sqlite(path)
    assert read(path) == (list(range(1, 101)), "")
    leaves = [at for at in range(0, len(whole), 1024) if whole[at] == 13 and at > 2048]  # type 13: a leaf of a table
    lost = []
    for page in leaves[:: len(leaves) // 5]:
        path.write_bytes(whole[:page] + bytes(1024) + whole[page + 1024 :])
        times, warning = read(path)
        lost.append(100 - len(times))
        assert warning.startswith(f"is damaged: {lost[-1]} message") and "malformed" in warning
    assert min(lost) > 0 and max(lost) < 5


def test_a_cut_sqlite_file_gives_what_is_there(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    whole = write_sqlite(path)
    for size in (len(whole) * 3 // 4 + 100, len(whole) // 4096 * 2048):  # in a page, and after one
        path.write_bytes(whole[:size])
        times, warning = read(path)
        share = len(times) / 100 * len(whole) / size
        assert 0.9 < share <= 1 and warning.startswith("is damaged: ")


def test_messages_in_the_write_ahead_log_of_a_killed_recorder_are_read(tmp_path: Path) -> None:
    file = write_rosbag2(tmp_path / "bag") / "bag.db3"
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA wal_autocheckpoint = 0")
    database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(1, 80, ?)", (cdr(80),))
    database.commit()
    copy = tmp_path / "copy"  # as it is when the recorder is killed
    copy.mkdir()
    for path in (file, Path(f"{file}-wal")):
        (copy / path.name).write_bytes(path.read_bytes())
    database.close()
    assert read(copy / "bag.db3") == ([*ALL, 80], "")


def test_a_split_bag_with_a_damaged_file_gives_the_others(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    for number in range(3):
        write_mcap(tmp_path / "bag" / f"bag_{number}.mcap")
    (tmp_path / "bag/bag_1.mcap").write_bytes(b"")
    (tmp_path / "bag/bag_2.mcap").write_bytes(b"something else" * 9)
    times, warning = read(tmp_path / "bag")
    assert times == ALL
    assert warning == (
        "lacks bag_1.mcap, which is empty (0 bytes); "
        "lacks bag_2.mcap, which is not an MCAP file, it does not begin with the MCAP magic"
    )


def test_a_damaged_file_compressed_as_a_whole_gives_its_beginning(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=1)
        writer.start(profile="ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(IMAGE, "ros2msg", b"x"))
        for stamp in range(100):
            writer.add_message(channel, stamp, random.bytes(5000), stamp)
        writer.finish()
    path = tmp_path / "bag.mcap.zstd"
    data = bytearray(zstandard.compress((tmp_path / "bag.mcap").read_bytes()))
    data[len(data) * 3 // 4 :] = bytes(len(data) // 4)
    path.write_bytes(data)
    with BagReader(path) as reader:
        count = len(list(reader.messages()))
        assert 50 <= count < 76 and reader.truncated
        assert reader.warning == f"{path} is cut in the middle: the {count} messages before the cut are read"


def test_commands_say_the_same_of_a_damaged_bag(tmp_path: Path, command_line: CommandLine) -> None:
    path = tmp_path / "bag.mcap"
    write_truth_bag(tmp_path / "whole.mcap", 4)
    with BagReader(tmp_path / "whole.mcap") as reader, path.open("wb") as file:
        writer = Writer(file, chunk_size=100_000)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for message in reader.messages():
            if message.topic not in channels:
                schema = writer.register_schema(message.msgtype, "ros2msg", b"x")
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            writer.add_message(channels[message.topic], message.log_time_ns, message.data, message.log_time_ns)
        writer.finish()
    data = path.read_bytes()
    flipped(path, data.index(b"\x28\xb5\x2f\xfd", len(data) // 2) + 100)
    with BagReader(path) as reader:
        list(reader.messages())
        said = reader.warning
    assert said.startswith(f"{path} is damaged: 1 chunk is damaged (")
    run = command_line("info", columns=500)
    code, out, err = run(path)
    assert err.count(said) == 1, err
    code, out, err = command_line("process", columns=500)(path, "-o", tmp_path / "out.mcap", "--matcher", "bm")
    assert code == 0 and (out + err).count(said) == 1, out + err
    code, out, err = command_line("doctor", columns=2000)(path, "--json", "-")
    assert json.dumps(said)[1:-1] in out


def test_images_for_a_calibration_say_it_too(tmp_path: Path) -> None:
    """What is lost is known when all pairs are read."""
    made = sequence(4)
    path = tmp_path / "bag.mcap"
    with BagWriter(path, chunk_size=1) as bag:
        for frame in made:
            for side, image in (("left", frame.pair.left), ("right", frame.pair.right)):
                message = image_message(TYPES, image.pixels, "mono8", image.stamp_ns, side)
                bag.write(f"/{side}/image_raw", message, image.stamp_ns)
    data = path.read_bytes()
    flipped(path, data.index(b"\x28\xb5\x2f\xfd", len(data) // 3) + 100)
    images = open_stereo_images(path)
    assert len(list(images)) == 3
    assert images.warnings[0].startswith(f"{path} is damaged: 1 chunk is damaged (")
