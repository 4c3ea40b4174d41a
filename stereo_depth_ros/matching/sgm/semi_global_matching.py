# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching of census costs, the default matcher."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import core_count, run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import F32, U8, U16, MatchResult, Reason
from stereo_depth_ros.core.vectors import BYTES
from stereo_depth_ros.matching.costs.census import CENSUS_WINDOW, census_rows, empty_census, padded_count
from stereo_depth_ros.matching.costs.features import UNRELATED_COST, feature_costs
from stereo_depth_ros.matching.costs.permeability import GROUP, permeabilities, permeability_rows
from stereo_depth_ros.matching.costs.prior import prior_costs
from stereo_depth_ros.matching.costs.windows import Windows, whole_range
from stereo_depth_ros.matching.filters.disparity_filter import DisparityFilter
from stereo_depth_ros.matching.filters.gap_filling import fill_gaps
from stereo_depth_ros.matching.filters.plane_filling import PlaneFilling
from stereo_depth_ros.matching.filters.speckle_filter import I16, SpeckleFilter
from stereo_depth_ros.matching.local_consistency import local_consistency
from stereo_depth_ros.matching.networks.features import FeatureNetwork
from stereo_depth_ros.matching.protocol import Images, check_pair
from stereo_depth_ros.matching.serial import SerialMatcher
from stereo_depth_ros.matching.sgm.cost_rows import LARGEST_SMOOTHED, View
from stereo_depth_ros.matching.sgm.path_costs import LARGEST_PATH_COST
from stereo_depth_ros.matching.sgm.search_prior import PreviousDisparities, SearchPrior, SmallPair
from stereo_depth_ros.matching.sgm.strips import (
    SPECKLE_STEPS_PER_PX,
    STEPS_PER_PX,
    Output,
    Scratch,
    Search,
    match_strips,
)

__all__ = ["QUALITIES", "Quality", "SemiGlobalMatcher"]

EDGE_GRAY_LEVELS = 6.0  # difference of neighbors at which P2 is halved
STRIP_BYTES = 24 << 20  # of costs: smaller strips stay in the cache, larger ones need less warm-up
STRIP_ROWS = 120  # of strips that keep a few rows: a fixed number, so that results do not depend on the cores
APPROACH_ROWS = 16
APPROACH_BYTES = 64 << 20  # of costs: searches of thousands of disparities have fewer warm-up rows
_NAN = np.float32(np.nan)
_LEFT_RIGHT = np.uint8(Reason.LEFT_RIGHT)
_TABLE = permeabilities()


class Quality(NamedTuple):
    """What a value of the parameter ``quality`` stands for; P1 and P2 in half census bits."""

    paths: int
    P1: int
    P2: int
    edge_aware: bool  # costs are smoothed along the image, see permeability.py
    own_right: bool  # the right image is matched on its own for the left-right check
    uniqueness_share: float  # of uniqueness_ratio: sums over paths differ less than the window sums it is defined for


_PLAIN: dict[str, Any] = {"edge_aware": False, "own_right": False, "uniqueness_share": 1 / 3}
_OF_A_NETWORK, _OF_SEVERAL_PAIRS = Quality(4, 30, 150, **_PLAIN), Quality(4, 12, 150, **_PLAIN)
QUALITIES: Mapping[str, Quality] = {
    "fast": Quality(3, 20, 150, **_PLAIN),
    "default": Quality(3, 9, 150, edge_aware=True, own_right=False, uniqueness_share=1 / 3),
    "best": Quality(4, 12, 150, edge_aware=True, own_right=True, uniqueness_share=1 / 6),
}


