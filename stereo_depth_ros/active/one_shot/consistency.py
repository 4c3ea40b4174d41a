# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Edges that continue from row to row have one label: doubtful ones are rejected, missing ones completed."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.one_shot.edges import I32, ColorEdges
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8

__all__ = ["vote"]

_LEAST_COSINE = 0.7  # between the changes of color of an edge in two successive rows
_LARGEST_STEP_PX = 2.0
_REACH_SIGMAS = 3.0
_LEAST_REACH = 4
_CANDIDATES = 8
_DOUBTFUL = 0.25  # weight of a label that is not in a run long enough to be unique
_LEAST_SHARE = 0.75  # of the votes that have a label
_LEAST_SURE = 0.4  # of all votes
_LEAST_ROWS = 3
_MOST_MISSING = 2  # changes between two of a chain


def vote(edges: ColorEdges, labels: I32, runs: U8, window: int, sigma_px: float) -> I32:
    """The labels on which the rows around each edge agree.

    Edges of successive rows are one edge where each is the nearest to the other and the color changes alike. A label of
    an edge has the votes of the rows that it is found in, a few to either side. Those in runs of at least ``window``
    edges are sure; others count for a quarter.

    Args:
        labels, runs: int32 and uint8 (H, K), from :func:`~stereo_depth_ros.active.one_shot.labels.label_rows`.
        sigma_px: the scale of the edges.

    Returns:
        int32 (H, K), -1 where the rows disagree; each label once in a row.
    """
    above, below = np.full(labels.shape, -1, np.int32), np.full(labels.shape, -1, np.int32)
    step = max(_LARGEST_STEP_PX, sigma_px)
    height = edges.counts.size
    run_bands(_link, height, edges.x_px, edges.changes, edges.counts, step, above, below, min_rows=8)
    agreed = np.full(labels.shape, -1, np.int32)
    reach = max(_LEAST_REACH, math.ceil(_REACH_SIGMAS * sigma_px))
    run_bands(_vote, height, labels, runs, edges.counts, window, reach, above, below, agreed, min_rows=8)
    return agreed


@compiled("void(int64, int64, float32[:, ::1], float32[:, :, ::1], int32[::1], float64, int32[:, ::1], int32[:, ::1])")
def _link(first: int, last: int, x_px: F32, changes: F32, counts: I32, step: float, above: I32, below: I32) -> None:
    for y in range(max(first, 1), last):
        i = 0
        for k in range(counts[y]):
            i = _nearest(x_px[y - 1], counts[y - 1], x_px[y, k], i)
            if i >= counts[y - 1] or abs(x_px[y - 1, i] - x_px[y, k]) > step:
                continue
            back = _nearest(x_px[y], counts[y], x_px[y - 1, i], max(0, k - 1))
            a, b = changes[y, k], changes[y - 1, i]
            product = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
            squares = (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) * (b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
            if back == k and product > _LEAST_COSINE * math.sqrt(squares):
                above[y, k] = i
                below[y - 1, i] = k


@compiled()
def _nearest(x_px: F32, count: int, x: float, start: int) -> int:
    """Index of the position nearest to ``x``, searched from ``start`` on; the positions increase."""
    i = start
    while i + 1 < count and abs(x_px[i + 1] - x) <= abs(x_px[i] - x):
        i += 1
    return i


@compiled(
    "void(int64, int64, int32[:, ::1], uint8[:, ::1], int32[::1], int64, int64, int32[:, ::1], int32[:, ::1],"
    " int32[:, ::1])"
)
def _vote(
    first: int,
    last: int,
    labels: I32,
    runs: U8,
    counts: I32,
    window: int,
    reach: int,
    above: I32,
    below: I32,
    agreed: I32,
) -> None:
    candidates = np.empty(_CANDIDATES, np.int64)
    weights, sure = np.empty(_CANDIDATES, np.float64), np.empty(_CANDIDATES, np.float64)
    support = np.empty(labels.shape[1], np.float64)
    for y in range(first, last):
        for k in range(counts[y]):
            candidates[:] = -1
            weights[:] = 0.0
            sure[:] = 0.0
            rows = 1
            _count(labels[y, k], runs[y, k], window, candidates, weights, sure)
            for side in range(2):
                row, i = y, k
                for _ in range(reach):
                    i = above[row, i] if side == 0 else below[row, i]
                    if i < 0:
                        break
                    row += -1 if side == 0 else 1
                    rows += 1
                    _count(labels[row, i], runs[row, i], window, candidates, weights, sure)
            best = np.argmax(weights)
            is_sure = sure[best] >= _LEAST_SURE * rows and weights[best] >= _LEAST_SHARE * weights.sum()
            support[k] = weights[best]
            agreed[y, k] = candidates[best] if is_sure and rows >= _LEAST_ROWS else -1
        _keep_best(counts[y], support, agreed[y])
        _drop_short_chains(counts[y], window, agreed[y])


@compiled()
def _count(label: int, run: int, window: int, candidates: npt.NDArray[np.int64], weights: F64, sure: F64) -> None:
    if label < 0:
        return
    for c in range(candidates.size):
        if candidates[c] < 0 or candidates[c] == label:
            candidates[c] = label
            weights[c] += 1.0 if run >= window else _DOUBTFUL
            sure[c] += 1.0 if run >= window else 0.0
            return


@compiled()
def _keep_best(count: int, support: F64, agreed: I32) -> None:
    """Of equal labels in a row, the one with the most votes remains."""
    for k in range(count):
        for i in range(k):
            if agreed[k] >= 0 and agreed[i] == agreed[k]:
                agreed[i if support[i] < support[k] else k] = -1


@compiled()
def _drop_short_chains(count: int, window: int, agreed: I32) -> None:
    """Drops labels in chains of fewer than ``window``; in a chain, at most two changes in a row are missing."""
    start, length, before = 0, 0, -1
    for k in range(count + 1):
        if k < count and agreed[k] < 0:
            continue
        if k == count or length == 0 or not 0 < agreed[k] - before <= _MOST_MISSING + 1:
            if length < window:
                agreed[start:k] = -1
            start, length = k, 0
        if k < count:
            length += 1
            before = agreed[k]
