# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""search_prior of sgm against the search of the whole range: errors on scenes, differences in sequences, and times.

python benchmarks/search_prior.py
python benchmarks/search_prior.py --data data --rounds 20

All ranges are of 128 disparities at least, as there is nothing to save below. ``previous`` of a scene is the second
match of the same pair.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import F32, U8, MatchResult, StereoPair
from stereo_depth_ros.datasets.dataset import StereoDataset
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.evaluation.evaluator import search_range
from stereo_depth_ros.evaluation.scenes import find_scenes
from stereo_depth_ros.matching.sgm.semi_global_matching import SemiGlobalMatcher
from stereo_depth_ros.stages.rectification import Rectifier

PRIORS = ("none", "pyramid", "previous")
LEAST_RANGE = 128
SIZE, RANGES = (1280, 720), (128, 192, 256, 512)
TIMED_SCENE = "Motorcycle_quarter"


def matchers(config: MatchingConfig) -> dict[str, SemiGlobalMatcher]:
    """One for each kind of prior."""
    return {prior: SemiGlobalMatcher(dataclasses.replace(config, search_prior=prior)) for prior in PRIORS}


def figures(result: MatchResult, truth_px: F32) -> tuple[float, float]:
    """Percent of the matched pixels with an error above 2 px, and density, percent of the pixels with a truth."""
    known, found = np.isfinite(truth_px), np.isfinite(result.disparity_px)
    errors_px = np.abs(result.disparity_px - truth_px)[known & found]
    return 100 * float(np.mean(errors_px > 2)), 100 * float(found[known].mean())


def scenes(data: Path, quality: str) -> None:
    """A row a scene."""
    print(f"\nquality {quality}\n\n| scene | " + " | ".join(f"{prior}: > 2 px, density" for prior in PRIORS) + " |")
    print("| --- |" + " --- |" * len(PRIORS))
    for source in find_scenes(data):
        scene = source.load()
        config = search_range(MatchingConfig(quality=quality), scene.truth_px)
        config = dataclasses.replace(config, num_disparities=max(config.num_disparities, LEAST_RANGE))
        cells = []
        for matcher in matchers(config).values():
            matcher.match(scene.left, scene.right)
            bad, density = figures(matcher.match(scene.left, scene.right), scene.truth_px)
            cells.append(f"{bad:.2f} %, {density:.1f} %")
        print(f"| {source.name} | {' | '.join(cells)} |", flush=True)


def rectified(dataset: StereoDataset) -> Iterator[tuple[U8, U8]]:
    """The rectified pairs of a sequence."""
    rectifier = Rectifier(dataset.rig)
    for frame in dataset:
        pair = rectifier.rectify(StereoPair(frame.left, frame.right))
        yield pair.left, pair.right


def sequences(data: Path) -> None:
    """A row a sequence and prior: how the result differs from that of the whole range."""
    found: dict[str, StereoDataset] = {}
    for folder in sorted(data.glob("kitti_odometry/*")):
        found[f"KITTI {folder.name}"] = KittiDataset(folder)
    for folder in sorted(data.glob("euroc/*")):
        found[f"EuRoC {folder.name}"] = EurocDataset(folder)
    print("\n| sequence | prior | density, whole range | density | differ by > 2 px |\n|" + " --- |" * 5)
    for name, dataset in found.items():
        of_prior = matchers(MatchingConfig(num_disparities=LEAST_RANGE))
        rows: dict[str, list[tuple[float, float, float]]] = {prior: [] for prior in PRIORS[1:]}
        for left, right in rectified(dataset):
            whole = of_prior["none"].match(left, right).disparity_px
            for prior, row in rows.items():
                other = of_prior[prior].match(left, right).disparity_px
                both = np.isfinite(whole) & np.isfinite(other)
                differ = float(np.mean(np.abs(whole - other)[both] > 2))
                row.append((float(np.isfinite(whole).mean()), float(np.isfinite(other).mean()), differ))
        for prior, row in rows.items():
            whole_density, density, differ = 100 * np.mean(row, axis=0)
            print(f"| {name}, {len(row)} pairs | {prior} | {whole_density:.1f} % | {density:.1f} % | {differ:.2f} % |")


def times(data: Path, rounds: int) -> None:
    """A row a range: the least CPU time of a pair, ms, and its ratio to the whole range."""
    scene = next(source for source in find_scenes(data) if source.name == TIMED_SCENE).load()
    left, right = (cv2.resize(image, SIZE, interpolation=cv2.INTER_CUBIC) for image in (scene.left, scene.right))
    print(f"\n| {SIZE[0]}x{SIZE[1]} | " + " | ".join(f"{prior}: ms CPU, ratio" for prior in PRIORS) + " |")
    print("| --- |" + " --- |" * len(PRIORS))
    for count in RANGES:
        of_prior = matchers(MatchingConfig(num_disparities=count))
        least = dict.fromkeys(PRIORS, np.inf)
        for _ in range(rounds + 1):  # interleaved: the machine may be slower for a while
            for prior, matcher in of_prior.items():
                start = time.process_time()
                matcher.match(left, right)
                least[prior] = min(least[prior], 1e3 * (time.process_time() - start))
        cells = [f"{ms:.0f}, {ms / least['none']:.2f}" for ms in least.values()]
        print(f"| {count} disparities | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = os.environ.get("STEREO_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of scenes and sequences")
    parser.add_argument("--rounds", type=int, default=10, help="number of timed rounds")
    options = parser.parse_args()
    for quality in ("default", "best"):
        scenes(options.data, quality)
    sequences(options.data)
    times(options.data, options.rounds)


if __name__ == "__main__":
    main()
