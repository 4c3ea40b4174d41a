# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameter file of a command: its values, and warnings where it has no effect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stereo_depth_ros.cli.output import warn
from stereo_depth_ros.config.other_parameters import without_effect_text
from stereo_depth_ros.config.ros_yaml import node_parameters
from stereo_depth_ros.config.values import PIPELINE_NODES, Value, read_params_file

__all__ = ["read_parameters"]


def read_parameters(path: Path | None, nodes: Sequence[str] = PIPELINE_NODES) -> dict[str, Value]:
    """The values that nodes take from a parameter file, see :func:`read_params_file`; none without a file.

    Warns if it has none for these nodes, and of parameters of stereo_image_proc that have no effect.
    """
    if path is None:
        return {}
    values, given = read_params_file(path, nodes), node_parameters(path, *nodes)
    if not given:
        warn(f"{path}: nothing for {', '.join(nodes)}; other sections do not apply")
    elif text := without_effect_text(given):
        warn(f"{path}: {text}")
    return values
