# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One line of what the doctor says: what was looked at, what was found, and what to do."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["Finding", "Level", "is_wrong"]


class Level(enum.IntEnum):
    """How bad it is; the worst of a list is its maximum."""

    OK = 0
    LEFT_OUT = 1  # could not be looked at
    WARNING = 2  # works, but worse than it could
    ERROR = 3  # no depth, or wrong depth


@dataclass(frozen=True)
class Finding:
    """A check and its outcome.

    Attributes:
        check: what was looked at, a few words.
        level: the verdict.
        value: what was found.
        limit: what it is held against.
        remedy: what to do; empty where there is nothing to do.
        figures: the numbers of it, by name with the unit behind.
    """

    check: str
    level: Level
    value: str
    limit: str = ""
    remedy: str = ""
    figures: Mapping[str, float | None] = field(default_factory=dict)

    @classmethod
    def refused(cls, check: str, error: Exception, label: str = "", limit: str = "", remedy: str = "") -> Finding:
        """An error of the package, whose message is "label: value: remedy".

        Args:
            label: what the message begins with, left out here.
            remedy: a better one than the message's own.
        """
        value, _, own_remedy = str(error).removeprefix(f"{label}: ").rpartition(": ")
        return cls(check, Level.ERROR, value, limit, remedy or own_remedy)

    def to_json(self) -> dict[str, Any]:
        """For JSON; the level by its name."""
        return {
            "check": self.check,
            "level": self.level.name.lower(),
            "value": self.value,
            "limit": self.limit,
            "remedy": self.remedy,
            "figures": dict(self.figures),
        }


def is_wrong(findings: Iterable[Finding], *checks: str) -> bool:
    """Whether one of these checks found an error."""
    return any(finding.check in checks and finding.level is Level.ERROR for finding in findings)
