# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tables that the command line prints."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from rich.table import Table

from stereo_depth_ros.bags.info import BagInfo
from stereo_depth_ros.config import CONFIGS, parameter_infos
from stereo_depth_ros.offline.report import RunReport

__all__ = [
    "evaluation_tables",
    "facts_table",
    "info_tables",
    "info_values",
    "parameters_table",
    "parameters_values",
    "plain_table",
    "result_tables",
]


Columns: TypeAlias = Mapping[str, tuple[str, float]]  # title to name and factor of a figure

_SCENE_COLUMNS: Columns = {
    "dense %": ("density", 100),
    "bad 0.5": ("bad_0_5", 1),
    "bad 1": ("bad_1", 1),
    "bad 2": ("bad_2", 1),
    "bad 2 all": ("bad_2_all", 1),
    "nonocc bad 2 all": ("nonocc_bad_2_all", 1),
    "avg px": ("avg", 1),
    "ms": ("ms", 1),
}
_ERRORS: Columns = {
    "dense %": ("density", 100),
    "bad 0.5": ("bad_0_5", 1),
    "bad 1": ("bad_1", 1),
    "bad 2": ("bad_2", 1),
    "bad 2 all": ("bad_2_all", 1),
    "nonocc bad 2 all": ("nonocc_bad_2_all", 1),
    "D1 all": ("d1_all", 1),
    "avg px": ("avg", 1),
}
_COSTS: Columns = {
    "ms": ("ms", 1),
    "ms per Mpx": ("ms_per_megapixel", 1),
    "ms per Mdisp": ("ms_per_million_disparities", 1),
    "confidence": ("auc_bad_1_ratio", 1),
}


def result_tables(result: RunReport, image: Path | None = None) -> Iterator[Table]:
    """What a replay or an offline run gave: the outputs, the stages, a summary with the paths."""
    if result.outputs:
        yield _outputs_table(result)
    if result.stages_ms:
        yield _stages_table(result)
    yield _summary_table(result, image)


def info_tables(info: BagInfo) -> Iterator[Table]:
    """What is in a bag: its topics, and its stereo rig where there is one."""
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
    table = plain_table("parameter", "default:r", "range", "meaning")
    for stage in CONFIGS.values():
        for info in parameter_infos(stage):
            table.add_row(info.name, str(info.default), info.range_text, info.doc)
        table.add_section()
    return table


def parameters_values() -> list[dict[str, Any]]:
    """The same for JSON."""
    return [
        dataclasses.asdict(info) | {"type": info.type.__name__}
        for stage in CONFIGS.values()
        for info in parameter_infos(stage)
    ]


def evaluation_tables(
    rows: Sequence[Mapping[str, Any]], range_given: bool, images: Path | None = None
) -> Iterator[Table]:
    """What an evaluation gave: a row for each scene and method, means of each method, how it was measured."""
    yield _scenes_table(rows)
    yield _means_table(rows, "mean errors", _ERRORS)
    yield _means_table(rows, "mean times", _COSTS)
    facts = facts_table()
    facts.add_row("bad x", "percent of the matched truth pixels that are wrong by more than x px")
    facts.add_row("all", "pixels without disparity count as wrong; nonocc: only pixels that both cameras see")
    ranges = [row["disparity_range"] for row in rows]
    rule = "as given" if range_given else "the smallest multiple of 16 above the scene's largest true disparity"
    facts.add_row("disparity_range", f"{min(ranges)} to {max(ranges)}, {rule}, the same for every method")
    facts.add_row("ms per Mdisp", "milliseconds for a million disparities: pixels times disparity_range")
    facts.add_row("confidence", "area under the bad 1 curve, most confident first, over that of a random order")
    masked = list(dict.fromkeys(row["scene"] for row in rows if row["occlusion"] == "mask"))
    facts.add_row("occlusion", "from the true disparities" + (f"; {', '.join(masked)}: own mask" if masked else ""))
    if images is not None:
        facts.add_row("images", str(images))
    yield facts


def _scenes_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    columns = _SCENE_COLUMNS
    table = plain_table("scene", "matcher", *_narrow(columns))
    for row in rows:
        table.add_row(row["scene"], row["matcher"], *(_figure(row[key], factor) for key, factor in columns.values()))
    return table


def _means_table(rows: Sequence[Mapping[str, Any]], title: str, columns: Columns) -> Table:
    """Means over the scenes of each method."""
    table = plain_table("matcher", "scenes:r", *_narrow(columns), title=title)
    for matcher in dict.fromkeys(row["matcher"] for row in rows):
        own = [row for row in rows if row["matcher"] == matcher]
        figures = (_figure(_mean(own, key), factor) for key, factor in columns.values())
        table.add_row(matcher, str(len(own)), *figures)
    return table


def _narrow(titles: Iterable[str]) -> list[str]:
    """Headers of numbers, a word a line: where the terminal is narrow, the names are folded before the numbers."""
    return [f"{title}:r".replace(" ", "\n") for title in titles]


def _mean(rows: Sequence[Mapping[str, Any]], name: str) -> float | None:
    known = [row[name] for row in rows if row[name] is not None]
    return sum(known) / len(known) if known else None


def _figure(value: float | None, factor: float) -> str:
    if value is None:
        return "-"
    scaled = factor * value
    return f"{scaled:.{2 if abs(scaled) < 10 else 1 if abs(scaled) < 100 else 0}f}"


def _summary_table(result: RunReport, image: Path | None) -> Table:
    facts = facts_table()
    facts.add_row("pairs in", str(result.pairs))
    if result.unpaired_left or result.unpaired_right:
        facts.add_row("images without partner", f"left {result.unpaired_left}, right {result.unpaired_right}")
    if result.skipped:
        facts.add_row("pairs left out", str(result.skipped))
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
    if image is not None:
        facts.add_row("image", str(image))
    return facts


def _outputs_table(result: RunReport) -> Table:
    table = plain_table(
        "output", "received:r", "lost:r", "p50 ms:r", "p95 ms:r", title="latency, raw pair sent to output received"
    )
    for topic, stats in result.outputs.items():
        lost = f"[red]{stats.lost}" if stats.lost else "0"
        table.add_row(topic, str(stats.received), lost, _ms(stats.p50_ms), _ms(stats.p95_ms))
    return table


def _stages_table(result: RunReport) -> Table:
    table = plain_table("stage", "p50 ms:r", "p95 ms:r", title="time inside the stages")
    for stage, (p50, p95) in result.stages_ms.items():
        table.add_row(stage, _ms(p50), _ms(p95))
    return table


def plain_table(*columns: str, title: str | None = None) -> Table:
    """A table; a column ending in ":r" is aligned to the right."""
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for column in columns:
        name, _, right = column.partition(":")
        table.add_column(name, justify="right" if right else "left", overflow="fold", header_style="dim")
    return table


def facts_table() -> Table:
    """A table of names and what they are."""
    table = Table(show_header=False, box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(style="dim")
    table.add_column(overflow="fold")
    return table


def _ms(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
