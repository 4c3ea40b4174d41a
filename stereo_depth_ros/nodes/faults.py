# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The faults of a node: which are present, and which of their reports are logged."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["FORGET_S", "HOLD_S", "MAX_FAULTS", "QUIET_S", "Faults"]

QUIET_S = 5.0  # a fault is logged at most once in this time
HOLD_S = 10.0  # a fault is present for this time after its last report, and for two of its intervals
FORGET_S = 60.0  # a fault that is reported less often than this has no interval
MAX_FAULTS = 16  # further ones share an entry
_MAX_TEXT = 500
_VALUE = re.compile(r"""'[^']*'|"[^"]*"|(?<![\w/])\d[\d.xe+-]*""")  # not the number in the name of a topic


@dataclass
class _Fault:
    text: str
    last_at: float
    logged_at: float
    interval_s: float = 0.0  # between its last two reports
    unlogged: int = 0


class Faults:
    """Faults by kind, in the order of their first reports; at most ``MAX_FAULTS`` and one for all others.

    Args:
        clock: seconds, monotonic.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._faults: dict[str, _Fault] = {}

    def report(self, kind: str, text: str) -> str:
        """Note that a fault has occurred.

        Args:
            kind: what it is and of what; numbers and quoted values in it make no difference.
            text: for the log.

        Returns:
            The line to log: the text, with the number of reports since the last line; empty if it is not yet due.
        """
        now = self._clock()
        self._faults = {key: fault for key, fault in self._faults.items() if now - fault.last_at < FORGET_S}
        key = _VALUE.sub("#", kind)[:_MAX_TEXT]
        if key not in self._faults and len(self._faults) >= MAX_FAULTS:
            key = ""
        fault = self._faults.get(key)
        if fault is None:
            self._faults[key] = _Fault(_short(text), now, now)
            return text
        fault.text, fault.interval_s, fault.last_at = _short(text), now - fault.last_at, now
        if now - fault.logged_at < QUIET_S:
            fault.unlogged += 1
            return ""
        more, fault.unlogged, fault.logged_at = fault.unlogged, 0, now
        return f"{text} ({more} more of this kind)" if more else text

    def present(self) -> list[str]:
        """The last text of every fault that lasts."""
        now = self._clock()
        return [
            fault.text for fault in self._faults.values() if now - fault.last_at < max(HOLD_S, 2 * fault.interval_s)
        ]


def _short(text: str) -> str:
    """The first line, not longer than fits into a status."""
    return text.partition("\n")[0][:_MAX_TEXT]
