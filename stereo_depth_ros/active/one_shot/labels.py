# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which change of the pattern an edge is: scores, and dynamic programming along each row in several passes.

Zhang, Curless and Seitz 2002, sections 3.3 and 3.4. The score of an edge and a change is the least consistency of the
three channels. A pass finds the best sequence of pairs in the order of the pattern; the next one does so with the edges
and changes that are left, which finds what stands before the background and breaks the order. Where two runs meet, some
edges may belong to either of them; these have no label.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.one_shot.edges import I32, ColorEdges
from stereo_depth_ros.active.one_shot.stripes import I8, StripePattern
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8

__all__ = ["LARGEST_RATIO", "change_types", "label_rows"]

LARGEST_RATIO = 1.8  # of the widths of two stripes beside each other on a smooth surface

_Flags = npt.NDArray[np.bool_]

_PASSES = 6
_SURELY_NONE, _SURELY = 0.3, 0.7  # magnitudes of a change: alpha and beta of the paper
_NEW_RUN = 1.5  # cost of a pair that does not follow the pair before in the image and in the pattern
_LEAST_TOTAL = 1.0  # of a pass
_LEAST_SCORE = 0.0  # of a pair in a run
_MOST_MISSING = 2  # changes between two edges beside each other on a smooth surface
_NEVER = -1e9
_UP, _LEFT, _PAIR, _CONTINUES = 0, 1, 2, 4


def change_types(changes: I8) -> tuple[I8, I32]:
    """The different changes of a pattern, int8 (T, 3), and the one of each edge of the pattern, int32 (N,)."""
    types, of = np.unique(changes, axis=0, return_inverse=True)
    return np.ascontiguousarray(types), of.reshape(-1).astype(np.int32)


def label_rows(edges: ColorEdges, pattern: StripePattern) -> tuple[I32, U8]:
    """The change of the pattern that each edge of each row is.

    Returns:
        int32 (H, K), the number of the change, -1 where there is none or where two are possible; and uint8 (H, K), the
        length of the run that the edge is in: of successive edges that are successive changes.
    """
    types, type_of = change_types(pattern.changes)
    labels = np.full(edges.x_px.shape, -1, np.int32)
    runs = np.zeros(edges.x_px.shape, np.uint8)
    kinds = types.astype(np.float32)
    seen = (edges.x_px, edges.changes, edges.counts)
    run_bands(_label, edges.counts.size, *seen, pattern.edges_px, kinds, type_of, labels, runs, min_rows=8)
    return labels, runs


@compiled(
    "void(int64, int64, float32[:, ::1], float32[:, :, ::1], int32[::1], float64[::1], float32[:, ::1], int32[::1],"
    " int32[:, ::1], uint8[:, ::1])"
)
def _label(
    first: int,
    last: int,
    x_px: F32,
    changes: F32,
    counts: I32,
    columns: F64,
    types: F32,
    type_of: I32,
    labels: I32,
    runs: U8,
) -> None:
    most = 0
    for y in range(first, last):
        most = max(most, counts[y])
    m = type_of.size
    score = np.empty((most, types.shape[0]), np.float32)
    trace = np.zeros((most + 1, m + 1), np.uint8)
    pair, best = np.empty((2, m + 1), np.float32), np.empty((2, m + 1), np.float32)
    used, either = np.empty(m, np.bool_), np.zeros(most, np.bool_)
    for y in range(first, last):
        n = counts[y]
        for i in range(n):
            for t in range(types.shape[0]):
                score[i, t] = _score(changes[y, i], types[t])
        used[:] = False
        for _ in range(_PASSES):
            if _one_pass(n, score, type_of, labels[y], used, trace, pair, best) < _LEAST_TOTAL:
                break
            _trace_back(n, m, trace, labels[y], used)
        _measure_runs(n, score, type_of, labels[y], runs[y])
        _drop_ambiguous(n, x_px[y], columns, score, type_of, labels[y], either)


@compiled()
def _score(edge: F32, change: F32) -> float:
    """The least consistency of the channels, -1 to 1 (section 3.3)."""
    least = 1.0
    for c in range(3):
        if change[c] == 0.0:
            value = 1.0 - (abs(edge[c]) - _SURELY_NONE) / (_SURELY - _SURELY_NONE)
        else:
            value = (edge[c] * change[c] - _SURELY_NONE) / (_SURELY - _SURELY_NONE)
        least = min(least, max(-1.0, value))
    return least


