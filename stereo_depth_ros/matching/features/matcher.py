# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sparse matching of corners and line segments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, F64, U8, Frame, MatchResult, Reason
from stereo_depth_ros.matching.features.corners import detect_orb, detect_sift, squared_distances_of_pairs
from stereo_depth_ros.matching.features.line_segments import common_rows, detect_segments, line_similarity
from stereo_depth_ros.matching.features.lucas_kanade import refine_right_points
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair, check_search
from stereo_depth_ros.matching.serial import SerialMatcher

__all__ = ["FeatureMatcher", "FeatureMatches", "nearest_pixels"]

Indices: TypeAlias = npt.NDArray[np.intp]

MAX_ROW_DIFFERENCE_PX = 1.0
MAX_CORNERS = 4000  # of an image, the strongest
FAST_THRESHOLD = 10  # with ORB's own 20, dim rooms are empty
REFINEMENT_WINDOW_PX = 11
MIN_COMMON_ROWS = 3
MIN_COMMON_SHARE = 0.5  # of the rows of the shorter of two segments
# Above this cost two features are taken for different ones: distance of SIFT descriptors (up to 724), bits of ORB
# descriptors (256), squared standard deviations of lines. Higher limits let in more wrong matches than right ones.
MAX_COST = {"sift": 250.0, "orb": 50.0, "lines": 4.0}
NOISE_SHARE = 0.1  # of the highest cost: two candidates that cost less are equally good
SUPPORT_PX = (15, 15)  # about what the smallest descriptors look at
RIVAL_PX = 2.0  # candidates with nearer disparities are one place found twice, at two scales for example


@dataclass(frozen=True, eq=False)
class FeatureMatches:
    """N points of the left image and the same points in the right image.

    Attributes:
        left_xy, right_xy: float64 (N, 2), px; pixel centers are whole numbers.
        score: float64 (N,), from 0, no better than another candidate, to 1, equal and alone.
    """

    left_xy: F64
    right_xy: F64
    score: F64

    def __len__(self) -> int:
        return len(self.score)

    @property
    def disparity_px(self) -> F64:
        """float64 (N,), x_left - x_right, px."""
        disparity: F64 = self.left_xy[:, 0] - self.right_xy[:, 0]
        return disparity

    def take(self, chosen: npt.NDArray[Any]) -> FeatureMatches:
        """The matches of these indices, or of this mask."""
        return FeatureMatches(self.left_xy[chosen], self.right_xy[chosen], self.score[chosen])

    def inside(self, left_mask: U8, right_mask: U8) -> FeatureMatches:
        """The matches whose left and right points lie where the masks of these images, uint8 (H, W), are not 0."""
        seen = (
            left_mask[nearest_pixels(self.left_xy, left_mask)] & right_mask[nearest_pixels(self.right_xy, right_mask)]
        )
        return self.take(seen != 0)

    def colors(self, left: Frame) -> U8:
        """uint8 (N, 3): red, green and blue of the left pixels in which the features lie."""
        height, width = left.pixels.shape[:2]
        pixels = left.pixels.reshape(height, width, -1)[nearest_pixels(self.left_xy, left.pixels)]
        rgb: U8 = pixels[:, {"mono8": (0, 0, 0), "rgb8": (0, 1, 2), "bgr8": (2, 1, 0)}[left.encoding]]
        return rgb

    def points_m(self, triangulation: Triangulation) -> F64:
        """float64 (N, 3): X, Y, Z in the left rectified frame, meters; NaN where the disparity is not above doffs."""
        return triangulation.points(self.left_xy, self.right_xy)


