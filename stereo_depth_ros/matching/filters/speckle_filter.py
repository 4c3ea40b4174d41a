# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Speckle filter, and conversion of fixed-point disparities to pixels."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8, Reason

__all__ = ["I16", "SpeckleFilter", "disparity_from_x16"]

I16: TypeAlias = npt.NDArray[np.int16]
I32: TypeAlias = npt.NDArray[np.int32]

SPECKLE = int(Reason.SPECKLE)
NAN = np.float32(np.nan)


def disparity_from_x16(disparity_x16: I16, reasons: U8, out: F32) -> None:
    """Write disparities in pixels, NaN where there is a reason.

    Args:
        disparity_x16: int16 (H, W), disparity in 1/16 px; any value where ``reasons`` is not 0.
        reasons: uint8 (H, W), bits of :class:`~stereo_depth_ros.core.types.Reason`.
        out: float32 (H, W), px.
    """
    run_bands(_disparity_rows, disparity_x16.shape[0], disparity_x16, reasons, out)


@compiled("void(int64, int64, int16[:, ::1], uint8[:, ::1], float32[:, ::1])")
def _disparity_rows(first: int, last: int, disparity_x16: I16, reasons: U8, out: F32) -> None:
    for y in range(first, last):
        for x in range(disparity_x16.shape[1]):
            out[y, x] = NAN if reasons[y, x] else np.float32(disparity_x16[y, x]) * np.float32(1 / 16)


class SpeckleFilter:
    """Removes small components of similar disparity, the same pixels as ``cv2.filterSpeckles``.

    Two valid neighbors (4-connected) that differ by at most ``max_difference`` are connected; components of up to
    ``max_size`` pixels are marked SPECKLE. Runs of pixels are merged by union-find (Wu, Otoo and Suzuki 2009), in bands
    of rows that are joined afterwards.
    """

    def __init__(self, max_size: int, max_difference: int) -> None:
        """``max_size`` in pixels, 0 keeps all; ``max_difference`` in 1/16 px."""
        self._max_size = max_size
        self._max_difference = max_difference
        self._labels: I32 = np.empty((0, 0), np.int32)

    def __call__(self, disparity_x16: I16, reasons: U8) -> None:
        """Mark speckles in ``reasons``, in place.

        Args:
            disparity_x16: int16 (H, W), disparity in 1/16 px.
            reasons: uint8 (H, W), 0 where valid.
        """
        if self._max_size == 0:
            return
        if self._labels.shape != disparity_x16.shape:
            self._labels = np.empty(disparity_x16.shape, np.int32)
            self._parent = np.empty(disparity_x16.size, np.int32)
            self._size = np.empty(disparity_x16.size, np.int32)
        rows = disparity_x16.shape[0]
        seams = np.zeros(rows, np.uint8)
        forest = (self._labels, self._parent, self._size)
        run_bands(_label_rows, rows, disparity_x16, reasons, self._max_difference, *forest, seams)
        _join_seams(disparity_x16, reasons, self._max_difference, *forest, seams)
        run_bands(_mark_rows, rows, reasons, self._max_size, *forest)


@compiled()
def _root(parent: I32, label: int) -> int:
    while parent[label] != label:
        label = parent[label]
    return label


@compiled()
def _unite(parent: I32, size: I32, a: int, b: int) -> int:
    """Merge two components; returns the root. The earlier root stays, which keeps trees flat in scan order."""
    a, b = _root(parent, a), _root(parent, b)
    if a == b:
        return a
    low, high = min(a, b), max(a, b)
    parent[high] = low
    size[low] += size[high]
    return low


@compiled(
    "void(int64, int64, int16[:, ::1], uint8[:, ::1], int64, int32[:, ::1], int32[::1], int32[::1], uint8[::1])",
)
def _label_rows(
    first: int,
    last: int,
    disparity_x16: I16,
    reasons: U8,
    tolerance: int,
    labels: I32,
    parent: I32,
    size: I32,
    seams: U8,
) -> None:
    """Label the runs of each row (by the index of their first pixel) and merge them with the runs above."""
    seams[first] = 1
    width = disparity_x16.shape[1]
    for y in range(first, last):
        label, begin, united = -1, 0, -1
        for x in range(width):
            if reasons[y, x]:
                if label >= 0:
                    size[_root(parent, label)] += x - begin
                label = -1
                continue
            value = np.int64(disparity_x16[y, x])
            if label < 0 or abs(value - disparity_x16[y, x - 1]) > tolerance:
                if label >= 0:
                    size[_root(parent, label)] += x - begin
                label, begin, united = y * width + x, x, -1
                parent[label] = label
                size[label] = 0
            labels[y, x] = label
            above = labels[y - 1, x] if y > first and reasons[y - 1, x] == 0 else united
            if above != united and abs(value - disparity_x16[y - 1, x]) <= tolerance:
                united = above
                _unite(parent, size, label, united)
        if label >= 0:
            size[_root(parent, label)] += width - begin


@compiled("void(int16[:, ::1], uint8[:, ::1], int64, int32[:, ::1], int32[::1], int32[::1], uint8[::1])")
def _join_seams(
    disparity_x16: I16, reasons: U8, tolerance: int, labels: I32, parent: I32, size: I32, seams: U8
) -> None:
    for y in range(1, disparity_x16.shape[0]):
        if seams[y]:
            for x in range(disparity_x16.shape[1]):
                step = abs(np.int64(disparity_x16[y, x]) - disparity_x16[y - 1, x])
                if reasons[y, x] == 0 and reasons[y - 1, x] == 0 and step <= tolerance:
                    _unite(parent, size, labels[y, x], labels[y - 1, x])


@compiled("void(int64, int64, uint8[:, ::1], int64, int32[:, ::1], int32[::1], int32[::1])")
def _mark_rows(first: int, last: int, reasons: U8, max_size: int, labels: I32, parent: I32, size: I32) -> None:
    for y in range(first, last):
        label, small = -1, False
        for x in range(labels.shape[1]):
            if reasons[y, x] == 0:
                if labels[y, x] != label:
                    label = labels[y, x]
                    small = size[_root(parent, label)] <= max_size
                if small:
                    reasons[y, x] = SPECKLE
