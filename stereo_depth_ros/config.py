# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: one frozen dataclass per stage; type, default, range, step, unit and one sentence each.

Everything else that knows a parameter (declared ROS parameters and their descriptors, ``config/*.yaml``, command-line
options, the README's table) is made from the metadata here.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from stereo_depth_ros.errors import ConfigError

__all__ = [
    "CONFIGS",
    "CalibrationConfig",
    "CloudConfig",
    "DepthConfig",
    "HealthConfig",
    "MatchingConfig",
    "PairingConfig",
    "ParameterInfo",
    "PipelineConfig",
    "parameter_infos",
    "replace_checked",
    "unknown_parameter",
]

ConfigT = TypeVar("ConfigT")


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of one parameter: its outside name, field, type, default, range, unit and sentence."""

    name: str
    field: str
    type: type
    default: bool | int | float | str
    doc: str
    low: float | None = None
    high: float | None = None
    step: float | None = None
    unit: str = ""
    choices: tuple[str, ...] = ()
    run_time: bool = True

    @property
    def range_text(self) -> str:
        """Range, step and unit, or the choices, in words; empty where there is none."""
        if self.choices:
            return ", ".join(self.choices)
        if self.low is None or self.high is None:
            return self.unit
        step = f" in steps of {self.step:g}" if self.step else ""
        return f"{self.low:g} to {self.high:g}{step} {self.unit}".rstrip()

    def check(self, value: Any) -> bool | int | float | str:
        """The value in the parameter's type; ConfigError with value, limit and remedy where it cannot be."""
        if self.type is float and type(value) is int:
            value = float(value)
        if type(value) is not self.type:
            raise ConfigError(
                f"parameter {self.name} = {value!r} is {type(value).__name__}, it takes {self.type.__name__}: "
                f"write it as {self.type.__name__}, for example {self.default!r}"
            )
        if self.choices and value not in self.choices:
            raise ConfigError(
                f"parameter {self.name} = {value!r} is none of {', '.join(self.choices)}: take one of them"
            )
        if isinstance(value, (str, bool)):
            return value
        assert isinstance(value, (int, float))
        if self.low is not None and self.high is not None and not self.low <= value <= self.high:
            raise ConfigError(
                f"parameter {self.name} = {value} is outside {self.low:g}..{self.high:g}: set it inside that range"
            )
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f"parameter {self.name} = {value} is not finite: set a number")
        if self.step and self.low is not None and (value - self.low) % self.step:
            below = value - (value - self.low) % self.step
            raise ConfigError(
                f"parameter {self.name} = {value} is not {self.low:g} plus a multiple of {self.step:g}: "
                f"take {below:g} or {below + self.step:g}"
            )
        return value


def _parameter(default: bool | int | float | str, doc: str, **info: Any) -> Any:
    return field(default=default, metadata={"doc": doc, **info})


def parameter_infos(config: type | object) -> Iterator[ParameterInfo]:
    """All parameters of a config class, in the order of its fields."""
    for item in dataclasses.fields(config):  # type: ignore[arg-type]
        info = dict(item.metadata)
        yield ParameterInfo(
            name=info.pop("name", item.name),
            field=item.name,
            type=type(item.default),
            default=item.default,  # type: ignore[arg-type]
            **info,
        )


def unknown_parameter(name: str, known: Iterable[str]) -> ConfigError:
    """The error to raise for a name that no parameter has; it names the one that was probably meant."""
    close = difflib.get_close_matches(name, known, 1)
    remedy = f"did you mean {close[0]!r}?" if close else "`stereo-depth parameters` lists all"
    return ConfigError(f"unknown parameter {name!r}: {remedy}")


class _Checked:
    """Checks every field against its metadata when the object is made."""

    def __post_init__(self) -> None:
        for info in parameter_infos(self):
            object.__setattr__(self, info.field, info.check(getattr(self, info.field)))


def replace_checked(config: ConfigT, changes: Mapping[str, Any]) -> ConfigT:
    """A copy of ``config`` with the values of ``changes``, keyed by outside name or field name.

    Raises:
        ConfigError: unknown key, or a value that the config refuses.
    """
    fields = {key: info.field for info in parameter_infos(config) for key in (info.name, info.field)}
    for key in changes:
        if key not in fields:
            raise unknown_parameter(key, fields)
    return dataclasses.replace(config, **{fields[key]: value for key, value in changes.items()})  # type: ignore[type-var]


@dataclass(frozen=True)
class PairingConfig(_Checked):
    """How left and right images, and their camera infos, are brought together."""

    queue_size: int = _parameter(
        5, "Unpaired images kept per eye while the other eye is awaited.", low=1, high=1000, run_time=False
    )
    approximate_sync: bool = _parameter(
        False, "Pair stamps that differ; false pairs equal stamps only.", run_time=False
    )
    approximate_sync_tolerance_seconds: float = _parameter(
        0.0,
        "Largest stamp difference within an approximate pair, itself included; 0 means no limit.",
        low=0.0,
        high=3600.0,
        unit="s",
        run_time=False,
    )

    image_transport: str = _parameter(
        "raw",
        "How images come in: raw, or compressed (topic with /compressed behind it).",
        choices=("raw", "compressed"),
        run_time=False,
    )

    @property
    def tolerance_ns(self) -> int | None:
        """Largest difference of stamps in a pair, in nanoseconds; None is no limit."""
        if not self.approximate_sync:
            return 0
        return round(self.approximate_sync_tolerance_seconds * 1e9) or None


@dataclass(frozen=True)
class MatchingConfig(_Checked):
    """The matcher, its search, its costs and its checks; a sentence ends with the matchers it is for, or is for all."""

    stereo_algorithm: int = _parameter(
        2,
        "Matcher: 0 bm, 1 sgbm, 2 sgm, 3 window, 4 adaptive_window, 5 diffusion, 6 scanline, 7 graph_cut, "
        "8 belief_propagation, 9 features, 10 onnx.",
        low=0,
        high=10,
    )
    prefilter_size: int = _parameter(
        9, "Window of the normalised-response prefilter; bm.", low=5, high=255, step=2, unit="px"
    )
    prefilter_cap: int = _parameter(31, "Bound on the prefiltered pixel values.", low=1, high=63)
    correlation_window_size: int = _parameter(
        15, "Side of the square matching window.", low=1, high=255, step=2, unit="px"
    )
    min_disparity: int = _parameter(0, "Disparity at which the search begins.", low=-2048, high=2048, unit="px")
    num_disparities: int = _parameter(
        64, "Number of disparities searched.", name="disparity_range", low=32, high=4096, step=16, unit="px"
    )
    texture_threshold: int = _parameter(10, "Least sum of prefiltered gradient in the window; bm.", low=0, high=10000)
    speckle_size: int = _parameter(
        100, "Components of at most this many pixels are removed; 0 keeps all.", low=0, high=1000, unit="px"
    )
    speckle_range: int = _parameter(
        4, "Largest step between neighbours of one component: in 1/16 px for bm, in px for the others.", low=0, high=31
    )
    disp12_max_diff: int = _parameter(
        0,
        "Tolerance of the left-right check; 0 is 1 px for sgbm and sgm, no check for the others.",
        low=0,
        high=128,
        unit="px",
    )
    sgbm_mode: int = _parameter(0, "0 five paths, 1 eight paths, 2 three paths, 3 four paths; sgbm.", low=0, high=3)
    uniqueness_ratio: float = _parameter(
        15.0, "Margin by which the best cost must win over the second.", low=0.0, high=100.0, unit="%"
    )
    P1: float = _parameter(
        0.0, "Penalty on disparity steps of one pixel; 0 is 8 times the area of the window; sgbm.", low=0.0, high=4000.0
    )
    P2: float = _parameter(
        0.0,
        "Penalty on larger disparity steps, above P1; 0 is 32 times the area of the window; sgbm.",
        low=0.0,
        high=4000.0,
    )
    sgm_paths: int = _parameter(4, "Directions that costs are summed along: 4 or 8; sgm.", low=4, high=8, step=4)
    sgm_P1: int = _parameter(30, "Penalty on disparity steps of one pixel, in census bits; sgm.", low=1, high=96)
    sgm_P2: int = _parameter(
        150, "Penalty on larger disparity steps where the image is flat, in census bits; sgm.", low=2, high=192
    )
    disparity_filter: str = _parameter(
        "mean", "Mean of neighbours that differ by up to 1 px, or median; sgm.", choices=("none", "mean", "median")
    )
    fill_holes: bool = _parameter(
        False, "Gives every pixel a disparity, holes that of the farther surface beside them; sgm, scanline."
    )
    window_cost: str = _parameter(
        "sad",
        "Dissimilarity of two windows; window, adaptive_window.",
        choices=("sad", "ssd", "zsad", "zssd", "ncc", "zncc"),
    )
    max_difference: int = _parameter(
        0,
        "Bound on the difference of two pixels, against outliers in a window; 0 is none; window, adaptive_window.",
        low=0,
        high=255,
    )
    vertical_search: int = _parameter(
        0,
        "Rows searched above and below, for pairs that are not quite rectified; window, adaptive_window.",
        low=0,
        high=16,
        unit="px",
    )
    diffusion_model: str = _parameter(
        "bayesian", "How support is gathered; diffusion.", choices=("bayesian", "membrane")
    )
    iterations: int = _parameter(
        0, "Iterations; 0 takes the method's own; diffusion, graph_cut, belief_propagation.", low=0, high=1000
    )
    smoothness: float = _parameter(
        0.0,
        "Weight of smoothness against the data; 0 takes the method's own; scanline, graph_cut, belief_propagation.",
        low=0.0,
        high=1000.0,
    )
    feature_type: str = _parameter(
        "sift", "What is matched: sift or orb corners, or line segments; features.", choices=("sift", "orb", "lines")
    )
    onnx_model: str = _parameter("", "Path of the network, two images in and a disparity out; onnx.", run_time=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stereo_algorithm == 1 and self.P2 and self.P2 <= self.P1:
            raise ConfigError(f"P2 = {self.P2:g} is not above P1 = {self.P1:g}: raise P2 or lower P1")

    @property
    def max_disparity(self) -> int:
        """Largest whole disparity searched, px."""
        return self.min_disparity + self.num_disparities - 1


@dataclass(frozen=True)
class DepthConfig(_Checked):
    """The depth image and its uncertainty."""

    depth_encoding: str = _parameter(
        "32FC1",
        "Depth image: 32FC1 is metres with NaN, 16UC1 is millimetres with 0 (REP 118).",
        choices=("32FC1", "16UC1"),
    )
    disparity_sigma_px: float = _parameter(
        0.25,
        "Standard deviation of a disparity, from which sigma_Z = Z^2 / (f B) sigma_d.",
        low=0.0,
        high=16.0,
        unit="px",
    )


@dataclass(frozen=True)
class CloudConfig(_Checked):
    """The point cloud."""

    avoid_point_cloud_padding: bool = _parameter(
        False, "Pack points without padding: 16 bytes with colour, 12 without."
    )
    use_color: bool = _parameter(True, "Colour the points with the left image.")


@dataclass(frozen=True)
class HealthConfig(_Checked):
    """The health of the calibration, which health_node watches."""

    health_rate: float = _parameter(
        2.0, "Pairs looked at a second; 0 looks at every one.", low=0.0, high=100.0, unit="Hz"
    )
    row_error_limit: float = _parameter(
        1.0, "Median row error of matched features above which the node warns.", low=0.1, high=20.0, unit="px"
    )
    auto_correct: bool = _parameter(
        False, "Publish right/camera_info_corrected, with the misalignment taken back.", run_time=False
    )
    correction_limit: float = _parameter(
        1.0, "Largest rotation that is corrected, about each axis.", low=0.01, high=5.0, unit="deg", run_time=False
    )
    correct_yaw: bool = _parameter(
        False, "Watch yaw, and correct it, beyond reference_yaw; false only tells it.", run_time=False
    )
    reference_yaw: float = _parameter(
        0.0, "Yaw that the rig shows when it is healthy.", low=-5.0, high=5.0, unit="deg", run_time=False
    )


@dataclass(frozen=True)
class CalibrationConfig(_Checked):
    """Calibration with a board, which calibration_node does."""

    board: str = _parameter(
        "chessboard", "What is shown to the cameras.", choices=("chessboard", "charuco", "aprilgrid"), run_time=False
    )
    board_size: str = _parameter(
        "9x6", "Columns x rows: inner corners of a chessboard, squares of a charuco board, tags.", run_time=False
    )
    board_square: float = _parameter(
        0.025, "Side of a square, or of a tag of an aprilgrid.", low=0.001, high=1.0, unit="m", run_time=False
    )
    board_marker: float = _parameter(
        0.0, "Side of a marker of a charuco board; 0 is 3/4 of a square.", low=0.0, high=1.0, unit="m", run_time=False
    )
    board_dictionary: str = _parameter(
        "DICT_4X4_50", "Markers of a charuco board, as OpenCV names them.", run_time=False
    )
    board_spacing: float = _parameter(
        0.3, "Gap between the tags of an aprilgrid, over a tag's side.", low=0.01, high=2.0, run_time=False
    )
    lens_model: str = _parameter(
        "plumb_bob",
        "Distortion model of both lenses.",
        choices=("plumb_bob", "rational_polynomial", "equidistant"),
        run_time=False,
    )
    max_board_motion: float = _parameter(
        2.0,
        "Way of the corners between two pairs above which a view is not taken; 0 takes all.",
        low=0.0,
        high=100.0,
        unit="px",
    )
    calibration_folder: str = _parameter("calibration", "Where ~/save writes left.yaml, right.yaml and the report.")


@dataclass(frozen=True)
class PipelineConfig:
    """All stages of the path."""

    pairing: PairingConfig = PairingConfig()
    matching: MatchingConfig = MatchingConfig()
    depth: DepthConfig = DepthConfig()
    cloud: CloudConfig = CloudConfig()


# By the names of the tables: the stages of the path, and what nodes beside it take
CONFIGS: Mapping[str, type] = {
    **{item.name: type(item.default) for item in dataclasses.fields(PipelineConfig)},
    "health": HealthConfig,
    "calibration": CalibrationConfig,
}