class SemiGlobalMatcher(SerialMatcher):
    """Semi-global matching (Hirschmueller 2008) of census costs (Zabih and Woodfill 1994).

    Costs are Hamming distances of 7 x 5 census codes. ``quality`` says what follows:

    - fast: they are smoothed over 3 x 3 pixels, and summed along three directions: from the left, right and above.
    - default: where the left image has hardly any texture, capped gray differences are added. The costs are smoothed
      along its edges (Cigla and Alatan 2013), see permeability.py.
    - best: as default, with the direction from below. The right image is matched on its own, along three directions,
      and must agree.

    ``sgm_paths`` 4 adds the direction from below, 8 the diagonals. P2 is lowered at edges of the left image: P2 / (1 +
    |difference| / 6), not below P1. The best disparity has a sub-pixel part from two lines of opposite slope, corrected
    for pixel locking (Haller and Nedevschi 2012). Unless the quality is best, the left-right check uses the same sums
    for the right pixels. The speckle filter and ``disparity_filter`` follow.

    Vertical paths run over strips of rows, each with 16 warm-up rows: strips are independent, and their costs stay in
    the cache (as the stripes of Spangenberg et al. 2014). Their heights depend on the image size and the search range
    only, so that the result does not depend on the number of cores.

    The margin of a winner over the best sum at least 2 px away is (second - best) / second, and must be at least a
    third of ``uniqueness_ratio`` percent, with best a sixth; it is 0 if the right image has no second candidate. With
    default and best the cost of a winner must also lie below the mean of the costs of its pixel, unless
    ``uniqueness_ratio`` is 0: noise alone has no such contrast. The confidence is this margin times the local
    consistency, computed on demand.

    ``fill_gaps_px`` fills short gaps of rows, with the lesser margin of both ends. With ``fill_holes`` every pixel has
    a disparity; pixels that it fills have confidence 0.

    With ``temporal_window`` T above 1 the cost of a disparity is the mean of its Hamming distances in the last T pairs:
    the scene is static and its light changes, as in :mod:`stereo_depth_ros.matching.spacetime.matcher`. P2 then
    follows the edges of the mean of the left images. Costs are smoothed over 3 x 3 pixels and summed along four
    directions in all qualities: patterns of the light have edges too.

    With ``sgm_cost`` onnx the costs are products of features of a network, see
    :class:`~stereo_depth_ros.matching.networks.features.FeatureNetwork`, in the range of those of the census; they are
    not smoothed, and summed along four directions, in all qualities.

    With ``search_prior`` only a window of the range is searched of each tile of 16 x 32 pixels, at least 64
    disparities, see search_prior.py. Margins there must be 2.5 times as large, as there are fewer rivals.

    With a prior, disparities that another sensor expects, the costs of others rise up to a bound
    (:func:`~stereo_depth_ros.matching.costs.prior.prior_costs`), before they are summed along paths. It is of the left
    image alone, so that the left-right check uses the sums of the left one then, with best too.

    ``support_px`` is the census window, 7 x 5 pixels; the smoothing of the costs reads more pixels on all sides. With a
    network it is the border without features and the pixel between.
    """

    name = "sgm"
    step_px = 1 / STEPS_PER_PX
    support_px = CENSUS_WINDOW

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if the penalties contradict each other."""
        self._quality = effective = _effective(config)
        super().__init__(config)
        self._speckle_filter = SpeckleFilter(config.speckle_size, config.speckle_range * SPECKLE_STEPS_PER_PX)
        self._disparity_filter = DisparityFilter(config.disparity_filter, self.step_px)
        self._plane_filling = PlaneFilling(self.step_px)
        lowered = effective.P2 * EDGE_GRAY_LEVELS / (EDGE_GRAY_LEVELS + np.arange(256))
        self._search = Search(
            max_disparity=config.max_disparity,
            disparities=config.num_disparities,
            uniqueness=effective.uniqueness_share * config.uniqueness_ratio / 100,
            tolerance=config.disp12_max_diff or 2,
            P1=np.uint8(effective.P1),
            P2=np.maximum(lowered, effective.P1).astype(np.uint8),
            approach_rows=APPROACH_ROWS,
            edge_aware=effective.edge_aware,
            indices_only=False,
            own_right=effective.own_right,
        )
        self.pair_count = config.temporal_window or 1
        self._shape = (0, 0)
        self._costs: U8 = np.empty((0, 0, 0), np.uint8)  # of a network
        self._search_prior = _search_prior(config, effective)
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
        if self._shape != left.shape:
            self._allocate(*left.shape)
        reasons = np.empty(left.shape, np.uint8)
        disparity_px, margin = np.empty((2, *left.shape), np.float32)
        output = Output(disparity_px, self._coarse, reasons, margin, self._indices)
        own_right = self._quality.own_right and prior is None
        windows = mirrored_windows = self._whole
        if self._search_prior is not None:
            windows, mirrored_windows = self._search_prior.windows(left, right, self._whole, own_right)
        search = self._search._replace(own_right=own_right)
        self._match_view(pairs, prior, windows, self._strips, search, self._scratch, output)
        if own_right:
            mirrored = [(_mirrored(right), _mirrored(left)) for left, right in pairs]
            search = self._search._replace(indices_only=True)
            right_output = output._replace(indices=self._right_indices)
            self._match_view(
                mirrored, None, mirrored_windows, self._right_strips, search, self._right_scratch, right_output
            )
            given = (self._indices, self._right_indices, self._search.max_disparity, self._search.tolerance)
            run_bands(_agree_rows, len(left), *given, reasons)
        self._speckle_filter(self._coarse, reasons)
        run_bands(_reject_rows, len(left), reasons, disparity_px, margin)
        self._disparity_filter(disparity_px)
        if self._search_prior is not None:
            self._search_prior.note(left, disparity_px)
        fill_gaps(disparity_px, reasons, margin, self.config.fill_gaps_px, self.step_px)
        if self.config.fill_holes:
            self._plane_filling(disparity_px, reasons, left)
        return MatchResult(
            disparity_px, reasons, self.step_px, functools.partial(local_consistency, disparity_px, margin)
        )

    def _match_view(
        self,
        pairs: Sequence[Images],
        prior: DisparityPrior | None,
        windows: Windows,
        strips: int,
        search: Search,
        scratch: Sequence[Scratch],
        output: Output,
    ) -> None:
        """Match the first image of each pair, the disparities of which are to the left in the second one."""
        census = self._census[: len(pairs)]
        if self._network is not None:
            self._costs_of_network(self._network, *pairs[-1])
        else:
            for pair, codes in zip(pairs, census, strict=True):
                for image, own in zip(pair, codes, strict=True):
                    run_bands(census_rows, len(image), image, own)
        image = _mean_image([pair[0] for pair in pairs])
        if search.edge_aware:
            run_bands(permeability_rows, len(image), image, _TABLE, *self._shares)
        view, expected = View(census, *self._shares, windows), prior_costs(prior, image)
        bands = len(scratch)

        def match(first: int, last: int) -> None:
            for band in range(first, last):
                begin, end = band * strips // bands, (band + 1) * strips // bands
                match_strips(begin, end, strips, image, view, self._costs, expected, search, scratch[band], output)

        run_bands(match, bands, min_rows=1)

    def _costs_of_network(self, network: FeatureNetwork, left: U8, right: U8) -> None:
        shape = (*left.shape, self.config.num_disparities)
        if self._costs.shape != shape:
            self._costs = np.empty(shape, np.uint8)
        features = network(left), network(right)
        run_bands(feature_costs, len(left), *features, self.config.max_disparity, UNRELATED_COST, self._costs)

    def _allocate(self, height: int, width: int) -> None:
        config, quality = self.config, self._quality
        count = config.num_disparities
        approach = min(max(APPROACH_BYTES // (width * count) // GROUP, 1) * GROUP, APPROACH_ROWS)
        rows = min(max(STRIP_BYTES // (2 * width * count), approach), 128)
        few_rows = max(STRIP_ROWS, 2 * approach)
        self._right_strips = _strip_count(height, few_rows)
        self._strips = self._right_strips if quality.paths == 3 else _strip_count(height, rows)
        highest = -(-height // self._strips) + GROUP  # strips begin at multiples of it
        given = (min(highest + 2 * approach, height), width, count)
        bands = range(min(core_count(), self._strips))
        self._scratch = [Scratch.allocate(*given, quality.paths, quality.edge_aware) for _ in bands]
        self._right_scratch = [Scratch.allocate(*given, 3, quality.edge_aware) for _ in bands if quality.own_right]
        self._search = self._search._replace(approach_rows=approach)
        self._coarse: I16 = np.zeros((height, width), np.int16)
        self._indices, self._right_indices = np.zeros((2, height, width) if quality.own_right else (2, 1, 1), np.uint16)
        self._census = empty_census(self.pair_count, 2, height, width)
        used = height if quality.edge_aware else 0
        along, scales, down = (np.zeros((rows, width), np.uint16) for rows in (used, used, used + 2 * GROUP))
        self._shares = along, scales, down
        self._whole = whole_range(height, width, padded_count(count))
        self._shape = (height, width)


def _strip_count(height: int, rows: int) -> int:
    """The number of strips of up to that many rows: a multiple of 4, to balance 2 or 4 cores."""
    return min(4 * -(-height // (4 * rows)), height)


def _mirrored(image: U8) -> U8:
    return np.ascontiguousarray(image[:, ::-1])


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


def _effective(config: MatchingConfig) -> Quality:
    """The quality, with the parameters that are not left to it."""
    quality = _OF_SEVERAL_PAIRS if config.temporal_window > 1 else QUALITIES[config.quality]
    if config.sgm_cost == "onnx":
        quality = _OF_A_NETWORK
    P1, P2 = config.sgm_P1 or quality.P1, config.sgm_P2 or quality.P2
    total, largest = P1 + P2, LARGEST_PATH_COST - LARGEST_SMOOTHED
    if P2 <= P1:
        raise ConfigError(
            f"sgm_P2 = {P2} is not above sgm_P1 = {P1}",
            value=P2,
            limit=P1,
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
    return quality._replace(paths=config.sgm_paths or quality.paths, P1=P1, P2=P2)


def _search_prior(config: MatchingConfig, quality: Quality) -> SearchPrior | None:
    """What limits the search, if the range is wider than the narrowest window."""
    if config.search_prior == "none":
        return None
    if not quality.edge_aware or quality.paths == 8:
        raise ConfigError(
            f"search_prior = {config.search_prior} is for quality default and best, single pairs, census costs and up "
            "to 4 paths",
            value=config.search_prior,
            limit="none",
            remedy="set it to none",
            settings=("search_prior",),
        )
    if config.num_disparities <= BYTES:
        return None
    return PreviousDisparities(config) if config.search_prior == "previous" else SmallPair(config, _coarse_matcher)


def _coarse_matcher(config: MatchingConfig) -> SemiGlobalMatcher:
    return SemiGlobalMatcher(config)


@compiled("void(int64, int64, uint16[:, ::1], uint16[:, ::1], int64, int64, uint8[:, ::1])")
def _agree_rows(
    first: int, last: int, indices: U16, mirrored: U16, max_disparity: int, tolerance: int, reasons: U8
) -> None:
    """Mark pixels whose right pixel has another disparity; that of the mirrored right image is at W - 1 - x."""
    width = indices.shape[1]
    for y in range(first, last):
        for x in range(width):
            if reasons[y, x] == 0:
                k = np.int64(indices[y, x])
                right_x = x - max_disparity + k
                if abs(np.int64(mirrored[y, width - 1 - right_x]) - k) > tolerance:
                    reasons[y, x] = _LEFT_RIGHT


@compiled("void(int64, int64, uint8[:, ::1], float32[:, ::1], float32[:, ::1])")
def _reject_rows(first: int, last: int, reasons: U8, disparity_px: F32, margin: F32) -> None:
    for y in range(first, last):
        for x in range(reasons.shape[1]):
            if reasons[y, x]:
                disparity_px[y, x] = _NAN
                margin[y, x] = 0
