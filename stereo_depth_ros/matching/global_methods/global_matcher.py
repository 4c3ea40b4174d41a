# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the global matchers: from a pair to its energy model, from labels to a result."""

from __future__ import annotations

from abc import abstractmethod

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.matching.costs.birchfield_tomasi import COST_STEPS
from stereo_depth_ros.matching.filters.speckle_filter import I16
from stereo_depth_ros.matching.global_methods.energy import I32, StereoModel, searched_columns, stereo_model
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair, check_search
from stereo_depth_ros.matching.selection.float_costs import finish
from stereo_depth_ros.matching.serial import SerialMatcher

__all__ = ["NO_LABEL", "GlobalMatcher", "margin"]

NO_LABEL = -1
LEAST_SMOOTHNESS = 1 / COST_STEPS


class GlobalMatcher(SerialMatcher):
    """A method that assigns a label to every pixel, the index of a whole disparity, or none to occluded pixels.

    Disparities are whole pixels: a sub-pixel fit would degrade more pixels than it improves, since the minimum of a
    truncated, sampling-insensitive cost is flat. ``disp12_max_diff`` above 0 also labels the right image (the mirrored
    pair) and marks inconsistent pixels, which doubles the time. ``uniqueness_ratio`` has no effect, as the costs of a
    single pixel do not determine its label. ``speckle_range`` is in px. The confidence is :func:`margin`, over windows
    of ``correlation_window_size``, times the local consistency.

    ``support_px`` is that window, which is also the initial window of the photometric correction.
    """

    step_px = 1.0

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if the search range does not fit in 16 bits, or ``smoothness`` is below the cost unit."""
        check_search(config)
        if 0 < config.smoothness < LEAST_SMOOTHNESS:
            raise ConfigError(
                f"smoothness = {config.smoothness:g} is below {LEAST_SMOOTHNESS:g} gray levels, the unit of the costs "
                f"of {self.name}",
                value=config.smoothness,
                limit=LEAST_SMOOTHNESS,
                remedy=f"use {LEAST_SMOOTHNESS:g} or more, or 0 for the default of the method",
                settings=("smoothness",),
            )
        super().__init__(config)

    @abstractmethod
    def _label(self, model: StereoModel) -> I32:
        """int32 (H, W), label of every pixel of the model, ``NO_LABEL`` for occluded pixels."""

    def _match(self, left: U8, right: U8) -> MatchResult:
        config = self.config
        check_pair(left, right, self)
        columns = searched_columns(config, left.shape[1])
        disparity_x16 = np.zeros(left.shape, np.int16)
        reasons = np.full(left.shape, Reason.BORDER, np.uint8)
        margins = np.zeros(left.shape, np.float32)
        # The right image first, so that the state of the last run is that of the left image.
        right_labels = self._right_labels(left, right) if config.disp12_max_diff > 0 else None
        model = stereo_model(left, right, config)
        labels = self._label(model)
        reasons[:, columns] = np.where(labels == NO_LABEL, np.uint8(Reason.NO_MATCH), np.uint8(0))
        disparity_x16[:, columns] = (labels + config.min_disparity) * X16_STEPS
        margins[:, columns] = margin(model, labels, config.correlation_window_size)
        if right_labels is not None:
            _check_right(disparity_x16, reasons, right_labels, config)
        return finish(disparity_x16, reasons, config, self.step_px, margins)

    def _right_labels(self, left: U8, right: U8) -> I32:
        """Labels of the right image, int32 (H, W), ``NO_LABEL`` where there is none."""
        model = stereo_model(right[:, ::-1], left[:, ::-1], self.config)
        mirrored = np.full(left.shape, NO_LABEL, np.int32)
        mirrored[:, searched_columns(self.config, left.shape[1])] = self._label(model)
        return mirrored[:, ::-1]


def _check_right(disparity_x16: I16, reasons: U8, right_labels: I32, config: MatchingConfig) -> None:
    """Mark the pixels whose right pixel has no label, or one more than ``disp12_max_diff`` away."""
    rows, columns = np.nonzero(reasons == 0)
    disparity = disparity_x16[rows, columns] // X16_STEPS
    other = right_labels[rows, columns - disparity]
    agree = (other != NO_LABEL) & (np.abs(other + config.min_disparity - disparity) <= config.disp12_max_diff)
    reasons[rows[~agree], columns[~agree]] = Reason.LEFT_RIGHT


def margin(model: StereoModel, labels: I32, window: int) -> F32:
    """Margin of the windowed cost at the disparity of a pixel over the best of the others.

    Costs are averaged over a square window; with ``own`` at the label of the pixel and ``other`` at the best label at
    least two away, the margin is other / (own + other): 1 if no other matches, 0.5 if another matches as well.

    Args:
        labels: int32 (H, W), as of ``GlobalMatcher``; the margin of ``NO_LABEL`` is undefined.
        window: side, odd, px.

    Returns:
        float32 (H, W), 0..1.
    """
    own = np.zeros(labels.shape, np.float32)
    other = np.full(labels.shape, np.inf, np.float32)
    for index in range(model.data.shape[2]):
        costs = np.minimum(model.data[:, :, index], model.largest_cost).astype(np.float32)
        mean = cv2.blur(costs, (window, window), borderType=cv2.BORDER_REFLECT)
        distance = np.abs(labels - index)
        own = np.where(distance == 0, mean, own)
        other = np.where(distance > 1, np.minimum(other, mean), other)
    result = np.full(labels.shape, 0.5, np.float32)
    np.divide(other, own + other, out=result, where=own + other > 0)
    return result
