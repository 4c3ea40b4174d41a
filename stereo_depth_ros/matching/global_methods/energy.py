# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Energy of a disparity map: data and smoothness terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.costs.birchfield_tomasi import COST_STEPS, OUTSIDE, birchfield_tomasi
from stereo_depth_ros.matching.photometric import match_photometric

__all__ = ["I32", "StereoModel", "energy", "neighbor_weights", "searched_columns", "stereo_model"]

I32: TypeAlias = npt.NDArray[np.int32]

LARGEST_DATA_COST = 15  # gray levels; truncation of the cost of outliers (occlusions, reflections)
SMOOTHNESS = 1.5  # gray levels, cost of a step of one pixel by default
LARGEST_STEP = 2  # px; truncation of the cost of larger steps
CONTRAST = 16  # gray levels; neighbors that differ by less are probably on one surface ...
CONTRAST_FACTOR = 2  # ... and the cost of a step between them is multiplied by this


@dataclass(frozen=True)
class StereoModel:
    """The energy function of one pair: E(f) = sum_p D(p, f_p) + sum_pq w_pq min(|f_p - f_q|, largest_step).

    Costs are integers in half gray levels, so that energies can be compared exactly.

    Attributes:
        data: int32 (H, W, N), D: cost of the disparity of each index.
        weights: int32 (2, H, W), w: cost of a step of one px, to the right neighbor in [0] and to the lower one in
            [1]; 0 without a neighbor.
        largest_step: truncation of the steps, px.
        largest_cost: the largest ``data`` of a disparity that lies in the right image.
    """

    data: I32
    weights: I32
    largest_step: int
    largest_cost: int


def searched_columns(config: MatchingConfig, width: int) -> slice:
    """The columns of the left image with at least one searched disparity inside the right image."""
    return slice(max(0, config.min_disparity), width + min(0, config.max_disparity))


def neighbor_weights(image: U8, smoothness: float) -> I32:
    """Contrast-sensitive weights of the edges between neighbors (Boykov, Veksler and Zabih 2001, section 8.2).

    Args:
        image: uint8 (H, W), with whose edges disparity steps should coincide.
        smoothness: weight across an edge of the image, gray levels.

    Returns:
        int32 (2, H, W), half gray levels, as in :class:`StereoModel`.
    """
    gray = image.astype(np.int32)
    weights = np.zeros((2, *image.shape), np.int32)
    low, high = round(COST_STEPS * smoothness), round(COST_STEPS * smoothness * CONTRAST_FACTOR)
    weights[0, :, :-1] = np.where(np.abs(np.diff(gray, axis=1)) < CONTRAST, high, low)
    weights[1, :-1] = np.where(np.abs(np.diff(gray, axis=0)) < CONTRAST, high, low)
    return weights


def stereo_model(left: U8, right: U8, config: MatchingConfig) -> StereoModel:
    """Truncated costs of Birchfield and Tomasi and contrast-sensitive weights, over :func:`searched_columns`.

    Costs are computed after the photometric correction of the left image. A disparity that leaves the right image costs
    more than all four neighbors can compensate.

    Args:
        left, right: uint8 (H, W), gray, rectified.
        config: the search range, and ``smoothness`` in gray levels, 0 for 1.5.
    """
    columns = searched_columns(config, left.shape[1])
    weights = neighbor_weights(left[:, columns], config.smoothness or SMOOTHNESS)
    left = match_photometric(left, right, config)
    costs = birchfield_tomasi(left, right, config.min_disparity, config.num_disparities)[:, columns]
    largest = COST_STEPS * LARGEST_DATA_COST
    forbidden = largest + 4 * LARGEST_STEP * int(weights.max()) + 1
    data = np.minimum(costs, largest).astype(np.int32)
    data[costs == OUTSIDE] = forbidden
    return StereoModel(data, weights, LARGEST_STEP, largest)


def energy(model: StereoModel, labels: I32) -> float:
    """E of a labeling, in gray levels.

    Args:
        labels: int32 (H, W), index of the disparity of each pixel, 0 to N - 1.
    """
    total = np.take_along_axis(model.data, labels[..., np.newaxis], axis=2).sum(dtype=np.int64)
    for weights, steps in (
        (model.weights[0, :, :-1], np.diff(labels, axis=1)),
        (model.weights[1, :-1], np.diff(labels, axis=0)),
    ):
        total += np.sum(weights * np.minimum(np.abs(steps), model.largest_step), dtype=np.int64)
    return float(total) / COST_STEPS
