# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sparse matcher of corners and line segments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, F64, U8, Frame, MatchResult, Reason
from stereo_depth_ros.matching.features.corner_checks import agree_with_neighbors, check_corners
from stereo_depth_ros.matching.features.corners import detect_orb, detect_sift, squared_distances_of_pairs
from stereo_depth_ros.matching.features.line_checks import check_lines
from stereo_depth_ros.matching.features.line_segments import common_rows, detect_segments, line_similarity
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair, check_search
from stereo_depth_ros.matching.serial import SerialMatcher

__all__ = ["FeatureMatcher", "FeatureMatches", "nearest_pixels"]

Indices: TypeAlias = npt.NDArray[np.intp]

MAX_ROW_DIFFERENCE_PX = 1.0
MAX_CORNERS = 4000  # per image, the strongest
FAST_THRESHOLD = 10  # with the default of 20, dark scenes have no corners
MIN_COMMON_ROWS = 3
MIN_COMMON_SHARE = 0.5  # of the rows of the shorter of two segments
ONTO_SURFACE_PX = 2.0  # from a line at a depth edge to the pixels of the near surface
# Largest cost of a match: distance of SIFT descriptors (up to 724), bits of ORB descriptors (256), squared standard
# deviations of lines. Higher limits add more wrong matches than correct ones.
MAX_COST = {"sift": 250.0, "orb": 50.0, "lines": 4.0}
NOISE_SHARE = 0.1  # of the largest cost: candidates below it are equally good
SUPPORT_PX = (15, 15)  # approximate extent of the smallest descriptors
RIVAL_PX = 2.0  # candidates closer in disparity are the same feature, for example at two scales


