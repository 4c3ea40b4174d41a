# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Active stereo: accuracy on rendered scenes with exact truth and on photographs, and time.

python benchmarks/active.py
python benchmarks/active.py --data ~/stereo --json active.json

Times are medians over calls in turns in one run. The photographs have no truth: a wall is compared with the plane that
fits best.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.active.light_stripe.extraction import StripeExtractor
from stereo_depth_ros.active.light_stripe.plane_calibration import calibrate_plane
from stereo_depth_ros.active.one_shot.decoding import decode_edges, one_shot
from stereo_depth_ros.active.one_shot.stripes import read_stripes, stripe_pattern
from stereo_depth_ros.calibration.chessboard import Chessboard
from stereo_depth_ros.camera_files.one_camera import read_camera
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.types import F32, F64, U8, Frame
from stereo_depth_ros.datasets.numbered_images import numbered_images, read_plain_frame
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.synthetic.projection import Optics, SyntheticScanner

DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
CALLS = 7
STRIPE_PX = 8


class Row(NamedTuple):
    """One measured quantity."""

    data: str
    figure: str
    value: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="folder of the datasets")
    parser.add_argument("--json", type=Path, help="write the rows as JSON")
    arguments = parser.parse_args()
    rows = []
    for part in (stripes_rendered, stripes_photographed, light_stripe_rendered, light_stripe_on_boards):
        for row in part(arguments.data):
            print("| " + " | ".join(row) + " |", flush=True)
            rows.append(row._asdict())
    if arguments.json:
        write_file(arguments.json, json.dumps(rows, indent=2) + "\n", overwrite=True)


def median_ms(*calls: Callable[[], object]) -> list[float]:
    """Median time of each call, in turns, after one call each."""
    times: list[list[float]] = [[] for _ in calls]
    for number in range(CALLS + 1):
        for call, taken in zip(calls, times, strict=True):
            start = time.perf_counter()
            call()
            if number:
                taken.append(1e3 * (time.perf_counter() - start))
    return [statistics.median(taken) for taken in times]


def stripes_rendered(_: Path) -> Iterator[Row]:
    """Color stripes on the table-top scene, 640x480, with a projector of 1024x768."""
    pattern = stripe_pattern((1024, 768), STRIPE_PX)
    stripes = read_stripes(pattern)
    for name, optics in (
        ("good light", Optics()),
        ("poor light", Optics(crosstalk=0.2, defocus_px=2.0, noise=3.0, ambient=0.3)),
    ):
        scanner = SyntheticScanner(640, 480, (1024, 768), optics=optics)
        left, truth = scanner.rig.left, scanner.truth()
        maps = cv2.initUndistortRectifyMap(left.K, left.D, left.R, left.P[:, :3], (640, 480), cv2.CV_32FC1)
        image = np.asarray(cv2.remap(scanner.capture(pattern)[0], *maps, cv2.INTER_LINEAR), np.uint8)
        found = one_shot(image, stripes)
        assert found.column_px is not None
        lit = truth.lit & (found.reasons == 0)
        off: F32 = np.abs(found.column_px - truth.column_px)[lit]
        data = f"stripes, rendered, {name}"
        yield Row(data, "lit pixels with a column", f"{lit.sum() / truth.lit.sum():.1%}")
        yield Row(
            data, "within 1 projector px, within half a stripe", f"{np.mean(off < 1):.1%}, {np.mean(off < 4):.2%}"
        )
        yield Row(
            data,
            "median error, median sigma, projector px",
            f"{np.median(off):.3f}, {np.nanmedian(found.sigma_px):.3f}",
        )
        decoding, blur = median_ms(partial(one_shot, image, stripes), partial(cv2.medianBlur, image, 5))
        yield Row(data, "time, ratio to cv2.medianBlur of 5x5", f"{decoding:.0f} ms, {decoding / blur:.0f}")