class FeatureMatcher(SerialMatcher):
    """Corners, SIFT (Lowe 2004) or ORB (Rublee et al. 2011), or line segments, matched by what describes them.

    A left feature is compared with the right features of its row, give or take a pixel, at the disparities searched.
    The match kept is the best one of both features, at a cost that is low enough (NO_MATCH otherwise; LEFT_RIGHT where
    the right feature prefers another), and wins over every candidate elsewhere by ``uniqueness_ratio`` (UNIQUENESS).
    Costs are distances of descriptors; for lines 1 / S, S being :func:`line_similarity`. The confidence is 1 minus the
    cost over the least cost elsewhere, or over the highest cost allowed where that is less; costs of less than a tenth
    of that are noise.

    Corners have the sub-pixel positions of their detector. ORB finds them at whole pixels: the right ones are moved to
    where the gray values agree with those around the left ones (Lucas and Kanade 1981). Lines that match have a
    disparity in each row that both cross. Pixels without a feature are NO_MATCH.
    """

    name = "features"
    step_px = 1 / X16_STEPS
    support_px = SUPPORT_PX

    def __init__(self, config: MatchingConfig) -> None:
        """ConfigError where the search does not fit in 16-bit disparities."""
        check_search(config)
        super().__init__(config)

    def _match(self, left: U8, right: U8) -> MatchResult:
        """A feature is told at the pixel it lies in."""
        check_pair(left, right, self.config)
        matches, lost_xy, why = self._find(left, right, MAX_ROW_DIFFERENCE_PX)
        reasons = np.full(left.shape, Reason.NO_MATCH, np.uint8)
        reasons[nearest_pixels(lost_xy, left)] = why
        columns = np.arange(left.shape[1])
        outside = (columns < self.config.min_disparity) | (columns - self.config.max_disparity > columns[-1])
        reasons[:, outside] = Reason.BORDER
        matches = matches.take(np.argsort(matches.score, kind="stable"))  # of several in a pixel the best comes last
        at = nearest_pixels(matches.left_xy, left)
        confidence = np.zeros(left.shape, np.float32)
        disparity_px = np.full(left.shape, np.nan, np.float32)
        disparity_px[at], confidence[at], reasons[at] = matches.disparity_px, matches.score, Reason.VALID
        return MatchResult(disparity_px, reasons, self.step_px, confidence)

    def find(self, left: U8, right: U8, max_row_difference_px: float = MAX_ROW_DIFFERENCE_PX) -> FeatureMatches:
        """The matched features themselves; of lines, a point in each row.

        Args:
            left, right: uint8 (H, W), gray, rectified; corners are found in other pairs too.
            max_row_difference_px: by how much the rows of two corners may differ; points of lines have equal rows.

        Raises:
            ImageError: see :class:`~stereo_depth_ros.matching.protocol.Matcher`.
        """
        check_pair(left, right, self.config)
        return self._find(left, right, max_row_difference_px)[0]

    def _find(self, left: U8, right: U8, max_row_difference_px: float) -> tuple[FeatureMatches, F64, U8]:
        """The matches; points of left features that have none, float64 (N, 2); the reasons, uint8 (N,)."""
        if self.config.feature_type == "lines":
            return self._find_lines(left, right)
        return self._find_corners(left, right, max_row_difference_px)

    def _find_corners(self, left: U8, right: U8, max_row_difference_px: float) -> tuple[FeatureMatches, F64, U8]:
        kind = self.config.feature_type
        (left_xy, left_descriptors), (right_xy, right_descriptors) = _detect(left, kind), _detect(right, kind)
        i, j = _in_common_rows(left_xy[:, 1], right_xy[:, 1], max_row_difference_px)
        near = self._searched(left_xy[i, 0] - right_xy[j, 0])
        i, j = i[near], j[near]
        squared = squared_distances_of_pairs(left_descriptors, right_descriptors, i, j)
        cost = np.sqrt(squared) if kind == "sift" else squared
        best, score, reasons = _select(i, j, cost, left_xy[i, 0] - right_xy[j, 0], len(left_xy), self.config)
        matches = FeatureMatches(left_xy[i[best]], right_xy[j[best]], score)
        if kind == "orb":
            matches = _refine(left, right, matches)
            rows_px = np.abs(matches.left_xy - matches.right_xy)[:, 1]
            matches = matches.take(self._searched(matches.disparity_px) & (rows_px <= max_row_difference_px))
        return _without_repetition(matches), left_xy[reasons != 0], reasons[reasons != 0]

    def _find_lines(self, left: U8, right: U8) -> tuple[FeatureMatches, F64, U8]:
        config = self.config
        ours, theirs = detect_segments(left), detect_segments(right)
        first, last = common_rows(ours, theirs)
        ends_px = np.stack([ours.columns(rows.T).T - theirs.columns(rows) for rows in (first, last)])
        least = np.maximum(MIN_COMMON_ROWS, MIN_COMMON_SHARE * np.minimum.outer(ours.height, theirs.height))
        i, j = np.nonzero(self._searched(ends_px).all(axis=0) & (last - first >= least))
        cost = 1 / line_similarity(ours, theirs, config.min_disparity, config.max_disparity)[i, j]
        best, score, reasons = _select(i, j, cost, ends_px.mean(axis=0)[i, j], len(ours), config)
        i, j = i[best], j[best]
        pair, rows = _whole_numbers(first[i, j], last[i, j])
        matches = FeatureMatches(ours.take(i[pair]).at(rows), theirs.take(j[pair]).at(rows), score[pair])
        lost = np.flatnonzero(reasons)
        segment, rows = _whole_numbers(*ours.ends[lost, :, 1].T)
        return matches, ours.take(lost[segment]).at(rows), reasons[lost[segment]]

    def _searched(self, disparity_px: F64) -> npt.NDArray[np.bool_]:
        searched: npt.NDArray[np.bool_] = disparity_px >= self.config.min_disparity
        return searched & (disparity_px <= self.config.max_disparity)


