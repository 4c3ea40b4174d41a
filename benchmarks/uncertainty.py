# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of disparities by their confidence: fit on real scenes, and how true they are on others.

python benchmarks/uncertainty.py --data ~/stereo
python benchmarks/uncertainty.py --data ~/stereo --write  # the tables of the package are fitted anew

Of a good standard deviation 68 % of the errors are within one and 95 % within two, in each group of scenes. The area is
that under the mean error of the pixels that are left, while those of the largest standard deviation are taken away
first, in parts of the area if those of the largest error are: 1 is the best.
"""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.evaluation.evaluator import search_range
from stereo_depth_ros.evaluation.scenes import Scene, find_scenes
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.matching import create_matcher, disparity_sigma

TUNED_ON = ("venus", "cones", "Art", "Aloe", "Bowling1", "Motorcycle_quarter")
KINDS = {
    "sgm fast": ("sgm", {"quality": "fast"}),
    "sgm default": ("sgm", {"quality": "default"}),
    "sgm best": ("sgm", {"quality": "best"}),
    "sgbm": ("sgbm", {}),
    "bm": ("bm", {}),
}
ONE_SIGMA, TWO_SIGMAS, AT_MOST = 0.68, 0.95, 0.76
NEIGHBORS = 2500  # pixels that the quantiles at a confidence are of
CONSTANT_PX = 0.25
F64 = npt.NDArray[np.float64]


class Errors(NamedTuple):
    """Absolute errors, px, and confidences of the pixels of a scene with disparity and truth."""

    errors_px: F64
    confidence: F64


def errors_of(scene: Scene, kind: str) -> Errors:
    """The errors of a matcher."""
    name, fields = KINDS[kind]
    found = create_matcher(name, search_range(MatchingConfig(), scene.truth_px), **fields).match(
        scene.left, scene.right
    )
    assert found.confidence is not None
    known = np.isfinite(scene.truth_px) & np.isfinite(found.disparity_px)
    errors_px = np.abs(found.disparity_px - scene.truth_px)[known]
    return Errors(errors_px.astype(np.float64), found.confidence[known].astype(np.float64))


def fitted(scenes: Sequence[Errors]) -> list[float]:
    """The table of these scenes; those with more pixels have no more weight."""
    sigmas = []
    for at in disparity_sigma.CONFIDENCES:
        near = [of.errors_px[np.argsort(np.abs(of.confidence - at), kind="stable")[:NEIGHBORS]] for of in scenes]
        errors_px = np.concatenate(near)
        one, two, most = np.quantile(errors_px, (ONE_SIGMA, TWO_SIGMAS, AT_MOST))
        sigmas.append(float(min(max(one, two / 2), most)))
    return [round(float(value), 2) for value in np.minimum.accumulate(sigmas)]


def area(errors_px: F64, order: npt.NDArray[np.int64]) -> float:
    """Mean over the shares taken away, up to 95 %, of the mean error of the pixels that are left."""
    ordered = errors_px[order]
    return float(np.mean([ordered[int(ordered.size * share) :].mean() for share in np.linspace(0, 0.95, 20)]))


def row(group: str, scenes: Sequence[Errors], table: Sequence[float]) -> str:
    """A row of the table of one group; means over its scenes."""
    figures = []
    for of in scenes:
        sigma = np.interp(of.confidence, disparity_sigma.CONFIDENCES, table)
        ratio = area(of.errors_px, np.argsort(-sigma, kind="stable")) / area(of.errors_px, np.argsort(-of.errors_px))
        within = [float(np.mean(of.errors_px <= limit)) for limit in (sigma, 2 * sigma, CONSTANT_PX)]
        figures.append((*within, ratio))
    one, two, constant, ratio = np.mean(figures, axis=0)
    return f"| {group} | {100 * one:.0f} % | {100 * two:.0f} % | {100 * constant:.0f} % | {ratio:.2f} |"


def write_tables(tables: dict[str, list[float]]) -> None:
    """Replace those of the package."""
    path = Path(disparity_sigma.__file__)
    rows = "".join(f'    "{kind}": ({", ".join(map(str, table))}),\n' for kind, table in tables.items())
    text = re.sub(r"(SIGMAS_PX: .* = \{\n).*?(\})", rf"\g<1>{rows}\g<2>", path.read_text(), flags=re.DOTALL)
    write_file(path, text, overwrite=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = os.environ.get("STEREO_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of scenes with ground truth")
    parser.add_argument("--write", action="store_true", help="write the tables into the package")
    options = parser.parse_args()
    groups: dict[str, dict[str, Scene]] = {}
    for folder in sorted(path for path in options.data.iterdir() if path.name.startswith(("middlebury", "eth3d"))):
        groups[folder.name] = {source.name.rpartition("/")[2]: source.load() for source in find_scenes(folder)}
    tables = {}
    for kind in KINDS:
        found = {name: errors_of(scene, kind) for scenes in groups.values() for name, scene in scenes.items()}
        tables[kind] = fitted([found[name] for name in TUNED_ON if name in found])
        print(f"\n{kind}\n\n| scenes not fitted to | within one | within two | within {CONSTANT_PX} px | area |")
        print("| --- | --- | --- | --- | --- |")
        for group, scenes in groups.items():
            others = {name: found[name] for name in scenes if name not in TUNED_ON}
            for name, errors in others.items():
                print(row(name, [errors], tables[kind]), flush=True)
            if len(others) > 1:
                print(row(f"mean of these in {group}", [*others.values()], tables[kind]), flush=True)
    if options.write:
        write_tables(tables)


if __name__ == "__main__":
    main()
