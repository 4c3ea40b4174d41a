# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Graph cuts: energy minimization by alpha-expansion."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.matching.global_methods.energy import I32, StereoModel, energy
from stereo_depth_ros.matching.global_methods.global_matcher import GlobalMatcher

__all__ = ["GraphCutMatcher"]

CYCLES = 4  # through all disparities; few moves remain after two
TO_RIGHT = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 0]])
TO_BELOW = np.array([[0, 0, 0], [0, 0, 0], [0, 1, 0]])


class GraphCutMatcher(GlobalMatcher):
    """Alpha-expansion (Boykov, Veksler and Zabih 2001) on the energy of ``energy.py``.

    An expansion move lets every pixel keep its disparity or change to one other, alpha. The optimal move is a minimum
    cut (the graph of Kolmogorov and Zabih 2004, without auxiliary nodes; it exists because the penalty is a metric).
    Starting from the disparities of lowest cost, moves cycle through the disparities in ascending order until none
    lowers the energy, or for ``iterations`` cycles. ``energies`` holds the energy, in gray levels, at the start and
    after each move that lowered it, for the last pair.

    Max-flow is computed by PyMaxflow (Boykov and Kolmogorov 2004), an optional dependency under the GPL. ``support_px``
    is that of :class:`GlobalMatcher`.
    """

    name = "graph_cut"

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError as :class:`GlobalMatcher`, or if PyMaxflow cannot be imported."""
        super().__init__(config)
        self.energies: list[float] = []
        try:
            self._maxflow: Any = importlib.import_module("maxflow")
        except ImportError as error:
            raise ConfigError(
                f"matcher graph_cut needs PyMaxflow, which cannot be imported ({error})", remedy="pip install PyMaxflow"
            ) from error

    def _label(self, model: StereoModel) -> I32:
        labels: I32 = model.data.argmin(axis=2).astype(np.int32)
        self.energies = [energy(model, labels)]
        count = model.data.shape[2]
        in_vain = 0
        for move in range((self.config.iterations or CYCLES) * count):
            expanded = self._expand(model, labels, move % count)
            reached = energy(model, expanded)
            in_vain += 1
            if reached < self.energies[-1]:
                labels, in_vain = expanded, 0
                self.energies.append(reached)
            if in_vain == count:
                break
        return labels

    def _expand(self, model: StereoModel, labels: I32, alpha: int) -> I32:
        """The labeling of minimum energy in which every pixel has its label or ``alpha``."""
        keep, change = np.empty((2, *labels.shape), np.int32)
        edges = np.empty((2, *labels.shape), np.int32)
        move = (model.data, model.weights, model.largest_step, labels, alpha)
        run_bands(_capacity_rows, labels.shape[0], *move, keep, change, edges)
        graph = self._maxflow.GraphInt(labels.size, 2 * labels.size)
        nodes = graph.add_grid_nodes(labels.shape)
        graph.add_grid_edges(nodes, edges[0], TO_RIGHT)
        graph.add_grid_edges(nodes, edges[1], TO_BELOW)
        graph.add_grid_tedges(nodes, change, keep)  # pixels in the sink segment change, their source edge is cut
        graph.maxflow()
        expanded: I32 = np.where(graph.get_grid_segments(nodes), np.int32(alpha), labels)
        return expanded


@compiled(
    "void(int64, int64, int32[:, :, ::1], int32[:, :, ::1], int32, int32[:, ::1], int32, "
    "int32[:, ::1], int32[:, ::1], int32[:, :, ::1])"
)
def _capacity_rows(
    first: int,
    last: int,
    data: I32,
    weights: I32,
    largest_step: int,
    labels: I32,
    alpha: int,
    keep: I32,
    change: I32,
    edges: I32,
) -> None:
    """Capacities of a graph whose cuts have the costs of the labelings of a move, up to a constant.

    With x = 0 for a pixel p that keeps its label and 1 for one that changes, the energy of an edge pq, E_xp,xq, is
    E00 + (E10 - E00) x_p - E10 x_q + (E01 + E10 - E00) (1 - x_p) x_q, as E11 = 0: a term per pixel, and one per edge
    from p to q, which is not negative by the triangle inequality.
    """
    width = labels.shape[1]
    for y in range(first, last):
        for x in range(width):
            label = labels[y, x]
            own_step = min(abs(label - alpha), largest_step)
            kept, changed = data[y, x, label], data[y, x, alpha]
            for side in range(2):  # as p: to the right neighbor, to the lower one
                weight = weights[side, y, x]
                edges[side, y, x] = 0
                if weight > 0:
                    other = labels[y + side, x + 1 - side]
                    both_keep = weight * min(abs(label - other), largest_step)
                    other_keeps = weight * min(abs(alpha - other), largest_step)
                    changed += other_keeps - both_keep
                    edges[side, y, x] = weight * own_step + other_keeps - both_keep
            if x > 0:  # as q
                changed -= weights[0, y, x - 1] * own_step
            if y > 0:
                changed -= weights[1, y - 1, x] * own_step
            least = min(kept, changed)
            keep[y, x], change[y, x] = kept - least, changed - least
