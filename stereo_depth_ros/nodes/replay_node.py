# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plays a stereo bag through the live graph and records the outputs; a node, and a function for programs."""

from __future__ import annotations

import dataclasses
import functools
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node

from stereo_depth_ros.bags.pairs import BagPairs, BagSelection
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.bags.writer import check_bag_output
from stereo_depth_ros.camera_files.urls import camera_info_paths
from stereo_depth_ros.config import CameraInfoConfig, PairingConfig, PipelineConfig, parameter_infos
from stereo_depth_ros.core.errors import CalibrationError, CameraOrderError, GraphError, StereoDepthError
from stereo_depth_ros.core.interrupts import handled_signals
from stereo_depth_ros.diagnosis.opening import open_selection
from stereo_depth_ros.evaluation.bag_score import score_disparity
from stereo_depth_ros.nodes.command_line import answer_help, start_ros
from stereo_depth_ros.nodes.first_pairs_watch import FIRST_PAIRS, ORDER
from stereo_depth_ros.nodes.interface import NodeInterface
from stereo_depth_ros.nodes.log import log_fatal, log_info
from stereo_depth_ros.nodes.parameters import error_text, parameters_of_ros
from stereo_depth_ros.nodes.replay.graph_ports import PUBLISHED, SUBSCRIBED, GraphPorts
from stereo_depth_ros.nodes.replay.player import Player
from stereo_depth_ros.nodes.replay.recorder import Recorder
from stereo_depth_ros.nodes.transport import prepare_process
from stereo_depth_ros.offline.provenance import provenance
from stereo_depth_ros.offline.report import RunReport
from stereo_depth_ros.replay.options import ReplayOptions

__all__ = ["INTERFACE", "check_recording", "main", "play", "replay", "selected"]

_END_S = 1.5  # after a signal, to remove the recording
_DIAGNOSTICS_TIMEOUT_S = 2.5  # nodes publish their timings once a second
INTERFACE = NodeInterface(
    "replay_node",
    configs=(ReplayOptions, PairingConfig, CameraInfoConfig),
    inputs=SUBSCRIBED,
    outputs=PUBLISHED,
    lazy=False,
)
# Parameters by the names that errors use
_PARAMETERS = {
    **{info.name: info.name for config in INTERFACE.configs for info in parameter_infos(config)},
    "left": "left_topic",
    "right": "right_topic",
}


def _nothing(*_: Any) -> None:
    """Default callback: does nothing."""


def replay(
    options: ReplayOptions,
    progress: Callable[[int, int], None] = _nothing,
    check: Callable[[], None] = _nothing,
    config: PipelineConfig | None = None,
) -> RunReport:
    """Play a bag through the nodes that run in this ROS domain; rclpy is initialized for it and shut down after it.

    Args:
        options: what to play, and how.
        progress: called with pairs sent and pairs to send (at most).
        check: called many times a second; ends the replay by raising.
        config: parameters of the nodes, for the pairing of the bag's images and for the record beside the outputs.

    Raises:
        BagError, TopicError: nothing to play.
        OutputError: the output exists and is not to be overwritten, or it is read, or it cannot be written.
        CameraOrderError: left and right are swapped; nothing is recorded.
        CalibrationError: the first pairs do not fit the calibration, with ``strict``; nothing is recorded.
        GraphError: an input has no subscriber, an output no publisher, or no output arrives.
    """
    prepare_process()
    context = Context()
    rclpy.init(args=[], context=context)
    try:
        node = Node(INTERFACE.name, context=context)
        try:
            return play(node, options, config or PipelineConfig(), progress, check)
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def check_recording(options: ReplayOptions) -> None:
    """Refuse an output that must not or cannot be written, before anything is played.

    Raises:
        BagError: its name does not end in .mcap.
        OutputError: it exists and is not to be overwritten, or it is read, or it cannot be written.
    """
    if options.output_path is not None:
        check_bag_output(options.output_path, bag_files(options.selection.path), overwrite=options.overwrite)


def selected(options: ReplayOptions, config: PipelineConfig) -> BagSelection:
    """What is read of the bag, and the calibration files that are read instead of its camera infos."""
    urls = config.camera_info
    files = camera_info_paths(urls.left_camera_info_url, urls.right_camera_info_url)
    return dataclasses.replace(options.selection, camera_files=files)


