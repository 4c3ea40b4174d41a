# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hole filling with planes: against a slow definition, and scenes with an exact answer."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.core import bands
from stereo_depth_ros.core.types import F32, F64, U8, Reason
from stereo_depth_ros.matching.filters.plane_filling import PlaneFilling

NAN = np.nan
STEP_PX = 1 / 64
DIRECTIONS = ((0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1))


def filled(disparity_px: F32, left: U8) -> F32:
    after = disparity_px.copy()
    reasons = np.where(np.isnan(after), int(Reason.LEFT_RIGHT), 0).astype(np.uint8)
    PlaneFilling(STEP_PX)(after, reasons, left)
    assert (reasons == 0).all() and np.isfinite(after).all()
    known = np.isfinite(disparity_px)
    np.testing.assert_array_equal(after[known], disparity_px[known])
    return after


def flat(shape: tuple[int, int]) -> U8:
    return np.full(shape, 90, np.uint8)


def plane_slowly(disparity_px: F32, y: int, x: int) -> F64:
    """Disparity and slopes at a pixel, by ridge regression of the samples that fit, twice."""
    grid = np.arange(-15, 16, 5)
    j, i = (values.ravel() for values in np.meshgrid(grid, grid, indexing="ij"))
    inside = (y + j >= 0) & (y + j < disparity_px.shape[0]) & (x + i >= 0) & (x + i < disparity_px.shape[1])
    j, i = j[inside], i[inside]
    d = disparity_px[y + j, x + i].astype(np.float64) - disparity_px[y, x]
    plane: F64 = np.zeros(3)
    tolerance = 1 + 0.15 * (np.abs(i) + np.abs(j))
    for _ in range(2):
        fits = np.abs(d - (plane[0] + plane[1] * i + plane[2] * j)) <= tolerance
        if fits.sum() < 6:
            return np.array([disparity_px[y, x], 0, 0])
        terms = np.stack([np.ones(fits.sum()), i[fits], j[fits]], axis=1)
        plane = np.linalg.solve(terms.T @ terms + np.diag([0, 250, 250]), terms.T @ d[fits])
        tolerance = np.ones(i.size)
    plane[0] += disparity_px[y, x]
    return plane


def planes_slowly(disparity_px: F32) -> F32:
    """Planes of all pixels beside holes: of tiles of 16 x 16 pixels, where one of the last four fits, that one."""
    height, width = disparity_px.shape
    planes = np.zeros((height, width, 3), np.float32)
    hole = np.pad(np.isnan(disparity_px), 1)
    for top in range(0, height, 16):
        for begin in range(0, width, 16):
            fitted: list[tuple[int, int]] = []
            for y in range(top, min(top + 16, height)):
                for x in range(begin, min(begin + 16, width)):
                    d = disparity_px[y, x]
                    if np.isnan(d) or not hole[y : y + 3, x : x + 3].any():
                        continue
                    for j, i in fitted[:-5:-1]:
                        at, along, down = planes[j, i]
                        at += along * (x - i) + down * (y - j)
                        if abs(at - d) <= 0.5:
                            planes[y, x] = at, along, down
                            break
                    else:
                        planes[y, x] = plane_slowly(disparity_px, y, x)
                        fitted.append((y, x))
    return planes


def proposals_slowly(disparity_px: F32, left: U8, planes: F32, y: int, x: int) -> list[tuple[np.float32, ...]]:
    """Disparity, score, slope and length of each ray that meets a surface."""
    height, width = disparity_px.shape
    low, high, one = np.nanmin(disparity_px), np.nanmax(disparity_px), np.float32(1)
    found = []
    for way in DIRECTIONS:
        j, i, total, number = y, x, 0, 0
        while np.isnan(disparity_px[j, i]):
            before = int(left[j, i])
            j, i, number = j + way[0], i + way[1], number + 1
            if not (0 <= j < height and 0 <= i < width):
                break
            total += abs(int(left[j, i]) - before)
        else:
            at, along, down = planes[j, i]
            d = np.clip(at - along * np.float32(i - x) - down * np.float32(j - y), low, high)
            score = np.float32(total) * np.float32(1 / np.float32(20))
            score += np.float32(number) * np.float32(np.hypot(*way) / np.float32(30))
            column = x - round(float(d))
            if 0 <= column < width:
                row = disparity_px[y]
                there = [v for u, v in enumerate(row) if np.isfinite(v) and u - round(float(v)) == column]
                score += 1000 * one if there and max(there) < d - 1 else one if not there else 0 * one
            found.append((d, score, along, np.float32(number), *map(np.float32, way)))
    return found


