# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the matchers: a frozen dataclass for what they share and one for each method; a node has them all."""

from __future__ import annotations

from dataclasses import dataclass

from stereo_depth_ros.config.matchers import MATCHERS, matcher_number
from stereo_depth_ros.config.parameter import Checked, parameter
from stereo_depth_ros.core.errors import ConfigError

__all__ = ["MatchingConfig"]

_NUMBERED = ", ".join(f"{number} {name}" for number, name in enumerate(MATCHERS))


@dataclass(frozen=True)
class SearchConfig(Checked):
    """The matcher, the disparities it searches, and the checks that follow."""

    stereo_algorithm: int = parameter(matcher_number("sgm"), f"Matcher: {_NUMBERED}.", low=0, high=len(MATCHERS) - 1)
    min_disparity: int = parameter(0, "Disparity at which the search begins.", low=-2048, high=2048, unit="px")
    num_disparities: int = parameter(
        64, "Number of disparities searched.", name="disparity_range", low=32, high=4096, step=16, unit="px"
    )
    uniqueness_ratio: float = parameter(
        15.0, "Margin by which the best cost must win over the second.", low=0.0, high=100.0, unit="%"
    )
    disp12_max_diff: int = parameter(
        0,
        "Tolerance of the left-right check; 0 is 1 px for sgbm and sgm, no check for the others.",
        low=0,
        high=128,
        unit="px",
    )
    speckle_size: int = parameter(
        100, "Components of at most this many pixels are removed; 0 keeps all.", low=0, high=1000, unit="px"
    )
    speckle_range: int = parameter(
        4, "Largest step between neighbors of one component: in 1/16 px for bm, in px for the others.", low=0, high=31
    )
    correlation_window_size: int = parameter(
        15, "Side of the square matching window.", low=1, high=255, step=2, unit="px"
    )
    fill_holes: bool = parameter(False, "Gives every pixel a disparity, holes that of the farther surface beside them.")


@dataclass(frozen=True)
class BlockMatchingConfig(Checked):
    """Of ``bm``; ``sgbm`` has the cap, too."""

    prefilter_size: int = parameter(
        9, "Window of the normalized-response prefilter.", low=5, high=255, step=2, unit="px"
    )
    prefilter_cap: int = parameter(31, "Bound on the prefiltered pixel values.", low=1, high=63)
    texture_threshold: int = parameter(10, "Least sum of prefiltered gradient in the window.", low=0, high=10000)


@dataclass(frozen=True)
class SgbmConfig(Checked):
    """Of ``sgbm``."""

    sgbm_mode: int = parameter(0, "0 five paths, 1 eight paths, 2 three paths, 3 four paths.", low=0, high=3)
    P1: float = parameter(
        0.0, "Penalty on disparity steps of one pixel; 0 is 8 times the area of the window.", low=0.0, high=4000.0
    )
    P2: float = parameter(
        0.0,
        "Penalty on larger disparity steps, above P1; 0 is 32 times the area of the window.",
        low=0.0,
        high=4000.0,
    )


@dataclass(frozen=True)
class SgmConfig(Checked):
    """Of ``sgm``."""

    sgm_paths: int = parameter(4, "Directions that costs are summed along: 4 or 8.", low=4, high=8, step=4)
    sgm_P1: int = parameter(30, "Penalty on disparity steps of one pixel, in census bits.", low=1, high=96)
    sgm_P2: int = parameter(
        150, "Penalty on larger disparity steps where the image is flat, in census bits.", low=2, high=192
    )
    disparity_filter: str = parameter(
        "mean", "Mean of neighbors that differ by up to 1 px, or median.", choices=("none", "mean", "median")
    )


@dataclass(frozen=True)
class CorrelationConfig(Checked):
    """Of ``window`` and ``adaptive_window``."""

    window_cost: str = parameter(
        "sad", "Dissimilarity of two windows.", choices=("sad", "ssd", "zsad", "zssd", "ncc", "zncc")
    )
    max_difference: int = parameter(
        0, "Bound on the difference of two pixels, against outliers in a window; 0 is none.", low=0, high=255
    )
    vertical_search: int = parameter(
        0, "Rows searched above and below, for pairs that are not quite rectified.", low=0, high=16, unit="px"
    )


@dataclass(frozen=True)
class DiffusionConfig(Checked):
    """Of ``diffusion``."""

    diffusion_model: str = parameter("bayesian", "How support is gathered.", choices=("bayesian", "membrane"))


@dataclass(frozen=True)
class GlobalMethodConfig(Checked):
    """Of ``scanline``, ``graph_cut`` and ``belief_propagation``; ``diffusion`` has iterations, too."""

    iterations: int = parameter(0, "Iterations; 0 takes the method's own.", low=0, high=1000)
    smoothness: float = parameter(
        0.0, "Weight of smoothness against the data; 0 takes the method's own.", low=0.0, high=1000.0
    )


@dataclass(frozen=True)
class FeatureConfig(Checked):
    """Of ``features``."""

    feature_type: str = parameter(
        "sift", "What is matched: sift or orb corners, or line segments.", choices=("sift", "orb", "lines")
    )


@dataclass(frozen=True)
class OnnxConfig(Checked):
    """Of ``onnx``."""

    onnx_model: str = parameter("", "Path of the network, two images in and a disparity out.", run_time=False)


@dataclass(frozen=True)
class MatchingConfig(
    OnnxConfig,  # fields stand in the reverse order of the bases
    FeatureConfig,
    GlobalMethodConfig,
    DiffusionConfig,
    CorrelationConfig,
    SgmConfig,
    SgbmConfig,
    BlockMatchingConfig,
    SearchConfig,
):
    """The matcher, its search, its costs and its checks; a sentence ends with the matchers it is for, or is for all."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stereo_algorithm == matcher_number("sgbm") and self.P2 and self.P2 <= self.P1:
            raise ConfigError(f"P2 = {self.P2:g} is not above P1 = {self.P1:g}: raise P2 or lower P1")

    @property
    def max_disparity(self) -> int:
        """Largest whole disparity searched, px."""
        return self.min_disparity + self.num_disparities - 1
