# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables and JSON values of `stereo-depth info`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from rich.text import Text

from stereo_depth_ros.bags.info import BagInfo
from stereo_depth_ros.cli.errors import error_text
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table

__all__ = ["info_tables", "info_values"]


def info_tables(info: BagInfo) -> Iterator[TextTable]:
    """The topics of a bag, and its stereo rig if it has one."""
    topics = plain_table("topic", "type", "messages:r", "Hz:r")
    for name, topic in info.topics.items():
        topics.add_row(name, topic.msgtype, str(topic.count), f"{topic.rate_hz:.2f}")
    yield topics
    facts = facts_table()
    facts.add_row("length", f"{info.duration_s:.3f} s")
    if info.stereo is not None:
        facts.add_row("left", info.stereo.left_image)
        facts.add_row("right", info.stereo.right_image)
    if info.left_image is not None:
        image = info.left_image
        facts.add_row("images", f"{image.width}x{image.height} {image.encoding}")
    if info.rig is not None:
        if info.camera_files:
            facts.add_row("calibration", " and ".join(info.rig.topics))
        facts.add_row("rig", f"f {info.rig.f_px:.1f} px, baseline {1e3 * info.rig.baseline_m:.1f} mm")
    facts.add_row(
        "pairs", f"{info.exact_pairs} with equal stamps, {info.near_pairs} within {1e3 * info.tolerance_s:g} ms"
    )
    facts.add_row("usable for stereo depth", Text("yes", style="green") if info.usable else Text("no", style="red"))
    yield facts


def info_values(info: BagInfo) -> dict[str, Any]:
    """The same as JSON values."""
    values = {
        name: getattr(info, name) for name in ("start_ns", "duration_s", "exact_pairs", "near_pairs", "tolerance_s")
    }
    values |= {"problems": [error_text(problem) for problem in info.problems], "warnings": list(info.warnings)}
    values["topics"] = {name: dataclasses.asdict(topic) for name, topic in info.topics.items()}
    for name in ("stereo", "left_image", "right_image"):
        found = getattr(info, name)
        values[name] = dataclasses.asdict(found) if found is not None else None
    values["rig"] = {"f_px": info.rig.f_px, "baseline_m": info.rig.baseline_m} if info.rig is not None else None
    return {"path": str(info.path), "usable": info.usable, **values}
