# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the stages and nodes: one frozen dataclass each.

Declared ROS parameters and their descriptors, ``config/*.yaml``, command-line options and the tables of the
documentation are generated from the metadata here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from stereo_depth_ros.config.light_stripe import LightStripeConfig, StripeMotionConfig
from stereo_depth_ros.config.matching import MatchingConfig
from stereo_depth_ros.config.parameter import Checked, parameter
from stereo_depth_ros.config.structured_light import StructuredLightConfig
from stereo_depth_ros.core.errors import ConfigError

__all__ = [
    "ANAGLYPH_FILTERS",
    "ANAGLYPH_METHODS",
    "CONFIGS",
    "CalibrationConfig",
    "CalibrationMonitorConfig",
    "CameraInfoConfig",
    "CloudConfig",
    "DepthConfig",
    "PairingConfig",
    "PipelineConfig",
    "PointConfig",
    "PriorConfig",
    "RectificationConfig",
    "ViewConfig",
]

ANAGLYPH_METHODS = ("true", "gray", "color", "half-color", "optimized", "dubois")
ANAGLYPH_FILTERS = ("red-cyan", "green-magenta", "amber-blue")


@dataclass(frozen=True)
class PairingConfig(Checked):
    """Input images and the pairing of left and right."""

    queue_size: int = parameter(5, "Number of unpaired images kept per camera.", low=1, high=1000, run_time=False)
    approximate_sync: bool = parameter(
        False, "Pair images with different stamps; if false, stamps must be equal.", run_time=False
    )
    approximate_sync_tolerance_seconds: float = parameter(
        0.0,
        "Largest stamp difference within an approximate pair, inclusive; 0 means no limit.",
        low=0.0,
        high=3600.0,
        unit="s",
        run_time=False,
    )

    image_transport: str = parameter(
        "raw",
        "Transport of the input images: raw or compressed (topics with the suffix /compressed).",
        choices=("raw", "compressed"),
        run_time=False,
    )

    @property
    def tolerance_ns(self) -> int | None:
        """Largest stamp difference within a pair, nanoseconds; None means no limit."""
        if not self.approximate_sync:
            return 0
        return round(self.approximate_sync_tolerance_seconds * 1e9) or None


@dataclass(frozen=True)
class CameraInfoConfig(Checked):
    """Calibration files in place of the camera infos."""

    left_camera_info_url: str = parameter(
        "",
        "Calibration file of the left camera, or of both, instead of the camera info topics: file:///PATH, "
        "package://PACKAGE/PATH or a path; empty for the topics.",
        run_time=False,
    )
    right_camera_info_url: str = parameter(
        "", "Calibration file of the right camera; empty where that of the left one holds both.", run_time=False
    )


@dataclass(frozen=True)
class PriorConfig(Checked):
    """A range sensor whose points guide the matcher."""

    prior_topic: str = parameter(
        "",
        "Topic of a range sensor (PointCloud2, LaserScan, or depth Image) whose points guide the matcher, sgm only; "
        "empty uses none.",
        run_time=False,
    )
    prior_extrinsics: str = parameter(
        "", "File with the pose of that range sensor; empty takes that of /tf_static and /tf.", run_time=False
    )


@dataclass(frozen=True)
class RectificationConfig(Checked):
    """The images that are rectified."""

    debayer: int = parameter(
        3,
        "Colors of 8-bit Bayer images: 3 by variable number of gradients (VNG), 0 bilinear, which takes a 25th of the "
        "time; 1 and 2, edge-aware in image_proc, are bilinear too.",
        low=0,
        high=3,
    )


@dataclass(frozen=True)
class DepthConfig(Checked):
    """The depth image and its uncertainty."""

    depth_encoding: str = parameter(
        "32FC1",
        "Encoding of the depth image (REP 118): 32FC1 in meters, invalid NaN, or 16UC1 in millimeters, invalid 0.",
        choices=("32FC1", "16UC1"),
    )
    disparity_sigma_px: float = parameter(
        0.0,
        "Standard deviation of a disparity, for the depth uncertainty sigma_Z = Z^2 / (f B) sigma_d; 0 takes that of "
        "each pixel by its confidence, or 0.25 px where the matcher has no table of it.",
        low=0.0,
        high=16.0,
        unit="px",
    )


@dataclass(frozen=True)
class PointConfig(Checked):
    """The points of a cloud."""

    avoid_point_cloud_padding: bool = parameter(
        False, "Pack points without padding: 16 bytes per point with color, 12 without."
    )
    use_color: bool = parameter(True, "Color the points with the left image.")


@dataclass(frozen=True)
class CloudConfig(PointConfig):
    """The point cloud of a disparity map."""

    point_quality: bool = parameter(
        False,
        "Give each point the fields confidence, 0 to 1, and sigma, the standard deviation of its depth in meters.",
    )


@dataclass(frozen=True)
class CalibrationMonitorConfig(Checked):
    """Calibration monitoring."""

    health_rate: float = parameter(
        2.0, "Rate at which pairs are checked; 0 checks every pair.", low=0.0, high=100.0, unit="Hz"
    )
    row_error_limit: float = parameter(
        1.0, "Median row error of matched features above which the node warns.", low=0.1, high=20.0, unit="px"
    )
    auto_correct: bool = parameter(
        False, "Publish right/camera_info_corrected, which compensates the estimated misalignment.", run_time=False
    )
    correction_limit: float = parameter(
        1.0, "Largest rotation that is corrected, per axis.", low=0.01, high=5.0, unit="deg", run_time=False
    )
    correct_yaw: bool = parameter(
        False, "Monitor and correct yaw relative to reference_yaw; if false, yaw is only reported.", run_time=False
    )
    reference_yaw: float = parameter(
        0.0, "Yaw measured while the calibration is good.", low=-5.0, high=5.0, unit="deg", run_time=False
    )
    range_sensor: str = parameter(
        "",
        "Topic of a range sensor (PointCloud2, LaserScan, or depth Image) that disparities are checked against; empty "
        "checks none.",
        run_time=False,
    )
    range_sensor_extrinsics: str = parameter(
        "", "File with the pose of the range sensor; empty takes that of /tf_static and /tf.", run_time=False
    )


@dataclass(frozen=True)
class CalibrationConfig(Checked):
    """Calibration with a board."""

    board: str = parameter(
        "chessboard", "Type of calibration board.", choices=("chessboard", "charuco", "aprilgrid"), run_time=False
    )
    board_size: str = parameter(
        "9x6",
        "Columns x rows: inner corners of a chessboard, squares of a ChArUco board, tags of an aprilgrid.",
        run_time=False,
    )
    board_square: float = parameter(
        0.025, "Side length of a square, or of a tag of an aprilgrid.", low=0.001, high=1.0, unit="m", run_time=False
    )
    board_marker: float = parameter(
        0.0,
        "Side length of a marker of a ChArUco board; 0 means 3/4 of a square.",
        low=0.0,
        high=1.0,
        unit="m",
        run_time=False,
    )
    board_dictionary: str = parameter(
        "DICT_4X4_50", "Marker dictionary of a ChArUco board, by its OpenCV name.", run_time=False
    )
    board_spacing: float = parameter(
        0.3,
        "Gap between the tags of an aprilgrid, as a fraction of the side of a tag.",
        low=0.01,
        high=2.0,
        run_time=False,
    )
    lens_model: str = parameter(
        "plumb_bob",
        "Distortion model of both cameras.",
        choices=("plumb_bob", "rational_polynomial", "equidistant"),
        run_time=False,
    )
    max_board_motion: float = parameter(
        2.0,
        "Corner motion between pairs above which a view is rejected; 0 accepts all.",
        low=0.0,
        high=100.0,
        unit="px",
    )
    calibration_folder: str = parameter(
        "calibration",
        "Folder in which ~/save writes left.yaml, right.yaml and the report; in numbered folders below it where it "
        "has them already.",
        run_time=False,
    )
    overwrite: bool = parameter(
        False, "Whether ~/save replaces the files in the folder instead of adding numbered ones.", run_time=False
    )


@dataclass(frozen=True)
class ViewConfig(Checked):
    """Views: the image between the cameras, anaglyphs and color maps."""

    view_position: float = parameter(
        0.5,
        "Position of the camera of view/image: 0 is the left one, 1 the right one; a message on view/position sets it.",
        low=-0.5,
        high=1.5,
    )
    anaglyph_method: str = parameter("dubois", "How the colors of an anaglyph are computed.", choices=ANAGLYPH_METHODS)
    anaglyph_filters: str = parameter(
        "red-cyan", "Filters of the glasses for anaglyphs, left and right.", choices=ANAGLYPH_FILTERS
    )
    auto_convergence: bool = parameter(
        True, "Shift the images of an anaglyph so that the subject, the nearest large surface, lies at the screen."
    )
    convergence: float = parameter(
        0.0,
        "Disparity that lies at the screen where auto_convergence is false, rounded.",
        low=-4096.0,
        high=4096.0,
        unit="px",
    )
    depth_near: float = parameter(
        0.0, "Depth with the lightest color of depth_color; 0 is the 1st percentile.", low=0.0, high=10000.0, unit="m"
    )
    depth_far: float = parameter(
        0.0, "Depth with the darkest color of depth_color; 0 is the 99th percentile.", low=0.0, high=10000.0, unit="m"
    )
    color_legend: bool = parameter(False, "Add a legend to disparity_color and depth_color, beside the image.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.depth_near and self.depth_far and self.depth_near >= self.depth_far:
            raise ConfigError(
                f"depth_near = {self.depth_near:g} m is not below depth_far = {self.depth_far:g} m",
                value=self.depth_near,
                limit=self.depth_far,
                remedy="exchange them, or set one of them to 0",
                settings=("near", "far"),
            )


@dataclass(frozen=True)
class PipelineConfig:
    """Parameters of all stages of the pipeline."""

    pairing: PairingConfig = PairingConfig()
    matching: MatchingConfig = MatchingConfig()
    depth: DepthConfig = DepthConfig()
    cloud: CloudConfig = CloudConfig()
    rectification: RectificationConfig = RectificationConfig()
    camera_info: CameraInfoConfig = CameraInfoConfig()


# By the names of the tables: the stages of the pipeline, and nodes beside it
CONFIGS: Mapping[str, type] = {
    **{item.name: type(item.default) for item in dataclasses.fields(PipelineConfig)},
    "prior": PriorConfig,
    "health": CalibrationMonitorConfig,
    "calibration": CalibrationConfig,
    "structured_light": StructuredLightConfig,
    "light_stripe": LightStripeConfig,
    "stripe_motion": StripeMotionConfig,
    "view": ViewConfig,
}