def filled_slowly(disparity_px: F32, left: U8, planes: F32) -> F32:
    after = disparity_px.copy()
    low, high = np.nanmin(disparity_px), np.nanmax(disparity_px)
    for y, x in np.argwhere(np.isnan(disparity_px)):
        if np.isfinite(after[y, x]):
            continue
        rays = proposals_slowly(disparity_px, left, planes, y, x)
        of_row = {int(ray[5]): ray for ray in rays if ray[4] == 0}
        quantile = 0.5
        if {-1, 1} <= of_row.keys():
            step = of_row[1][0] - of_row[-1][0]
            quantile = 0.2 if step > 1 and of_row[1][3] <= step + 3 else 0.5
        least = min(ray[1] for ray in rays)
        weights = [np.exp(-min(int((ray[1] - least) * 16), 128) / 16) for ray in rays]
        reached = {
            ray[0]: (sum(w for w, other in zip(weights, rays, strict=True) if other[0] <= ray[0]), ray[2])
            for ray in rays[::-1]
        }
        d, along = next((d, reached[d][1]) for d in sorted(reached) if reached[d][0] >= quantile * sum(weights))
        after[y, x] = round(float(d) * 64) / 64
        if x + 1 < after.shape[1] and np.isnan(after[y, x + 1]):
            after[y, x + 1] = round(float(np.clip(d + along, low, high)) * 64) / 64
    return after


@pytest.mark.parametrize("cores", [1, 2])
def test_every_pixel_is_filled_by_the_definition(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bands, "core_count", lambda: cores)
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:150, :61].astype(np.float32)
    disparity_px = np.where(x + 0.3 * y > 50, 22 - 0.06 * x, 9 + 0.05 * y + 0.02 * x)
    disparity_px = np.rint(64 * (disparity_px + rng.normal(0, 0.2, y.shape))).astype(np.float32) / 64
    disparity_px[rng.uniform(size=y.shape) < 0.02] = 31.25  # wrong ones
    for top, begin, rows, columns in ((0, 0, 40, 14), (30, 25, 25, 30), (70, 5, 17, 41), (100, 40, 33, 21)):
        disparity_px[top : top + rows, begin : begin + columns] = NAN
    disparity_px[rng.uniform(size=y.shape) < 0.1] = NAN
    left = rng.integers(0, 30, y.shape, np.uint8) + np.where(x > 33, 40, 0).astype(np.uint8)
    after = filled(disparity_px, left)
    expected = planes_slowly(disparity_px)
    np.testing.assert_array_equal(after, filled_slowly(disparity_px, left, expected))


def test_occluded_pixels_belong_to_the_background() -> None:
    """A wall at 4 px and a box at 16 px: the 12 columns beside the box are hidden from the right camera."""
    disparity_px = np.full((50, 90), 4, np.float32)
    disparity_px[10:50, 40:70] = 16
    truth = disparity_px.copy()
    disparity_px[10:50, 28:40] = NAN
    np.testing.assert_array_equal(filled(disparity_px, flat(truth.shape)), truth)


def test_surfaces_end_at_edges_of_the_image() -> None:
    """A box on the left, at 16 px, before a wall; both are seen by both cameras up to the edge, which is slanted."""
    y, x = np.mgrid[:60, :120]
    box = x < 50 + y // 5
    truth = np.where(box, 16, 4).astype(np.float32)
    disparity_px = truth.copy()
    disparity_px[12:47, 44:84] = NAN
    left = np.where(box, 160, 60).astype(np.uint8)
    wrong = filled(disparity_px, left) != truth
    assert wrong.sum() <= 35  # pixels are filled two by two: one in each row
    assert (filled(disparity_px, flat(truth.shape)) != truth).sum() > 100


@pytest.mark.parametrize(("along", "down"), [(0.125, 0.0), (0.0, -0.25), (-0.0625, 0.125)])
def test_slanted_planes_go_on(along: float, down: float) -> None:
    """Where the samples of a plane are complete, a hole of it has the plane but for the shrinkage of the slope.

    The shrinkage is 250 / (250 + the sum of squared distances of the samples), 49 x 100 px^2 of a whole window.
    """
    y, x = np.mgrid[:70, :100]
    truth = (30 + along * x + down * y).astype(np.float32)
    disparity_px = truth.copy()
    disparity_px[30:38, 40:52] = NAN
    error = np.abs(filled(disparity_px, flat(truth.shape)) - truth)
    assert error.max() <= 0.06 * (12 * abs(along) + 8 * abs(down)) + STEP_PX
    level = np.abs(filled(disparity_px, flat(truth.shape)) - disparity_px[34, 39])[30:38, 40:52]
    assert level.max() > 0.5  # it is not level


def test_pixels_whose_rays_meet_nothing_are_filled() -> None:
    disparity_px = np.full((9, 14), NAN, np.float32)
    disparity_px[3, 5] = 7.5
    np.testing.assert_array_equal(filled(disparity_px, flat((9, 14))), np.full((9, 14), 7.5, np.float32))


def test_empty_map_stays_empty() -> None:
    disparity_px = np.full((5, 8), NAN, np.float32)
    reasons = np.full((5, 8), Reason.UNIQUENESS, np.uint8)
    PlaneFilling(STEP_PX)(disparity_px, reasons, flat((5, 8)))
    assert np.isnan(disparity_px).all() and (reasons == Reason.UNIQUENESS).all()


def test_images_of_changing_size_and_read_only_ones() -> None:
    filling = PlaneFilling(STEP_PX)
    for shape in ((40, 30), (33, 52), (1, 9)):
        disparity_px = np.full(shape, 5, np.float32)
        disparity_px[:, 2:4] = NAN
        left = flat(shape)
        left.flags.writeable = False
        filling(disparity_px, np.zeros(shape, np.uint8), left)
        assert (disparity_px == 5).all()
