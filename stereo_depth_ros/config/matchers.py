# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Registry of the matchers: one entry each, from which numbers, parameter texts, tables and help are generated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["MATCHERS", "MatcherInfo", "matcher_number", "matchers_with"]

_SEARCH = ("min_disparity", "disparity_range", "min_confidence", "max_depth_error", "max_relative_depth_error")
_CHECKS = ("uniqueness_ratio", "disp12_max_diff", "speckle_size", "speckle_range")
_WINDOW = "correlation_window_size"
_CORRELATION = (*_SEARCH, *_CHECKS, _WINDOW, "window_cost", "max_difference", "vertical_search")
_GLOBAL = (*_SEARCH, *_CHECKS[1:], _WINDOW, "smoothness")

_TEMPORAL = ("temporal_window", "temporal_gap")
_NETWORK = ("onnx_model", "onnx_provider", "onnx_normalization", "onnx_multiple")

_SECOND_COST = "percentage by which the costs of all but the adjacent disparities must exceed the lowest cost"


@dataclass(frozen=True)
class MatcherInfo:
    """Description of a matcher, available before its module is imported.

    Attributes:
        name: of the matcher, for ``create_matcher``, options and tables.
        location: module below ``stereo_depth_ros.matching`` and class.
        sentence: description.
        parameters: public names of the parameters that have an effect on it.
        uniqueness: meaning of ``uniqueness_ratio`` for it; empty if it has no effect.
        takes_prior: whether it uses the disparities that another sensor expects.
    """

    name: str
    location: str
    sentence: str
    parameters: tuple[str, ...]
    uniqueness: str = ""
    takes_prior: bool = False


# The position of an entry is the number of the matcher in the parameter stereo_algorithm.
_LINES = (
    MatcherInfo(
        "bm",
        "window.block_matching:BlockMatcher",
        "Block matching with the exact disparities of OpenCV's StereoBM in half the time, optional left-right check.",
        (*_SEARCH, *_CHECKS, _WINDOW, "prefilter_size", "prefilter_cap", "texture_threshold"),
        _SECOND_COST,
    ),
    MatcherInfo(
        "sgbm",
        "sgm.semi_global_block_matching:SemiGlobalBlockMatcher",
        "Semi-global block matching with the exact disparities of OpenCV's StereoSGBM; automatic P1 and P2.",
        (*_SEARCH, *_CHECKS, _WINDOW, "prefilter_cap", "sgbm_mode", "P1", "P2"),
        _SECOND_COST,
    ),
    MatcherInfo(
        "sgm",
        "sgm.semi_global_matching:SemiGlobalMatcher",
        "The default: semi-global matching of census costs (Hirschmueller 2008), 3, 4 or 8 paths, sub-pixel.",
        (
            *(*_SEARCH, *_CHECKS, "sgm_cost", "quality", "sgm_paths", "sgm_P1", "sgm_P2", "disparity_filter"),
            *("fill_gaps_px", "fill_holes", "search_prior", *_TEMPORAL, *_NETWORK),
        ),
        "three times the percentage by which the lowest summed cost must lie below the lowest one at least 2 px away",
        takes_prior=True,
    ),
    MatcherInfo(
        "window",
        "window.fixed_window:WindowMatcher",
        "Area correlation with SAD, SSD, NCC or their zero-mean forms, any odd window, optional vertical search.",
        _CORRELATION,
        _SECOND_COST,
    ),
    MatcherInfo(
        "adaptive_window",
        "window.adaptive_window:AdaptiveWindowMatcher",
        "Windows whose size and shape adapt to the uncertainty (Kanade and Okutomi 1994).",
        _CORRELATION,
        _SECOND_COST,
    ),
    MatcherInfo(
        "diffusion",
        "global_methods.diffusion:DiffusionMatcher",
        "Bayesian or membrane diffusion of support (Scharstein and Szeliski 1998).",
        (*_SEARCH, *_CHECKS, _WINDOW, "diffusion_model", "iterations"),
        _SECOND_COST,
    ),
    MatcherInfo(
        "scanline",
        "global_methods.scanline:ScanlineMatcher",
        "Dynamic programming with occlusion, ordering and inter-scanline consistency (Ohta and Kanade 1985).",
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
        "Sparse matching of SIFT or ORB corners, or of line segments.",
        (*_SEARCH, "uniqueness_ratio", "feature_type"),
        "percentage by which the cost of every candidate elsewhere must exceed the lowest cost",
    ),
    MatcherInfo(
        "onnx",
        "onnx:OnnxMatcher",
        "A user-supplied neural network, two images in and a disparity map out; needs onnxruntime.",
        (*_SEARCH, *_NETWORK, "onnx_scale", "onnx_offset"),
    ),
    MatcherInfo(
        "spacetime",
        "spacetime.matcher:SpaceTimeMatcher",
        "Correlation over windows in space and time, of the last pairs under changing light (Zhang et al. 2003).",
        (*_SEARCH, *_CHECKS, *_TEMPORAL, "spacetime_window", "slanted_windows"),
        _SECOND_COST,
    ),
)

MATCHERS: Mapping[str, MatcherInfo] = {info.name: info for info in _LINES}


def matcher_number(name: str) -> int:
    """The number of a matcher in ``stereo_algorithm``; KeyError for an unknown name."""
    MATCHERS[name]
    return list(MATCHERS).index(name)


def matchers_with(parameter: str) -> tuple[str, ...]:
    """Names of the matchers that a parameter, by its public name, has an effect on; empty for other parameters."""
    return tuple(name for name, info in MATCHERS.items() if parameter in info.parameters)
