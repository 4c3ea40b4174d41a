# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads the SQLite files of rosbag2 (.db3), row by row, so that a damaged page loses its own messages only."""

from __future__ import annotations

import shutil
import sqlite3
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from stereo_depth_ros.bags.chunked_file import Channel, RawMessage, Waiting
from stereo_depth_ros.bags.inflate import INFLATED_LIMIT, InflationBudget, check_size
from stereo_depth_ros.bags.losses import Losses, cause_text
from stereo_depth_ros.core.errors import BagError

__all__ = ["SqliteFile"]

_MAGIC = b"SQLite format 3\0"
_TABLES = {"topics", "messages"}
_UNKNOWN = "unknown topics"


class SqliteFile:
    """An SQLite file of rosbag2 of any version.

    Attributes:
        path: the file.
        cut: always False; a file that is cut has lost rows.
        losses: what could not be read so far.
        budget: for messages that are compressed in it.
        start_ns, end_ns: log times of the first and last message; 0 when there is none.

    Raises:
        BagError: not an SQLite file of rosbag2, or its topics cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cut = False
        self.losses = Losses()
        self.budget = InflationBudget(path.stat().st_size)
        with path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise BagError(
                    "is not an SQLite file, it does not begin with the magic of SQLite",
                    subject=str(path),
                    remedy="check what the file is, or copy it again",
                )
        with ExitStack() as stack:
            try:
                self._database = stack.enter_context(closing(_connect(_whole_pages(path, stack))))
                self._check_tables()
                self._channels = self._read_channels()
                rows, topics, times = self._list_messages()
            except sqlite3.Error as error:
                remedy = f"recover it with `sqlite3 {path.name} .recover | sqlite3 new.db3`"
                raise BagError(f"is cut or damaged ({cause_text(error)})", subject=str(path), remedy=remedy) from error
            self._files = stack.pop_all()
        order = np.argsort(times, kind="stable")
        self._rows, self._topics, self._times = rows[order], topics[order], times[order]
        self.start_ns, self.end_ns = (int(self._times[at]) if len(order) else 0 for at in (0, -1))

    @property
    def counts(self) -> list[tuple[Channel, int]]:
        """The topics and their numbers of messages."""
        counts = Counter(self._topics.tolist())
        return [(channel, counts[key]) for key, channel in self._channels.items()]

    def messages(self, topics: set[str], start_ns: int, end_ns: int, waiting: Waiting) -> Iterator[RawMessage]:
        """Messages with start_ns <= log time <= end_ns, in log-time order; none has to wait."""
        wanted = [key for key, channel in self._channels.items() if channel.topic in topics]
        limits = np.clip([start_ns, end_ns], -(2**63), 2**63 - 1)
        inside = np.isin(self._topics, wanted) & (self._times >= limits[0]) & (self._times <= limits[1])
        for at in np.flatnonzero(inside):
            row, channel = int(self._rows[at]), self._channels[int(self._topics[at])]
            try:
                data = self._data(row)
            except (sqlite3.Error, ValueError, BagError) as error:
                self.losses.add_messages((self.path, row), channel.topic, 1, cause_text(error))
            else:
                yield RawMessage(channel, int(self._times[at]), data, (row, 0))

    def close(self) -> None:
        """Close the file."""
        self._files.close()

    def _check_tables(self) -> None:
        # only tables that are stored: views and computed columns can be of any size
        stored = self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0")
        names = {str(name) for (name,) in stored}
        if not names:
            raise sqlite3.DatabaseError("it has no tables")
        if not names >= _TABLES:
            raise BagError(
                f"is an SQLite file, but not of rosbag2: its tables are {', '.join(sorted(names)[:10])}",
                subject=str(self.path),
                value=sorted(names),
                limit=sorted(_TABLES),
                remedy="give an .mcap, .db3 or .bag file or a rosbag2 folder",
            )
        for table in _TABLES:
            for _, name, _, _, _, _, hidden in self._database.execute(f"PRAGMA table_xinfo({table})"):
                if hidden:
                    raise BagError(
                        f"computes the column {name} of its table {table}, rosbag2 stores all columns",
                        subject=str(self.path),
                        value=name,
                        remedy="record it again",
                    )

    def _read_channels(self) -> dict[int, Channel]:
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
        return {key: Channel(str(name), str(kind), str(form)) for key, name, kind, form in rows if type(key) is int}

    def _list_messages(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row, topic and log time of all messages whose rows can be read; the others are losses."""
        listed = array("q"), array("q"), array("q")
        lost: Counter[str] = Counter()
        cause = "a row without topic or time"

        def add(rows: Iterable[tuple[object, object, object]]) -> None:
            for row, topic, time_ns in rows:
                if type(row) is int and type(time_ns) is int and type(topic) is int and topic in self._channels:
                    for column, value in zip(listed, (row, topic, time_ns), strict=True):
                        column.append(value)
                else:
                    lost[_UNKNOWN] += 1

        select = "SELECT rowid, topic_id, timestamp FROM messages"
        try:
            add(self._database.execute(f"{select} NOT INDEXED ORDER BY rowid"))
        except sqlite3.Error as error:
            cause = cause_text(error)
            for row in self._rows_after(listed[0][-1] if listed[0] else 0):
                try:
                    add(self._database.execute(f"{select} WHERE rowid = ?", (row,)).fetchall())
                except sqlite3.Error:
                    lost[_UNKNOWN] += 1
            if not listed[0]:
                raise
        for topic, count in lost.items():
            self.losses.add_messages((self.path, "rows"), topic, count, cause)
        rows, topics, times = (np.array(column, np.int64) for column in listed)
        return rows, topics, times

    def _rows_after(self, row: int) -> list[int]:
        """Rows after one, where they cannot be listed: by the index of the times, or up to the last one."""
        try:
            found = self._database.execute("SELECT rowid FROM messages INDEXED BY timestamp_idx").fetchall()
            return sorted({key for (key,) in found if type(key) is int and key > row})
        except sqlite3.Error:
            pass
        try:
            last = self._database.execute("SELECT max(rowid) FROM messages").fetchone()[0]
        except sqlite3.Error:
            last = None
        room = self.path.stat().st_size // 8  # rows that fit into the file
        return list(range(row + 1, last + 1)) if type(last) is int and last - row <= room else []

    def _data(self, row: int) -> bytes:
        select = "SELECT length(data), CASE WHEN length(data) <= ? THEN data END FROM messages WHERE rowid = ?"
        size, data = self._database.execute(select, (INFLATED_LIMIT, row)).fetchone() or (0, None)
        check_size(size if type(size) is int else 0)
        if not isinstance(data, bytes):
            raise ValueError(f"its data are no bytes in row {row}")
        return data


