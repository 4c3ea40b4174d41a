# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the matchers."""

from __future__ import annotations

from dataclasses import dataclass

from stereo_depth_ros.config.parameter import Checked, parameter
from stereo_depth_ros.core.errors import ConfigError

__all__ = ["MatchingConfig"]


@dataclass(frozen=True)
class MatchingConfig(Checked):
    """The matcher, its search, its costs and its checks; a sentence ends with the matchers it is for, or is for all."""

    stereo_algorithm: int = parameter(
        2,
        "Matcher: 0 bm, 1 sgbm, 2 sgm, 3 window, 4 adaptive_window, 5 diffusion, 6 scanline, 7 graph_cut, "
        "8 belief_propagation, 9 features, 10 onnx.",
        low=0,
        high=10,
    )
    prefilter_size: int = parameter(
        9, "Window of the normalised-response prefilter; bm.", low=5, high=255, step=2, unit="px"
    )
    prefilter_cap: int = parameter(31, "Bound on the prefiltered pixel values.", low=1, high=63)
    correlation_window_size: int = parameter(
        15, "Side of the square matching window.", low=1, high=255, step=2, unit="px"
    )
    min_disparity: int = parameter(0, "Disparity at which the search begins.", low=-2048, high=2048, unit="px")
    num_disparities: int = parameter(
        64, "Number of disparities searched.", name="disparity_range", low=32, high=4096, step=16, unit="px"
    )
    texture_threshold: int = parameter(10, "Least sum of prefiltered gradient in the window; bm.", low=0, high=10000)
    speckle_size: int = parameter(
        100, "Components of at most this many pixels are removed; 0 keeps all.", low=0, high=1000, unit="px"
    )
    speckle_range: int = parameter(
        4, "Largest step between neighbours of one component: in 1/16 px for bm, in px for the others.", low=0, high=31
    )
    disp12_max_diff: int = parameter(
        0,
        "Tolerance of the left-right check; 0 is 1 px for sgbm and sgm, no check for the others.",
        low=0,
        high=128,
        unit="px",
    )
    sgbm_mode: int = parameter(0, "0 five paths, 1 eight paths, 2 three paths, 3 four paths; sgbm.", low=0, high=3)
    uniqueness_ratio: float = parameter(
        15.0, "Margin by which the best cost must win over the second.", low=0.0, high=100.0, unit="%"
    )
    P1: float = parameter(
        0.0, "Penalty on disparity steps of one pixel; 0 is 8 times the area of the window; sgbm.", low=0.0, high=4000.0
    )
    P2: float = parameter(
        0.0,
        "Penalty on larger disparity steps, above P1; 0 is 32 times the area of the window; sgbm.",
        low=0.0,
        high=4000.0,
    )
    sgm_paths: int = parameter(4, "Directions that costs are summed along: 4 or 8; sgm.", low=4, high=8, step=4)
    sgm_P1: int = parameter(30, "Penalty on disparity steps of one pixel, in census bits; sgm.", low=1, high=96)
    sgm_P2: int = parameter(
        150, "Penalty on larger disparity steps where the image is flat, in census bits; sgm.", low=2, high=192
    )
    disparity_filter: str = parameter(
        "mean", "Mean of neighbours that differ by up to 1 px, or median; sgm.", choices=("none", "mean", "median")
    )
    fill_holes: bool = parameter(
        False, "Gives every pixel a disparity, holes that of the farther surface beside them; sgm, scanline."
    )
    window_cost: str = parameter(
        "sad",
        "Dissimilarity of two windows; window, adaptive_window.",
        choices=("sad", "ssd", "zsad", "zssd", "ncc", "zncc"),
    )
    max_difference: int = parameter(
        0,
        "Bound on the difference of two pixels, against outliers in a window; 0 is none; window, adaptive_window.",
        low=0,
        high=255,
    )
    vertical_search: int = parameter(
        0,
        "Rows searched above and below, for pairs that are not quite rectified; window, adaptive_window.",
        low=0,
        high=16,
        unit="px",
    )
    diffusion_model: str = parameter(
        "bayesian", "How support is gathered; diffusion.", choices=("bayesian", "membrane")
    )
    iterations: int = parameter(
        0, "Iterations; 0 takes the method's own; diffusion, graph_cut, belief_propagation.", low=0, high=1000
    )
    smoothness: float = parameter(
        0.0,
        "Weight of smoothness against the data; 0 takes the method's own; scanline, graph_cut, belief_propagation.",
        low=0.0,
        high=1000.0,
    )
    feature_type: str = parameter(
        "sift", "What is matched: sift or orb corners, or line segments; features.", choices=("sift", "orb", "lines")
    )
    onnx_model: str = parameter("", "Path of the network, two images in and a disparity out; onnx.", run_time=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stereo_algorithm == 1 and self.P2 and self.P2 <= self.P1:
            raise ConfigError(f"P2 = {self.P2:g} is not above P1 = {self.P1:g}: raise P2 or lower P1")

    @property
    def max_disparity(self) -> int:
        """Largest whole disparity searched, px."""
        return self.min_disparity + self.num_disparities - 1
