# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What could not be read of a file of a bag: its damaged chunks and messages, counted by topic."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Set

from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.core.quoted import quoted

__all__ = ["Losses", "cause_text"]

_MOST_TOPICS, _LONGEST_NAME = 10, 80  # in a sentence


class Losses:
    """Grows while a file is read; each chunk and message counts once, however often it is read.

    Causes are texts: an error would keep what was inflated in memory, by its traceback.
    """

    def __init__(self) -> None:
        self._chunks: dict[Hashable, Mapping[str, int]] = {}
        self._messages: dict[Hashable, tuple[str, int]] = {}
        self._cause = ""

    def __bool__(self) -> bool:
        return bool(self._chunks or self._messages)

    def add_chunk(self, place: Hashable, messages: Mapping[str, int], cause: str) -> None:
        """A chunk that cannot be read; ``messages`` are its messages by topic, empty where no index tells."""
        self._cause = self._cause or cause
        self._chunks[place] = messages

    def add_messages(self, place: Hashable, topic: str, count: int, cause: str) -> None:
        """Messages of a topic that cannot be read."""
        self._cause = self._cause or cause
        self._messages[place] = topic, count

    def may_hold(self, topics: Set[str]) -> bool:
        """Whether messages of some topics may be lost."""
        chunks = self._chunks.values()
        return any(topic in topics for topic, _ in self._messages.values()) or any(
            not messages or topics & messages.keys() for messages in chunks
        )

    @staticmethod
    def sentence(files: Iterable[Losses]) -> str:
        """What is lost in the files of a bag: "2 chunks are damaged (...): 7 messages are lost, /a 4, /b 3"."""
        losses = [found for found in files if found]
        topics: Counter[str] = Counter()
        chunks, unknown = 0, 0
        for found in losses:
            chunks += len(found._chunks)
            unknown += sum(not messages for messages in found._chunks.values())
            for topic, count in found._messages.values():
                topics[topic] += count
            for messages in found._chunks.values():
                topics.update(messages)
        if not losses:
            return ""
        counts = [f"{_name(topic)} {count}" for topic, count in sorted(topics.items())[:_MOST_TOPICS]]
        if len(topics) > _MOST_TOPICS:
            counts.append(f"and of {len(topics) - _MOST_TOPICS} more topics")
        total = sum(topics.values())
        lost = f"{total} {'message is' if total == 1 else 'messages are'} lost, {', '.join(counts)}" if total else ""
        if not chunks:
            return f"{lost} ({losses[0]._cause})"
        if unknown:
            more = f"{lost}, and those of {unknown} of the chunks" if lost else "the messages are lost"
            lost = f"{more}, how many is not known"
        return f"{chunks} {'chunk is' if chunks == 1 else 'chunks are'} damaged ({losses[0]._cause}): {lost}"


def _name(topic: str) -> str:
    """A topic as it is, or in quotes where its name is not one of ROS."""
    return topic if len(topic) <= _LONGEST_NAME and topic.isprintable() else quoted(topic)


def cause_text(error: Exception) -> str:
    """What an error says, in one line: its problem, or its text where it is about the data."""
    if isinstance(error, UnicodeDecodeError):
        return "a text in it is not UTF-8"
    if isinstance(error, KeyError):
        return "a field of it is missing"
    if isinstance(error, RecursionError):
        return "it is nested too deep"
    if isinstance(error, (struct.error, IndexError, EOFError)):
        return "a number in it is cut"
    if isinstance(error, (AssertionError, AttributeError, TypeError, MemoryError)):  # of libraries, about themselves
        return "it is damaged"
    text = error.problem if isinstance(error, StereoDepthError) else str(error)
    return " ".join(text.split()).rstrip(".")[:200] or "it is damaged"
