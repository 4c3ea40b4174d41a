# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result of replay, process and demo: tables or JSON on stdout, warnings, and the exit code."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import typer
from rich.text import Text

from stereo_depth_ros.cli.export import SurfaceExport, add_files
from stereo_depth_ros.cli.output import EXIT_INCOMPLETE, show, tell, warn
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table
from stereo_depth_ros.evaluation.bag_score import BagScore
from stereo_depth_ros.offline.report import RunReport

__all__ = ["finish_run", "truth_text"]


def finish_run(
    result: RunReport,
    json_file: Path | None,
    overwrite: bool,
    image: Path | None = None,
    surfaces: SurfaceExport | None = None,
) -> None:
    """Print tables or JSON and warnings; exit with code 3 if pairs were skipped or outputs lost.

    Raises:
        OutputError: the JSON file or stdout cannot be written.
    """
    values = result.to_json() | ({"image": str(image)} if image else {}) | (surfaces.to_json() if surfaces else {})
    show(_tables(result, image, surfaces), values, json_file, overwrite=overwrite)
    for text in result.warnings:
        warn(text)
    if result.skipped or (result.lost and not result.realtime):
        tell(f"error: {result.skipped} pairs skipped, {result.lost} outputs lost: see the warnings above")
        raise typer.Exit(EXIT_INCOMPLETE)


def _tables(result: RunReport, image: Path | None, surfaces: SurfaceExport | None) -> Iterator[TextTable]:
    """Latency of each output, time of each stage, and a summary."""
    if result.outputs:
        yield _outputs_table(result)
    if result.stages_ms:
        yield _stages_table(result)
    yield _summary_table(result, image, surfaces)


def _summary_table(result: RunReport, image: Path | None, surfaces: SurfaceExport | None) -> TextTable:
    facts = facts_table()
    facts.add_row("pairs read", str(result.pairs))
    if result.unpaired_left or result.unpaired_right:
        facts.add_row("unpaired images", f"left {result.unpaired_left}, right {result.unpaired_right}")
    if result.skipped:
        facts.add_row("pairs skipped", str(result.skipped))
    facts.add_row("pairs per second", f"{result.frames_per_second:.1f}")
    score = result.score
    if score is not None:
        facts.add_row("disparity images", str(score.frames))
        facts.add_row("valid pixels", f"{100 * score.valid_fraction:.1f} %")
        if score.truth_frames:
            facts.add_row("error against truth", truth_text(score))
    if result.output is not None:
        facts.add_row("bag written", str(result.output))
    if image is not None:
        facts.add_row("image written", str(image))
    if surfaces is not None:
        add_files(facts, surfaces.written)
    return facts


def truth_text(score: BagScore) -> str:
    """The errors of disparities whose truth is known."""
    return (
        f"median {score.median_px:.3f} px, mean {score.avg_px:.3f} px, {score.bad_2:.2f} % above 2 px "
        f"({score.truth_frames} frames, density {100 * score.density:.1f} %)"
    )


def _outputs_table(result: RunReport) -> TextTable:
    table = plain_table(
        "output", "received:r", "lost:r", "p50 ms:r", "p95 ms:r", title="latency from raw pair sent to output received"
    )
    for topic, stats in result.outputs.items():
        lost = Text(str(stats.lost), style="red" if stats.lost else "")
        table.add_row(topic, str(stats.received), lost, _ms(stats.p50_ms), _ms(stats.p95_ms))
    return table


def _stages_table(result: RunReport) -> TextTable:
    table = plain_table("stage", "p50 ms:r", "p95 ms:r", title="computing time of the stages")
    for stage, (p50, p95) in result.stages_ms.items():
        table.add_row(stage, _ms(p50), _ms(p95))
    return table


def _ms(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
