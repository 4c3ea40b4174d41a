# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy and speed of the real-time matchers compared with OpenCV, on real scenes with ground truth.

python benchmarks/matching.py
python benchmarks/matching.py --data ~/stereo --scenes cones Art --parts accuracy locking
python benchmarks/matching.py --parts speed --rounds 30 --json matching.json

SGBM, 3WAY and BM are bare OpenCV matchers, which return 16-bit fixed point. The others are those of this package with
their defaults, except `sgbm`, which has the parameters of SGBM and of 3WAY. `sgbm` and `bm` have the disparities of
SGBM, 3WAY and BM: their times differ by the kernels and by the overhead of the Matcher protocol.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import core_count
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.evaluation.evaluator import search_range
from stereo_depth_ros.evaluation.hard_regions import hard_regions
from stereo_depth_ros.evaluation.metrics import disparity_errors
from stereo_depth_ros.evaluation.scenes import Scene, find_scenes
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.matching import create_matcher

Call: TypeAlias = Callable[[U8, U8], npt.NDArray[Any]]  # float32 px with NaN, or OpenCV's int16 in 1/16 px
Row: TypeAlias = dict[str, Any]

TUNED_ON = ("venus", "cones", "Art", "Aloe", "Bowling1", "Motorcycle_quarter")
SUBPIXEL_SCENES = ("Motorcycle_quarter", "terrace")  # with ground truth that is not rounded
SPEED_SCENE = "Motorcycle_quarter"  # its 60 px of disparity become 52 px and 103 px
SIZES = ((640, 480, 64), (1280, 720, 128))
FIGURES = ("density", "bad_0_5", "bad_1", "bad_2", "bad_2_all", "avg_px")
QUALITIES, DENSITY = ("fast", "default", "best"), 0.85
REGIONS = ("edges", "thin")  # near depth edges and of thin structures
REGION_FIGURES = ("density", "bad_2")
BINS = 10
REQUIRED = {  # bounds of the figures in requirements
    "bad_2 ratio": (0.0, 0.5),
    "bad_1 ratio": (0.0, 0.7),
    "density points": (3.0, 100.0),
    "dense density": (1.0, 1.0),
    "dense bad_2_all ratio": (0.0, 0.36),
}
LARGEST_TIME_RATIO = 0.6  # of sgm to SGBM on two cores


def _ours(name: str, **fields: Any) -> Callable[[MatchingConfig], Call]:
    def make(search: MatchingConfig) -> Call:
        matcher = create_matcher(name, search, **fields)
        return lambda left, right: matcher.match(left, right).disparity_px

    return make


def _opencv_sgbm(mode: int) -> Callable[[MatchingConfig], Call]:
    def make(search: MatchingConfig) -> Call:
        first, count = search.min_disparity, search.num_disparities
        call: Call = cv2.StereoSGBM.create(first, count, 3, 72, 288, 1, 31, 10, 100, 2, mode).compute
        return call

    return make


def _opencv_bm(search: MatchingConfig) -> Call:
    bm = cv2.StereoBM.create(search.num_disparities, search.correlation_window_size)
    bm.setMinDisparity(search.min_disparity)
    bm.setPreFilterCap(search.prefilter_cap)
    bm.setTextureThreshold(search.texture_threshold)
    bm.setUniquenessRatio(round(search.uniqueness_ratio))
    bm.setSpeckleWindowSize(search.speckle_size)
    bm.setSpeckleRange(search.speckle_range)
    call: Call = bm.compute
    return call


_AS_SGBM = {"correlation_window_size": 3, "P1": 72.0, "P2": 288.0, "disp12_max_diff": 1, "uniqueness_ratio": 10.0}
METHODS: dict[str, Callable[[MatchingConfig], Call]] = {
    "sgm": _ours("sgm"),
    "sgm dense": _ours("sgm", fill_holes=True),
    "sgm fast": _ours("sgm", quality="fast"),
    "sgm best": _ours("sgm", quality="best"),
    "sgm 8 paths": _ours("sgm", sgm_paths=8),
    "SGBM": _opencv_sgbm(cv2.STEREO_SGBM_MODE_SGBM),
    "sgbm": _ours("sgbm", **_AS_SGBM, speckle_range=2),
    "3WAY": _opencv_sgbm(cv2.STEREO_SGBM_MODE_SGBM_3WAY),
    "sgbm 3WAY": _ours("sgbm", **_AS_SGBM, speckle_range=2, sgbm_mode=2),
    "bm": _ours("bm"),
    "BM": _opencv_bm,
}
COMPARED = (
    "sgm",
    "sgm dense",
    "sgm fast",
    "sgm best",
    "sgm 8 paths",
    "SGBM",
    "3WAY",
    "bm",
)  # the others equal one of these


