# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the sparse matcher on real scenes with ground truth: corners of SIFT and ORB, and line segments.

python benchmarks/features.py
python benchmarks/features.py --data ~/stereo --scenes cones Art --kinds sift lines --json features.json

The truth of a match is that of the pixel that contains it. Of lines every row is a match.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from matching import load_scenes, table

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.evaluation.evaluator import search_range
from stereo_depth_ros.evaluation.metrics import disparity_errors
from stereo_depth_ros.evaluation.scenes import Scene
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.matching import create_matcher

Row: TypeAlias = dict[str, Any]

KINDS = ("sift", "orb", "lines")
TUNED_ON = ("venus", "cones", "Art", "Aloe", "Bowling1", "Motorcycle_quarter")
FIGURES = ("matches", "bad_1", "bad_2", "avg_px", "median_px", "ms")


def accuracy(scenes: dict[str, Scene], kinds: tuple[str, ...]) -> list[Row]:
    """A row for every scene and kind of feature."""
    rows: list[Row] = []
    for scene, data in scenes.items():
        search = search_range(MatchingConfig(), data.truth_px)
        for kind in kinds:
            matcher = create_matcher("features", search, feature_type=kind)
            matcher.match(data.left, data.right)
            begin = time.perf_counter()
            found = matcher.match(data.left, data.right).disparity_px
            ms = 1e3 * (time.perf_counter() - begin)
            errors = disparity_errors(found, data.truth_px)
            row: Row = {"scene": scene, "kind": kind, "matches": int(np.count_nonzero(np.isfinite(found)))}
            row |= {figure: getattr(errors, figure) for figure in FIGURES[1:-1]}
            rows.append(row | {"ms": ms})
    return rows


def means(rows: list[Row], kinds: tuple[str, ...]) -> list[Row]:
    """The mean of every figure over the scenes used for tuning, and over the others."""
    found: list[Row] = []
    for group in ("tuned on", "held out"):
        for kind in kinds:
            chosen = [r for r in rows if r["kind"] == kind and (r["scene"] in TUNED_ON) == (group == "tuned on")]
            if chosen:
                row: Row = {"scenes": f"{group} ({len(chosen)})", "kind": kind}
                found.append(row | {name: statistics.fmean(r[name] for r in chosen) for name in FIGURES})
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = os.environ.get("STEREO_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of scenes with ground truth")
    parser.add_argument("--scenes", nargs="+", default=[], help="names of scenes; default: all")
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows as JSON")
    options = parser.parse_args()
    rows = accuracy(load_scenes(options.data, options.scenes), tuple(options.kinds))
    averages = means(rows, tuple(options.kinds))
    table("Accuracy; bad in percent", rows)
    table("Means over the scenes", averages)
    if options.json:
        write_file(options.json, json.dumps({"scenes": rows, "means": averages}, indent=1) + "\n", overwrite=True)


if __name__ == "__main__":
    main()
