# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Starts stereo depth: one node for each stage, or with fused:=true the whole pipeline in one node."""

import dataclasses

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, LogInfo
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from stereo_depth_ros.config import CalibrationMonitorConfig, PipelineConfig, parameter_infos

PIPELINE = [item.name for item in dataclasses.fields(PipelineConfig)]
STAGES = {item.name: list(parameter_infos(item.default)) for item in dataclasses.fields(PipelineConfig)}
STAGES["health"] = list(parameter_infos(CalibrationMonitorConfig))

ARGUMENTS = {
    "fused": ("false", "One stereo_depth_node in place of one node for each stage."),
    "launch_image_proc": ("true", "Start rectify_node; false where another node rectifies (fused: always rectifies)."),
    "namespace": ("", "Namespace of the nodes."),
    "left_namespace": ("left", "Namespace of the topics of the left camera."),
    "right_namespace": ("right", "Namespace of the topics of the right camera."),
    "health": ("false", "Start calibration_monitor, which monitors the calibration; see auto_correct."),
    "container": ("", "Accepted for compatibility, not used: each Python node runs in its process."),
}

IMAGE_TOPICS = ("image_raw", "image_rect", "image_rect_color")
CAMERA_TOPICS = ("camera_info", *IMAGE_TOPICS, *(f"{topic}/compressed" for topic in IMAGE_TOPICS))

# image_transport is that of the cameras: rectify_node publishes raw images
RECTIFIED_TRANSPORT = PythonExpression(
    [
        *("'raw' if '", LaunchConfiguration("launch_image_proc"), "'.lower() in ('true', '1') else '"),
        *(LaunchConfiguration("image_transport"), "'"),
    ]
)


# With auto_correct, rectify with the camera infos of calibration_monitor
RIGHT_INFO_TO_RECTIFY = PythonExpression(
    [
        *("'/camera_info_corrected' if '", LaunchConfiguration("health"), "'.lower() in ('true', '1')"),
        *(" and '", LaunchConfiguration("auto_correct"), "'.lower() in ('true', '1') else '/camera_info'"),
    ]
)


def remappings(rectifies):
    """The topics of the cameras, in their namespaces."""
    targets = {
        f"{side}/{topic}": [LaunchConfiguration(f"{side}_namespace"), f"/{topic}"]
        for side in ("left", "right")
        for topic in CAMERA_TOPICS
    }
    targets["right/camera_info_corrected"] = [LaunchConfiguration("right_namespace"), "/camera_info_corrected"]
    if rectifies:
        targets["right/camera_info"] = [LaunchConfiguration("right_namespace"), RIGHT_INFO_TO_RECTIFY]
    return list(targets.items())


def stage_node(executable, *stages, condition=None, rectifies=False, **parameters):
    """A node with the parameters of its stages, its camera topics in the namespaces of the cameras."""
    return Node(
        package="stereo_depth_ros",
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            {
                info.name: ParameterValue(
                    parameters.get(info.name, LaunchConfiguration(info.name)), value_type=info.type
                )
                for stage in stages
                for info in STAGES[stage]
            }
        ],
        remappings=remappings(rectifies),
        condition=condition,
        output="screen",
    )


def generate_launch_description():
    """Arguments, nodes, and a message where an argument has no effect."""
    fused = LaunchConfiguration("fused")
    container = LaunchConfiguration("container")
    rectified = {"image_transport": RECTIFIED_TRANSPORT}
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            *(
                DeclareLaunchArgument(info.name, default_value=str(info.default), description=info.doc)
                for infos in STAGES.values()
                for info in infos
            ),
            LogInfo(
                msg=["container:=", container, " is not used: each Python node runs in its process"],
                condition=IfCondition(PythonExpression(["'", container, "' != ''"])),
            ),
            GroupAction(
                [
                    stage_node(
                        "rectify_node",
                        "pairing",
                        condition=IfCondition(LaunchConfiguration("launch_image_proc")),
                        rectifies=True,
                    ),
                    stage_node("disparity_node", "pairing", "matching", **rectified),
                    stage_node("point_cloud_node", "pairing", "cloud", **rectified),
                    stage_node("depth_node", "pairing", "depth", **rectified),
                ],
                condition=UnlessCondition(fused),
            ),
            stage_node("stereo_depth_node", *PIPELINE, condition=IfCondition(fused), rectifies=True),
            stage_node(
                "calibration_monitor",
                "pairing",
                "health",
                condition=IfCondition(LaunchConfiguration("health")),
                **rectified,
            ),
        ]
    )