def disparities(call: Call, left: U8, right: U8, search: MatchingConfig) -> F32:
    """The disparities of the method, float32, px, NaN where invalid."""
    found = call(left, right)
    if found.dtype == np.float32:
        return found
    return np.where(found >= 16 * search.min_disparity, found.astype(np.float32) / 16, np.float32(np.nan))


def timed_ms(calls: dict[str, Call], left: U8, right: U8, rounds: int) -> dict[str, list[float]]:
    """Milliseconds of every call in every round after a warm-up round; calls alternate to see the same machine load."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for name in [*calls] * (rounds + 1):
        begin = time.perf_counter()
        calls[name](left, right)
        times[name].append(1e3 * (time.perf_counter() - begin))
    return {name: values[1:] for name, values in times.items()}


def accuracy(scenes: dict[str, Scene], rounds: int = 5) -> list[Row]:
    """A row for every scene and compared method; no ms where there are no timed rounds."""
    rows: list[Row] = []
    for scene, data in scenes.items():
        search = search_range(MatchingConfig(), data.truth_px)
        calls = {name: METHODS[name](search) for name in COMPARED}
        times = timed_ms(calls, data.left, data.right, rounds) if rounds else {name: [math.nan] for name in calls}
        for name, call in calls.items():
            found = disparities(call, data.left, data.right, search)
            errors = disparity_errors(found, data.truth_px)
            row = {"scene": scene, "disparities": search.num_disparities, "method": name}
            row |= {figure: getattr(errors, figure) for figure in FIGURES}
            row |= _in_hard_regions(found, data.truth_px)
            rows.append(row | {"ms": statistics.median(times[name])})
    return rows


class Pixels(NamedTuple):
    """The pixels of a scene with truth: absolute errors, NaN without a disparity, of the result and of a filled one."""

    errors_px: F32
    confidence: F32
    filled_px: F32
    visible: npt.NDArray[np.bool_]  # in the right image too


def at_density(scenes: dict[str, Scene]) -> list[Row]:
    """Errors of the qualities of sgm as they are, and without the least confident pixels until the density is 0.85.

    One threshold of the confidence for all scenes, so that the mean of their densities is that.
    """
    rows: list[Row] = []
    for quality in QUALITIES:
        pixels = {name: _pixels_with_truth(scene, quality) for name, scene in scenes.items()}
        groups = {"all": list(pixels), "tuned on": [*TUNED_ON], "held out": [n for n in pixels if n not in TUNED_ON]}
        for group, names in groups.items():
            chosen = [pixels[name] for name in names if name in pixels]
            if chosen:
                low, high = 0.0, 1.0
                for _ in range(30):
                    middle = (low + high) / 2
                    dense = np.mean([_figures(scene, middle)["density"] for scene in chosen]) > 100 * DENSITY
                    low, high = (middle, high) if dense else (low, middle)
                for threshold, at in ((-1.0, "natural"), (low, f"{DENSITY}")):
                    figures = [_figures(scene, threshold) for scene in chosen]
                    row: Row = {"quality": quality, "scenes": group, "at": at}
                    rows.append(row | {name: float(np.mean([of[name] for of in figures])) for name in figures[0]})
    return rows


def _pixels_with_truth(scene: Scene, quality: str) -> Pixels:
    search, known = search_range(MatchingConfig(), scene.truth_px), np.isfinite(scene.truth_px)
    found = create_matcher("sgm", search, quality=quality).match(scene.left, scene.right)
    filled = create_matcher("sgm", search, quality=quality, fill_holes=True).match(scene.left, scene.right)
    assert found.confidence is not None
    errors, filled_errors = (np.abs(of.disparity_px - scene.truth_px)[known] for of in (found, filled))
    return Pixels(errors, found.confidence[known], filled_errors, scene.visible[known])


def _figures(scene: Pixels, threshold: float) -> Row:
    """Shares of pixels in percent, and the mean error; ``noc`` is of the pixels that both cameras see."""
    kept, seen = np.isfinite(scene.errors_px) & (scene.confidence >= threshold), scene.visible
    errors, both = scene.errors_px[kept], scene.errors_px[kept & seen]
    row: Row = {"density": kept.mean(), "density noc": kept[seen].mean()}
    row |= {"bad_1": (errors > 1).mean(), "bad_2": (errors > 2).mean(), "bad_2 noc": (both > 2).mean()}
    filled = {"filled bad_2": scene.filled_px, "filled noc": scene.filled_px[seen]}
    row |= {name: (of > 2).mean() if threshold < 0 else math.nan for name, of in filled.items()}
    return {name: 100 * float(share) for name, share in row.items()} | {"avg_px": float(errors.mean())}


def _in_hard_regions(found: F32, truth_px: F32) -> Row:
    """Share of the pixels with truth, density and errors, near depth edges and on thin structures."""
    row: Row = {}
    regions, known = hard_regions(truth_px), np.isfinite(truth_px)
    for name in REGIONS:
        region = getattr(regions, name)
        errors = disparity_errors(found, truth_px, region)
        row |= {f"{name} share": np.count_nonzero(region) / np.count_nonzero(known)}
        row |= {f"{name} {figure}": getattr(errors, figure) for figure in REGION_FIGURES}
    return row


def means(rows: list[Row]) -> dict[str, Row]:
    """The mean over scenes of every figure, by method."""
    return {
        name: {
            figure: float(np.nanmean([row[figure] for row in rows if row["method"] == name]))  # no thin structure: NaN
            for figure in rows[0]
            if isinstance(rows[0][figure], float)
        }
        for name in COMPARED
    }


def requirements(rows: list[Row]) -> list[Row]:
    """sgm compared with SGBM on all scenes, on those used for tuning and on the others, and the violated bounds."""
    tuned = [row for row in rows if row["scene"] in TUNED_ON]
    held_out = [row for row in rows if row["scene"] not in TUNED_ON]
    found: list[Row] = []
    for group, chosen in (("all", rows), ("tuned on", tuned), ("held out", held_out)):
        if not chosen:
            continue
        mean = means(chosen)
        sgm, dense, sgbm = mean["sgm"], mean["sgm dense"], mean["SGBM"]
        row: Row = {"scenes": f"{group} ({len(chosen) // len(COMPARED)})"}
        row |= {f"{figure} ratio": sgm[figure] / sgbm[figure] for figure in ("bad_2", "bad_1", "bad_0_5", "avg_px")}
        row |= {"density points": 100 * (sgm["density"] - sgbm["density"]), "dense density": dense["density"]}
        row |= {"dense bad_2_all ratio": dense["bad_2_all"] / sgbm["bad_2_all"]}
        missed = [name for name, (low, high) in REQUIRED.items() if not low <= row[name] <= high]
        found.append(row | {"misses": ", ".join(missed) or "nothing"})
    return found


class PriorCase(NamedTuple):
    """Points sampled from the truth: their share of the pixels with truth, their noise, and the share of wrong ones."""

    share: float
    sigma_px: float
    wrong: float


PRIORS = (PriorCase(0.01, 0.5, 0.1), PriorCase(0.05, 0.5, 0.1), PriorCase(0.05, 0.0, 0.0), PriorCase(0.05, 0.5, 0.3))
FLAT_GRAY = 2.0  # standard deviation of 9 x 9 px, below which a wall has no texture


def sampled_prior(truth_px: F32, case: PriorCase, seed: int = 7) -> DisparityPrior:
    """Points at random pixels; wrong ones are anywhere between the smallest and the largest true disparity."""
    rng = np.random.default_rng(seed)
    known = np.isfinite(truth_px)
    points = known & (rng.random(truth_px.shape) < case.share)
    disparity_px = truth_px + rng.normal(0, case.sigma_px, truth_px.shape)
    wrong = rng.random(truth_px.shape) < case.wrong
    disparity_px[wrong] = rng.uniform(truth_px[known].min(), truth_px[known].max(), np.count_nonzero(wrong))
    sigma_px = np.full(truth_px.shape, max(case.sigma_px, 0.1), np.float32)
    return DisparityPrior(np.where(points, disparity_px, np.nan).astype(np.float32), sigma_px)


def guided(scenes: dict[str, Scene]) -> list[Row]:
    """sgm with and without a prior on each scene: all pixels but the points, and those of walls without texture."""
    rows: list[Row] = []
    for scene, data in scenes.items():
        matcher = create_matcher("sgm", search_range(MatchingConfig(), data.truth_px))
        gray = data.left.astype(np.float32)
        mean = cv2.blur(gray, (9, 9))
        flat = cv2.blur(gray * gray, (9, 9)) - mean * mean < FLAT_GRAY**2
        for case in (None, *PRIORS):
            prior = None if case is None else sampled_prior(data.truth_px, case)
            begin = time.perf_counter()
            found = matcher.match(data.left, data.right, prior=prior).disparity_px
            points = "none" if case is None else "{:.0%}, {} px, {:.0%} wrong".format(*case)
            row: Row = {"scene": scene, "points": points}
            elsewhere = np.ones(flat.shape, np.bool_) if prior is None else ~prior.known
            for part, mask in (("", elsewhere), ("flat ", elsewhere & flat)):
                errors = disparity_errors(found, data.truth_px, mask)
                row |= {f"{part}{figure}": getattr(errors, figure) for figure in ("density", "bad_2", "bad_2_all")}
            rows.append(row | {"avg_px": disparity_errors(found, data.truth_px, elsewhere).avg_px})
            rows[-1]["ms"] = 1e3 * (time.perf_counter() - begin)
    return rows


def guided_means(rows: list[Row]) -> list[Row]:
    """The means over the scenes used for tuning, and over the others."""
    found: list[Row] = []
    for group in ("tuned on", "held out"):
        of_group = [row for row in rows if (row["scene"] in TUNED_ON) == (group == "tuned on")]
        for points in dict.fromkeys(row["points"] for row in of_group):
            chosen = [row for row in of_group if row["points"] == points]
            mean = {name: float(np.nanmean([row[name] for row in chosen])) for name in list(rows[0])[2:]}
            found.append({"scenes": f"{group} ({len(chosen)})", "points": points} | mean)
    return found


def locking(scenes: dict[str, Scene]) -> list[Row]:
    """Histograms of the fractional parts of disparities with errors up to 1 px in both methods, and of their truth.

    Bins are centered on 0, 0.1 ... 0.9. A disparity is spread evenly over its step: steps of 1/16 would otherwise fall
    unevenly into the bins. Distance: the share that would have to move to match the histogram of the truth.
    """
    rows: list[Row] = []
    for scene in SUBPIXEL_SCENES:
        if scene not in scenes:
            continue
        data, rng = scenes[scene], np.random.default_rng(1)
        search = search_range(MatchingConfig(), data.truth_px)
        found = {name: disparities(METHODS[name](search), data.left, data.right, search) for name in ("sgm", "SGBM")}
        used = np.logical_and.reduce([np.abs(px - data.truth_px) <= 1 for px in found.values()])
        shares: dict[str, npt.NDArray[np.float64]] = {}
        for name, step in (("truth", 0.0), ("sgm", 1 / 64), ("SGBM", 1 / 16)):
            px = found.get(name, data.truth_px)[used] + rng.uniform(-step / 2, step / 2, np.count_nonzero(used))
            bins = np.rint(px * BINS).astype(int) % BINS
            shares[name] = 100 * np.bincount(bins, minlength=BINS) / bins.size
            row = {"scene": scene, "method": name} | {f"{n / BINS:.1f}": shares[name][n] for n in range(BINS)}
            rows.append(row | {"distance": float(np.abs(shares[name] - shares["truth"]).sum() / 2)})
    return rows


def speed(scene: Scene, rounds: int) -> list[Row]:
    """Times of all methods on the resized scene, on two cores and on one."""
    rows: list[Row] = []
    for cores in (2, 1):
        for width, height, count in SIZES:
            left, right = (cv2.resize(side, (width, height)) for side in (scene.left, scene.right))
            times = in_process(cores, _measure, count, left, right, rounds)
            for name, ms in times.items():
                row = {"cores": cores, "size": f"{width}x{height}/{count}", "method": name}
                row |= {"minimum ms": min(ms), "median ms": statistics.median(ms)}
                row |= {"ratio of minima": min(ms) / min(times["SGBM"])}
                row |= {"ratio of medians": statistics.median(ms) / statistics.median(times["SGBM"])}
                row |= {"to 3WAY": statistics.median(ms) / statistics.median(times["3WAY"])}
                required = name == "sgm" and cores == 2
                rows.append(row | {"holds": row["ratio of medians"] <= LARGEST_TIME_RATIO if required else None})
    return rows


def _measure(count: int, left: U8, right: U8, rounds: int) -> dict[str, list[float]]:
    search = MatchingConfig(num_disparities=count)
    return timed_ms({name: make(search) for name, make in METHODS.items()}, left, right, rounds)


def in_process(cores: int, function: Callable[..., Any], *args: Any) -> Any:
    """The result of ``function`` in a process restricted to ``cores`` cores, including the threads of OpenCV."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, initializer=_use_cores, initargs=(cores,)) as pool:
        return pool.submit(function, *args).result()


