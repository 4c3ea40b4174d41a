# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records serialized messages into a bag in a separate thread, so that the graph does not wait for the disk."""

from __future__ import annotations

import queue
import threading
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TypeAlias

from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.core.in_words import in_words

__all__ = ["Recorder"]

_QUEUE_SIZE = 64  # messages; about eight pairs with all their outputs
_Item: TypeAlias = tuple[str, str, bytes, int, None, bool]


class Recorder:
    """Writes into an MCAP bag while the ``with`` block lasts.

    :meth:`write` returns immediately while fewer than 64 messages wait, and waits for the disk otherwise. There is no
    bag when the block ends in an exception.

    Args:
        path: the bag to write; None records nothing.
        overwrite: replace an existing bag.

    Raises:
        OutputError: the bag exists and ``overwrite`` is false, or it cannot be created.
    """

    def __init__(self, path: Path | None, *, overwrite: bool = False) -> None:
        # lz4: zstd takes longer for a cloud than the matcher for its pair
        self._writer = BagWriter(path, compression="lz4", overwrite=overwrite) if path is not None else None
        self._queue: queue.Queue[_Item | None] = queue.Queue(_QUEUE_SIZE)
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)

    def __enter__(self) -> Recorder:
        if self._writer is not None:
            self._writer.__enter__()
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is None:
            return
        try:
            self._queue.put(None)
            self._thread.join()
        except BaseException:  # Ctrl-C while the last messages are written
            self._writer.discard()
            raise
        if self._error is not None and error is None:
            self._writer.__exit__(type(self._error), self._error, None)
            self._raise_error()
        self._writer.__exit__(kind, error, trace)

    def write(self, topic: str, msgtype: str, cdr: bytes, log_time_ns: int, latched: bool = False) -> None:
        """Hand a serialized message to the writing thread; ``latched`` as of the bag.

        Raises:
            OutputError: an earlier message could not be written.
        """
        if self._writer is not None:
            self._raise_error()
            self._queue.put((topic, msgtype, cdr, log_time_ns, None, latched))

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a record of names and values; call it before the first message."""
        if self._writer is not None:
            self._writer.write_metadata(name, values)

    def _run(self) -> None:
        assert self._writer is not None
        while (item := self._queue.get()) is not None:
            if self._error is None:  # after an error the queue is emptied, so that no writer waits for it
                try:
                    self._writer.write_raw(*item)
                except Exception as error:  # handed to the thread that records
                    self._error = error

    def _raise_error(self) -> None:
        if self._error is not None:
            raise OutputError(
                f"recording stopped: {in_words(self._error)}", remedy="free space on the disk"
            ) from self._error
