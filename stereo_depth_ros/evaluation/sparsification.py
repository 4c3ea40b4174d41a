# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sparsification curves: the error of the most confident pixels over their share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, F64

__all__ = ["SparsificationCurve", "sparsification"]


@dataclass(frozen=True)
class SparsificationCurve:
    """Mean errors of the k most confident of n pixels, k = 1..n (Hu and Mordohai 2012: "ROC curve").

    Attributes:
        error: float64 (n,), mean error of the k most confident pixels; pixels of equal confidence count as in random
            order, so that a constant confidence gives the random order.
        oracle: float64 (n,), the same in the order of the errors, a lower bound for every confidence.
    """

    error: F64
    oracle: F64

    @property
    def area(self) -> float:
        """Area under the curve, in the unit of the error: mean over all shares kept."""
        return float(self.error.mean())

    @property
    def oracle_area(self) -> float:
        """Area of the order of the errors."""
        return float(self.oracle.mean())

    @property
    def random_area(self) -> float:
        """Expected area of a random order: the mean error of all pixels."""
        return float(self.error[-1])

    def at(self, kept: float) -> float:
        """Mean error of the most confident share ``kept``, above 0 up to 1."""
        return float(self.error[int(np.ceil(kept * self.error.size)) - 1])


def sparsification(confidence: F32, error: F64) -> SparsificationCurve | None:
    """The curve of matched pixels with truth; None for no pixels.

    Args:
        confidence: float32 (n,), in [0, 1].
        error: float64 (n,), absolute error of each pixel, or 100 where it is wrong and 0 where it is right.

    Raises:
        ImageError: not one confidence in [0, 1] for each error.
    """
    if confidence.shape != error.shape or confidence.ndim != 1:
        raise ImageError(
            f"confidence is {confidence.shape}, errors are {error.shape}",
            value=confidence.shape,
            limit=error.shape,
            remedy="give one for each pixel",
        )
    if not error.size:
        return None
    if not (confidence.min() >= 0 and confidence.max() <= 1):  # refuses NaN too
        raise ImageError(
            f"confidence is {confidence.min()}..{confidence.max()}, it must be within 0..1",
            value=(float(confidence.min()), float(confidence.max())),
            limit=(0, 1),
            remedy="correct the matcher that returned it",
        )
    _, group, sizes = np.unique(-confidence, return_inverse=True, return_counts=True)
    means = np.bincount(group, error) / sizes
    return SparsificationCurve(_running_mean(np.repeat(means, sizes)), _running_mean(np.sort(error)))


def _running_mean(values: F64) -> F64:
    means: F64 = np.cumsum(values) / np.arange(1, values.size + 1)
    return means