@dataclass(frozen=True, eq=False)
class FeatureMatches:
    """N points of the left image and the same points in the right image.

    Attributes:
        left_xy, right_xy: float64 (N, 2), px; pixel centers are whole numbers.
        score: float64 (N,), from 0, no better than another candidate, to 1, identical and unique.
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
        """The matches of these indices or of this mask."""
        return FeatureMatches(self.left_xy[chosen], self.right_xy[chosen], self.score[chosen])

    def moved(self, x_px: F64) -> FeatureMatches:
        """Both points moved along the row, float64 (N,) px; disparities stay."""
        step = np.stack((x_px, np.zeros_like(x_px)), axis=1)
        return FeatureMatches(self.left_xy + step, self.right_xy + step, self.score)

    def inside(self, left_mask: U8, right_mask: U8) -> FeatureMatches:
        """The matches whose left and right points are inside the masks of these images, uint8 (H, W), not 0."""
        seen = (
            left_mask[nearest_pixels(self.left_xy, left_mask)] & right_mask[nearest_pixels(self.right_xy, right_mask)]
        )
        return self.take(seen != 0)

    def colors(self, left: Frame) -> U8:
        """uint8 (N, 3): red, green and blue of the left pixels that contain the features."""
        height, width = left.pixels.shape[:2]
        pixels = left.pixels.reshape(height, width, -1)[nearest_pixels(self.left_xy, left.pixels)]
        rgb: U8 = pixels[:, {"mono8": (0, 0, 0), "rgb8": (0, 1, 2), "bgr8": (2, 1, 0)}[left.encoding]]
        return rgb

    def points_m(self, triangulation: Triangulation) -> F64:
        """float64 (N, 3): X, Y, Z in the left rectified frame, meters; NaN where the disparity is not above doffs."""
        return triangulation.points(self.left_xy, self.right_xy)


class FeatureMatcher(SerialMatcher):
    """Corners, SIFT (Lowe 2004) or ORB (Rublee et al. 2011), or line segments, matched by their descriptors.

    A left feature is compared with the right features within one row of it and within the search range. A match must be
    the best one for both features (LEFT_RIGHT otherwise), have a cost below a limit (NO_MATCH otherwise), and be better
    than every candidate elsewhere by ``uniqueness_ratio`` (UNIQUENESS otherwise). Costs are distances of descriptors;
    for lines 1 / S, S being :func:`line_similarity`. The confidence is 1 minus the cost over the lowest cost elsewhere,
    or over the largest cost allowed if that is lower; costs of less than a tenth of that are noise.

    Left corners have the positions of their detector, right ones are refined along the row and checked
    (:func:`check_corners`), and corners must agree with their neighbors (:func:`agree_with_neighbors`, SPECKLE
    otherwise). Matched lines have a disparity in each common row; the image must move
    with them on one side at least (:func:`check_lines`, NO_MATCH otherwise). Where it does on one side only, at a depth
    edge, the points are moved by 2 px to that side: that surface has the disparity.
    Pixels without a feature are NO_MATCH. ``support_px`` is the approximate extent of the smallest descriptors.
    """

    name = "features"
    step_px = 1 / X16_STEPS
    support_px = SUPPORT_PX

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if the search range does not fit in 16-bit disparities."""
        check_search(config)
        super().__init__(config)

    def _match(self, left: U8, right: U8) -> MatchResult:
        """Features are written to the pixels that contain them."""
        check_pair(left, right, self)
        matches, lost_xy, why = self._find(left, right, MAX_ROW_DIFFERENCE_PX)
        reasons = np.full(left.shape, Reason.NO_MATCH, np.uint8)
        reasons[nearest_pixels(lost_xy, left)] = why
        columns = np.arange(left.shape[1])
        outside = (columns < self.config.min_disparity) | (columns - self.config.max_disparity > columns[-1])
        reasons[:, outside] = Reason.BORDER
        matches = matches.take(np.argsort(matches.score, kind="stable"))  # of several in one pixel the best is last
        at = nearest_pixels(matches.left_xy, left)
        confidence = np.zeros(left.shape, np.float32)
        disparity_px = np.full(left.shape, np.nan, np.float32)
        disparity_px[at], confidence[at], reasons[at] = matches.disparity_px, matches.score, Reason.VALID
        return MatchResult(disparity_px, reasons, self.step_px, confidence)

    def find(self, left: U8, right: U8, max_row_difference_px: float = MAX_ROW_DIFFERENCE_PX) -> FeatureMatches:
        """The matched features; of lines, a point in each row.

        Args:
            left, right: uint8 (H, W), gray, rectified; corners may also be in unrectified pairs.
            max_row_difference_px: largest row difference of two corners; points of lines have equal rows.

        Raises:
            ImageError: see :class:`~stereo_depth_ros.matching.protocol.Matcher`.
        """
        check_pair(left, right, self)
        return self._find(left, right, max_row_difference_px)[0]

    def _find(self, left: U8, right: U8, max_row_difference_px: float) -> tuple[FeatureMatches, F64, U8]:
        """The matches; points of unmatched left features, float64 (N, 2); their reasons, uint8 (N,)."""
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
        matches, why = self._checked(left, right, _without_repetition(matches))
        lost = reasons != 0
        lost_xy = np.concatenate((left_xy[lost], matches.left_xy[why != 0]))
        return matches.take(why == 0), lost_xy, np.concatenate((reasons[lost], why[why != 0]))

    def _checked(self, left: U8, right: U8, matches: FeatureMatches) -> tuple[FeatureMatches, U8]:
        """The matches with refined right points, and the reasons of those that the checks reject, uint8 (N,)."""
        search_px = self.config.min_disparity, self.config.max_disparity
        unique = self.config.uniqueness_ratio > 0
        checked = check_corners(left, right, matches.left_xy, matches.right_xy, search_px, unique)
        reasons = checked.reasons
        reasons[(reasons == 0) & ~self._searched(checked.disparity_px)] = Reason.NO_MATCH
        kept = np.flatnonzero(reasons == 0)
        agree = agree_with_neighbors(matches.left_xy[kept], checked.disparity_px[kept])
        reasons[kept[~agree]] = Reason.SPECKLE
        right_xy = np.stack((matches.left_xy[:, 0] - checked.disparity_px, matches.right_xy[:, 1]), axis=1)
        return FeatureMatches(matches.left_xy, right_xy, matches.score), reasons

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
        search_px = config.min_disparity, config.max_disparity
        smaller, larger = check_lines(left, right, pair, matches.left_xy, matches.disparity_px, search_px)
        reasons[i[~smaller & ~larger]] = Reason.NO_MATCH
        beside_px = ONTO_SURFACE_PX * (larger.astype(np.float64) - smaller)
        matches = matches.moved(beside_px[pair]).take((smaller | larger)[pair])
        lost = np.flatnonzero(reasons)
        segment, rows = _whole_numbers(*ours.ends[lost, :, 1].T)
        return matches, ours.take(lost[segment]).at(rows), reasons[lost[segment]]

    def _searched(self, disparity_px: F64) -> npt.NDArray[np.bool_]:
        searched: npt.NDArray[np.bool_] = disparity_px >= self.config.min_disparity
        return searched & (disparity_px <= self.config.max_disparity)


def nearest_pixels(xy: F64, image: npt.NDArray[Any]) -> tuple[Indices, Indices]:
    """Rows and columns of the pixels of ``image``, (H, W) or (H, W, C), that contain points, float64 (N, 2)."""
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
    """Pairs that are matches and their scores, and the reasons of all ``count`` left features.

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
    """For each group the index of its lowest cost, the first one of equal costs."""
    order = np.lexsort((cost, group))
    return order[np.unique(group[order], return_index=True)[1]]


def _without_repetition(matches: FeatureMatches) -> FeatureMatches:
    """The best match of each left position: SIFT returns a corner once per orientation."""
    ordered = matches.take(np.argsort(-matches.score, kind="stable"))
    return ordered.take(np.unique(ordered.left_xy, axis=0, return_index=True)[1])


def _whole_numbers(first: npt.NDArray[Any], last: npt.NDArray[Any]) -> tuple[Indices, Indices]:
    """All integers from first[k] to last[k] inclusive, for each k; returns the k and the integers."""
    begin = np.ceil(first).astype(np.intp)
    counts = np.maximum(0, np.floor(last).astype(np.intp) + 1 - begin)
    k = np.repeat(np.arange(len(counts)), counts)
    return k, begin[k] + np.arange(len(k)) - np.repeat(np.cumsum(counts) - counts, counts)
