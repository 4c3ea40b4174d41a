# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What comes before and after a long step, each in a thread beside it: items read ahead, items written behind."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from types import TracebackType
from typing import Generic, TypeVar

__all__ = ["ReadAhead", "WriteBehind"]

T = TypeVar("T")


class ReadAhead(Generic[T]):
    """Runs an iterable in a thread of its own, a few items ahead; to be used in a ``with`` block, which ends it.

    Args:
        items: iterated over in the thread only.
        limit: most items that wait, at least 1; one more may be under way.
        name: of the thread.
    """

    def __init__(self, items: Iterable[T], limit: int, name: str) -> None:
        self._queue: _Queue[T] = _Queue(limit)
        self._thread = threading.Thread(target=self._read, args=(items,), name=name, daemon=True)

    def __iter__(self) -> Iterator[T]:
        """The items in order.

        Raises:
            BaseException: what the iterable raises, after the items before it.
        """
        return self._queue.items()

    def __enter__(self) -> ReadAhead[T]:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._queue.abandon()
        self._thread.join()

    def _read(self, items: Iterable[T]) -> None:
        try:
            for item in items:
                if not self._queue.put(item):
                    return
        except BaseException as error:  # whoever takes the items raises it
            self._queue.end(error)
        else:
            self._queue.end()


class WriteBehind(Generic[T]):
    """Calls a function with items, in order, in a thread of its own; to be used in a ``with`` block.

    The block waits for the items that are under way, unless it ends in an exception: then those that wait are dropped.

    Args:
        write: called in the thread only. After it has raised, it is not called again.
        limit: most items that wait, at least 1; :meth:`put` waits where there are as many.
        name: of the thread.
    """

    def __init__(self, write: Callable[[T], None], limit: int, name: str) -> None:
        self._queue: _Queue[T] = _Queue(limit)
        self._write = write
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def put(self, item: T) -> None:
        """Add an item.

        Raises:
            BaseException: what the function raised at an earlier one.
        """
        if not self._queue.put(item):
            self.finish()

    def finish(self) -> None:
        """Wait until all items are written; none may be added afterwards.

        Raises:
            BaseException: what the function raised.
        """
        self._queue.end()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def __enter__(self) -> WriteBehind[T]:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()
        else:
            self._queue.abandon()
            self._thread.join()

    def _run(self) -> None:
        try:
            for item in self._queue.items():
                self._write(item)
        except BaseException as error:  # put and finish raise it
            self._error = error
            self._queue.abandon()


class _Queue(Generic[T]):
    """A bounded queue from one thread to another, which either of them may end."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._items: deque[T] = deque()
        self._changed = threading.Condition()
        self._ended = self._abandoned = False
        self._error: BaseException | None = None

    def put(self, item: T) -> bool:
        """Add an item when there is room; False where none is taken any more."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._items) < self._limit or self._abandoned)
            if self._abandoned:
                return False
            self._items.append(item)
            self._changed.notify_all()
            return True

    def items(self) -> Iterator[T]:
        """The items until the end, where the error of :meth:`end` is raised."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._items or self._ended or self._abandoned)
                if self._abandoned or not self._items:
                    break
                item = self._items.popleft()
                self._changed.notify_all()
            yield item
            del item  # it may hold images
        if self._error is not None and not self._abandoned:
            raise self._error

    def end(self, error: BaseException | None = None) -> None:
        """No more items come."""
        with self._changed:
            self._ended, self._error = True, error
            self._changed.notify_all()

    def abandon(self) -> None:
        """No more items are taken: those that wait are dropped."""
        with self._changed:
            self._abandoned = True
            self._items.clear()
            self._changed.notify_all()
