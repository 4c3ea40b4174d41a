# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching of census costs, the default matcher."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import core_count, run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.matching.costs.census import (
    CENSUS_BITS,
    CENSUS_WINDOW,
    census_rows,
    empty_census,
)
from stereo_depth_ros.matching.costs.features import UNRELATED_COST, feature_costs
from stereo_depth_ros.matching.costs.prior import prior_costs
from stereo_depth_ros.matching.filters.disparity_filter import DisparityFilter
from stereo_depth_ros.matching.filters.gap_filling import fill_gaps
from stereo_depth_ros.matching.filters.plane_filling import PlaneFilling
from stereo_depth_ros.matching.filters.speckle_filter import I16, SpeckleFilter
from stereo_depth_ros.matching.local_consistency import local_consistency
from stereo_depth_ros.matching.networks.features import FeatureNetwork
from stereo_depth_ros.matching.protocol import Images, check_pair
from stereo_depth_ros.matching.serial import SerialMatcher
from stereo_depth_ros.matching.sgm.path_costs import LARGEST_PATH_COST
from stereo_depth_ros.matching.sgm.strips import (
    SPECKLE_STEPS_PER_PX,
    STEPS_PER_PX,
    Output,
    Scratch,
    Search,
    match_bands,
)

__all__ = ["SemiGlobalMatcher"]

EDGE_GRAY_LEVELS = 6.0  # difference of neighbors at which P2 is halved
UNIQUENESS_SHARE = 1 / 3  # of uniqueness_ratio: sums over paths differ less than the window sums it is defined for
STRIP_BYTES = 24 << 20  # of costs: smaller strips stay in the cache, larger ones need less warm-up
APPROACH_ROWS = 16
APPROACH_BYTES = 64 << 20  # of costs: searches of thousands of disparities have fewer warm-up rows
_NAN = np.float32(np.nan)


