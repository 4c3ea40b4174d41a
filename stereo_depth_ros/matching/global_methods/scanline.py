# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Dynamic programming along scanlines with occlusion, ordering constraint and inter-scanline consistency."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import U8, MatchResult
from stereo_depth_ros.matching.costs.birchfield_tomasi import COST_STEPS
from stereo_depth_ros.matching.filters.plane_filling import PlaneFilling
from stereo_depth_ros.matching.global_methods.energy import I32, StereoModel
from stereo_depth_ros.matching.global_methods.global_matcher import NO_LABEL, GlobalMatcher

__all__ = ["ScanlineMatcher"]

OCCLUSION = 8.0  # gray levels, cost of an occluded pixel in either image
CONSISTENCY = 1.0  # weight of steps between scanlines relative to those along them; 0 is independent scanlines
FAR = np.int32(2**29)
MATCH, LEFT_ONLY, RIGHT_ONLY = range(3)


class ScanlineMatcher(GlobalMatcher):
    """Every scanline is the path of lowest cost through left and right row, consistent with the adjacent scanlines.

    Along a scanline (Cox, Hingorani, Rao and Maggs 1996; Belhumeur 1996) a path has three moves: left and right
    pixel match, the left pixel is occluded in the right image, or the right one in the left. So a pixel has at most one
    partner and the order of the pixels is the same in both rows. The cost of a match is the pixel dissimilarity, that
    of an occluded pixel a constant, and that of the end of a run of occluded pixels the cost of a discontinuity, lower
    at an intensity edge (edges also guide the path in Bobick and Intille 1999).

    Across scanlines (Ohta and Kanade 1985) edges that are connected between rows should keep their disparity. Ohta and
    Kanade search the path of whole edges in three dimensions; here steps between vertical neighbors cost as in
    ``energy.py``, again less across an intensity edge, and "occluded" is an additional label at the cost of a
    discontinuity from every disparity. For each scanline the sum over itself and all columns, which form a tree, is
    minimized exactly (the tree of Bleyer and Gelautz 2008): first the costs of the columns for each label of a pixel,
    then the path with these costs.

    Pixels occluded in the right image are NO_MATCH. With ``fill_holes`` every pixel has a disparity; filled pixels have
    confidence 0. ``support_px`` is that of :class:`GlobalMatcher`.
    """

    name = "scanline"

    def _match(self, left: U8, right: U8) -> MatchResult:
        result = super()._match(left, right)
        if self.config.fill_holes:
            PlaneFilling(result.step_px)(result.disparity_px, result.reasons, left)
        return result

    def _label(self, model: StereoModel) -> I32:
        height, width, count = model.data.shape
        costs = np.empty((height, width, count + 1), np.int32)
        occlusion = round(COST_STEPS * OCCLUSION)
        between = np.rint(CONSISTENCY * model.weights[1]).astype(np.int32)
        limits = (model.largest_step, model.largest_cost, occlusion)
        run_bands(_column_costs, width, model.data, between, *limits, costs)
        labels = np.empty((height, width), np.int32)
        run_bands(_path_rows, height, costs, model.weights[0] * model.largest_step, occlusion, labels)
        return labels


@compiled()
def _update_message(message: I32, data: I32, y: int, x: int, weight: int, largest_step: int, occlusion: int) -> None:
    """Update the message received by pixel (y, x) to the one it sends to its vertical neighbor, for each label.

    The last label is "occluded", ``largest_step`` away from all others. Messages are normalized to a minimum of 0.
    """
    count = message.size - 1
    hidden = message[count] + occlusion
    seen = message[0] + data[y, x, 0]
    for k in range(count):
        message[k] += data[y, x, k]
        seen = min(seen, message[k])
    for k in range(1, count):
        message[k] = min(message[k], message[k - 1] + weight)
    for k in range(count - 2, -1, -1):
        message[k] = min(message[k], message[k + 1] + weight)
    step = weight * largest_step
    least, most = min(seen, hidden), min(seen, hidden) + step
    for k in range(count):
        message[k] = min(message[k], most) - least
    message[count] = min(hidden, most) - least


