# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables and JSON values of `stereo-depth calibrate`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from stereo_depth_ros.calibration.calibration_result import StereoCalibration
from stereo_depth_ros.calibration.view_finder import FoundViews
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table

__all__ = ["calibrate_tables", "calibrate_values", "cameras_table", "views_table"]


def calibrate_values(result: StereoCalibration, found: FoundViews, output: Path) -> dict[str, Any]:
    counts = {"left_only": len(found.left_only), "right_only": len(found.right_only), "without": len(found.not_found)}
    counts["skipped"] = len(found.skipped)
    return {**result.to_json(), "pairs": {"total": found.pairs, **counts}, "output": str(output)}


def calibrate_tables(result: StereoCalibration, found: FoundViews, output: Path) -> Iterator[TextTable]:
    yield cameras_table(result)
    yield views_table(result)
    facts = facts_table()
    counts = f"{found.pairs} examined, {len(result.views)} used, {len(result.dropped)} dropped"
    facts.add_row("pairs", counts + (f", {len(found.skipped)} skipped" if found.skipped else ""))
    for side, circle in zip(("left", "right"), result.circles, strict=True):
        if circle is not None:
            facts.add_row(f"image circle, {side}", f"{circle}: the coverage is judged within it")
    facts.add_row("baseline", f"{1e3 * result.baseline_m:.3f} ± {1e3 * result.baseline_sigma_m:.3f} mm")
    facts.add_row("rms of both cameras", f"{result.rms_stereo_px:.3f} px")
    alone = f"left {result.left.rms_alone_px:.3f}, right {result.right.rms_alone_px:.3f} px"
    facts.add_row("rms of each camera alone", alone)
    facts.add_row("row error after rectification", f"rms {result.epipolar_rms_px:.3f} px")
    cover = result.coverage
    facts.add_row("coverage", f"x {cover.x:.0%}, y {cover.y:.0%}, size {cover.size:.0%}, skew {cover.skew:.0%}")
    for number, text in enumerate(cover.missing):
        facts.add_row("to improve it" if number == 0 else "", text)
    facts.add_row("files", str(output))
    yield facts


def cameras_table(result: StereoCalibration, sides: tuple[str, str] = ("left", "right")) -> TextTable:
    """Intrinsics of both cameras, with their standard deviations."""
    table = plain_table("", "fx px:r", "fy px:r", "cx px:r", "cy px:r", "rms px:r")
    for side, camera in zip(sides, (result.left, result.right), strict=True):
        values = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
        cells = [f"{value:.2f} ± {sigma:.2f}" for value, sigma in zip(values, camera.sigmas[:4], strict=True)]
        table.add_row(side, *cells, f"{camera.rms_px:.3f}")
    return table


def views_table(result: StereoCalibration, sides: tuple[str, str] = ("left", "right"), name: str = "view") -> TextTable:
    """Errors of each view."""
    table = plain_table(name, *(f"rms {side} px:r" for side in sides), "row error px:r")
    for view in result.views:
        table.add_row(view.name, f"{view.rms_left:.3f}", f"{view.rms_right:.3f}", f"{view.rms_rows:.3f}")
    return table
