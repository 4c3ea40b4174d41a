# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile bags: what inflates without end, metadata.yaml of any content, foreign and computed SQLite tables."""

from __future__ import annotations

import os
import sqlite3
import struct
import tracemalloc
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Header, Message, Schema
from test_bag_reader import IMAGE, IN_ORDER, cdr, write_mcap, write_rosbag2
from test_bag_reader import read as read_all

from stereo_depth_ros.bags import inflate
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.core.errors import BagError

MAGIC = b"\x89MCAP0\r\n"


def zstd_bomb(size: int, states_size: bool) -> bytes:
    """A frame of blocks that repeat a zero: 8 GiB take 262 kB (RFC 8878, 3.1.1)."""
    header = bytes((0xC0 if states_size else 0, 7 << 3)) + (struct.pack("<Q", size) if states_size else b"")
    block = ((2**17 << 3) | 2).to_bytes(3, "little") + b"\0"
    return b"\x28\xb5\x2f\xfd" + header + block * (size // 2**17) + (3).to_bytes(3, "little") + b"\0"


def bag_of_chunk(path: Path, compression: str, data: bytes, size: int, number: int = 1) -> Path:
    """A message of /a at 5 ns outside of chunks, and chunks that state to inflate to ``size`` bytes."""
    records = RecordBuilder()
    Header("ros2", "").write(records)
    Schema(id=1, name=IMAGE, encoding="ros2msg", data=b"x").write(records)
    Channel(id=1, topic="/a", message_encoding="cdr", metadata={}, schema_id=1).write(records)
    Message(channel_id=1, log_time=5, data=cdr(5), publish_time=5, sequence=0).write(records)
    for _ in range(number):
        Chunk(
            compression=compression,
            data=data,
            message_start_time=10,
            message_end_time=20,
            uncompressed_crc=0,
            uncompressed_size=size,
        ).write(records)
    DataEnd(0).write(records)
    path.write_bytes(MAGIC + records.end() + MAGIC)
    return path


def read_one(path: Path) -> str:
    """The warning of a bag of which only the message of /a at 5 ns is read."""
    with BagReader(path) as reader:
        (message,) = reader.messages()
        assert message.data == cdr(5)
        return reader.warning


LZ4_BOMB = lz4.frame.compress(bytes(2**24))


@pytest.mark.parametrize(
    ("compression", "data", "size", "cause"),
    [
        ("zstd", zstd_bomb(2**33, False), 2**33, "8589934592 bytes in one chunk or message, the maximum is 268435456"),
        ("zstd", zstd_bomb(2**33, True), 2**33, "8589934592 bytes in one chunk or message, the maximum is 268435456"),
        ("zstd", zstd_bomb(2**33, False), 1000, "inflates to more than 1000 bytes"),
        ("zstd", zstd_bomb(2**33, True), 1000, "inflates to more than 1000 bytes"),
        ("lz4", LZ4_BOMB, 2**63, "9223372036854775808 bytes in one chunk or message, the maximum is 268435456"),
        ("lz4", LZ4_BOMB, 1000, "inflates to more than 1000 bytes"),
        ("zstd", zstandard.compress(bytes(1000)), 999, "inflates to more than 999 bytes"),
        ("zstd", zstandard.compress(bytes(1000)), 1001, "1000 bytes of 1001"),
        ("brotli", b"x", 10, "compression 'brotli' is not supported, supported are zstd, lz4, bz2 and none"),
    ],
)
def test_a_chunk_that_inflates_too_far_is_lost(
    tmp_path: Path, compression: str, data: bytes, size: int, cause: str
) -> None:
    path = bag_of_chunk(tmp_path / "bag.mcap", compression, data, size)
    tracemalloc.start()
    try:
        assert f"1 chunk is damaged ({cause})" in read_one(path)
        assert tracemalloc.get_traced_memory()[1] < 16 * 2**20
    finally:
        tracemalloc.stop()


def test_chunks_that_inflate_too_far_together_are_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inflate, "_TOTAL_LIMIT", 5 * 2**20)
    monkeypatch.setattr(inflate, "_TOTAL_RATIO", 10)
    records = struct.pack("<BQ", 0x80, 2**20 - 9) + bytes(2**20 - 9)  # a record of a kind that is skipped
    path = bag_of_chunk(tmp_path / "bag.mcap", "zstd", zstandard.compress(records), 2**20, 8)
    cause = "inflates to more than 5242880 bytes in total, the maximum for a file of"
    assert f"3 chunks are damaged ({cause} " in read_one(path)


def test_chunks_of_too_many_records_are_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inflate, "_RECORDS", 1000)
    records = struct.pack("<BQ", 0x80, 0) * 10_000
    path = bag_of_chunk(tmp_path / "bag.mcap", "zstd", zstandard.compress(records), len(records))
    assert "1 chunk is damaged (more than " in read_one(path)


TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)"


def sqlite_bag(path: Path, rows: list[tuple[object, ...]], messages: str = MESSAGES) -> Path:
    with sqlite3.connect(path) as database:
        database.execute(TOPICS)
        database.execute(messages)
        database.execute("INSERT INTO topics VALUES(1, '/a', ?, 'cdr')", (IMAGE,))
        if rows:
            database.executemany("INSERT INTO messages VALUES(?, ?, ?, ?)", rows)
    database.close()
    return path


@pytest.mark.parametrize("states_size", [False, True])
def test_a_message_that_inflates_too_far_is_lost(tmp_path: Path, states_size: bool) -> None:
    path = sqlite_bag(tmp_path / "bag.db3", [(1, 1, 5, cdr(5)), (2, 1, 6, zstd_bomb(2**33, states_size))])
    cause = "8589934592" if states_size else "inflates to more than 268435456"
    assert f"1 message is lost, /a 1 ({cause} bytes" in read_one(path)


