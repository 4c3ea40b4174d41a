# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Levenberg-Marquardt iteration, by problems whose minimum is known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.levenberg_marquardt import StopRules, damped_step, minimize

STOP = StopRules(max_trials=100, tolerance=1e-12, converged_steps=1, max_damping=1e12)


@dataclass(frozen=True, eq=False)
class Rosenbrock:
    """Residuals 10 (y - x^2) and 1 - x: one minimum, of cost 0, at (1, 1)."""

    x: F64
    dampings: list[float] = field(default_factory=list)

    @property
    def residuals(self) -> F64:
        return np.array([10 * (self.x[1] - self.x[0] ** 2), 1 - self.x[0]])

    @property
    def cost(self) -> float:
        return float(self.residuals @ self.residuals)

    def trial(self, damping: float) -> Rosenbrock:
        self.dampings.append(damping)
        J = np.array([[-20 * self.x[0], 10.0], [-1.0, 0.0]])
        return Rosenbrock(self.x + damped_step(J.T @ J, J.T @ self.residuals, damping), self.dampings)


@dataclass(frozen=True)
class Scripted:
    """Costs of the trials in turn, whatever the damping."""

    cost: float
    costs: list[float]
    dampings: list[float]

    def trial(self, damping: float) -> Scripted:
        self.dampings.append(damping)
        return Scripted(self.costs[len(self.dampings) - 1], self.costs, self.dampings)


def scripted(*costs: float, **rules: float) -> tuple[float, list[float]]:
    """The cost that 100 ends at by trials of these costs, and the dampings tried."""
    stop = {"max_trials": len(costs), "tolerance": 0.01, "converged_steps": 1, "max_damping": 1e12, **rules}
    dampings: list[float] = []
    return minimize(Scripted(100.0, list(costs), dampings), StopRules(**stop)).cost, dampings  # type: ignore[arg-type]


def test_curved_valley() -> None:
    start = Rosenbrock(np.array([-1.2, 1.0]))
    found = minimize(start, STOP)
    np.testing.assert_allclose(found.x, (1.0, 1.0), atol=1e-9)
    # The undamped first step raises the cost: some trials are rejected
    assert max(found.dampings) > 1e-3 > min(found.dampings)


def test_damped_step_of_a_linear_problem() -> None:
    """Without damping the minimum itself; with much, down the gradient over the damped diagonal."""
    J, target = np.array([[1.0, 2.0], [0.0, 3.0], [4.0, 1.0]]), np.array([0.7, -1.3])
    normal, gradient = J.T @ J, J.T @ (J @ -target)
    np.testing.assert_allclose(damped_step(normal, gradient, 0.0), target, atol=1e-12)
    np.testing.assert_allclose(damped_step(normal, gradient, 1e9), -gradient / (1e9 * np.diag(normal)), rtol=1e-6)


def test_rejected_trials_raise_the_damping_and_change_nothing() -> None:
    cost, dampings = scripted(101.0, float("nan"), 50.0, 20.0)
    assert cost == 20.0
    assert dampings == pytest.approx([1e-3, 1e-2, 1e-1, 1e-2])


def test_stop_rules() -> None:
    assert scripted(50.0, 49.9, 10.0) == (49.9, pytest.approx([1e-3, 1e-4]))
    assert scripted(50.0, 49.9, 49.8, 10.0, converged_steps=2)[0] == 49.8
    assert scripted(50.0, 49.9, 30.0, 29.9, 29.8, 1.0, converged_steps=2)[0] == 29.8, "in a row"
    assert scripted(50.0, 20.0, 1.0, max_trials=2)[0] == 20.0
    assert scripted(101.0, 101.0, 101.0, 1.0, max_damping=0.5) == (100.0, pytest.approx([1e-3, 1e-2, 1e-1]))
