# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of `stereo-depth evaluate`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table

__all__ = ["bias_warnings", "evaluate_tables"]

Columns: TypeAlias = Mapping[str, tuple[str, float]]  # column title to name and factor of a figure

_BAD_PIXELS: Columns = {
    "dense %": ("density", 100),
    "bad 0.5": ("bad_0_5", 1),
    "bad 1": ("bad_1", 1),
    "bad 2": ("bad_2", 1),
    "bad 2 all": ("bad_2_all", 1),
    "nonocc bad 2 all": ("nonocc_bad_2_all", 1),
}
_SIGNED: Columns = {"avg px": ("avg", 1), "signed px": ("signed_median", 1)}
_SCENE_COLUMNS: Columns = {**_BAD_PIXELS, **_SIGNED, "ms": ("ms", 1)}
_ERRORS: Columns = {**_BAD_PIXELS, "D1 all": ("d1_all", 1), **_SIGNED}
_HARD_REGIONS: Columns = {
    f"{part} {title}": (f"{part}_{name}", factor)
    for part in ("edges", "thin")
    for title, name, factor in (
        ("share %", "share", 100),
        ("dense %", "density", 100),
        ("bad 2", "bad_2", 1),
        ("bad 2 all", "bad_2_all", 1),
    )
}
_COSTS: Columns = {
    "ms": ("ms", 1),
    "ms per Mpx": ("ms_per_megapixel", 1),
    "ms per Mdisp": ("ms_per_million_disparities", 1),
    "confidence": ("auc_bad_1_ratio", 1),
}


def evaluate_tables(
    rows: Sequence[Mapping[str, Any]],
    range_given: bool,
    plots: Path | None = None,
    truths: Mapping[str, str] | None = None,
) -> Iterator[TextTable]:
    """A row for each scene and method, the means of each method, and the definitions of the figures.

    ``truths`` tells by bag where its truth comes from.
    """
    yield _scenes_table(rows, "", _SCENE_COLUMNS)
    yield _scenes_table(rows, "near depth edges and on thin structures", _HARD_REGIONS)
    yield _means_table(rows, "mean errors", _ERRORS)
    yield _means_table(rows, "mean errors near depth edges and on thin structures", _HARD_REGIONS)
    yield _means_table(rows, "mean times", _COSTS)
    facts = facts_table()
    facts.add_row("bad x", "percentage of the matched pixels with truth whose error is above x px")
    facts.add_row("all", "pixels without a disparity count as wrong")
    facts.add_row("signed px", "median of disparity minus truth")
    facts.add_row("nonocc", "pixels visible to both cameras only")
    facts.add_row(
        "edges", "pixels within 4 px of a depth edge, a step of the truth of more than 2 px; share of the truth"
    )
    facts.add_row("thin", "pixels of structures thinner than 8 px, nearer than all around them by more than 2 px")
    ranges = [row["disparity_range"] for row in rows]
    rule = "as set" if range_given else "the smallest multiple of 16 above the scene's largest true disparity"
    facts.add_row("disparity_range", f"{min(ranges)} to {max(ranges)}, {rule}, the same for every method")
    facts.add_row("ms per Mdisp", "milliseconds for a million disparities, pixels times disparity_range")
    facts.add_row("confidence", "area under the bad 1 curve, pixels in order of confidence, relative to a random order")
    masked = list(dict.fromkeys(row["scene"] for row in rows if row["occlusion"] == "mask"))
    given = f"; {', '.join(masked)}: mask of the dataset" if masked else ""
    facts.add_row("occlusion", f"computed from the true disparities{given}")
    for bag, text in (truths or {}).items():
        facts.add_row("truth", f"{bag}: {text}")
    if plots is not None:
        facts.add_row("plots", str(plots))
    yield facts


def bias_warnings(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """A sentence for each method whose disparities are too large or too small everywhere by a constant."""
    for matcher in dict.fromkeys(row["matcher"] for row in rows):
        of_matcher = [row for row in rows if row["matcher"] == matcher]
        for sign, size in ((1, "large"), (-1, "small")):
            found = [row for row in of_matcher if sign * (row["constant_bias"] or 0) > 0]
            if found:
                amounts = sorted(abs(row["constant_bias"]) for row in found)
                by = " to ".join(dict.fromkeys(f"{amount:.2f}" for amount in (amounts[0], amounts[-1])))
                yield (
                    f"{matcher}: disparities are {by} px too {size} everywhere on {len(found)} of {len(of_matcher)} "
                    "scenes (median signed error, more than twice their spread): look for a shift in its input or "
                    "output, such as padding or cropping of a network's export; where all methods have it, for one in "
                    "the truth"
                )


def _scenes_table(rows: Sequence[Mapping[str, Any]], title: str, columns: Columns) -> TextTable:
    table = plain_table("scene", "matcher", *_narrow(columns), title=title)
    for row in rows:
        table.add_row(row["scene"], row["matcher"], *(_figure(row[key], factor) for key, factor in columns.values()))
    return table


def _means_table(rows: Sequence[Mapping[str, Any]], title: str, columns: Columns) -> TextTable:
    """The mean of each method over its scenes."""
    table = plain_table("matcher", "scenes:r", *_narrow(columns), title=title)
    for matcher in dict.fromkeys(row["matcher"] for row in rows):
        of_matcher = [row for row in rows if row["matcher"] == matcher]
        figures = (_figure(_mean(of_matcher, key), factor) for key, factor in columns.values())
        table.add_row(matcher, str(len(of_matcher)), *figures)
    return table


def _narrow(titles: Iterable[str]) -> list[str]:
    """Titles of number columns, one word per line to keep the columns narrow."""
    return [f"{title}:r".replace(" ", "\n") for title in titles]


def _mean(rows: Sequence[Mapping[str, Any]], name: str) -> float | None:
    known = [row[name] for row in rows if row[name] is not None]
    return sum(known) / len(known) if known else None


def _figure(value: float | None, factor: float) -> str:
    if value is None:
        return "-"
    scaled = factor * value
    return f"{scaled:.{2 if abs(scaled) < 10 else 1 if abs(scaled) < 100 else 0}f}"
