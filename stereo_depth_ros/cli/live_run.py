# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of a bag through a live graph with progress on stderr, shared by replay and demo."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.output import progress_bar
from stereo_depth_ros.cli.params_file import read_parameters
from stereo_depth_ros.config.values import PIPELINE_NODES, Value, pipeline_config
from stereo_depth_ros.offline.report import RunReport
from stereo_depth_ros.replay.graph_processes import SHAPES, require_ros
from stereo_depth_ros.replay.options import ReplayOptions

__all__ = ["run_live"]


def run_live(
    options: ReplayOptions,
    shape: str,
    values: dict[str, Value],
    params_file: Path | None,
    monitor: Literal["", "report", "correct"] = "",
) -> RunReport:
    """Start the nodes, play the bag, stop the nodes; the arguments are those of ``replay_through_graph``.

    Kernels are compiled here once, so that the nodes load them from disk.
    """
    require_ros()
    from stereo_depth_ros.nodes.live_replay import replay_through_graph

    config = pipeline_config(
        {**read_parameters(params_file, PIPELINE_NODES if shape == "fused" else SHAPES[shape]), **values}
    )
    prepare_kernels(config.matching)
    with progress_bar(f"playing, {shape}") as progress:
        return replay_through_graph(options, shape, values, config, progress, params_file, monitor)
