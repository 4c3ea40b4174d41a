# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzing: whatever a message, a file or an argument holds, it works or is refused in one sentence with a remedy."""

from __future__ import annotations

from typing import Any

import pytest
from fuzz_targets import TARGETS, Target, run_case
from hypothesis import HealthCheck, given, settings

ROUNDS = 4  # all targets together take half a minute; benchmarks/fuzz.py runs for a given time


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_what_failed_once(target: Target) -> None:
    for case in target.known:
        run_case(target, case)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_random_cases(target: Target) -> None:
    """The same ones in each run."""

    @settings(
        max_examples=ROUNDS * target.examples,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(target.cases)
    def run(case: Any) -> None:
        run_case(target, case)

    run()
