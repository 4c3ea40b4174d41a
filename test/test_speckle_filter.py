# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Speckle filter against cv2.filterSpeckles, fixed point against its definition."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.types import Reason
from stereo_depth_ros.matching.filters.speckle_filter import SpeckleFilter, disparity_from_x16

INVALID = -16


def _blocks(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Blocky disparities with noise and with irregular holes: components of all sizes and shapes."""
    coarse = rng.integers(0, 60, (height // 7 + 1, width // 9 + 1)) * 16
    disparity_x16 = np.kron(coarse, np.ones((7, 9), int))[:height, :width] + rng.integers(-3, 4, (height, width))
    disparity_x16[cv2.GaussianBlur(rng.uniform(0, 1, (height, width)), (0, 0), 2) > 0.52] = INVALID
    return disparity_x16.astype(np.int16)


@pytest.mark.parametrize("cores", [1, 2, 5])
@pytest.mark.parametrize(("size", "difference"), [(1, 0), (20, 4), (63, 3), (200, 64), (1000, 496)])
def test_speckles_are_those_of_opencv(size: int, difference: int, cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "core_count", lambda: cores)
    speckle_filter = SpeckleFilter(size, difference)
    rng = np.random.default_rng(size)
    removed = 0
    for shape in ((481, 133), (131, 77), (40, 300), (40, 300)):  # sizes change: buffers follow
        disparity_x16 = _blocks(rng, *shape)
        reasons = np.where(disparity_x16 == INVALID, int(Reason.NO_MATCH), 0).astype(np.uint8)
        expected = disparity_x16.copy()
        cv2.filterSpeckles(expected, INVALID, size, difference)
        speckle_filter(disparity_x16, reasons)
        np.testing.assert_array_equal(reasons == 0, expected != INVALID)
        np.testing.assert_array_equal(reasons == Reason.NO_MATCH, disparity_x16 == INVALID)
        removed += int((reasons == Reason.SPECKLE).sum())
    assert removed > 0


def test_component_across_all_bands_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "core_count", lambda: 4)
    disparity_x16 = np.full((256, 10), 160, np.int16)
    reasons = np.full((256, 10), Reason.NO_MATCH, np.uint8)
    reasons[:, 3] = 0  # a pole of 256 pixels over four bands
    reasons[5:15, 7] = 0
    SpeckleFilter(255, 0)(disparity_x16, reasons)
    assert (reasons[:, 3] == 0).all()
    assert (reasons[5:15, 7] == Reason.SPECKLE).all()
    SpeckleFilter(256, 0)(disparity_x16, reasons)
    assert (reasons[:, 3] == Reason.SPECKLE).all()


def test_size_zero_keeps_all() -> None:
    reasons = np.zeros((5, 7), np.uint8)
    SpeckleFilter(0, 4)(np.arange(35, dtype=np.int16).reshape(5, 7) * 100, reasons)
    assert (reasons == 0).all()


def test_disparity_from_x16() -> None:
    disparity_x16 = np.array([[17, -40, 32767], [8, -32768, 0]], np.int16)
    reasons = np.array([[0, 0, 0], [Reason.BORDER, 0, Reason.TEXTURE]], np.uint8)
    out = np.zeros((2, 3), np.float32)
    disparity_from_x16(disparity_x16, reasons, out)
    nan = np.nan
    np.testing.assert_array_equal(out, np.array([[1.0625, -2.5, 2047.9375], [nan, -2048, nan]], np.float32))
