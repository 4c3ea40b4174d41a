# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time and accuracy of the views.

python benchmarks/views.py
python benchmarks/views.py --data ~/stereo --rounds 50

Times, by the clock and of all cores together, are medians at 640x480 in color, with the disparities of the synthetic
room. Accuracy is the PSNR over all pixels of the image between the outer ones of Tsukuba, and of each folder with
--data that has im2, im4 and im6 (Middlebury 2001), with disparities of sgm, and of plain blending.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.datasets.image_files import read_image
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.synthetic.sequence import SyntheticSequence
from stereo_depth_ros.views.anaglyph import anaglyph
from stereo_depth_ros.views.color_maps import depth_color, disparity_color
from stereo_depth_ros.views.convergence import converged, subject_disparity
from stereo_depth_ros.views.gif import animated_gif
from stereo_depth_ros.views.interpolation import interpolate_view
from stereo_depth_ros.views.layouts import arranged
from stereo_depth_ros.views.stereogram import stereogram
from stereo_depth_ros.views.wiggle import FRAME_MS, wiggle

DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
TSUKUBA = tuple(f"scene1.row3.col{number}.ppm" for number in (3, 4, 5))
MIDDLEBURY = ("im2.ppm", "im4.ppm", "im6.ppm")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="folder with folders of images")
    parser.add_argument("--rounds", type=int, default=20, help="calls of each view")
    options = parser.parse_args()
    for name, wall_ms, cpu_ms in times_ms(options.rounds):
        print(f"| {name} | {wall_ms:.1f} ms | {cpu_ms:.1f} ms |")
    for folder in sorted({path.parent for path in options.data.rglob("*.ppm")}):
        for names in (TSUKUBA, MIDDLEBURY):
            if all((folder / name).is_file() for name in names):
                left, truth, right = (read_image(folder / name) for name in names)
                view_db, blend_db = accuracy_db(left, truth, right)
                print(f"| {folder.name} | {view_db:.2f} dB | {blend_db:.2f} dB |")


def times_ms(rounds: int) -> Iterator[tuple[str, float, float]]:
    """Median time of each view: by the clock, and of all cores together."""
    made = SyntheticSequence(1)[0]
    left, right = (
        cv2.applyColorMap(np.ascontiguousarray(side.pixels), cv2.COLORMAP_BONE)
        for side in (made.pair.left, made.pair.right)
    )
    gray = made.pair.left.pixels, made.pair.right.pixels
    disparity_px = create_matcher("sgm").match(*gray).disparity_px
    shift_px = subject_disparity(disparity_px)
    views: dict[str, Callable[[], object]] = {
        "from between": lambda: interpolate_view(left, right, disparity_px, 0.5),
        "from between, gray": lambda: interpolate_view(*gray, disparity_px, 0.5),
        "convergence": lambda: converged(left, right, subject_disparity(disparity_px)),
        "anaglyph, Dubois": lambda: anaglyph(*converged(left, right, shift_px)),
        "anaglyph, half-color": lambda: anaglyph(*converged(left, right, shift_px), "half-color"),
        "interlaced": lambda: arranged(left, right, "interlaced"),
        "stereogram": lambda: stereogram(disparity_px),
        "disparity as colors": lambda: disparity_color(disparity_px, 0, 63),
        "depth as colors": lambda: depth_color(made.truth_depth_m),
        "wiggle animation": lambda: animated_gif(wiggle(left, right, disparity_px, shift_px), FRAME_MS),
    }
    for name, draw in views.items():
        draw()
        found = []
        for _ in range(rounds):
            start = time.perf_counter(), time.process_time()
            draw()
            found.append((time.perf_counter() - start[0], time.process_time() - start[1]))
        wall_ms, cpu_ms = (1e3 * statistics.median(each) for each in zip(*found, strict=True))
        yield name, wall_ms, cpu_ms


def accuracy_db(left: U8, truth: U8, right: U8) -> tuple[float, float]:
    """PSNR of the view half-way, and of both images blended."""
    grays = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (left, right)]
    disparity_px: F32 = create_matcher("sgm").match(*grays).disparity_px
    blended = np.asarray(cv2.addWeighted(left, 0.5, right, 0.5, 0), np.uint8)
    return psnr(interpolate_view(left, right, disparity_px, 0.5), truth), psnr(blended, truth)


def psnr(image: U8, truth: U8) -> float:
    return float(10 * np.log10(255**2 / np.mean((image.astype(np.float64) - truth) ** 2)))


if __name__ == "__main__":
    main()
