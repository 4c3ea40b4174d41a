# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Space-time stereo over the number of pairs: density, differences to sgm, noise and time, of images of a static scene.

python benchmarks/spacetime.py IMAGES --min-disparity -106 --disparity-range 352
python benchmarks/spacetime.py IMAGES --window 1 --pairs 8 32 --plot out/noise.png --disparities out/disparity.png
python benchmarks/spacetime.py --speed

IMAGES is a folder of left and right images with left.yaml and right.yaml, as `stereo-depth convert images` reads it.
The object is where the light changes: the standard deviation of the gray levels over time is above 3, opened by 5 x 5
pixels. Noise is 1.4826 times the median absolute residual to a quadric fitted to 15 x 15 pixels, the median over the
patches that are on the object and whose disparities, by all pairs, fit to a quadric within a quarter of a pixel. It is
compared with that of a single pair in windows of the same size, at least 5, without a check but the left-right one, on
the patches that have both.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32, U8, StereoPair
from stereo_depth_ros.datasets.images import ImagesDataset
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.stages.rectification import Rectifier

HALF = 7  # of a patch
LIT = 3.0  # gray levels
SMOOTH_PX = 0.25


def read_pairs(folder: Path) -> list[tuple[U8, U8]]:
    """The rectified pairs."""
    dataset = ImagesDataset(folder)
    rectifier = Rectifier(dataset.rig)
    rectified = [rectifier.rectify(StereoPair(frame.left, frame.right)) for frame in dataset]
    return [(pair.left, pair.right) for pair in rectified]


def object_of(pairs: Sequence[tuple[U8, U8]]) -> npt.NDArray[np.bool_]:
    """bool (H, W), true where the light changes in the left images."""
    lit = np.std([left for left, _ in pairs], axis=0) > LIT
    return np.asarray(cv2.morphologyEx(lit.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8)) > 0)


def residuals(disparity_px: F32, on: npt.NDArray[np.bool_]) -> dict[tuple[int, int], float]:
    """The noise of each patch on the object of which at least half has a disparity, by its place."""
    v, u = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1] / HALF
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(-1, 6)
    found = {}
    for y in range(HALF, on.shape[0] - HALF, 2 * HALF + 1):
        for x in range(HALF, on.shape[1] - HALF, 2 * HALF + 1):
            rows, columns = slice(y - HALF, y + HALF + 1), slice(x - HALF, x + HALF + 1)
            patch = disparity_px[rows, columns].ravel().astype(float)
            valid = np.isfinite(patch)
            if on[rows, columns].all() and valid.mean() > 0.5:
                for _ in range(3):  # without what does not belong to the surface
                    fit = np.linalg.lstsq(terms[valid], patch[valid], rcond=None)[0]
                    error = np.abs(terms @ fit - patch)
                    scale = 1.4826 * float(np.nanmedian(error))
                    valid = np.isfinite(patch) & (error <= 3 * scale + 1e-6)
                found[y, x] = scale
    return found


def timed(name: str, pairs: Sequence[tuple[U8, U8]], count: int, runs: int, **fields: Any) -> tuple[Any, float]:
    """Result of the last ``count`` pairs, and the median milliseconds."""
    matcher = create_matcher(name, temporal_window=count, **fields)
    times = []
    for _ in range(runs + 1):
        begin = time.perf_counter()
        result = matcher.match(*pairs[-1], earlier=pairs[-count:-1])
        times.append(1e3 * (time.perf_counter() - begin))
    return result, statistics.median(times[1:])


def table(pairs: Sequence[tuple[U8, U8]], counts: Sequence[int], window: int, search: dict[str, int]) -> dict[str, Any]:
    """Print a row for each number of pairs and both kinds of windows; the rows and the last disparities."""
    on = object_of(pairs)
    sgm, _ = timed("sgm", pairs, 1, 1, **search)
    fields = {**search, "spacetime_window": max(window, 5), "uniqueness_ratio": 0.0, "speckle_size": 0}
    single = residuals(timed("spacetime", pairs, 1, 1, **fields)[0].disparity_px, on)
    rows: list[dict[str, float]] = []
    results = {}
    for slanted in (False, True):
        for count in counts:
            fields = {**search, "spacetime_window": window, "slanted_windows": slanted}
            results[slanted, count] = timed("spacetime", pairs, count, 1, **fields)
    smooth = residuals(results[True, max(counts)][0].disparity_px, on)
    places = [place for place, noise in smooth.items() if noise < SMOOTH_PX]
    print(f"object {on.sum()} px, {len(places)} smooth patches, sgm on {100 * np.mean(sgm.reasons[on] == 0):.1f} %")
    columns = ("windows", "pairs", "density", "sgm within 1 px", "noise px", "of patches", "of a single pair", "ms")
    print(f"\n| {' | '.join(columns)} |\n|{' --- |' * len(columns)}")
    for (slanted, count), (result, ms) in results.items():
        disparity_px = result.disparity_px
        both = on & np.isfinite(disparity_px) & np.isfinite(sgm.disparity_px)
        near = np.mean(np.abs(disparity_px - sgm.disparity_px)[both] <= 1)
        patches = residuals(disparity_px, on)
        noises = [patches[place] for place in places if place in patches]
        row = {"slanted": slanted, "pairs": count, "density": np.mean(np.isfinite(disparity_px[on])), "near": near}
        both_places = [place for place in places if place in patches and place in single]
        medians = [np.median([of[place] for place in both_places]) for of in (patches, single)]
        row |= {"noise_px": float(np.median(noises)) if noises else np.nan, "patches": len(noises), "ms": ms}
        rows.append(row)
        print(
            f"| {'slanted' if slanted else 'constant'} | {count} | {100 * row['density']:.1f} % | {100 * near:.1f} % "
            f"| {row['noise_px']:.3f} | {len(noises)} | {medians[0] / medians[1]:.2f} | {ms:.0f} |"
        )
    return {"rows": rows, "disparity_px": results[True, max(counts)][0].disparity_px}


