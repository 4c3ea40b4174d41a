# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a replay or an offline run gave, on stdout, and the exit code that says whether everything came through."""

from __future__ import annotations

from pathlib import Path

import typer

from stereo_depth_ros.cli.output import EXIT_LOST, messages, show
from stereo_depth_ros.cli.tables import result_tables
from stereo_depth_ros.offline.report import RunReport

__all__ = ["finish_run"]


def finish_run(result: RunReport, json_file: Path | None, overwrite: bool, image: Path | None = None) -> None:
    """Tables or JSON, warnings, and exit code 3 where a pair was skipped or an output lost."""
    values = result.to_json() | ({"image": str(image)} if image else {})
    show(result_tables(result, image), values, json_file, overwrite=overwrite)
    for text in result.warnings:
        messages.print(f"warning: {text}", markup=False)
    if result.skipped or (result.lost and not result.realtime):
        messages.print(f"error: {result.skipped} pairs left out, {result.lost} outputs lost: see the warnings above")
        raise typer.Exit(EXIT_LOST)
