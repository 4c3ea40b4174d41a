# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the matchers: a frozen dataclass for the common ones and one for each method."""

from __future__ import annotations

from dataclasses import dataclass

from stereo_depth_ros.config.matchers import MATCHERS, matcher_number
from stereo_depth_ros.config.parameter import Checked, parameter
from stereo_depth_ros.core.errors import ConfigError

__all__ = ["MatchingConfig"]

_NUMBERED = ", ".join(f"{number} {name}" for number, name in enumerate(MATCHERS))


@dataclass(frozen=True)
class SearchConfig(Checked):
    """Matcher, search range and the checks that follow."""

    stereo_algorithm: int = parameter(
        matcher_number("sgm"), f"Matching method: {_NUMBERED}.", low=0, high=len(MATCHERS) - 1
    )
    min_disparity: int = parameter(0, "Smallest disparity searched.", low=-2048, high=2048, unit="px")
    num_disparities: int = parameter(
        64, "Number of disparities searched.", name="disparity_range", low=32, high=4096, step=16, unit="px"
    )
    uniqueness_ratio: float = parameter(
        15.0,
        "Margin by which the best cost must be better than the second best; 0 disables the check.",
        low=0.0,
        high=100.0,
        unit="%",
    )
    disp12_max_diff: int = parameter(
        0,
        "Tolerance of the left-right check; with 0, sgm uses 2 px, sgbm and spacetime 1 px, the others do not check.",
        low=0,
        high=128,
        unit="px",
    )
    speckle_size: int = parameter(
        100,
        "Largest connected component that is removed as a speckle; 0 disables the filter.",
        low=0,
        high=1000,
        unit="px",
    )
    speckle_range: int = parameter(
        4,
        "Largest disparity difference between neighbors of a component: in 1/16 px for bm, in px for the others.",
        low=0,
        high=31,
    )
    min_confidence: float = parameter(0.0, "Least confidence of a disparity; 0 accepts all.", low=0.0, high=1.0)
    max_depth_error: float = parameter(
        0.0, "Largest standard deviation of the depth of a pixel; 0 accepts any.", low=0.0, high=1000.0, unit="m"
    )
    max_relative_depth_error: float = parameter(
        0.0,
        "Largest standard deviation of the depth of a pixel, in percent of its depth; 0 accepts any.",
        low=0.0,
        high=100.0,
        unit="%",
    )
    correlation_window_size: int = parameter(
        15, "Side length of the square matching window.", low=1, high=255, step=2, unit="px"
    )
    fill_holes: bool = parameter(
        False,
        "Fill invalid pixels with the planes of the surrounding surfaces: across no edges of the image, and with the "
        "background where the right camera sees nothing.",
    )


@dataclass(frozen=True)
class BlockMatchingConfig(Checked):
    """Parameters of ``bm``; ``sgbm`` also uses the cap."""

    prefilter_size: int = parameter(
        9,
        "Window of the normalized-response prefilter; no effect, since the Sobel prefilter is used.",
        low=5,
        high=255,
        step=2,
        unit="px",
    )
    prefilter_cap: int = parameter(31, "Limit to which prefilter responses are clipped.", low=1, high=63)
    texture_threshold: int = parameter(
        10, "Minimum sum of absolute prefilter responses in the window.", low=0, high=10000
    )


@dataclass(frozen=True)
class SgbmConfig(Checked):
    """Parameters of ``sgbm``."""

    sgbm_mode: int = parameter(
        0, "Path directions: 0 five (SGBM), 1 eight (HH), 2 three (3WAY), 3 four (HH4).", low=0, high=3
    )
    P1: float = parameter(
        200.0, "Penalty on disparity changes of 1 px; 0 means 8 times the window area.", low=0.0, high=4000.0
    )
    P2: float = parameter(
        400.0,
        "Penalty on larger disparity changes, above P1; 0 means 32 times the window area.",
        low=0.0,
        high=4000.0,
    )


@dataclass(frozen=True)
class SgmConfig(Checked):
    """Parameters of ``sgm``."""

    sgm_cost: str = parameter(
        "census",
        "Matching costs: Hamming distances of the census, or products of features by the network in onnx_model.",
        choices=("census", "onnx"),
    )
    quality: str = parameter(
        "default",
        "Preset: fast, three paths and plain costs; default, costs that follow the edges of the image; best, four "
        "paths and a match of the right image on its own.",
        choices=("fast", "default", "best"),
    )
    search_prior: str = parameter(
        "none",
        "Search only near disparities that are roughly known: of the pair at a quarter of its size (pyramid), or of "
        "the pair before (previous; results then depend on it). It saves time in ranges of more than 128 disparities.",
        choices=("none", "pyramid", "previous"),
    )
    sgm_paths: int = parameter(
        0, "Number of path directions, 4 or 8; 0 uses that of the quality, 3 or 4.", low=0, high=8, step=4
    )
    sgm_P1: int = parameter(
        0, "Penalty on disparity changes of 1 px, in half census bits; 0 uses that of the quality.", low=0, high=96
    )
    sgm_P2: int = parameter(
        0,
        "Penalty on larger disparity changes, in half census bits, lower at intensity edges; 0 uses that of the "
        "quality.",
        low=0,
        high=190,
    )
    disparity_filter: str = parameter(
        "mean",
        "Disparity filter: mean of the 5 x 5 neighbors that differ by at most 1 px, or 3 x 3 median.",
        choices=("none", "mean", "median"),
    )
    fill_gaps_px: int = parameter(
        0,
        "Longest gap of a row that is filled linearly, if the disparities at its ends differ by at most 1 px; 0 fills "
        "none.",
        low=0,
        high=64,
        unit="px",
    )


