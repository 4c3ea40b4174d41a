# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Starts stereo depth: one node for each stage, or with fused:=true the whole pipeline in one node."""

import dataclasses
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, LogInfo, OpaqueFunction
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from stereo_depth_ros.config import CalibrationMonitorConfig, PipelineConfig, parameter_infos
from stereo_depth_ros.config.other_parameters import is_ros_parameter
from stereo_depth_ros.config.ros_yaml import node_parameters
from stereo_depth_ros.config.values import PIPELINE_NODES, check_texts, pipeline_config, read_params_file
from stereo_depth_ros.core.errors import ConfigError

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
    "params_file": ("", "ROS parameter file; every node takes its sections, arguments that are given override them."),
    "use_sim_time": ("false", "Take the time from /clock."),
    "log_level": ("info", "Lowest level of the messages that are logged: debug, info, warn, error or fatal."),
    "use_system_default_qos": ("false", "Accepted for compatibility, not used: set qos_overrides in a params_file."),
    "container": ("", "Accepted for compatibility, not used: each Python node runs in its process."),
}

SWITCHES = ("fused", "launch_image_proc", "health", "use_sim_time")
LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")

IMAGE_TOPICS = ("image_raw", "image_rect", "image_rect_color")
GRAY_AND_COLOR = ("image_mono", "image_color")  # before rectification
CAMERA_TOPICS = ("camera_info", *IMAGE_TOPICS, *GRAY_AND_COLOR, *(f"{topic}/compressed" for topic in IMAGE_TOPICS))

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


def stage_node(executable, *stages, file_parameters, condition=None, rectifies=False, **parameters):
    """A node with the parameters of its stages, its camera topics in the namespaces of the cameras."""
    values = {
        info.name: ParameterValue(parameters.get(info.name, LaunchConfiguration(info.name)), value_type=info.type)
        for stage in stages
        for info in STAGES[stage]
    }
    for name, value in file_parameters(executable).items():
        if name in values or is_ros_parameter(name):
            values[name] = ParameterValue(value, value_type=type(value))
    return Node(
        package="stereo_depth_ros",
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[values],
        ros_arguments=["--log-level", LaunchConfiguration("log_level")],
        remappings=remappings(rectifies),
        condition=condition,
        output="screen",
    )


def check_choice(name, value, choices):
    """Raise ConfigError for an argument that is not one of the choices."""
    if value not in choices:
        raise ConfigError(f"argument {name} = {value!r} is not one of {', '.join(choices)}", remedy="use one of them")


def nodes(context, given):
    """The nodes, after a check of all arguments: an error here ends the launch before a process has started."""
    texts = context.launch_configurations
    for name in SWITCHES:
        check_choice(name, texts[name].lower(), ("true", "false", "1", "0"))  # as IfCondition
    check_choice("log_level", texts["log_level"], LOG_LEVELS)
    values = check_texts({info.name: texts[info.name] for infos in STAGES.values() for info in infos})
    pipeline_config(values)
    sim_time = {"use_sim_time": True} if texts["use_sim_time"].lower() in ("true", "1") else {}
    # rectify_node publishes raw images, whatever the file says of the cameras
    fixed = {"image_transport"} if texts["launch_image_proc"].lower() in ("true", "1") else set()

    def file_parameters(executable):
        """What a node takes from the file beside the arguments that are given; the fused node stands for all."""
        if not texts["params_file"]:
            return sim_time
        names = PIPELINE_NODES if executable == "stereo_depth_node" else (executable,)
        names = [f"{texts['namespace'].strip('/')}/{name}".strip("/") for name in names]
        path = Path(texts["params_file"])
        of_ros = {name: value for name, value in node_parameters(path, *names).items() if is_ros_parameter(name)}
        not_taken = given if executable in ("rectify_node", "stereo_depth_node") else given | fixed
        found = {**of_ros, **read_params_file(path, names)}
        found = {name: value for name, value in found.items() if name not in not_taken}
        pipeline_config({**values, **found})
        return {**sim_time, **found}

    return actions(file_parameters)


def actions(file_parameters):
    """The nodes of both shapes, with their conditions."""
    fused = LaunchConfiguration("fused")
    rectified = {"image_transport": RECTIFIED_TRANSPORT}

    def node(executable, *stages, **options):
        return stage_node(executable, *stages, file_parameters=file_parameters, **options)

    return [
        GroupAction(
            [
                node(
                    "rectify_node",
                    "pairing",
                    "rectification",
                    condition=IfCondition(LaunchConfiguration("launch_image_proc")),
                    rectifies=True,
                ),
                node("disparity_node", "pairing", "matching", **rectified),
                node("point_cloud_node", "pairing", "cloud", **rectified),
                node("depth_node", "pairing", "depth", **rectified),
            ],
            condition=UnlessCondition(fused),
        ),
        node("stereo_depth_node", *PIPELINE, condition=IfCondition(fused), rectifies=True),
        node(
            "calibration_monitor",
            "pairing",
            "health",
            condition=IfCondition(LaunchConfiguration("health")),
            **rectified,
        ),
    ]


def generate_launch_description():
    """Arguments, nodes, and a message where an argument has no effect."""
    container = LaunchConfiguration("container")
    given = set()  # arguments that are given: before the others have their defaults
    return LaunchDescription(
        [
            OpaqueFunction(function=lambda context: given.update(context.launch_configurations)),
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
            OpaqueFunction(function=nodes, args=[given]),
        ]
    )
