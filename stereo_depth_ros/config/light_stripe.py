# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of light stripe scanning."""

from __future__ import annotations

from dataclasses import dataclass

from stereo_depth_ros.config.parameter import Checked, parameter

__all__ = ["LightStripeConfig", "StripeMotionConfig"]


@dataclass(frozen=True)
class LightStripeConfig(Checked):
    """Light stripe scanning: the stripe in the image, and the points on its light plane."""

    stripe_method: str = parameter(
        "ridge",
        "Sub-pixel place of the stripe: ridge of Gaussian derivatives (Steger 1998), or center of mass of a line.",
        choices=("ridge", "center"),
    )
    stripe_direction: str = parameter(
        "vertical",
        "Direction of the stripe in the image: vertical gives one point a row, horizontal one a column.",
        choices=("vertical", "horizontal"),
    )
    stripe_channel: str = parameter(
        "auto",
        "Colors in which the stripe is sought: one channel, or its excess over green (red) or over red (green, blue), "
        "in which white and gray surfaces vanish; auto takes the best one in the first image.",
        choices=("auto", "gray", "red", "green", "blue", "red_excess", "green_excess", "blue_excess"),
    )
    stripe_width: float = parameter(
        5.0,
        "Expected width of the stripe; up to three times that is accepted.",
        low=2.0,
        high=100.0,
        unit="px",
    )
    stripe_contrast: float = parameter(
        4.0,
        "Least gray levels by which the stripe exceeds both of its sides, mean over its width; below five standard "
        "deviations of the noise it is not accepted either.",
        low=0.0,
        high=255.0,
    )
    second_stripe: float = parameter(
        0.5,
        "Contrast of a second stripe in a line, relative to that of the first, from which the line is rejected.",
        low=0.05,
        high=1.0,
    )
    min_stripe_length: int = parameter(
        4, "Lines that a piece of the stripe must have; shorter ones are rejected.", low=1, high=1000
    )
    stripe_min_depth: float = parameter(0.0, "Depth from which stripes are sought.", low=0.0, high=1000.0, unit="m")
    stripe_max_depth: float = parameter(
        0.0, "Depth up to which stripes are sought; 0 means no limit.", low=0.0, high=1000.0, unit="m"
    )
    min_plane_angle: float = parameter(
        2.0, "Angle between ray and light plane below which a point is rejected.", low=0.0, high=45.0, unit="deg"
    )
    max_axis_distance: float = parameter(
        0.0,
        "Distance from the axis of a turntable above which a point is rejected; 0 means no limit.",
        low=0.0,
        high=1000.0,
        unit="m",
    )
    max_stripe_difference: float = parameter(
        1.0,
        "Largest difference in disparity between light plane and second camera, where both give a point.",
        low=0.01,
        high=100.0,
        unit="px",
    )


@dataclass(frozen=True)
class StripeMotionConfig(Checked):
    """Calibration and motion of a light stripe scanner."""

    laser_file: str = parameter(
        "",
        "File of the light plane, written by `stereo-depth calibrate-laser`.",
        run_time=False,
    )
    stripe_motion: str = parameter(
        "none",
        "Motion between the images: none, linear (a joint, or a coordinate of a table, in meters along linear_axis), "
        "turntable (a joint in radians about the axis in turntable_file), or pose (geometry_msgs/PoseStamped).",
        choices=("none", "linear", "turntable", "pose"),
        run_time=False,
    )
    moving: str = parameter(
        "object",
        "What moves: the object; the sensor, which is camera and laser together; or the light plane alone.",
        choices=("object", "sensor", "plane"),
        run_time=False,
    )
    linear_axis: str = parameter(
        "1 0 0", "Direction of a linear motion in the frame of the camera, three numbers.", run_time=False
    )
    turntable_file: str = parameter(
        "", "File of the axis of a turntable, written by `stereo-depth calibrate-turntable`.", run_time=False
    )
    motion_joint: str = parameter("", "Name of the joint in joint_states; empty takes the first one.", run_time=False)
    max_profiles: int = parameter(
        5000, "Profiles kept for the merged cloud; the oldest are dropped.", low=1, high=1000000
    )
