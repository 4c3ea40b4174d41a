# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bag file of chunks: its messages in log-time order, chunk by chunk; a damaged chunk loses its own messages only."""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from stereo_depth_ros.bags.inflate import InflationBudget
from stereo_depth_ros.bags.losses import Losses, cause_text
from stereo_depth_ros.core.errors import BagError

__all__ = ["Channel", "Chunk", "ChunkedFile", "RawMessage", "StoredMessage", "Waiting"]

_QUEUE_LIMIT = 320 * 2**20  # bytes of messages that wait for earlier ones of other chunks; more than one chunk has
_MESSAGE_BYTES = 300  # what a message takes in the queue besides its data


class Channel(NamedTuple):
    """A topic of a file: its name, message type and message encoding ("cdr", "ros1", "protobuf", "json")."""

    topic: str
    msgtype: str
    encoding: str


class StoredMessage(NamedTuple):
    """One message of a chunk, as it is stored."""

    channel: int
    log_time_ns: int
    data: bytes


class RawMessage(NamedTuple):
    """One message of a file, as it is stored; ``place`` identifies it in the file."""

    channel: Channel
    log_time_ns: int
    data: bytes
    place: tuple[int, int]


class Waiting:
    """Counts the messages of a bag that wait for earlier ones of other chunks and files."""

    def __init__(self) -> None:
        self._bytes = 0

    def add(self, message: StoredMessage) -> None:
        """One more.

        Raises:
            BagError: they are too large in total.
        """
        self._bytes += len(message.data) + _MESSAGE_BYTES
        if self._bytes > _QUEUE_LIMIT:
            raise BagError(
                f"more than {_QUEUE_LIMIT} bytes of messages are out of order",
                value=self._bytes,
                limit=_QUEUE_LIMIT,
                remedy="sort it with `mcap sort`",
            )

    def remove(self, message: StoredMessage) -> None:
        """One less."""
        self._bytes -= len(message.data) + _MESSAGE_BYTES


@dataclass(frozen=True)
class Chunk:
    """A chunk, or one message outside of chunks.

    Attributes:
        offset: where it begins in the file, bytes.
        start_ns, end_ns: log times of its first and last message.
        counts: messages by channel.
        cut: the file ends in it, so that its first messages are all there is.
    """

    offset: int
    start_ns: int
    end_ns: int
    counts: Mapping[int, int]
    cut: bool = False


class ChunkedFile(ABC):
    """What MCAP and ROS 1 bags have in common. A subclass finds the chunks and channels, and reads a chunk.

    Attributes:
        path: the file.
        cut: the file ends, or is damaged, before its end.
        losses: what could not be read so far.
        budget: for what is compressed in it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cut = False
        self.losses = Losses()
        self.budget = InflationBudget(path.stat().st_size)
        self.channels: dict[int, Channel] = {}
        self.chunks: list[Chunk] = []
        self._counts: Counter[int] = Counter()
        self._file = path.open("rb")
        try:
            self._open()
        except BaseException:
            self._file.close()
            raise
        unknown = 0
        for chunk in self.chunks:
            self._counts.update(chunk.counts)
            unknown += sum(count for key, count in chunk.counts.items() if key not in self.channels)
        if unknown:
            self.losses.add_messages((self.path, -1), "unknown topics", unknown, "their channel is lost")
        self.chunks = [chunk for chunk in self.chunks if chunk.end_ns >= chunk.start_ns]

    @property
    def start_ns(self) -> int:
        """Log time of the first message; 0 where there is none."""
        return min((chunk.start_ns for chunk in self.chunks), default=0)

    @property
    def end_ns(self) -> int:
        """Log time of the last message; 0 where there is none."""
        return max((chunk.end_ns for chunk in self.chunks), default=0)

    @property
    def counts(self) -> list[tuple[Channel, int]]:
        """The channels and their numbers of messages, those of damaged chunks included where an index tells."""
        return [(channel, self._counts[key]) for key, channel in self.channels.items()]

    def messages(self, topics: set[str], start_ns: int, end_ns: int, waiting: Waiting) -> Iterator[RawMessage]:
        """Messages with start_ns <= log time <= end_ns, in log-time order; ``waiting`` counts those that wait.

        Raises:
            BagError: messages are so far out of order that too many have to wait.
        """
        ids = {key: channel for key, channel in self.channels.items() if channel.topic in topics}
        # a chunk stays in the queue until its first message is due, then its messages replace it
        queue: list[tuple[int, int, int, Chunk | StoredMessage]] = [
            (chunk.start_ns, chunk.offset, -1, chunk)
            for chunk in self.chunks
            if chunk.start_ns <= end_ns and chunk.end_ns >= start_ns and ids.keys() & chunk.counts.keys()
        ]
        heapq.heapify(queue)
        while queue:
            log_time_ns, offset, index, item = heapq.heappop(queue)
            if isinstance(item, StoredMessage):
                waiting.remove(item)
                yield RawMessage(ids[item.channel], log_time_ns, item.data, (offset, index))
                continue
            for number, message in enumerate(self._messages_of(item, ids)):
                if start_ns <= message.log_time_ns <= end_ns:
                    heapq.heappush(queue, (message.log_time_ns, offset, number, message))
                    waiting.add(message)

    def by_topic(self, counts: Mapping[int, int]) -> Counter[str]:
        """Numbers of messages by topic instead of channel."""
        topics: Counter[str] = Counter()
        for key, count in counts.items():
            topics[self.channels[key].topic if key in self.channels else "unknown topics"] += count
        return topics

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @abstractmethod
    def _open(self) -> None:
        """Fills ``channels`` and ``chunks``, and sets ``cut``."""

    @abstractmethod
    def _read(self, chunk: Chunk, wanted: Container[int]) -> Iterator[StoredMessage]:
        """The messages of the wanted channels. Raises any Exception at damage, after the messages before it."""

    def _messages_of(self, chunk: Chunk, ids: Mapping[int, Channel]) -> list[StoredMessage]:
        """The messages of some channels in a chunk; none, and a loss, where it is damaged."""
        messages: list[StoredMessage] = []
        try:
            # the same messages whatever part of the bag is read: of channels in the counts, at times within the range
            for message in self._read(chunk, ids.keys() & chunk.counts.keys()):  # those before the damage remain
                log_time_ns = min(max(message.log_time_ns, chunk.start_ns), chunk.end_ns)
                messages.append(message._replace(log_time_ns=log_time_ns))
        except Exception as error:  # of the libraries that parse and decompress it, which have no common base class
            if not chunk.cut:
                self.losses.add_chunk((self.path, chunk.offset), self.by_topic(chunk.counts), cause_text(error))
                return []
        return messages
