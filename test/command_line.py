# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Types of the fixture `command_line`, which runs `stereo-depth` in the process of the tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

# arguments to exit code, stdout and stderr
Run: TypeAlias = Callable[..., tuple[int, str, str]]


class CommandLine(Protocol):
    """Makes a :data:`Run`."""

    def __call__(self, *command: str, columns: int | None = None) -> Run:
        """Of a subcommand, or of `stereo-depth` itself; ``columns`` is the width of the terminal."""
