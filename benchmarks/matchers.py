# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time of the matchers beside the bare OpenCV call with the same parameters: ``python benchmarks/matchers.py``.

Ours returns float32 pixels and the reasons, OpenCV its 16-bit fixed point. Runs alternate; medians.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.types import U8

SIZES = ((480, 640, 64), (720, 1280, 128))
RUNS = {"bm": 40, "sgbm": 8}


def textured_pair(height: int, width: int, largest: int) -> tuple[U8, U8]:
    """Blurred noise seen at patches of constant disparity, with camera noise on the left."""
    rng = np.random.default_rng(1)
    right = cv2.GaussianBlur(rng.uniform(0, 255, (height, width)).astype(np.float32), (0, 0), 1.2)
    right = cv2.normalize(right, np.empty_like(right), 0, 255, cv2.NORM_MINMAX)
    patches = rng.uniform(0, largest, (6, 8)).astype(np.float32)
    disparity = cv2.resize(patches, (width, height), interpolation=cv2.INTER_NEAREST)
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    left = cv2.remap(right, x - disparity, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    noisy = np.clip(left + rng.normal(0, 3, left.shape), 0, 255)
    return noisy.astype(np.uint8), right.astype(np.uint8)


def opencv_matcher(name: str, config: MatchingConfig) -> cv2.StereoMatcher:
    """OpenCV's object with the parameters of ``config``."""
    if name == "sgbm":
        return cv2.StereoSGBM.create(
            minDisparity=config.min_disparity,
            numDisparities=config.num_disparities,
            blockSize=config.correlation_window_size,
            P1=round(config.P1),
            P2=round(config.P2),
            preFilterCap=config.prefilter_cap,
            uniquenessRatio=round(config.uniqueness_ratio),
            speckleWindowSize=config.speckle_size,
            speckleRange=config.speckle_range,
            mode=config.sgbm_mode,
        )
    bm = cv2.StereoBM.create(config.num_disparities, config.correlation_window_size)
    bm.setPreFilterCap(config.prefilter_cap)
    bm.setTextureThreshold(config.texture_threshold)
    bm.setUniquenessRatio(round(config.uniqueness_ratio))
    bm.setSpeckleWindowSize(config.speckle_size)
    bm.setSpeckleRange(config.speckle_range)
    return bm


def medians_ms(calls: list[Callable[[], object]], runs: int) -> list[float]:
    """Median time of each call, milliseconds; the calls alternate, so that all see the same machine."""
    times = np.empty((runs, len(calls)))
    for call in calls:
        call()
    for run in range(runs):
        for column, call in enumerate(calls):
            begin = time.perf_counter()
            call()
            times[run, column] = time.perf_counter() - begin
    return [float(value) * 1e3 for value in np.median(times, axis=0)]


def main() -> None:
    print(f"OpenCV {cv2.__version__}, {cv2.getNumThreads()} threads")
    print("| matcher | image | disparities | ours ms | OpenCV ms | ratio | valid |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for height, width, count in SIZES:
        left, right = textured_pair(height, width, count * 3 // 4)
        for name, runs in RUNS.items():
            matcher = create_matcher(name, num_disparities=count)
            bare = opencv_matcher(name, matcher.config)
            out, fixed = np.empty(left.shape, np.float32), np.empty(left.shape, np.int16)
            ours, theirs = medians_ms(
                [
                    lambda m=matcher, a=left, b=right, o=out: m.match(a, b, o),  # type: ignore[misc]
                    lambda m=bare, a=left, b=right, o=fixed: m.compute(a, b, o),  # type: ignore[misc]
                ],
                runs,
            )
            valid = matcher.match(left, right).valid_fraction
            size = f"{width}x{height}"
            print(f"| {name} | {size} | {count} | {ours:.1f} | {theirs:.1f} | {ours / theirs:.2f} | {valid:.0%} |")


if __name__ == "__main__":
    main()