@compiled("void(int64, int64, int32[:, :, ::1], int32[:, ::1], int32, int32, int32, int32[:, :, ::1])")
def _column_costs(
    first: int, last: int, data: I32, weights: I32, largest_step: int, largest_cost: int, occlusion: int, costs: I32
) -> None:
    """Minimum sum over a column for each label of each of its pixels, up to a constant; FAR outside the image.

    Args:
        first, last: columns of this band.
        weights: int32 (H, W), of the step to the row below.
        costs: int32 (H, W, N + 1), written; the last label is "occluded".
    """
    height, count = data.shape[0], data.shape[2]
    message = np.empty(count + 1, np.int32)
    for x in range(first, last):
        message[:] = 0
        for y in range(height):
            for k in range(count):
                costs[y, x, k] = data[y, x, k] + message[k]
            costs[y, x, count] = occlusion + message[count]
            _update_message(message, data, y, x, weights[y, x], largest_step, occlusion)
        message[:] = 0
        for y in range(height - 1, -1, -1):
            for k in range(count):
                costs[y, x, k] = costs[y, x, k] + message[k] if data[y, x, k] <= largest_cost else FAR
            costs[y, x, count] += message[count]
            if y > 0:
                _update_message(message, data, y, x, weights[y - 1, x], largest_step, occlusion)


@compiled()
def _trace_back(origin: U8, state: int, k: int, y: int, labels: I32) -> None:
    """Write the labels of row ``y``, from the end of its path back to the start."""
    x = origin.shape[0] - 1
    while x >= 0:
        if state == MATCH:
            labels[y, x] = k
            state = origin[x, k] & 3
            x -= 1
        elif state == LEFT_ONLY:
            labels[y, x] = NO_LABEL
            state = LEFT_ONLY if origin[x, k] & 4 else MATCH
            k -= 1
            x -= 1
        else:
            state = RIGHT_ONLY if origin[x, k] & 8 else MATCH
            k += 1


@compiled("void(int64, int64, int32[:, :, ::1], int32[:, ::1], int32, int32[:, ::1])")
def _path_rows(first: int, last: int, costs: I32, gaps: I32, occlusion: int, labels: I32) -> None:
    """The path of lowest cost of each row, as labels.

    The position of a path is (x, k): the end of left pixel x and of right pixel x - disparity(k). An
    occluded left pixel moves it to (x + 1, k + 1), an occluded right pixel to (x, k - 1), a match to (x + 1, k). A run
    of occluded pixels is in one image and ends with a match.

    Args:
        costs: int32 (H, W, N + 1) of :func:`_column_costs`.
        gaps: int32 (H, W), cost of ending a run of occluded pixels between a pixel and its right neighbor.
        occlusion: cost of an occluded right pixel.
        labels: int32 (H, W), written.
    """
    width, count = labels.shape[1], costs.shape[2] - 1
    matched, left_only, right_only = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.int32)
    origin = np.empty((width, count), np.uint8)  # bits 0, 1: state before a match; 2: before LEFT_ONLY; 3: RIGHT_ONLY
    for y in range(first, last):
        for k in range(count):
            matched[k] = 0 if costs[y, 0, k] < FAR else FAR
            left_only[k] = right_only[k] = FAR
        for x in range(width):
            gap = gaps[y, x - 1] if x > 0 else 0
            hidden = costs[y, x, count]
            previous_match = previous_left = FAR
            for k in range(count):
                match, left, right = matched[k], left_only[k] + gap, right_only[k] + gap
                least = min(match, left, right)
                state = MATCH if match == least else LEFT_ONLY if left == least else RIGHT_ONLY
                origin[x, k] = state + (4 if previous_left < previous_match else 0)
                matched[k] = min(least + costs[y, x, k], FAR)
                left = left_only[k]
                left_only[k] = min(min(previous_match, previous_left) + hidden, FAR)
                previous_match, previous_left = match, left
            right_only[count - 1] = FAR
            for k in range(count - 2, -1, -1):
                origin[x, k] += 8 if right_only[k + 1] < matched[k + 1] else 0
                right_only[k] = min(min(matched[k + 1], right_only[k + 1]) + occlusion, FAR)
        least, at, state = FAR, 0, MATCH
        for k in range(count):
            if matched[k] < least:
                least, at, state = matched[k], k, MATCH
            if left_only[k] < least:
                least, at, state = left_only[k], k, LEFT_ONLY
        _trace_back(origin, state, at, y, labels)