class SemiGlobalMatcher(SerialMatcher):
    """Semi-global matching (Hirschmueller 2008) of census costs (Zabih and Woodfill 1994).

    Costs are Hamming distances of 9 x 7 census codes, smoothed over 3 x 3 pixels. They are summed along ``sgm_paths``
    directions, with P2 lowered at edges of the left image: P2 / (1 + |difference| / 6), not below P1. The best
    disparity has a sub-pixel part from two lines of opposite slope, corrected for pixel locking (Haller and Nedevschi
    2012). The left-right check uses the same sums for the right pixels. The speckle filter and ``disparity_filter``
    follow.

    Vertical paths run over strips of rows, each with 16 warm-up rows: strips are independent, and their costs stay in
    the cache (as the stripes of Spangenberg et al. 2014). Their heights depend on the image size and the search range
    only, so that the result does not depend on the number of cores.

    The margin of a winner over the best sum at least 2 px away is (second - best) / second, and must be at least a
    third of ``uniqueness_ratio`` percent; it is 0 if the right image has no second candidate. The confidence is this
    margin times the local consistency, computed on demand.

    ``fill_gaps_px`` fills short gaps of rows, with the lesser margin of both ends. With ``fill_holes`` every pixel has
    a disparity; pixels that it fills have confidence 0.

    With ``temporal_window`` T above 1 the cost of a disparity is the mean of its Hamming distances in the last T pairs:
    the scene is static and its light changes, as in :mod:`stereo_depth_ros.matching.spacetime.matcher`. P2 then follows
    the edges of the mean of the left images.

    With ``sgm_cost`` onnx the costs are products of features of a network, see
    :class:`~stereo_depth_ros.matching.networks.features.FeatureNetwork`, in the range of those of the census.

    With a prior, disparities that another sensor expects, the costs of others rise up to a bound
    (:func:`~stereo_depth_ros.matching.costs.prior.prior_costs`), before they are summed along paths.

    ``support_px`` is the census window, 9 x 7 pixels; the smoothing of the costs reads one more on all sides. With
    a network it is the border without features and the pixel between.
    """

    name = "sgm"
    step_px = 1 / STEPS_PER_PX
    support_px = CENSUS_WINDOW

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if the penalties contradict each other."""
        _check_penalties(config)
        super().__init__(config)
        self._speckle_filter = SpeckleFilter(config.speckle_size, config.speckle_range * SPECKLE_STEPS_PER_PX)
        self._disparity_filter = DisparityFilter(config.disparity_filter, self.step_px)
        self._plane_filling = PlaneFilling(self.step_px)
        lowered = config.sgm_P2 * EDGE_GRAY_LEVELS / (EDGE_GRAY_LEVELS + np.arange(256))
        self._search = Search(
            max_disparity=config.max_disparity,
            disparities=config.num_disparities,
            uniqueness=UNIQUENESS_SHARE * config.uniqueness_ratio / 100,
            tolerance=max(config.disp12_max_diff, 1),
            P1=np.uint8(config.sgm_P1),
            P2=np.maximum(lowered, config.sgm_P1).astype(np.uint8),
            approach_rows=APPROACH_ROWS,
        )
        self.pair_count = config.temporal_window or 1
        self._shape = (0, 0)
        self._costs: U8 = np.empty((0, 0, 0), np.uint8)  # of a network
        self._network = FeatureNetwork(config) if config.sgm_cost == "onnx" else None
        if self._network is not None:
            _check_single(config)
            self.engine = self._network.engine
            self.support_px = (2 * self._network.border_px + 1,) * 2

    def _match(self, left: U8, right: U8) -> MatchResult:
        return self._match_pairs([(left, right)], None)

    def _match_pairs(self, pairs: Sequence[Images], prior: DisparityPrior | None) -> MatchResult:
        left, right = pairs[-1]
        check_pair(left, right, self, partial=True)
        disparity_px = np.empty(left.shape, np.float32)
        reasons = np.empty(left.shape, np.uint8)
        margin = np.empty(left.shape, np.float32)
        if self._shape != left.shape:
            self._allocate(*left.shape)
        census = self._census[: len(pairs)]
        if self._network is not None:
            self._costs_of_network(self._network, left, right)
        else:
            for pair, codes in zip(pairs, census, strict=True):
                for image, own in zip(pair, codes, strict=True):
                    run_bands(census_rows, len(image), image, own)
        output = Output(disparity_px, self._coarse, reasons, margin)
        bands = len(self._scratch.raw)
        image = _mean_image([pair[0] for pair in pairs])
        given = (image, census, self._costs, prior_costs(prior, image), self._search)
        run_bands(match_bands, bands, bands, self._strips, *given, self._scratch, output, min_rows=1)
        self._speckle_filter(self._coarse, reasons)
        run_bands(_reject_rows, len(left), reasons, disparity_px, margin)
        self._disparity_filter(disparity_px)
        fill_gaps(disparity_px, reasons, margin, self.config.fill_gaps_px, self.step_px)
        if self.config.fill_holes:
            self._plane_filling(disparity_px, reasons, left)
        return MatchResult(
            disparity_px, reasons, self.step_px, functools.partial(local_consistency, disparity_px, margin)
        )

    def _costs_of_network(self, network: FeatureNetwork, left: U8, right: U8) -> None:
        shape = (*left.shape, self.config.num_disparities)
        if self._costs.shape != shape:
            self._costs = np.empty(shape, np.uint8)
        features = network(left), network(right)
        run_bands(feature_costs, len(left), *features, self.config.max_disparity, UNRELATED_COST, self._costs)

    def _allocate(self, height: int, width: int) -> None:
        count = self.config.num_disparities
        approach = min(max(APPROACH_BYTES // (width * count), 2), APPROACH_ROWS)
        rows = min(max(STRIP_BYTES // (2 * width * count), approach), 128)
        self._strips = min(4 * -(-height // (4 * rows)), height)  # a multiple of 4, to balance 2 or 4 cores
        highest = -(-height // self._strips)
        bands = min(core_count(), self._strips)
        self._scratch = Scratch.allocate(bands, min(highest + 2 * approach, height), width, self.config)
        self._search = self._search._replace(approach_rows=approach)
        self._coarse: I16 = np.zeros((height, width), np.int16)
        self._census = empty_census(self.pair_count, 2, height, width)
        self._shape = (height, width)


def _mean_image(images: Sequence[U8]) -> U8:
    """The mean of the left images, in which the edges of projected patterns average out; uint8 (H, W)."""
    if len(images) == 1:
        return images[0]
    total = np.zeros(images[0].shape, np.uint16)
    for image in images:
        total += image
    return np.asarray(total // len(images), np.uint8)


def _check_single(config: MatchingConfig) -> None:
    if config.temporal_window > 1:
        raise ConfigError(
            f"temporal_window = {config.temporal_window} has no effect on the costs of a network (sgm_cost = onnx)",
            value=config.temporal_window,
            limit=1,
            remedy="set it to 1, or sgm_cost to census",
            settings=("temporal_window", "sgm_cost"),
        )


def _check_penalties(config: MatchingConfig) -> None:
    total, largest = config.sgm_P1 + config.sgm_P2, LARGEST_PATH_COST - CENSUS_BITS
    if config.sgm_P2 <= config.sgm_P1:
        raise ConfigError(
            f"sgm_P2 = {config.sgm_P2} is not above sgm_P1 = {config.sgm_P1}",
            value=config.sgm_P2,
            limit=config.sgm_P1,
            remedy="raise it",
            settings=("sgm_P2",),
        )
    if total > largest:
        raise ConfigError(
            f"sgm_P1 + sgm_P2 = {total} is above {largest}, the limit of 8-bit sums",
            value=total,
            limit=largest,
            remedy="lower one of them",
            settings=("sgm_P1", "sgm_P2"),
        )


@compiled("void(int64, int64, uint8[:, ::1], float32[:, ::1], float32[:, ::1])")
def _reject_rows(first: int, last: int, reasons: U8, disparity_px: F32, margin: F32) -> None:
    for y in range(first, last):
        for x in range(reasons.shape[1]):
            if reasons[y, x]:
                disparity_px[y, x] = _NAN
                margin[y, x] = 0
