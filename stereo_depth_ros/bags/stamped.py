# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag with their header stamps; those whose stamp cannot be are left out and counted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from stereo_depth_ros.bags.reader import BagMessage
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.messages.cdr import cdr_stamp_ns

__all__ = ["StampedMessages"]


class StampedMessages:
    """Reads stamps, and notes the messages that have none.

    Attributes:
        left_out: messages so far.
        first: why the first of them is left out; None while there is none.
    """

    def __init__(self) -> None:
        self.left_out = 0
        self.first: MessageError | None = None

    def read(self, messages: Iterable[BagMessage]) -> Iterator[tuple[int, BagMessage]]:
        """Stamp, integer nanoseconds, and message of all that have one."""
        for message in messages:
            try:
                stamp_ns = cdr_stamp_ns(message.data)
            except MessageError as error:
                self.left_out += 1
                self.first = self.first or error.about(message.topic)
            else:
                yield stamp_ns, message

    @property
    def error(self) -> MessageError | None:
        """How many messages are left out and why the first one is; None where none are."""
        if self.first is None:
            return None
        return MessageError(
            f"{self.left_out} messages are left out, the first one is of {self.first.subject}: {self.first.problem}",
            value=self.left_out,
            limit=0,
            remedy=self.first.remedy,
        )
