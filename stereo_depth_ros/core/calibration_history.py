# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which camera infos apply to a pair: those of its stamps, also while the calibration changes."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

__all__ = ["CalibrationHistory"]

T = TypeVar("T")
_MOST_CHANGES = 100  # of one camera; a lens that zooms changes with every image
_SETTLE_NS = 10**9
_KEPT_STAMPS = 200


class CalibrationHistory(Generic[T]):
    """The different camera infos of both cameras, by stamp; sides are 0 (left) and 1 (right).

    To an image applies the camera info of its stamp, else the newest one before it, else the last one received. So does
    the last one where camera infos are not stamped (stamp 0, or always the same), from its arrival on. Not thread-safe.
    """

    def __init__(self) -> None:
        self._sides: tuple[_Side[T], _Side[T]] = (_Side(), _Side())

    def add(self, side: int, stamp_ns: int, contents: Hashable, info: T) -> bool:
        """Add a camera info, in the order of arrival.

        Args:
            side: of the camera.
            stamp_ns: of its header.
            contents: all of it but the stamp.
            info: what :meth:`at` returns.

        Returns:
            Whether its contents are not those that applied to its stamp so far.
        """
        return self._sides[side].add(stamp_ns, contents, info)

    def last_ns(self, side: int) -> int | None:
        """Stamp of the camera info received last; None before the first one."""
        return self._sides[side].last_ns

    @property
    def is_known(self) -> bool:
        """Whether both cameras have one."""
        return all(side.last_ns is not None for side in self._sides)

    def at(self, stamps_ns: tuple[int, int]) -> tuple[T, T]:
        """The camera infos of a pair by the stamps of its images, once both are known."""
        left, right = (side.at(stamp_ns).info for side, stamp_ns in zip(self._sides, stamps_ns, strict=True))
        return left, right

    def lacks(self, stamps_ns: tuple[int, int]) -> bool:
        """Whether a camera info of these stamps may still come: later than the last one, or between different ones."""
        return any(side.lacks(stamp_ns) for side, stamp_ns in zip(self._sides, stamps_ns, strict=True))

    def has_own(self, stamps_ns: tuple[int, int]) -> bool:
        """Whether camera infos of exactly these stamps were added; true too for a camera whose infos have no stamps."""
        return all(side.has_own(stamp_ns) for side, stamp_ns in zip(self._sides, stamps_ns, strict=True))

    def is_changing(self, stamps_ns: tuple[int, int]) -> bool:
        """Whether a calibration has changed less than a second before these stamps, or after them."""
        return any(side.changed_since(min(stamps_ns) - _SETTLE_NS) for side in self._sides)


@dataclass
class _Change(Generic[T]):
    """Equal camera infos, one after the other."""

    first_ns: int
    last_ns: int
    contents: Hashable
    info: T


class _Side(Generic[T]):
    """Camera infos of one camera that differ from the one before, by stamp."""

    def __init__(self) -> None:
        self._changes: list[_Change[T]] = []
        self.last_ns: int | None = None
        self._stamps_ns: deque[int] = deque(maxlen=_KEPT_STAMPS)  # different ones, in the order of arrival

    def add(self, stamp_ns: int, contents: Hashable, info: T) -> bool:
        self.last_ns = stamp_ns
        if stamp_ns not in self._stamps_ns:
            self._stamps_ns.append(stamp_ns)
        if self._changes:
            applied = self.at(stamp_ns)
            if applied.contents == contents:
                applied.last_ns = max(applied.last_ns, stamp_ns)
                return False
            if self._changes[-1].last_ns - stamp_ns > _SETTLE_NS:
                self._forget_after(stamp_ns)
        self._insert(_Change(stamp_ns, stamp_ns, contents, info))
        del self._changes[:-_MOST_CHANGES]
        return True

    def at(self, stamp_ns: int) -> _Change[T]:
        return self._changes[self._begun(stamp_ns) - 1]

    def lacks(self, stamp_ns: int) -> bool:
        if self.last_ns is None or self.last_ns < stamp_ns:
            return True
        begun = self._begun(stamp_ns)
        # Of two cameras on one topic, the camera infos of one may come sooner
        return 0 < begun < len(self._changes) and self._changes[begun - 1].last_ns < stamp_ns

    def has_own(self, stamp_ns: int) -> bool:
        return stamp_ns in self._stamps_ns or len(self._stamps_ns) == 1

    def changed_since(self, stamp_ns: int) -> bool:
        return len(self._changes) > 1 and self._changes[-1].first_ns > stamp_ns

    def _begun(self, stamp_ns: int) -> int:
        """How many begin at this stamp or before it."""
        later = (at for at in range(len(self._changes), 0, -1) if self._changes[at - 1].first_ns <= stamp_ns)
        return next(later, 0)

    def _forget_after(self, stamp_ns: int) -> None:
        """What is of another clock."""
        del self._changes[self._begun(stamp_ns) :]
        if self._changes:
            self._changes[-1].last_ns = min(self._changes[-1].last_ns, stamp_ns)

    def _insert(self, change: _Change[T]) -> None:
        """A camera info of one stamp, where others apply before and after it."""
        stamp_ns, begun = change.first_ns, self._begun(change.first_ns)
        changes = [change]
        if begun:
            before = self._changes[begun - 1]
            if before.last_ns > stamp_ns:
                changes.append(_Change(stamp_ns + 1, before.last_ns, before.contents, before.info))
            before.last_ns = min(before.last_ns, stamp_ns - 1)
            if before.last_ns < before.first_ns:
                begun -= 1
                del self._changes[begun]
        self._changes[begun:begun] = changes
