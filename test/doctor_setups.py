# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the camera infos of a setup, and the findings by check."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.diagnosis.survey import StereoSetup
from stereo_depth_ros.diagnosis.verdict import Diagnosis

Change: TypeAlias = Callable[[Any], Any]
F64: TypeAlias = Any


def as_is(info: Any) -> Any:
    return info


def entries(name: str, change: Callable[[F64], F64]) -> Change:
    """Changes an array of a camera info."""
    return lambda info: replace(info, **{name: change(np.array(getattr(info, name), np.float64))})


def put(name: str, index: int, value: float) -> Change:
    return entries(name, lambda array: np.where(np.arange(array.size) == index, value, array))


def times(name: str, index: int, factor: float) -> Change:
    return entries(name, lambda array: np.where(np.arange(array.size) == index, factor * array, array))


def both(*changes: Change) -> Change:
    def change(info: Any) -> Any:
        for one in changes:
            info = one(info)
        return info

    return change


def scaled(factor: float) -> Change:
    """A calibration of another resolution, whose width and height are wrong."""
    k = np.repeat([factor, factor, 1.0], 3)
    p = np.repeat([factor, factor, 1.0], 4)
    return both(entries("k", lambda array: k * array), entries("p", lambda array: p * array))


def with_infos(setup: StereoSetup, left: Change = as_is, right: Change = as_is) -> StereoSetup:
    sides = ((setup.left, left), (setup.right, right))
    records = [replace(record, infos=[change(info) for info in record.infos]) for record, change in sides]
    return replace(setup, left=records[0], right=records[1])


def faults(diagnosis: Diagnosis) -> dict[str, Finding]:
    return {finding.check: finding for finding in diagnosis.findings if finding.level > Level.SKIPPED}


def all_of(diagnosis: Diagnosis) -> dict[str, Finding]:
    found = {finding.check: finding for finding in diagnosis.findings}
    assert len(found) == len(diagnosis.findings), "a check is reported twice"
    return found
