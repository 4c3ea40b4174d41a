# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The registry of matchers: a line each; numbers, parameter texts, tables and help are made from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["MATCHERS", "MatcherInfo", "matcher_number", "matchers_with"]

_SEARCH = ("min_disparity", "disparity_range")
_CHECKS = ("uniqueness_ratio", "disp12_max_diff", "speckle_size", "speckle_range")
_WINDOW = "correlation_window_size"
_CORRELATION = (*_SEARCH, *_CHECKS, _WINDOW, "window_cost", "max_difference", "vertical_search")
_GLOBAL = (*_SEARCH, *_CHECKS[1:], _WINDOW, "smoothness")

_SECOND_COST = "percent by which every cost that is not a neighbor of the least one must exceed it"


@dataclass(frozen=True)
class MatcherInfo:
    """What is known of a matcher before its module is imported.

    Attributes:
        name: for ``create_matcher``, ``--matcher`` and tables.
        location: module below ``stereo_depth_ros.matching`` and class.
        sentence: what it does.
        parameters: outside names of the parameters that have an effect on it.
        uniqueness: what ``uniqueness_ratio`` means to it; empty where it has no effect.
    """

    name: str
    location: str
    sentence: str
    parameters: tuple[str, ...]
    uniqueness: str = ""


# The position of a line is the matcher's number in the parameter stereo_algorithm.
_LINES = (
    MatcherInfo(
        "bm",
        "window.block_matching:BlockMatcher",
        "Block matching, bit for bit OpenCV's in half its time, with a left-right check on request.",
        (*_SEARCH, *_CHECKS, _WINDOW, "prefilter_size", "prefilter_cap", "texture_threshold"),
        _SECOND_COST,
    ),
    MatcherInfo(
        "sgbm",
        "sgm.semi_global_block_matching:SemiGlobalBlockMatcher",
        "OpenCV's semi-global block matching, all four modes; P1 and P2 follow the window where they are not set.",
        (*_SEARCH, *_CHECKS, _WINDOW, "prefilter_cap", "sgbm_mode", "P1", "P2"),
        _SECOND_COST,
    ),
    MatcherInfo(
        "sgm",
        "sgm.semi_global_matching:SemiGlobalMatcher",
        "The default: semi-global matching of census costs (Hirschmueller 2008), 4 or 8 paths, sub-pixel.",
        (*_SEARCH, *_CHECKS, "sgm_paths", "sgm_P1", "sgm_P2", "disparity_filter", "fill_holes"),
        "a third of it is the percentage by which the least sum must lie below the least one 2 px or more away",
    ),
    MatcherInfo(
        "window",
        "window.fixed_window:WindowMatcher",
        "Correlation: SAD, SSD, NCC and their zero-mean forms, any odd window, also over several rows.",
        _CORRELATION,
        _SECOND_COST,
    ),
    MatcherInfo(
        "adaptive_window",
        "window.adaptive_window:AdaptiveWindowMatcher",
        "Windows whose size and shape follow the uncertainty (Kanade and Okutomi 1994).",
        _CORRELATION,
        _SECOND_COST,
    ),
    MatcherInfo(
        "diffusion",
        "global_methods.diffusion:DiffusionMatcher",
        "Membrane and Bayesian diffusion of support (Scharstein and Szeliski 1998).",
        (*_SEARCH, *_CHECKS, _WINDOW, "diffusion_model", "iterations"),
        _SECOND_COST,
    ),
    MatcherInfo(
        "scanline",
        "global_methods.scanline:ScanlineMatcher",
        "Dynamic programming with occlusion and ordering, rows made consistent (Ohta and Kanade 1985).",
        (*_GLOBAL, "fill_holes"),
    ),
    MatcherInfo(
        "graph_cut",
        "global_methods.graph_cut:GraphCutMatcher",
        "Alpha-expansion (Boykov, Veksler and Zabih 2001); needs PyMaxflow (GPL).",
        (*_GLOBAL, "iterations"),
    ),
    MatcherInfo(
        "belief_propagation",
        "global_methods.belief_propagation:BeliefPropagationMatcher",
        "Hierarchical min-sum belief propagation (Felzenszwalb and Huttenlocher 2006).",
        (*_GLOBAL, "iterations"),
    ),
    MatcherInfo(
        "features",
        "features.matcher:FeatureMatcher",
        "SIFT or ORB corners, or line segments: sparse.",
        (*_SEARCH, "uniqueness_ratio", "feature_type"),
        "percent by which the cost of every candidate elsewhere must exceed the least one",
    ),
    MatcherInfo(
        "onnx",
        "onnx:OnnxMatcher",
        "A network of yours, two images in and a disparity out; needs onnxruntime.",
        (*_SEARCH, "onnx_model"),
    ),
)

MATCHERS: Mapping[str, MatcherInfo] = {info.name: info for info in _LINES}


def matcher_number(name: str) -> int:
    """The number of a matcher in ``stereo_algorithm``; KeyError where there is no such matcher."""
    MATCHERS[name]
    return list(MATCHERS).index(name)


def matchers_with(parameter: str) -> tuple[str, ...]:
    """Names of the matchers that a parameter, by its outside name, has an effect on; none for other parameters."""
    return tuple(name for name, info in MATCHERS.items() if parameter in info.parameters)
