# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tables that the command line prints."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.table import Table

from stereo_depth_ros.config import STAGE_CONFIGS, parameter_infos
from stereo_depth_ros.io.bag_info import BagInfo
from stereo_depth_ros.replay.report import ReplayResult

__all__ = ["info_tables", "info_values", "parameters_table", "parameters_values", "result_tables"]


def result_tables(result: ReplayResult, picture: Path | None = None) -> Iterator[Table]:
    """What a replay or an offline run gave: the outputs, the stages, a summary with the paths."""
    if result.outputs:
        yield _outputs_table(result)
    if result.stages_ms:
        yield _stages_table(result)
    yield _summary_table(result, picture)


def info_tables(info: BagInfo) -> Iterator[Table]:
    """What is in a bag: its topics, and its stereo rig where there is one."""
    topics = _table("topic", "type", "messages:r", "Hz:r")
    for name, topic in info.topics.items():
        topics.add_row(name, topic.msgtype, str(topic.count), f"{topic.rate_hz:.2f}")
    yield topics
    facts = _facts()
    facts.add_row("length", f"{info.duration_s:.3f} s")
    if info.stereo is not None:
        facts.add_row("left", info.stereo.left_image)
        facts.add_row("right", info.stereo.right_image)
    if info.left_image is not None:
        image = info.left_image
        facts.add_row("images", f"{image.width}x{image.height} {image.encoding}")
    if info.rig is not None:
        facts.add_row("rig", f"f {info.rig.f_px:.1f} px, baseline {1e3 * info.rig.baseline_m:.1f} mm")
    facts.add_row(
        "pairs", f"{info.exact_pairs} of equal stamps, {info.near_pairs} within {1e3 * info.tolerance_s:g} ms"
    )
    facts.add_row("stereo depth", "[green]can be made of it" if info.usable else "[red]cannot be made of it")
    yield facts


def info_values(info: BagInfo) -> dict[str, Any]:
    """The same for JSON."""
    values = {
        name: getattr(info, name) for name in ("start_ns", "duration_s", "exact_pairs", "near_pairs", "tolerance_s")
    }
    values |= {name: list(getattr(info, name)) for name in ("problems", "warnings")}
    values["topics"] = {name: dataclasses.asdict(topic) for name, topic in info.topics.items()}
    for name in ("stereo", "left_image", "right_image"):
        found = getattr(info, name)
        values[name] = dataclasses.asdict(found) if found is not None else None
    values["rig"] = {"f_px": info.rig.f_px, "baseline_m": info.rig.baseline_m} if info.rig is not None else None
    return {"path": str(info.path), "usable": info.usable, **values}


def parameters_table() -> Table:
    """Every parameter: default, range, meaning."""
    table = _table("parameter", "default:r", "range", "meaning")
    for stage in STAGE_CONFIGS:
        for info in parameter_infos(stage):
            table.add_row(info.name, str(info.default), info.range_text, info.doc)
        table.add_section()
    return table


def parameters_values() -> list[dict[str, Any]]:
    """The same for JSON."""
    return [
        dataclasses.asdict(info) | {"type": info.type.__name__}
        for stage in STAGE_CONFIGS
        for info in parameter_infos(stage)
    ]


def _summary_table(result: ReplayResult, picture: Path | None) -> Table:
    facts = _facts()
    facts.add_row("pairs in", str(result.pairs))
    if result.unpaired_left or result.unpaired_right:
        facts.add_row("images without partner", f"left {result.unpaired_left}, right {result.unpaired_right}")
    if result.left_out:
        facts.add_row("pairs left out", str(result.left_out))
    facts.add_row("pairs a second", f"{result.frames_per_second:.1f}")
    score = result.score
    if score is not None:
        facts.add_row("disparities out", str(score.frames))
        facts.add_row("valid pixels", f"{100 * score.valid_fraction:.1f} %")
        if score.truth_frames:
            facts.add_row(
                "error against truth",
                f"median {score.median_px:.3f} px, mean {score.avg_px:.3f} px, {score.bad_2:.2f} % beyond 2 px "
                f"({score.truth_frames} frames, density {100 * score.density:.1f} %)",
            )
    if result.output is not None:
        facts.add_row("bag written", str(result.output))
    if picture is not None:
        facts.add_row("picture", str(picture))
    return facts


def _outputs_table(result: ReplayResult) -> Table:
    table = _table(
        "output", "received:r", "lost:r", "p50 ms:r", "p95 ms:r", title="latency, raw pair sent to output received"
    )
    for topic, stats in result.outputs.items():
        lost = f"[red]{stats.lost}" if stats.lost else "0"
        table.add_row(topic, str(stats.received), lost, _ms(stats.p50_ms), _ms(stats.p95_ms))
    return table


def _stages_table(result: ReplayResult) -> Table:
    table = _table("stage", "p50 ms:r", "p95 ms:r", title="time inside the stages")
    for stage, (p50, p95) in result.stages_ms.items():
        table.add_row(stage, _ms(p50), _ms(p95))
    return table


def _table(*columns: str, title: str | None = None) -> Table:
    """A table; a column ending in ":r" is aligned to the right."""
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for column in columns:
        name, _, right = column.partition(":")
        table.add_column(name, justify="right" if right else "left", overflow="fold", header_style="dim")
    return table


def _facts() -> Table:
    table = Table(show_header=False, box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(style="dim")
    table.add_column(overflow="fold")
    return table


def _ms(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