def plot(rows: Sequence[dict[str, float]]) -> U8:
    """Noise and density over the number of pairs, in one image."""
    width, height, margin = 720, 420, 60
    image = np.full((height, width, 3), 255, np.uint8)
    counts = sorted({int(row["pairs"]) for row in rows})
    top = max(row["noise_px"] for row in rows if np.isfinite(row["noise_px"]))
    black, font = (0, 0, 0), cv2.FONT_HERSHEY_SIMPLEX

    def at(count: float, share: float) -> tuple[int, int]:
        x = margin + (width - 2 * margin) * np.log2(count) / max(np.log2(counts[-1]), 1)
        return round(float(x)), round(height - margin - (height - 2 * margin) * share)

    cv2.rectangle(image, at(1, 0), at(counts[-1], 1), black, 1)
    for count in counts:
        cv2.putText(image, str(count), (at(count, 0)[0] - 6, height - margin + 20), font, 0.45, black, 1, cv2.LINE_AA)
    for share in (0, 0.5, 1):
        y = at(1, share)[1] + 4
        cv2.putText(image, f"{share * top:.2f}", (10, y), font, 0.45, black, 1, cv2.LINE_AA)
        cv2.putText(image, f"{100 * share:.0f} %", (width - 52, y), font, 0.45, black, 1, cv2.LINE_AA)
    lines = [("noise px", False, "noise_px", (200, 80, 0)), ("noise px, slanted", True, "noise_px", (0, 0, 200))]
    for number, (label, slanted, key, color) in enumerate([*lines, ("density", False, "density", (0, 140, 0))]):
        scale = top if key == "noise_px" else 1.0
        points = [at(row["pairs"], row[key] / scale) for row in rows if row["slanted"] == slanted and row[key] >= 0]
        cv2.polylines(image, [np.array(points, np.int32)], False, color, 2, cv2.LINE_AA)
        cv2.putText(image, label, (margin + 150 * number, 30), font, 0.5, color, 1, cv2.LINE_AA)
    cv2.putText(image, "pairs", (width // 2 - 20, height - 15), font, 0.5, black, 1, cv2.LINE_AA)
    return image


def colored(disparity_px: F32) -> U8:
    """An image of the disparities, black where there is none."""
    low, high = np.nanpercentile(disparity_px, (1, 99))
    levels = np.clip(255 * (np.nan_to_num(disparity_px, nan=low) - low) / (high - low), 0, 255).astype(np.uint8)
    image = cv2.applyColorMap(levels, cv2.COLORMAP_TURBO)
    image[~np.isfinite(disparity_px)] = 0
    return np.asarray(image, np.uint8)


def speed(rounds: int) -> None:
    """Print the time of 8 pairs beside that of sgm with one pair, 640x480 and 64 disparities, in turns."""
    rng = np.random.default_rng(1)
    pairs = []
    for _ in range(8):
        wide = cv2.GaussianBlur(rng.integers(0, 256, (480, 700), np.uint8), (0, 0), 1.2)
        pairs.append((np.ascontiguousarray(wide[:, :640]), np.ascontiguousarray(wide[:, 30:670])))
    methods: dict[str, tuple[str, int, dict[str, Any]]] = {
        "sgm, 1 pair": ("sgm", 1, {}),
        "sgm, 8 pairs": ("sgm", 8, {}),
        "spacetime 5 x 5 x 8": ("spacetime", 8, {}),
        "spacetime 15 x 15 x 8": ("spacetime", 8, {"spacetime_window": 15}),
    }
    times: dict[str, list[float]] = {name: [] for name in methods}
    matchers = {name: (create_matcher(m, temporal_window=n, **f), n) for name, (m, n, f) in methods.items()}
    for round_ in range(rounds + 1):
        for name, (matcher, count) in matchers.items():
            begin = time.perf_counter()
            matcher.match(*pairs[-1], earlier=pairs[-count:-1])
            times[name] += [1e3 * (time.perf_counter() - begin)] if round_ else []
    reference = statistics.median(times["sgm, 1 pair"])
    print("| method | ms | of sgm |\n| --- | --- | --- |")
    for name, values in times.items():
        print(f"| {name} | {statistics.median(values):.1f} | {statistics.median(values) / reference:.2f} |")


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=Path, nargs="?")
    parser.add_argument("--pairs", type=int, nargs="+", default=[1, 2, 4, 8, 16, 32])
    parser.add_argument("--window", type=int, default=5)
    parser.add_argument("--min-disparity", type=int, default=0)
    parser.add_argument("--disparity-range", type=int, default=64)
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--disparities", type=Path)
    parser.add_argument("--speed", action="store_true", help="compare the time of 8 pairs with that of sgm")
    parser.add_argument("--rounds", type=int, default=10)
    arguments = parser.parse_args()
    if arguments.speed:
        speed(arguments.rounds)
    if arguments.images is None:
        return
    search = {"min_disparity": arguments.min_disparity, "num_disparities": arguments.disparity_range}
    found = table(read_pairs(arguments.images), arguments.pairs, arguments.window, search)
    if arguments.plot is not None:
        save_png(arguments.plot, plot(found["rows"]), overwrite=True)
    if arguments.disparities is not None:
        save_png(arguments.disparities, colored(found["disparity_px"]), overwrite=True)


if __name__ == "__main__":
    main()
