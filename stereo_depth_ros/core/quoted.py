# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Text from messages and files as an error quotes it: on one line, and no longer than a line."""

from __future__ import annotations

from stereo_depth_ros.core.in_words import kind_in_words

__all__ = ["quoted"]

_LONGEST = 80  # characters
_LONGEST_BITS = 256  # of an integer, of which Python shows 4300 digits and raises ValueError for more


def quoted(value: object) -> str:
    """A text in quotes, control characters escaped; of a long one the beginning and how long it is."""
    if isinstance(value, str):
        return repr(value) if len(value) <= _LONGEST else f"{value[:_LONGEST]!r}... ({len(value)} characters)"
    if isinstance(value, int) and value.bit_length() > _LONGEST_BITS:
        return f"a number of {value.bit_length()} bits"
    shown = repr(value)
    return shown if len(shown) <= _LONGEST else f"{shown[:_LONGEST]}... ({kind_in_words(type(value))})"
