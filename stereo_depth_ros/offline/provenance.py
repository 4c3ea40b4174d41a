# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Provenance of a result: version, parameters and geometry of the rig as names and values."""

from __future__ import annotations

import dataclasses
from typing import Any

from stereo_depth_ros.config import PipelineConfig, parameter_infos
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.version import __version__

__all__ = ["provenance"]


def provenance(config: PipelineConfig, rig: StereoRig | None = None, **values: Any) -> dict[str, str]:
    """Version, every parameter by its public name, the rectified geometry of the rig, and ``values``, all as text."""
    record = {"version": __version__, **{name: str(value) for name, value in values.items()}}
    for stage in dataclasses.fields(config):
        stage_config = getattr(config, stage.name)
        for info in parameter_infos(stage_config):
            record[info.name] = str(getattr(stage_config, info.field))
    if rig is not None:
        for name in ("f_px", "fy_px", "cx_left", "cx_right", "cy", "baseline_m"):
            record[f"rig.{name}"] = repr(getattr(rig, name))
    return record
