# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Positions of edges: the part that depends on the colors is estimated from the image itself and removed.

Where a bright channel blooms, or where the projector or the camera is not linear, a rising edge is found too early and
a falling one too late; channels are also displaced by the lenses. Along a smooth surface the positions of three
successive edges are nearly linear in their projector columns, whatever their colors, so that the displacement of each
kind of change follows by least squares from the triples of the pattern, with the median over the rows for each of them.
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

_ROUNDS = 6
_OUTLIER_SIGMAS = 3.0
_PRIOR_SIGMA, _LEAST_SIGMA = 0.1, 0.01  # of a displacement, and of a triple of changes, stripes
_MOST_TRIPLES = 40_000
_LEAST_TRIPLES = 30
_LEAST_EQUATIONS = 30  # triples of the pattern, for up to some 18 kinds of changes; with fewer there is no correction
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
    number = labels[row[:, None], at].astype(np.intp)
    x, u, kind = x_px[row[:, None], at].astype(np.float64), pattern.edges_px[number], type_of[number].astype(np.intp)
    share = (u[:, 1] - u[:, 0]) / (u[:, 2] - u[:, 0])
    stripe_px = (x[:, 2] - x[:, 0]) / 2
    factors = np.stack([share - 1.0, np.ones_like(share), -share], axis=1)
    deviations = np.sum(factors * x, axis=1)
    first, middle_of = np.unique(number[:, 1], return_index=True)[1], number[:, 1]
    median = _medians(middle_of, deviations / stripe_px)
    displacement = np.zeros(len(types))
    if first.size >= _LEAST_EQUATIONS:
        displacement = _fit(factors[first], kind[first], median, len(types))
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


def _medians(group: _Index, values: F64) -> F64:
    """The median of the values of each group, in the order of the groups."""
    order = np.argsort(group, kind="stable")
    parts = np.split(values[order], np.flatnonzero(np.diff(group[order])) + 1)
    return np.array([np.median(part) for part in parts])


def _fit(factors: F64, kind: _Index, values: F64, kinds: int) -> F64:
    """Least squares without outliers, with a prior that is 0: what the equations do not determine stays small."""
    displacement: F64 = np.zeros(kinds)
    for _ in range(_ROUNDS):
        deviations = values - np.sum(factors * displacement[kind], axis=1)
        sigma = max(robust_sigma(deviations), _LEAST_SIGMA)
        inlier = np.abs(deviations) <= _OUTLIER_SIGMAS * sigma
        f, k, v = factors[inlier], kind[inlier], values[inlier]
        A = np.zeros((len(v), kinds))
        for a in range(3):
            np.add.at(A, (np.arange(len(v)), k[:, a]), f[:, a])
        normal = A.T @ A + (sigma / _PRIOR_SIGMA) ** 2 * np.identity(kinds)
        displacement = np.asarray(np.linalg.solve(normal, A.T @ v), np.float64)
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