@compiled()
def _one_pass(n: int, score: F32, type_of: I32, labels: I32, used: _Flags, trace: U8, pair: F32, best: F32) -> float:
    """The total of the best sequence of pairs of free edges and free changes; writes ``trace``."""
    m = type_of.size
    pair[0, :] = _NEVER
    best[0, :] = 0.0
    pair[1, 0] = _NEVER
    best[1, 0] = 0.0
    for i in range(1, n + 1):
        now, before = i % 2, 1 - i % 2
        if labels[i - 1] >= 0:
            pair[now, :] = _NEVER
            best[now, :] = best[before, :]
            trace[i, :] = _UP
            continue
        for j in range(1, m + 1):
            total, direction, continues = np.float32(_NEVER), _UP, 0
            if not used[j - 1]:
                total = best[before, j - 1] - np.float32(_NEW_RUN)
                if pair[before, j - 1] >= total:
                    total, continues = pair[before, j - 1], _CONTINUES
                total += score[i - 1, type_of[j - 1]]
            highest = best[before, j]
            if best[now, j - 1] > highest:
                highest, direction = best[now, j - 1], _LEFT
            if total > highest:
                highest, direction = total, _PAIR
            pair[now, j] = total
            best[now, j] = highest
            trace[i, j] = direction + continues
    return float(best[n % 2, m])


@compiled()
def _trace_back(n: int, m: int, trace: U8, labels: I32, used: _Flags) -> None:
    i, j, in_run = n, m, False
    while i > 0 and j > 0:
        step = trace[i, j]
        if in_run or step % _CONTINUES == _PAIR:
            labels[i - 1] = j - 1
            used[j - 1] = True
            in_run = step >= _CONTINUES
            i, j = i - 1, j - 1
        elif step % _CONTINUES == _LEFT:
            j -= 1
        else:
            i -= 1


@compiled()
def _measure_runs(n: int, score: F32, type_of: I32, labels: I32, runs: U8) -> None:
    """Drops pairs that contradict; the length of each run of the others, at most 255."""
    for i in range(n):
        if labels[i] >= 0 and score[i, type_of[labels[i]]] < _LEAST_SCORE:
            labels[i] = -1
    start = 0
    for i in range(1, n + 1):
        if i == n or labels[i] < 0 or labels[i - 1] < 0 or labels[i] != labels[i - 1] + 1:
            for k in range(start, i):
                runs[k] = min(i - start, 255) if labels[k] >= 0 else 0
            start = i


@compiled()
def _drop_ambiguous(n: int, x_px: F32, columns: F64, score: F32, type_of: I32, labels: I32, either: _Flags) -> None:
    """Drops edges where two runs meet and that could continue the other run as well."""
    either[:n] = False
    for i in range(n - 1):
        a, b = labels[i], labels[i + 1]
        if a < 0 or b < 0 or b == a + 1 or _is_smooth(i, n, x_px, columns, labels):
            continue
        k, other = i + 1, a + 1
        while k < n and other < type_of.size and labels[k] == b + k - i - 1 and score[k, type_of[other]] > 0.0:
            either[k] = True
            k, other = k + 1, other + 1
        k, other = i, b - 1
        while k >= 0 and other >= 0 and labels[k] == a + k - i and score[k, type_of[other]] > 0.0:
            either[k] = True
            k, other = k - 1, other - 1
    for i in range(n):
        if either[i]:
            labels[i] = -1


@compiled()
def _is_smooth(i: int, n: int, x_px: F32, columns: F64, labels: I32) -> bool:
    """Whether only edges are missing between two: the stripes there are about as wide as one beside them."""
    if not 0 < labels[i + 1] - labels[i] <= _MOST_MISSING + 1:
        return False
    step = (x_px[i + 1] - x_px[i]) / (columns[labels[i + 1]] - columns[labels[i]])
    for k in (i - 1, i + 1):
        if k >= 0 and k + 1 < n and labels[k] >= 0 and labels[k + 1] == labels[k] + 1:
            beside = (x_px[k + 1] - x_px[k]) / (columns[labels[k + 1]] - columns[labels[k]])
            if 1.0 / LARGEST_RATIO < step / beside < LARGEST_RATIO:
                return True
    return False