def nearest_pixels(xy: F64, image: npt.NDArray[Any]) -> tuple[Indices, Indices]:
    """Rows and columns of the pixels of ``image``, (H, W) or (H, W, C), in which points, float64 (N, 2), lie."""
    columns, rows = np.rint(xy).astype(np.intp).T
    return rows.clip(0, image.shape[0] - 1), columns.clip(0, image.shape[1] - 1)


def _detect(image: U8, kind: str) -> tuple[F64, F32]:
    """Positions, float64 (N, 2) px, and descriptors, float32 (N, D)."""
    return detect_sift(image, MAX_CORNERS) if kind == "sift" else detect_orb(image, MAX_CORNERS, FAST_THRESHOLD)


def _in_common_rows(left_y: F64, right_y: F64, tolerance: float) -> tuple[Indices, Indices]:
    """Indices of all pairs of a left and a right point whose rows differ by at most ``tolerance``."""
    order = np.argsort(right_y, kind="stable")
    begin = np.searchsorted(right_y, left_y - tolerance, "left", order)
    end = np.searchsorted(right_y, left_y + tolerance, "right", order)
    left, position = _whole_numbers(begin, end - 1)
    return left, order[position]


def _select(
    i: Indices, j: Indices, cost: F64, disparity_px: F64, count: int, config: MatchingConfig
) -> tuple[Indices, F64, U8]:
    """Pairs that are matches and their scores, and of all ``count`` left features why not.

    Args:
        i, j: (P,), left and right feature of each pair.
        cost, disparity_px: float64 (P,).
    """
    best = _cheapest(i, cost)
    place_px = np.zeros(count)
    place_px[i[best]] = disparity_px[best]
    elsewhere = np.abs(disparity_px - place_px[i]) > RIVAL_PX
    rivals = np.full(count, np.inf)
    np.minimum.at(rivals, i[elsewhere], cost[elsewhere])
    least, rival, limit = cost[best], rivals[i[best]], MAX_COST[config.feature_type]
    noise = NOISE_SHARE * limit
    ambiguous = rival <= np.maximum(least, noise) * (1 + config.uniqueness_ratio / 100)
    tests = (least > limit, ~np.isin(best, _cheapest(j, cost)), ambiguous & (config.uniqueness_ratio > 0))
    why = np.select(tests, (Reason.NO_MATCH, Reason.LEFT_RIGHT, Reason.UNIQUENESS), Reason.VALID)
    reasons = np.full(count, Reason.NO_MATCH, np.uint8)
    reasons[i[best]] = why
    bound = np.minimum(rival, limit)
    score = (bound - least) / np.maximum(bound, noise)
    return best[why == Reason.VALID], score[why == Reason.VALID], reasons


def _cheapest(group: Indices, cost: F64) -> Indices:
    """For each group in turn the index of its least cost, the first one where several are equal."""
    order = np.lexsort((cost, group))
    return order[np.unique(group[order], return_index=True)[1]]


def _refine(left: U8, right: U8, matches: FeatureMatches) -> FeatureMatches:
    """The right points moved to where the windows around left and right points agree; fewer where some do not."""
    right_xy, refined = refine_right_points(
        left, right, matches.left_xy, matches.right_xy, window_px=REFINEMENT_WINDOW_PX, max_move_px=RIVAL_PX
    )
    return FeatureMatches(matches.left_xy, right_xy, matches.score).take(refined)


def _without_repetition(matches: FeatureMatches) -> FeatureMatches:
    """The best match of each left position: SIFT tells a corner once for each of its orientations."""
    ordered = matches.take(np.argsort(-matches.score, kind="stable"))
    return ordered.take(np.unique(ordered.left_xy, axis=0, return_index=True)[1])


def _whole_numbers(first: npt.NDArray[Any], last: npt.NDArray[Any]) -> tuple[Indices, Indices]:
    """All whole numbers from first[k] to last[k], both included, for each k in turn; of each its k and itself."""
    begin = np.ceil(first).astype(np.intp)
    counts = np.maximum(0, np.floor(last).astype(np.intp) + 1 - begin)
    k = np.repeat(np.arange(len(counts)), counts)
    return k, begin[k] + np.arange(len(k)) - np.repeat(np.cumsum(counts) - counts, counts)
