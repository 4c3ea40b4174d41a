# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A finding of the doctor: what was checked, what was found, and what to do."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from stereo_depth_ros.core.errors import StereoDepthError

__all__ = ["Finding", "Level", "is_wrong"]


class Level(enum.IntEnum):
    """Severity; the worst of a list is its maximum."""

    OK = 0
    SKIPPED = 1  # could not be checked
    WARNING = 2  # works, but worse than it could
    ERROR = 3  # no depth, or wrong depth


@dataclass(frozen=True)
class Finding:
    """A check and its outcome.

    Attributes:
        check: what was checked, in a few words.
        level: the severity.
        value: what was found.
        limit: what is expected.
        remedy: what to do; empty where there is nothing to do.
        figures: the numbers behind it, by name with unit.
        settings: values of parameters that the remedy asks for, by name.
    """

    check: str
    level: Level
    value: str
    limit: str = ""
    remedy: str = ""
    figures: Mapping[str, float | None] = field(default_factory=dict)
    settings: Mapping[str, bool | int | float] = field(default_factory=dict)

    @classmethod
    def refused(cls, check: str, error: StereoDepthError, limit: str = "", remedy: str = "") -> Finding:
        """An error of the package, about the subject that the check names; with a better remedy where there is one."""
        return cls(check, Level.ERROR, error.problem, limit, remedy or error.remedy)

    def to_json(self) -> dict[str, Any]:
        """For JSON; the level by its name."""
        return {
            "check": self.check,
            "level": self.level.name.lower(),
            "value": self.value,
            "limit": self.limit,
            "remedy": self.remedy,
            "figures": dict(self.figures),
            "settings": dict(self.settings),
        }


def is_wrong(findings: Iterable[Finding], *checks: str) -> bool:
    """Whether one of these checks found an error."""
    return any(finding.check in checks and finding.level is Level.ERROR for finding in findings)
