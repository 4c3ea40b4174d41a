# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads bags without ROS: MCAP, rosbag2 folders, bare sqlite3 files, ROS 1 bags, also cut and damaged ones."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any

from stereo_depth_ros.bags.chunked_file import Waiting
from stereo_depth_ros.bags.conversion import check_convertible, message_type, stored_type, to_cdr
from stereo_depth_ros.bags.losses import Losses, cause_text
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.sources import BagSource, open_sources
from stereo_depth_ros.core.errors import BagError, MessageError

__all__ = ["BagMessage", "BagReader", "TopicInfo"]


@dataclass(frozen=True)
class TopicInfo:
    """A topic of a bag.

    Attributes:
        msgtype: message type as it is read, ``package/msg/Name``; empty where the bag lacks it.
        count: number of messages, those that are lost included where an index tells.
        stored: message type as it is stored, with its encoding where that is none of ROS; empty where it is the same.
    """

    msgtype: str
    count: int
    stored: str = ""


@dataclass(frozen=True)
class BagMessage:
    """One serialized message: topic, message type, log time and CDR bytes."""

    topic: str
    msgtype: str
    log_time_ns: int
    data: bytes


class BagReader:
    """An open bag: topics, time span and messages.

    Messages that are compressed each, those of ROS 1, and Foxglove's images and calibrations are read as CDR bytes of
    sensor_msgs. What is damaged is left out and counted: a chunk, a message, a page, a file of several.

    Args:
        path: an ``.mcap``, ``.db3`` or ROS 1 ``.bag`` file, or a rosbag2 folder, with or without ``metadata.yaml``.

    Attributes:
        topics: type and number of messages per topic.
        types: deserializes messages.
        start_ns, end_ns: log times of the first and the last message.
        truncated: a file of the bag is cut; only the messages before the cut are read.

    Raises:
        BagError: the path does not exist, is not a bag, is empty, or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.types = RosbagsTypes()
        with ExitStack() as stack:
            self._sources, self._notes = open_sources(path, stack)
            self.topics = self._merge_topics()
            self.truncated = any(source.cut for source in self._sources)
            filled = [source for source in self._sources if any(count for _, count in source.counts)]
            if not filled:
                lost = self._lost
                raise BagError(
                    f"holds no messages{' before the cut' * self.truncated}{f', {lost}' * bool(lost)}",
                    subject=str(path),
                    remedy="record it again",
                )
            self.start_ns = min(source.start_ns for source in filled)
            self.end_ns = max(source.end_ns for source in filled)
            self._files = stack.pop_all()

    @property
    def warning(self) -> str:
        """What of the bag could not be read so far: it is cut, or damaged; empty where nothing is missing."""
        parts = []
        if self.truncated:
            count = sum(info.count for info in self.topics.values())
            parts.append(f"is cut in the middle: the {count} messages before the cut are read")
        if lost := self._lost:
            parts.append(f"is damaged: {lost}")
        parts += self._notes
        return f"{self.path} {'; '.join(parts)}" if parts else ""

    @property
    def msgtypes(self) -> dict[str, str]:
        """Message type per topic."""
        return {name: info.msgtype for name, info in self.topics.items()}

    def messages(
        self, topics: Iterable[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Messages with start_ns <= log time <= end_ns, in the order of their log times.

        Args:
            topics: topics to read; None reads all.
            start_ns, end_ns: first and last log time, both included; None sets no limit.

        Raises:
            BagError: a topic is not in the bag, or the bag is damaged where it is read.
        """
        wanted = set(self.topics if topics is None else topics)
        if missing := wanted - set(self.topics):
            raise BagError(
                f"has no topic {', '.join(sorted(missing))}",
                subject=str(self.path),
                value=sorted(missing),
                limit=list(self.topics),
                remedy=f"choose among {', '.join(self.topics)}",
            )
        # without limits also those whose log times are damaged
        start = -(2**64) if start_ns is None else start_ns
        end = 2**64 if end_ns is None else end_ns
        waiting = Waiting()
        streams = [self._read(source, wanted, start, end, waiting) for source in self._sources]
        return self._found(wanted, heapq.merge(*streams, key=itemgetter(0)))

    def deserialize(self, message: BagMessage) -> Any:
        """The message as a rosbags object.

        Raises:
            MessageError: a type that ROS 2 Jazzy does not have, or bytes that are not a message of this type.
        """
        try:
            return self.types.deserialize(message.data, message.msgtype)
        except MessageError as error:
            raise error.about(f"{self.path}, {message.topic} at {message.log_time_ns} ns") from error

    def close(self) -> None:
        """Close all files."""
        self._files.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def _lost(self) -> str:
        return Losses.sentence(source.losses for source in self._sources)

    def _read(
        self, source: BagSource, topics: set[str], start_ns: int, end_ns: int, waiting: Waiting
    ) -> Iterator[tuple[int, BagMessage | None]]:
        """Log times and messages of a file, converted; one that is damaged is left out and counted.

        The first item is only the time at which they begin: chunks of all files of a long bag do not fit into memory.
        """
        for channel, _ in source.counts:
            if channel.topic in topics:
                check_convertible(self.types, channel)
        yield source.start_ns, None
        for message in source.messages(topics, start_ns, end_ns, waiting):
            channel = message.channel
            try:
                cdr = to_cdr(self.types, message, source.budget)
            except Exception as error:  # those of the libraries that parse it have no common base class
                source.losses.add_messages((source.path, *message.place), channel.topic, 1, cause_text(error))
            else:
                found = BagMessage(channel.topic, message_type(channel), message.log_time_ns, cdr)
                yield message.log_time_ns, found

    def _found(self, topics: set[str], items: Iterator[tuple[int, BagMessage | None]]) -> Iterator[BagMessage]:
        """The messages; an error where damage has left none."""
        is_empty = True
        try:
            for _, message in items:
                if message is not None:
                    is_empty = False
                    yield message
        except BagError as error:
            raise error.about(self.path) from error
        except Exception as error:  # those of the libraries that parse it have no common base class
            problem = f"is damaged ({cause_text(error)})"
            raise BagError(problem, subject=str(self.path), remedy="record or copy it again") from error
        if is_empty and any(source.losses.may_hold(topics) for source in self._sources):
            raise BagError(f"is damaged: {self._lost}", subject=str(self.path), remedy="record or copy it again")

    def _merge_topics(self) -> dict[str, TopicInfo]:
        topics: dict[str, TopicInfo] = {}
        for source in self._sources:
            for channel, count in source.counts:
                known = topics.get(channel.topic, TopicInfo("", 0))
                msgtype, stored = message_type(channel), stored_type(channel)
                topics[channel.topic] = TopicInfo(
                    msgtype or known.msgtype, count + known.count, stored if stored != msgtype else known.stored
                )
        return dict(sorted(topics.items()))