def stripes_photographed(data: Path) -> Iterator[Row]:
    """Stripes of another program on a wall, 3264x2448, and a hand before it."""
    folder = data / "active" / "d_color_stripe_tingck"
    stripes = read_stripes(read_rgb(folder / "pattern2.bmp"))
    for reduced in (1, 2, 4):
        image = read_rgb(folder / "wall.jpg")
        image = np.asarray(
            cv2.resize(image, None, fx=1 / reduced, fy=1 / reduced, interpolation=cv2.INTER_AREA), np.uint8
        )
        points = decode_edges(image, stripes).points()
        off = np.abs(plane_errors(points))
        name = f"stripes, wall, {image.shape[1]}x{image.shape[0]}"
        yield Row(name, "edges", str(len(points)))
        yield Row(name, "within 1 px, 2 px (a stripe) of the plane", f"{np.mean(off < 1):.2%}, {np.mean(off < 2):.3%}")
        yield Row(name, "rms of those within 1 px, px", f"{np.sqrt(np.mean(off[off < 1] ** 2)):.3f}")
        yield Row(name, "time", f"{median_ms(partial(one_shot, image, stripes))[0]:.0f} ms")
    found = one_shot(read_rgb(folder / "hand.jpg"), stripes)
    assert found.column_px is not None
    rows = [row[np.isfinite(row)] for row in found.column_px]
    falls, steps = (sum(values) for values in zip(*((np.sum(np.diff(r) < 0), r.size) for r in rows), strict=True))
    yield Row("stripes, hand, 3264x2448", "pixels with a column, decreasing along a row", f"{steps}, {falls}")


def light_stripe_rendered(_: Path) -> Iterator[Row]:
    """A curved laser line, 1280x720, of a Gaussian profile with noise."""
    y, x = np.indices((720, 1280)).astype(float)
    place = 400.3 + 0.4 * y[:, 0] + 20 * np.sin(y[:, 0] / 60)
    exact = 30 + 150 * np.exp(-0.5 * np.square((x - place[:, None]) / 1.8))
    noisy = exact + 2.0 * np.random.default_rng(0).normal(size=exact.shape)
    gray = np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)
    color = np.stack((gray // 3, gray, gray // 4), axis=-1)
    for method in ("ridge", "center"):
        extractor = StripeExtractor(LightStripeConfig(stripe_method=method, stripe_channel="green"))
        frames = Frame(gray, 0, "", "mono8"), Frame(color, 0, "", "rgb8")
        found = extractor.extract(frames[0])
        off = float(np.sqrt(np.mean(np.square(found.position_px - place))))
        name = f"laser line, rendered, 1280x720, {method}"
        yield Row(name, "rms error, median sigma, px", f"{off:.4f}, {np.median(found.sigma_px):.4f}")
        in_gray, in_color = median_ms(*(partial(extractor.extract, frame) for frame in frames))
        yield Row(name, "time of a profile, gray and color", f"{in_gray:.2f} ms, {in_color:.2f} ms")


def light_stripe_on_boards(data: Path) -> Iterator[Row]:
    """A laser line on a chessboard in twelve poses."""
    folder = data / "active" / "c_laser_turntable_srv"
    camera = read_camera(folder / "calibration4.yaml", (640, 480))
    images = [(path.name, read_plain_frame(path)) for path in numbered_images([folder / "laser_boards"])]
    for method in ("ridge", "center"):
        config = LightStripeConfig(stripe_method=method)
        result = calibrate_plane(images, Chessboard((8, 6), 0.04), camera, config, 0.16)
        points = sum(map(len, result.residuals_m))
        figures = f"{len(result.stripes)}, {points}, {1e3 * result.median_m:.3f} mm"
        yield Row(f"laser line, boards, {method}", "poses, points, median distance from the plane", figures)


def read_rgb(path: Path) -> U8:
    return np.ascontiguousarray(np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR), np.uint8)[..., ::-1])


def plane_errors(points: F64) -> F64:
    """Deviation from the best u = (a x + b y + c) / (d x + e y + 1), in u.

    Args:
        points: float64 (N, 3), x, y, u.
    """
    x, y, u = ((points - points.mean(axis=0)) / points.std(axis=0)).T
    weight, inlier = np.ones_like(u), np.ones(len(u), bool)
    off = np.zeros_like(u)
    for _ in range(10):
        A = np.stack([x, y, np.ones_like(x), -u * x, -u * y], axis=1) / weight[:, None]
        a, b, c, d, e = np.linalg.lstsq(A[inlier], (u / weight)[inlier], rcond=None)[0]
        weight = d * x + e * y + 1
        off = ((a * x + b * y + c) / weight - u) * points[:, 2].std()
        inlier = np.abs(off) < 1.0
    return np.asarray(off, np.float64)


if __name__ == "__main__":
    main()
