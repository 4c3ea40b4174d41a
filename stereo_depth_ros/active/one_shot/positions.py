# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Positions of edges: the part that depends on the colors is estimated from the image itself and removed.

Where a bright channel blooms, or where the projector or the camera is not linear, a rising edge is found too early and
a falling one too late; channels are also displaced by the lenses. Along a smooth surface the positions of three
successive edges are nearly linear in their projector columns, whatever their colors, so that the displacement of each
kind of change follows from many such triples by least squares.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.one_shot.edges import I32
from stereo_depth_ros.active.one_shot.labels import change_types
from stereo_depth_ros.active.one_shot.stripes import StripePattern
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.geometry.robust import robust_sigma

__all__ = ["remove_displacements"]

_Index = npt.NDArray[np.intp]

_ROUNDS = 3
_OUTLIER_SIGMAS = 3.0
_MOST_TRIPLES = 40_000
_LEAST_TRIPLES = 30
_VARIANCE = 1.5  # of x[i] - (x[i - 1] + x[i + 1]) / 2, for edges of variance 1


def remove_displacements(x_px: F32, labels: I32, pattern: StripePattern) -> tuple[F32, float]:
    """Positions without the displacement of their kind of change, and their standard deviation.

    The displacements are in units of the local width of a stripe. That of all kinds together is not observable and is
    taken as 0.

    Args:
        x_px: float32 (H, K), increasing where there is a label.
        labels: int32 (H, K), -1 where there is none.

    Returns:
        float32 (H, K), and the standard deviation of an edge, px; NaN with fewer than 30 triples.
    """
    types, type_of = change_types(pattern.changes)
    row, left, middle, right = _triples(labels)
    if row.size < _LEAST_TRIPLES:
        return x_px, float("nan")
    at = np.stack([left, middle, right], axis=1)
    number = labels[row[:, None], at]
    x, u, kind = x_px[row[:, None], at].astype(np.float64), pattern.edges_px[number], type_of[number]
    share = (u[:, 1] - u[:, 0]) / (u[:, 2] - u[:, 0])
    stripe_px = (x[:, 2] - x[:, 0]) / 2
    factors = np.stack([share - 1.0, np.ones_like(share), -share], axis=1)
    deviations = np.sum(factors * x, axis=1)
    displacement = _fit(factors, kind, deviations / stripe_px, len(types))
    left_over = deviations - stripe_px * np.sum(factors * displacement[kind], axis=1)
    corrected = x_px.copy()
    own = np.where(labels >= 0, displacement[type_of[labels]], 0.0)
    corrected -= (own * _stripe_widths(x_px, labels, float(np.median(stripe_px)))).astype(np.float32)
    return corrected, robust_sigma(left_over) / _VARIANCE**0.5


def _triples(labels: I32) -> tuple[_Index, _Index, _Index, _Index]:
    """Row and three columns of labels that follow each other, at most some 40000 of them."""
    row, column = np.nonzero(labels >= 0)
    number = labels[row, column]
    follows = (row[1:] == row[:-1]) & (number[1:] == number[:-1] + 1)
    first = np.flatnonzero(follows[1:] & follows[:-1])
    first = first[:: max(1, first.size // _MOST_TRIPLES)]
    return row[first], column[first], column[first + 1], column[first + 2]


def _fit(factors: F64, kind: I32, values: F64, kinds: int) -> F64:
    """Least squares without outliers; of minimal norm, as one displacement of all kinds changes nothing."""
    displacement: F64 = np.zeros(kinds)
    for _ in range(_ROUNDS):
        deviations = values - np.sum(factors * displacement[kind], axis=1)
        inlier = np.abs(deviations) <= _OUTLIER_SIGMAS * robust_sigma(deviations)
        f, k, v = factors[inlier], kind[inlier], values[inlier]
        normal, right = np.zeros((kinds, kinds)), np.zeros(kinds)
        for a in range(3):
            right += np.bincount(k[:, a], f[:, a] * v, kinds)
            for b in range(3):
                normal += np.bincount(k[:, a] * kinds + k[:, b], f[:, a] * f[:, b], kinds**2).reshape(kinds, kinds)
        displacement = np.asarray(np.linalg.lstsq(normal, right, rcond=1e-6)[0], np.float64)
    return displacement


def _stripe_widths(x_px: F32, labels: I32, typical: float) -> F64:
    """Distance to the neighbors with the next labels, the typical one where there are none."""
    width = np.full(x_px.shape, np.nan)
    follows = (labels[:, 1:] == labels[:, :-1] + 1) & (labels[:, :-1] >= 0)
    steps = np.where(follows, np.diff(x_px, axis=1), np.nan)
    both = np.full((*x_px.shape, 2), np.nan)
    both[:, 1:, 0], both[:, :-1, 1] = steps, steps
    counts = np.isfinite(both).sum(axis=2)
    np.divide(np.nansum(both, axis=2), counts, out=width, where=counts > 0)
    return np.where(counts > 0, width, typical)
