# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of `stereo-depth rig`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from stereo_depth_ros.cli.errors import param_options
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table

__all__ = ["rig_tables"]

_MAX_ROWS = 30  # of the depth table; the JSON has all depths
_VIEWS = {"raw_left": "raw, left", "raw_right": "raw, right", "rectified": "rectified"}


def rig_tables(result: Mapping[str, Any], search_given: bool) -> Iterator[TextTable]:
    """Fields of view, ranges, depth errors and recommended parameters, from the JSON values."""
    yield _view_table(result["field_of_view"])
    yield _limits_table(result)
    yield _depths_table(result["depths"])
    yield _summary(result, search_given)


def _view_table(views: Mapping[str, Mapping[str, float | None]]) -> TextTable:
    table = plain_table("image", "horizontal:r", "vertical:r", "diagonal:r", title="field of view, degrees")
    for side, name in _VIEWS.items():
        table.add_row(
            name, *(_number(views[side][f"{angle}_deg"], 1) for angle in ("horizontal", "vertical", "diagonal"))
        )
    return table


def _limits_table(result: Mapping[str, Any]) -> TextTable:
    percent = 100 * result["precision"]["max_error"]
    title = "range, from the largest disparity searched to the largest error allowed"
    table = plain_table(
        "baseline mm:r", "times:r", "nearest m:r", f"error {percent:g} % at m:r", "search ends m:r", title=title
    )
    for limits in result["limits"]:
        end_m = limits["search_end_m"]
        table.add_row(
            f"{1e3 * limits['baseline_m']:.1f}",
            f"{limits['baseline_factor']:g}",
            _meters(limits["nearest_m"]),
            _meters(limits["farthest_m"]),
            "infinity" if end_m is None else _meters(end_m),
        )
    return table


def _depths_table(depths: list[Mapping[str, float | None]]) -> TextTable:
    columns = ("depth m:r", "disparity px:r", "step mm:r", "sigma mm:r", "sigma %:r", "overlap %:r", "common width m:r")
    table = plain_table(*(column.replace(" ", "\n") for column in columns), title="depth error")
    for row in _thinned(depths):
        depth_m, step_m, sigma_m = row["depth_m"], row["step_m"], row["sigma_m"]
        assert depth_m is not None and sigma_m is not None
        table.add_row(
            f"{depth_m:g}",
            _number(row["disparity_px"], 2),
            _millimeters(step_m),
            _millimeters(sigma_m),
            f"{100 * sigma_m / depth_m:.2f}",
            _number(row["overlap"], 1, 100),
            _number(row["common_width_m"], 2),
        )
    return table


def _thinned(depths: list[Mapping[str, float | None]]) -> list[Mapping[str, float | None]]:
    """All depths if there are at most _MAX_ROWS, else every 2nd, 5th, 10th, 20th or 50th multiple of their step."""
    if len(depths) <= _MAX_ROWS:
        return depths
    known = [float(row["depth_m"] or 0) for row in depths]
    step_m = known[1] - known[0]
    every = next(k for k in (2, 5, 10, 20, 50) if len(depths) / k <= _MAX_ROWS)
    return [row for row, depth_m in zip(depths, known, strict=True) if round(depth_m / step_m) % every == 0]


def _summary(result: Mapping[str, Any], search_given: bool) -> TextTable:
    rig, search, precision, advice = (result[name] for name in ("rig", "search", "precision", "recommended"))
    facts = facts_table()
    facts.add_row("cameras", ", ".join(result["cameras"]))
    facts.add_row(
        "rig",
        f"{rig['width']}x{rig['height']}, f {rig['f_px']:.1f} px, baseline {1e3 * rig['baseline_m']:.1f} mm, "
        f"infinity at {rig['doffs_px']:.2f} px",
    )
    last = search["min_disparity"] + search["disparity_range"] - 1
    facts.add_row("searched", f"{search['min_disparity']} to {last} px, {'as set' if search_given else 'recommended'}")
    facts.add_row("disparities", f"in steps of {precision['step_px']:.3g} px, sigma {precision['sigma_px']:g} px")
    facts.add_row("step", "difference to the depth of the next smaller disparity")
    facts.add_row("overlap", "share of the rectified image width at that depth")
    names = ("min_disparity", "disparity_range")
    facts.add_row(f"from {advice['nearest_m']:.3g} m", ", ".join(f"{name}: {advice[name]}" for name in names))
    facts.add_row("options", param_options({name: advice[name] for name in names}))
    if "plot" in result:
        facts.add_row("plot", result["plot"])
    return facts


def _number(value: float | None, digits: int, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"


def _meters(value: float) -> str:
    return f"{value:.3g}" if value < 100 else f"{value:.0f}"


def _millimeters(meters: float | None) -> str:
    if meters is None:
        return "infinite"
    return f"{1e3 * meters:.{2 if meters < 0.01 else 1 if meters < 0.1 else 0}f}"
