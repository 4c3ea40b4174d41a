# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads bags without ROS: MCAP (also cut), rosbag2 folders, bare sqlite3 files, ROS 1 bags."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.recovery import RecoveredMcap
from stereo_depth_ros.bags.sources import open_sources
from stereo_depth_ros.core.errors import BagError, MessageError

__all__ = ["BagMessage", "BagReader", "TopicInfo"]


@dataclass(frozen=True)
class TopicInfo:
    """Message type (``package/msg/Name``, empty where the bag lacks it) and number of messages of a topic."""

    msgtype: str
    count: int


@dataclass(frozen=True)
class BagMessage:
    """One serialized message: topic, message type, log time and CDR bytes."""

    topic: str
    msgtype: str
    log_time_ns: int
    data: bytes


class BagReader:
    """An open bag: topics, time span and messages.

    Args:
        path: an ``.mcap``, ``.db3`` or ROS 1 ``.bag`` file, or a rosbag2 folder, with or without ``metadata.yaml``.

    Attributes:
        topics: type and number of messages per topic.
        start_ns, end_ns: log times of the first and the last message.
        truncated: a file of the bag is cut; only the messages before the cut are read.

    Raises:
        BagError: the path does not exist, is not a bag, is empty, or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._types = RosbagsTypes()
        with ExitStack() as stack:
            self._sources = open_sources(path, self._types, stack)
            self.topics = self._merge_topics()
            self.truncated = any(isinstance(source, RecoveredMcap) and source.cut for source in self._sources)
            filled = [source for source in self._sources if any(count for _, count in source.topics.values())]
            if not filled:
                raise BagError(
                    f"holds no messages{' before the cut' * self.truncated}",
                    subject=str(path),
                    remedy="record it again",
                )
            self.start_ns = min(source.start_ns for source in filled)
            self.end_ns = max(source.end_ns for source in filled)
            self._files = stack.pop_all()

    @property
    def warning(self) -> str:
        """One sentence about a bag that is cut; empty where it is complete."""
        count = sum(info.count for info in self.topics.values())
        return f"{self.path} is cut in the middle: the {count} messages before the cut are read" * self.truncated

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
        start = self.start_ns if start_ns is None else start_ns
        end = self.end_ns if end_ns is None else end_ns
        streams = [source.messages(wanted, start, end) for source in self._sources]
        return self._read(heapq.merge(*streams, key=lambda item: item[1]))

    def deserialize(self, message: BagMessage) -> Any:
        """The message as a rosbags object.

        Raises:
            MessageError: a type that ROS 2 Jazzy does not have, or bytes that are not a message of this type.
        """
        try:
            return self._types.deserialize(message.data, message.msgtype)
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

    def _read(self, items: Iterator[tuple[str, int, bytes]]) -> Iterator[BagMessage]:
        try:
            for topic, log_time_ns, data in items:
                yield BagMessage(topic, self.topics[topic].msgtype, log_time_ns, data)
        except BagError:
            raise
        except Exception as error:  # those of rosbags and of what it reads with have no common base class
            raise BagError(f"is damaged ({error})", subject=str(self.path), remedy="record or copy it again") from error

    def _merge_topics(self) -> dict[str, TopicInfo]:
        topics: dict[str, TopicInfo] = {}
        for source in self._sources:
            for name, (msgtype, count) in source.topics.items():
                known = topics.get(name, TopicInfo("", 0))
                topics[name] = TopicInfo(_full_type_name(msgtype) or known.msgtype, count + known.count)
        return dict(sorted(topics.items()))


def _full_type_name(msgtype: str) -> str:
    """``package/msg/Name`` for the ``package/Name`` of the first ROS 2 bags."""
    package, _, name = msgtype.partition("/")
    return f"{package}/msg/{name}" if name and "/" not in name else msgtype