def test_a_compressed_file_that_inflates_too_far_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inflate, "_FILE_LIMIT", 2**22)
    path = tmp_path / "bag.mcap.zstd"
    path.write_bytes(zstd_bomb(2**24, False))
    with pytest.raises(BagError, match=r"bag\.mcap\.zstd: inflates to more than 4194304 bytes, the maximum for a file"):
        BagReader(path)


def test_messages_that_are_out_of_order_too_far_are_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stereo_depth_ros.bags.chunked_file._QUEUE_LIMIT", 5000)
    path = write_mcap(tmp_path / "bag.mcap", chunk_size=10**6)
    with BagReader(path) as reader, pytest.raises(BagError, match=r"bag\.mcap: more than 5000 bytes of messages are"):
        list(reader.messages())


LAUGHS = "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 40))
NAMES = "rosbag2_bagfile_information:\n  relative_file_paths: [bag.db3]\n"


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("", "it is not the metadata of a bag"),
        ("[1, 2]", "it is not the metadata of a bag"),
        ("rosbag2_bagfile_information: null", "it is not the metadata of a bag"),
        ("rosbag2_bagfile_information: [1]", "it is not the metadata of a bag"),
        ("other: 1", "it has no 'rosbag2_bagfile_information'"),
        ("rosbag2_bagfile_information: {version: 5}", "it has no 'relative_file_paths'"),
        ("rosbag2_bagfile_information: {relative_file_paths: bag.db3}", "relative_file_paths is not a list of names"),
        ("rosbag2_bagfile_information: {relative_file_paths: [null]}", "relative_file_paths is not a list of names"),
        ("rosbag2_bagfile_information: {relative_file_paths: [7]}", "relative_file_paths is not a list of names"),
        ("rosbag2_bagfile_information: {relative_file_paths: ['']}", "relative_file_paths is not a list of names"),
        (f"{LAUGHS}rosbag2_bagfile_information: {{relative_file_paths: *a39}}", "more than 50000 values"),
        ("[" * 100_000, "more than 32 levels deep"),
        ("".join(" " * n + "a:\n" for n in range(500)), "more than 32 levels deep"),
        ("# " + "x" * 300_000, "it is larger than 262144 bytes"),
        ("a: [", "expected the node content"),
        ("\x00\x01", "it is a binary file, not text"),
    ],
)
def test_metadata_that_is_not_that_of_a_bag_is_ignored_and_named(tmp_path: Path, content: str, why: str) -> None:
    folder = write_rosbag2(tmp_path / "bag")
    (folder / "metadata.yaml").write_text(content)
    assert read_all(folder) == IN_ORDER
    with BagReader(folder) as reader:
        assert reader.warning.startswith(f"{folder} has a metadata.yaml that is ignored ({why}"), reader.warning
        assert len(reader.warning) < 500


@pytest.mark.parametrize("value", ["null", "[1, 2]", "7", "{a: b}", "*a39", ".inf", "!!python/object:os.system {}"])
@pytest.mark.parametrize("name", ["compression_mode", "compression_format", "version", "storage_identifier", "files"])
def test_other_metadata_may_be_anything(tmp_path: Path, name: str, value: str) -> None:
    folder = write_rosbag2(tmp_path / "bag")
    (folder / "metadata.yaml").write_text(f"{LAUGHS}{NAMES}  {name}: {value}\n" if "python" not in value else NAMES)
    assert read_all(folder) == IN_ORDER


def test_another_compression_is_named(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "bag")
    (folder / "metadata.yaml").write_text(f"{NAMES}  compression_format: lz4\n")
    with pytest.raises(BagError, match=r"bag: is compressed by 'lz4', only zstd is supported: convert it"):
        BagReader(folder)


def test_a_foreign_sqlite_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "places.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE bookmarks(id INTEGER PRIMARY KEY)")
        database.execute("CREATE TABLE history(id INTEGER PRIMARY KEY)")
    database.close()
    with pytest.raises(BagError) as caught:
        BagReader(path)
    assert str(caught.value) == (
        f"{path}: is an SQLite file, but not of rosbag2: its tables are bookmarks, history: "
        "give an .mcap, .db3 or .bag file or a rosbag2 folder"
    )


@pytest.mark.parametrize(
    ("messages", "problem"),
    [
        (
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) SELECT i",
            "is an SQLite",
        ),
        (
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, "
            "data BLOB AS (printf('%.*c', 900000000, 'x')))",
            "computes the column data of its table messages",
        ),
    ],
)
def test_computed_messages_are_refused(tmp_path: Path, messages: str, problem: str) -> None:
    with pytest.raises(BagError, match=problem):
        BagReader(sqlite_bag(tmp_path / "bag.db3", [], messages))


def test_rows_of_other_types_are_lost(tmp_path: Path) -> None:
    path = sqlite_bag(
        tmp_path / "bag.db3",
        [(1, 1, 5, cdr(5)), (2, 1, "noon", b""), (3, None, 7, b""), (4, 9, 8, b""), (5, 1, 9, 3.5), (6, 1, 9, None)],
    )
    assert "5 messages are lost, /a 2, unknown topics 3 (a row without topic or time)" in read_one(path)


def test_names_of_files_are_not_parsed(tmp_path: Path) -> None:
    folder = tmp_path / "50% [red]#1?mode=memory"
    folder.mkdir()
    assert read_all((write_rosbag2(tmp_path / "bag") / "bag.db3").rename(folder / "bag.db3")) == IN_ORDER


def test_a_pipe_is_not_a_bag(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "bag.mcap")
    with pytest.raises(BagError, match=r"bag\.mcap: is not a bag"):
        BagReader(tmp_path / "bag.mcap")
