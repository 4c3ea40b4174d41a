# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Text from messages and files as a terminal or a log may show it: without control characters."""

from __future__ import annotations

__all__ = ["printable"]


def printable(text: object) -> str:
    r"""The text, each character that is not printable as its escape: ESC as ``\x1b``, a line feed as ``\n``.

    Names in bags, files and messages may hold what a terminal obeys: escape sequences, carriage returns, characters
    that reverse the direction of writing. Printable is what :meth:`str.isprintable` says.
    """
    shown = str(text)
    return shown if shown.isprintable() else "".join(map(_shown, shown))


def _shown(character: str) -> str:
    return character if character.isprintable() else character.encode("unicode_escape").decode()