@dataclass(frozen=True)
class CorrelationConfig(Checked):
    """Parameters of ``window`` and ``adaptive_window``."""

    window_cost: str = parameter(
        "sad", "Matching cost of two windows.", choices=("sad", "ssd", "zsad", "zssd", "ncc", "zncc")
    )
    max_difference: int = parameter(
        0, "Truncation of the absolute difference of two pixels, with sad only; 0 disables it.", low=0, high=255
    )
    vertical_search: int = parameter(
        0, "Rows searched above and below, for imperfectly rectified pairs.", low=0, high=16, unit="px"
    )


@dataclass(frozen=True)
class DiffusionConfig(Checked):
    """Parameters of ``diffusion``."""

    diffusion_model: str = parameter(
        "bayesian", "Diffusion of support between neighbors.", choices=("bayesian", "membrane")
    )


@dataclass(frozen=True)
class GlobalMethodConfig(Checked):
    """Parameters of ``scanline``, ``graph_cut`` and ``belief_propagation``; ``diffusion`` also uses the iterations."""

    iterations: int = parameter(0, "Number of iterations; 0 uses the default of the method.", low=0, high=1000)
    smoothness: float = parameter(
        0.0,
        "Cost of a disparity change of 1 px, in gray levels; 0 uses the default of the method.",
        low=0.0,
        high=1000.0,
    )


@dataclass(frozen=True)
class FeatureConfig(Checked):
    """Parameters of ``features``."""

    feature_type: str = parameter(
        "sift", "Features to match: SIFT corners, ORB corners or line segments.", choices=("sift", "orb", "lines")
    )


@dataclass(frozen=True)
class OnnxConfig(Checked):
    """Parameters of ``onnx``, and of ``sgm`` where a network gives its costs."""

    onnx_model: str = parameter(
        "",
        "Path of the ONNX file of the network: for onnx two images in and a disparity map out, for sgm an image in and "
        "features out.",
        run_time=False,
    )
    onnx_provider: str = parameter(
        "auto",
        "Execution provider of ONNX Runtime; auto takes the first of cuda, openvino and cpu that starts.",
        choices=("auto", "cpu", "cuda", "tensorrt", "openvino"),
        run_time=False,
    )
    onnx_normalization: str = parameter(
        "auto",
        "What the network takes instead of gray values of 0 to 255 (none): 0 to 1 (unit), -1 to 1 (signed), by mean "
        "and deviation of ImageNet or of each image (standard); auto takes that of the metadata of its file, or none, "
        "for features standard.",
        choices=("auto", "none", "unit", "signed", "imagenet", "standard"),
    )
    onnx_multiple: int = parameter(
        0,
        "Images are padded to a multiple of this size; 0 takes that of the metadata, or the first of 32, 64 and 128 "
        "with which the network runs.",
        low=0,
        high=512,
        unit="px",
    )
    onnx_scale: float = parameter(
        0.0,
        "Factor of the disparities of the network; 0 takes that of the metadata, or 1, or -1 where their mean is "
        "negative.",
        low=-10000.0,
        high=10000.0,
    )
    onnx_offset: float = parameter(
        0.0, "Added to the disparities of the network, against a constant bias.", low=-16.0, high=16.0, unit="px"
    )


@dataclass(frozen=True)
class TemporalConfig(Checked):
    """Parameters of ``spacetime``, and of ``sgm`` where it sums costs over time."""

    temporal_window: int = parameter(
        0,
        "Number of pairs, the newest ones, that are matched together; 0 uses the default of the method: 8 for "
        "spacetime, 1 for sgm.",
        low=0,
        high=64,
    )
    temporal_gap: float = parameter(
        1.0,
        "Longest time between successive pairs that are matched together; 0 means no limit.",
        low=0.0,
        high=3600.0,
        unit="s",
    )
    spacetime_window: int = parameter(
        5, "Side length of the square window in the image; 1 with many pairs.", low=1, high=255, step=2, unit="px"
    )
    slanted_windows: bool = parameter(
        False,
        "Windows whose disparity is linear in x, y and time, for slanted surfaces and moving scenes; slow.",
    )


@dataclass(frozen=True)
class MatchingConfig(
    TemporalConfig,
    OnnxConfig,  # dataclass fields are in the reverse order of the bases
    FeatureConfig,
    GlobalMethodConfig,
    DiffusionConfig,
    CorrelationConfig,
    SgmConfig,
    SgbmConfig,
    BlockMatchingConfig,
    SearchConfig,
):
    """All matching parameters; those that not every matcher uses name their matchers."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stereo_algorithm == matcher_number("sgbm") and self.P2 and self.P2 <= self.P1:
            raise ConfigError(
                f"P2 = {self.P2:g} is not above P1 = {self.P1:g}",
                value=self.P2,
                limit=self.P1,
                remedy="raise P2 or lower P1",
                settings=("P2", "P1"),
            )

    @property
    def temporal_gap_ns(self) -> int | None:
        """Longest time between successive pairs that are matched together, nanoseconds; None means no limit."""
        return round(self.temporal_gap * 1e9) or None

    @property
    def max_disparity(self) -> int:
        """Largest whole disparity searched, px."""
        return self.min_disparity + self.num_disparities - 1
