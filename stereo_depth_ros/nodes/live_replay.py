# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Starts the nodes, plays a bag through them, and stops them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

from stereo_depth_ros.bags.pairs import BagPairs
from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.diagnosis.opening import open_selection
from stereo_depth_ros.nodes.readiness import wait_until_ready
from stereo_depth_ros.nodes.replay_node import check_recording, replay, selected
from stereo_depth_ros.nodes.transport import prepare_process
from stereo_depth_ros.offline.report import RunReport
from stereo_depth_ros.replay.graph_processes import GraphProcesses
from stereo_depth_ros.replay.options import ReplayOptions

__all__ = ["replay_through_graph"]

# Topics of a camera that the nodes of either shape subscribe.
_URLS = ("left_camera_info_url", "right_camera_info_url")
_CAMERA_INPUTS = ("camera_info", "image_raw", "image_raw/compressed", "image_rect", "image_rect_color")


def replay_through_graph(
    options: ReplayOptions,
    shape: str,
    parameters: Mapping[str, bool | int | float | str],
    config: PipelineConfig,
    progress: Callable[[int, int], None],
    params_file: Path | None = None,
    monitor: Literal["", "report", "correct"] = "",
) -> RunReport:
    """Start the nodes, play, stop the nodes.

    Args:
        options: what to play, and how.
        shape: "fused" or "separate".
        parameters: parameters of the nodes; image transport and simulated time are added.
        config: of ``parameters`` and ``params_file``.
        progress: called with pairs sent and pairs to send (at most).
        params_file: a ROS parameter file for the nodes.
        monitor: see :class:`GraphProcesses`.

    Raises:
        BagError, TopicError: nothing to play; before any node is started.
        OutputError: the output must not or cannot be written.
        GraphError: a node ended, or no output arrives.
    """
    check_recording(options)
    chosen, choice = open_selection(selected(options, config), config.pairing)
    options = replace(options, left_topic=chosen.left or "", right_topic=chosen.right or "")
    with BagPairs(chosen, config.pairing) as pairs:
        transport = "compressed" if pairs.topics.compressed else "raw"
    # The camera infos of calibration files are published by the replay
    all_parameters = {**parameters, "image_transport": transport, **dict.fromkeys(_URLS, "")}
    if not options.realtime:
        all_parameters |= _reliable_inputs()
    if options.clock:
        all_parameters["use_sim_time"] = True
    prepare_process()
    with (
        tempfile.TemporaryDirectory(prefix="stereo-depth-") as logs,
        GraphProcesses(
            shape, all_parameters, Path(logs), params_file, monitor, views=bool(options.view_topics)
        ) as graph,
    ):
        wait_until_ready(graph.numbers, graph.log_lengths, graph.check)
        report = replay(options, progress, graph.check, config)
    return replace(report, warnings=(choice, *report.warnings)) if choice else report


def _reliable_inputs() -> dict[str, str]:
    """Overrides that make every subscription reliable: no message is lost, even without the transport profile."""
    sides = [f"/{side}/{name}" for side in ("left", "right") for name in _CAMERA_INPUTS]
    return {f"qos_overrides.{topic}.subscription.reliability": "reliable" for topic in (*sides, "/disparity")}
