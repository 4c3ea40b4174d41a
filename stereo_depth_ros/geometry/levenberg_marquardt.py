# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Levenberg-Marquardt iteration: damping, acceptance of steps and stopping, for any least-squares problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from stereo_depth_ros.core.types import F64

__all__ = ["Iterate", "StopRules", "damped_step", "minimize"]

_FIRST_DAMPING, _FACTOR = 1e-3, 10.0

IterateT = TypeVar("IterateT", bound="Iterate")


class Iterate(Protocol):
    """Values of the parameters of a least-squares problem."""

    @property
    def cost(self) -> float:
        """Sum of squared residuals, weighted or robust, at these values."""

    def trial(self: IterateT, damping: float) -> IterateT:
        """The values after a step by the normal equations, their diagonal enlarged by the share ``damping``."""


@dataclass(frozen=True)
class StopRules:
    """When the iteration ends.

    Attributes:
        max_trials: number of steps, rejected ones included.
        tolerance: relative decrease of the cost at or below which a step has converged.
        converged_steps: number of accepted steps in a row that have to converge.
        max_damping: above it no smaller step is tried.
    """

    max_trials: int
    tolerance: float
    converged_steps: int
    max_damping: float


def minimize(start: IterateT, stop: StopRules) -> IterateT:
    """The values of least cost near the start (Levenberg 1944, Marquardt 1963).

    A step that raises the cost, or makes it NaN, is tried again with ten times the damping; a step that does not is
    kept, and the damping divided by ten.
    """
    best, damping, converged = start, _FIRST_DAMPING, 0
    for _ in range(stop.max_trials):
        trial = best.trial(damping)
        if not trial.cost <= best.cost:  # NaN too
            damping *= _FACTOR
            if damping > stop.max_damping:
                break
            continue
        converged = converged + 1 if best.cost - trial.cost <= stop.tolerance * best.cost else 0
        best, damping = trial, damping / _FACTOR
        if converged == stop.converged_steps:
            break
    return best


def damped_step(normal: F64, gradient: F64, damping: float) -> F64:
    """Step of the parameters, float64 (P,), from J^T J, float64 (P, P), and J^T r, float64 (P,)."""
    damped = normal + damping * np.diag(normal.diagonal())
    return np.asarray(np.linalg.lstsq(damped, -gradient, rcond=None)[0], np.float64)
