# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of plain data, such as that of a YAML file; the errors name the value that is something else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64

__all__ = ["MAX_SIZE_PX", "entry", "number", "numbers", "whole"]

MAX_SIZE_PX = 65535  # of an image in a calibration file
_MOST_NUMBERS = 10_000


def entry(values: Any, *keys: str) -> Any:
    """The value at a path of keys.

    Raises:
        CalibrationError: one of the keys is missing, or what should hold it is not a mapping.
    """
    for at, key in enumerate(keys):
        if not isinstance(values, Mapping) or key not in values:
            raise CalibrationError(f"lacks the key {'.'.join(keys[: at + 1])!r}", value=key, remedy="write it again")
        values = values[key]
    return values


def number(value: Any, name: str) -> float:
    """A finite number.

    Raises:
        CalibrationError: something else.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise CalibrationError(
            f"a value is not a number ({name}: {_shown(value)})", value=value, limit="a number", remedy="write numbers"
        )
    return float(value)


def numbers(value: Any, name: str, *counts: int) -> F64:
    """float64 (n,): the finite numbers of a list, or of nested lists row by row.

    Args:
        value: the list.
        name: of the value, for errors.
        counts: how many there may be; any number by default.

    Raises:
        CalibrationError: something else, or another count.
    """
    flat: list[float] = []
    waiting = [value]
    while waiting:
        item = waiting.pop()
        if isinstance(item, list):
            waiting.extend(reversed(item))
        else:
            flat.append(number(item, name))
        if len(flat) + len(waiting) > _MOST_NUMBERS:
            raise CalibrationError(f"{name} holds more than {_MOST_NUMBERS} values", remedy="write a matrix")
    if counts and len(flat) not in counts:
        raise CalibrationError(
            f"{name} has {len(flat)} values, not {' or '.join(map(str, counts))}",
            value=len(flat),
            limit=counts,
            remedy="write all of them",
        )
    return np.array(flat, np.float64)


def whole(value: Any, name: str, low: int = 1, high: int = MAX_SIZE_PX) -> int:
    """A whole number of ``low`` to ``high``, which may be written as 640.0.

    Raises:
        CalibrationError: something else.
    """
    found = number(value, name)
    if not low <= found <= high or found != int(found):
        raise CalibrationError(
            f"{name} = {_shown(value)} is not a whole number of {low} to {high}",
            value=value,
            limit=(low, high),
            remedy="write the size in pixels",
        )
    return int(found)


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, (list, Mapping)):
        return "a list" if isinstance(value, list) else "a mapping"
    return quoted(value)
