# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hierarchical min-sum belief propagation."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.matching.global_methods.energy import I32, StereoModel, energy
from stereo_depth_ros.matching.global_methods.global_matcher import GlobalMatcher

__all__ = ["BeliefPropagationMatcher"]

LEVELS = 5  # blocks of up to 16 x 16 pixels
ITERATIONS = 10  # on each level
RIGHT, LEFT, DOWN, UP = range(4)  # direction of a message


class BeliefPropagationMatcher(GlobalMatcher):
    """Loopy min-sum belief propagation (max-product of the probabilities) on the grid, from coarse to fine.

    After Felzenszwalb and Huttenlocher (2006): messages of a truncated linear penalty in time linear in the number of
    disparities; the two colors of a checkerboard are updated alternately, so one set of messages suffices; messages are
    initialized from a grid of half the resolution. In contrast to the paper, a pixel of the coarser grid stands for
    labelings that are constant on its block, so contrast-sensitive weights are summed like the costs.

    The energy is that of ``energy.py``; ``energies`` holds it, in gray levels, after each iteration on the finest grid
    for the last pair. It does not decrease monotonically. ``iterations`` are per grid. ``support_px`` is that of
    :class:`GlobalMatcher`.
    """

    name = "belief_propagation"

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError as :class:`GlobalMatcher`."""
        super().__init__(config)
        self.energies: list[float] = []

    def _label(self, model: StereoModel) -> I32:
        self.energies = []
        models = [model]
        for _ in range(LEVELS - 1):
            models.append(_coarser(models[-1]))
        labels: I32 = np.empty(model.data.shape[:2], np.int32)
        messages = _no_messages(models[-1])
        for level in reversed(models):
            if level is not models[-1]:
                messages = _finer_messages(messages, level)
            for _ in range(self.config.iterations or ITERATIONS):
                _exchange(level, messages)
                if level is model:
                    run_bands(_label_rows, labels.shape[0], model.data, messages, labels)
                    self.energies.append(energy(model, labels))
        return labels


def _coarser(model: StereoModel) -> StereoModel:
    """The energy of labelings that are constant on blocks of 2 x 2 pixels, smaller at the right and bottom edge."""
    height, width = model.data.shape[:2]
    rows, columns = np.arange(0, height, 2), np.arange(0, width, 2)
    data: I32 = np.add.reduceat(np.add.reduceat(model.data, rows, 0, np.int32), columns, 1, np.int32)
    weights = np.zeros((2, len(rows), len(columns)), np.int32)
    # Edges between blocks start in the last column or row of a block.
    to_right = np.add.reduceat(model.weights[0, :, 1::2], rows, 0, np.int32)
    to_below = np.add.reduceat(model.weights[1, 1::2], columns, 1, np.int32)
    weights[0, :, : to_right.shape[1]] = to_right
    weights[1, : to_below.shape[0]] = to_below
    return StereoModel(data, weights, model.largest_step, model.largest_cost)


def _no_messages(model: StereoModel) -> I32:
    """Zero messages, int32 (4, H + 2, W + 2, N), with a border of senders outside the image that stay 0."""
    height, width, count = model.data.shape
    return np.zeros((4, height + 2, width + 2, count), np.int32)


def _finer_messages(coarse: I32, model: StereoModel) -> I32:
    """Initialize each pixel with half the messages of its block: an edge of blocks is two edges of pixels."""
    height, width = model.data.shape[:2]
    messages = _no_messages(model)
    halves = (coarse[:, 1:-1, 1:-1] // 2).repeat(2, axis=1).repeat(2, axis=2)
    messages[:, 1:-1, 1:-1] = halves[:, :height, :width]
    return messages


def _exchange(model: StereoModel, messages: I32) -> None:
    """One iteration: the pixels of each color send messages to their neighbors, all of the other color."""
    for color in (0, 1):
        values = (model.data, model.weights, model.largest_step, color, messages)
        run_bands(_message_rows, model.data.shape[0], *values)


@compiled()
def _send(total: I32, reply: I32, weight: int, largest_step: int, message: I32) -> None:
    """Message of a pixel to a neighbor: its total without the reply of the neighbor, for each label of the neighbor.

    The minimum over all labels of the pixel, by a forward and a backward pass, normalized to a minimum of 0.
    """
    count = total.size
    least = total[0] - reply[0]
    for k in range(count):
        message[k] = total[k] - reply[k]
        least = min(least, message[k])
    for k in range(1, count):
        message[k] = min(message[k], message[k - 1] + weight)
    for k in range(count - 2, -1, -1):
        message[k] = min(message[k], message[k + 1] + weight)
    most = weight * largest_step
    for k in range(count):
        message[k] = min(message[k] - least, most)


@compiled("void(int64, int64, int32[:, :, ::1], int32[:, :, ::1], int32, int64, int32[:, :, :, ::1])")
def _message_rows(first: int, last: int, data: I32, weights: I32, largest_step: int, color: int, messages: I32) -> None:
    height, width, count = data.shape
    total = np.empty(count, np.int32)
    for y in range(first, last):
        row = y + 1
        for x in range((y + color) % 2, width, 2):
            column = x + 1
            from_left, from_right = messages[RIGHT, row, column - 1], messages[LEFT, row, column + 1]
            from_above, from_below = messages[DOWN, row - 1, column], messages[UP, row + 1, column]
            for k in range(count):
                total[k] = data[y, x, k] + from_left[k] + from_right[k] + from_above[k] + from_below[k]
            if x < width - 1:
                _send(total, from_right, weights[0, y, x], largest_step, messages[RIGHT, row, column])
            if x > 0:
                _send(total, from_left, weights[0, y, x - 1], largest_step, messages[LEFT, row, column])
            if y < height - 1:
                _send(total, from_below, weights[1, y, x], largest_step, messages[DOWN, row, column])
            if y > 0:
                _send(total, from_above, weights[1, y - 1, x], largest_step, messages[UP, row, column])


@compiled("void(int64, int64, int32[:, :, ::1], int32[:, :, :, ::1], int32[:, ::1])")
def _label_rows(first: int, last: int, data: I32, messages: I32, labels: I32) -> None:
    """The label of minimum belief, the sum of data cost and all incoming messages."""
    width, count = data.shape[1:]
    belief = np.empty(count, np.int32)
    for y in range(first, last):
        for x in range(width):
            from_left, from_right = messages[RIGHT, y + 1, x], messages[LEFT, y + 1, x + 2]
            from_above, from_below = messages[DOWN, y, x + 1], messages[UP, y + 2, x + 1]
            for k in range(count):
                belief[k] = data[y, x, k] + from_left[k] + from_right[k] + from_above[k] + from_below[k]
            labels[y, x] = np.argmin(belief)