def _use_cores(cores: int) -> None:
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    cv2.setNumThreads(core_count())


def table(title: str, rows: Sequence[Row]) -> None:
    """Print rows with equal keys as a Markdown table."""
    if not rows:
        return
    print(f"\n{title}\n\n| {' | '.join(rows[0])} |\n|{' --- |' * len(rows[0])}")
    for row in rows:
        print(f"| {' | '.join(_cell(value) for value in row.values())} |", flush=True)


def _cell(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "", True: "yes", False: "NO"}[value]
    if isinstance(value, float):
        size = abs(value)
        return f"{value:.{0 if size >= 100 else 1 if size >= 10 else 2 if size >= 1 else 3}f}"
    return str(value)


def load_scenes(folder: Path, names: Sequence[str]) -> dict[str, Scene]:
    """The scenes with ground truth of a folder, or the named ones of them."""
    sources = {source.name: source for source in find_scenes(folder)}
    if unknown := set(names) - set(sources):
        raise SystemExit(f"no scene {', '.join(sorted(unknown))} in {folder}: name some of {', '.join(sources)}")
    return {name: sources[name].load() for name in names or sources}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = os.environ.get("STEREO_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of scenes with ground truth")
    parser.add_argument("--scenes", nargs="+", default=[], help="names of scenes; default: all")
    parts = ("accuracy", "density", "prior", "locking", "speed")
    parser.add_argument("--parts", nargs="+", default=parts, choices=parts)
    parser.add_argument("--rounds", type=int, default=15, help="number of timed rounds for speed")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows as JSON")
    options = parser.parse_args()
    scenes = load_scenes(options.data, options.scenes)
    print(f"OpenCV {cv2.__version__}, {core_count()} cores")
    found: dict[str, list[Row]] = {}
    if "accuracy" in options.parts:
        found["accuracy"] = rows = accuracy(scenes)
        found["means"] = [{"method": name} | mean for name, mean in means(rows).items()]
        found["requirements"] = requirements(rows)
        table("Accuracy; bad in percent, avg in px, ms on all cores", rows)
        table("Means over the scenes", found["means"])
        table("sgm against SGBM", found["requirements"])
    if "density" in options.parts:
        found["density"] = at_density(scenes)
        table(f"sgm as it is, and at a mean density of {DENSITY}; percent, avg in px", found["density"])
    if "prior" in options.parts:
        found["prior"] = guided(scenes)
        table("Means of sgm with points of a prior, sampled from the truth", guided_means(found["prior"]))
    if "locking" in options.parts:
        found["locking"] = locking(scenes)
        table("Fractional parts of disparities, percent", found["locking"])
    if "speed" in options.parts:
        scene = load_scenes(options.data, [SPEED_SCENE])[SPEED_SCENE]
        found["speed"] = speed(scene, options.rounds)
        table(f"Speed on {SPEED_SCENE}, resized; ratios to SGBM", found["speed"])
    if options.json:
        write_file(options.json, json.dumps(found, indent=1) + "\n", overwrite=True)


if __name__ == "__main__":
    main()