def play(
    node: Node,
    options: ReplayOptions,
    config: PipelineConfig,
    progress: Callable[[int, int], None] = _nothing,
    check: Callable[[], None] = _nothing,
) -> RunReport:
    """As :func:`replay`, with an existing node."""
    check_recording(options)
    selection, choice = open_selection(selected(options, config), config.pairing)
    with BagPairs(selection, config.pairing) as pairs:
        with Recorder(options.output_path, overwrite=options.overwrite) as recorder:
            recorder.write_metadata("stereo_depth_ros", provenance(config, bag=options.bag))
            ports = GraphPorts(node, recorder, pairs.topics.compressed, options.clock, options.view_topics)
            player = Player(ports, pairs, options, config.pairing.approximate_sync, check)
            try:
                player.play(progress)
                ports.await_diagnostics(_DIAGNOSTICS_TIMEOUT_S)
                intruders = "; ".join(ports.intruders())  # may be discovered only while the bag plays
            finally:
                ports.close()
            _check_rig(options, ports)
            _check_played(options, player, ports.errors_reported())
        result = RunReport(
            bag=options.selection.path,
            output=options.output_path,
            pairs=player.sent,
            unpaired_left=pairs.unpaired_left,
            unpaired_right=pairs.unpaired_right,
            outputs=player.stats,
            wall_s=player.wall_s,
            stages_ms=ports.stages_ms(),
            realtime=options.realtime,
            warnings=tuple(
                text for text in (choice, pairs.warning, *pairs.losses, ports.errors_reported(), intruders) if text
            ),
        )
    if options.output_path is None:
        return result
    topic = node.resolve_topic_name("disparity")
    return dataclasses.replace(result, score=score_disparity(options.output_path, options.selection.path, topic))


def _check_rig(options: ReplayOptions, ports: GraphPorts) -> None:
    """Refuse to keep outputs of swapped cameras, and with ``strict`` of a calibration that does not fit."""
    if fault := ports.reported(ORDER):
        raise CameraOrderError(fault, subject=options.bag, settings=("left_topic", "right_topic"))
    if options.strict and (fault := ports.reported(FIRST_PAIRS)):
        raise CalibrationError(fault, subject=options.bag)


def _check_played(options: ReplayOptions, player: Player, errors_reported: str) -> None:
    """Refuse to keep a recording without outputs."""
    if options.output_path is not None and not any(stats.received for stats in player.stats.values()):
        reason = errors_reported or "the nodes report no error"
        raise GraphError(f"no output for any of {player.sent} pairs", value=0, limit=player.sent, remedy=reason)


def main() -> int:
    """Run the node: play, log the summary, end; or print its help.

    Returns:
        0 after playing, a signal or the help, 1 where the bag cannot be played, 3 where outputs were lost.
    """
    if answer_help(INTERFACE, "Plays a stereo bag through the live graph, records the outputs, and ends.", sys.argv):
        return 0
    # The recording is removed on the way out.
    with handled_signals(signal.default_int_handler, _END_S, functools.partial(os._exit, 0)):
        return _run()


def _run() -> int:
    prepare_process()
    try:
        start_ros(sys.argv)
        with parameters_of_ros():
            node = Node(INTERFACE.name)
        options = _declared(node, ReplayOptions)
        config = PipelineConfig(pairing=_declared(node, PairingConfig), camera_info=_declared(node, CameraInfoConfig))
        result = play(node, options, config)
        log_info(node.get_logger(), _summary(result))
        return 3 if result.lost and not result.realtime else 0
    except StereoDepthError as error:
        log_fatal(get_logger("stereo_depth_ros"), error_text(error, _PARAMETERS))
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    finally:
        rclpy.try_shutdown()


def _declared(node: Node, config: type[Any]) -> Any:
    """The config with the values of the node's parameters."""
    values = {}
    for info in parameter_infos(config):
        descriptor = ParameterDescriptor(description=info.doc, read_only=True, dynamic_typing=True)
        values[info.field] = node.declare_parameter(info.name, info.default, descriptor).value
    return config(**values)


def _summary(result: RunReport) -> str:
    outputs = ", ".join(f"{topic} {stats.received}" for topic, stats in result.outputs.items())
    return (
        f"{result.pairs} pairs of {result.bag} sent, {result.frames_per_second:.1f} pairs/s; received {outputs}; "
        f"{result.lost} lost; recorded into {result.output or 'nothing'}"
    )


if __name__ == "__main__":
    raise SystemExit(main())