def _whole_pages(path: Path, stack: ExitStack) -> Path:
    """The file; a copy that ends after a page where it is cut in one, whose missing bytes SQLite would read as 0."""
    size = path.stat().st_size
    with path.open("rb") as file:
        page_size = int.from_bytes(file.read(18)[16:], "big")
        page_size = page_size if page_size >= 512 else 2**16  # which is stored as 1
        if not size % page_size:
            return path
        copy = Path(stack.enter_context(TemporaryDirectory()), path.name)
        file.seek(0)
        with copy.open("wb") as target:
            shutil.copyfileobj(file, target)
            target.truncate(size - size % page_size)
    return copy


def _connect(path: Path) -> sqlite3.Connection:
    """Opens a file to read only; messages that a recorder left in its write-ahead log are read too."""
    log = path.with_name(f"{path.name}-wal")
    options = "mode=ro" if log.exists() and log.stat().st_size else "mode=ro&immutable=1"
    database = sqlite3.connect(f"{path.resolve().as_uri()}?{options}", uri=True, check_same_thread=False)
    database.text_factory = lambda text: text.decode(errors="replace")
    # a writable schema also accepts a file that is cut; nothing is written to one that is open to read only
    for pragma in ("trusted_schema = OFF", "cell_size_check = ON", "writable_schema = ON"):
        database.execute(f"PRAGMA {pragma}")
    return database
