# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the stages and nodes: one frozen dataclass each.

Everything else that knows a parameter (declared ROS parameters and their descriptors, ``config/*.yaml``, command-line
options, the README's table) is made from the metadata here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from stereo_depth_ros.config.matching import MatchingConfig
from stereo_depth_ros.config.parameter import Checked, parameter

__all__ = [
    "CONFIGS",
    "CalibrationConfig",
    "CalibrationMonitorConfig",
    "CloudConfig",
    "DepthConfig",
    "PairingConfig",
    "PipelineConfig",
]


@dataclass(frozen=True)
class PairingConfig(Checked):
    """How left and right images, and their camera infos, are brought together."""

    queue_size: int = parameter(
        5, "Unpaired images kept per camera while the other camera is awaited.", low=1, high=1000, run_time=False
    )
    approximate_sync: bool = parameter(False, "Pair stamps that differ; false pairs equal stamps only.", run_time=False)
    approximate_sync_tolerance_seconds: float = parameter(
        0.0,
        "Largest stamp difference within an approximate pair, itself included; 0 means no limit.",
        low=0.0,
        high=3600.0,
        unit="s",
        run_time=False,
    )

    image_transport: str = parameter(
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
class DepthConfig(Checked):
    """The depth image and its uncertainty."""

    depth_encoding: str = parameter(
        "32FC1",
        "Depth image: 32FC1 is meters with NaN, 16UC1 is millimeters with 0 (REP 118).",
        choices=("32FC1", "16UC1"),
    )
    disparity_sigma_px: float = parameter(
        0.25,
        "Standard deviation of a disparity, from which sigma_Z = Z^2 / (f B) sigma_d.",
        low=0.0,
        high=16.0,
        unit="px",
    )


@dataclass(frozen=True)
class CloudConfig(Checked):
    """The point cloud."""

    avoid_point_cloud_padding: bool = parameter(False, "Pack points without padding: 16 bytes with color, 12 without.")
    use_color: bool = parameter(True, "Color the points with the left image.")


@dataclass(frozen=True)
class CalibrationMonitorConfig(Checked):
    """The health of the calibration, which health_node watches."""

    health_rate: float = parameter(
        2.0, "Pairs looked at a second; 0 looks at every one.", low=0.0, high=100.0, unit="Hz"
    )
    row_error_limit: float = parameter(
        1.0, "Median row error of matched features above which the node warns.", low=0.1, high=20.0, unit="px"
    )
    auto_correct: bool = parameter(
        False, "Publish right/camera_info_corrected, with the misalignment taken back.", run_time=False
    )
    correction_limit: float = parameter(
        1.0, "Largest rotation that is corrected, about each axis.", low=0.01, high=5.0, unit="deg", run_time=False
    )
    correct_yaw: bool = parameter(
        False, "Watch yaw, and correct it, beyond reference_yaw; false only tells it.", run_time=False
    )
    reference_yaw: float = parameter(
        0.0, "Yaw that the rig shows when it is healthy.", low=-5.0, high=5.0, unit="deg", run_time=False
    )


@dataclass(frozen=True)
class CalibrationConfig(Checked):
    """Calibration with a board, which calibration_node does."""

    board: str = parameter(
        "chessboard", "What is shown to the cameras.", choices=("chessboard", "charuco", "aprilgrid"), run_time=False
    )
    board_size: str = parameter(
        "9x6", "Columns x rows: inner corners of a chessboard, squares of a charuco board, tags.", run_time=False
    )
    board_square: float = parameter(
        0.025, "Side of a square, or of a tag of an aprilgrid.", low=0.001, high=1.0, unit="m", run_time=False
    )
    board_marker: float = parameter(
        0.0, "Side of a marker of a charuco board; 0 is 3/4 of a square.", low=0.0, high=1.0, unit="m", run_time=False
    )
    board_dictionary: str = parameter(
        "DICT_4X4_50", "Markers of a charuco board, as OpenCV names them.", run_time=False
    )
    board_spacing: float = parameter(
        0.3, "Gap between the tags of an aprilgrid, over a tag's side.", low=0.01, high=2.0, run_time=False
    )
    lens_model: str = parameter(
        "plumb_bob",
        "Distortion model of both lenses.",
        choices=("plumb_bob", "rational_polynomial", "equidistant"),
        run_time=False,
    )
    max_board_motion: float = parameter(
        2.0,
        "Way of the corners between two pairs above which a view is not taken; 0 takes all.",
        low=0.0,
        high=100.0,
        unit="px",
    )
    calibration_folder: str = parameter("calibration", "Where ~/save writes left.yaml, right.yaml and the report.")
    overwrite: bool = parameter(False, "~/save replaces the files that are there.")


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
    "health": CalibrationMonitorConfig,
    "calibration": CalibrationConfig,
}
