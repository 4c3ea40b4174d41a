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
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.active.focus.distances import even_distances
from stereo_depth_ros.active.focus.stack import depth_from_focus
from stereo_depth_ros.active.light_stripe.extraction import StripeExtractor
from stereo_depth_ros.active.light_stripe.plane_calibration import calibrate_plane
from stereo_depth_ros.active.one_shot.decoding import decode_edges, one_shot
from stereo_depth_ros.active.one_shot.stripes import read_stripes, stripe_pattern
from stereo_depth_ros.active.structured_light.correspondence import correspondences, disparity_from_maps
from stereo_depth_ros.active.structured_light.decoding import decode
from stereo_depth_ros.active.structured_light.noise import Noise
from stereo_depth_ros.active.structured_light.patterns import KINDS, Pattern, PatternSequence
from stereo_depth_ros.active.structured_light.phase import harmonics, wave_of_images
from stereo_depth_ros.calibration.chessboard import Chessboard
from stereo_depth_ros.camera_files.one_camera import read_camera
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.types import F32, F64, U8, Frame, Reason
from stereo_depth_ros.datasets.numbered_images import numbered_images, read_plain_frame
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.geometry.epipolar import homogeneous
from stereo_depth_ros.geometry.fundamental import estimate_fundamental
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.focal_stack import focal_stack
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
    parts = (
        *(patterns_rendered, patterns_captured, stripes_rendered, stripes_photographed),
        *(light_stripe_rendered, light_stripe_on_boards),
        *(focus_rendered, focus_photographed),
    )
    for part in parts:
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


def patterns_rendered(_: Path) -> Iterator[Row]:
    """Sequences of patterns on the table-top scene, 640x480, with a projector of 1024x768; times at 1280x720."""
    for kind in KINDS:
        sequence = PatternSequence.of_kind(kind, (1024, 768))
        for seed in (7, 8):
            scanner = SyntheticScanner(640, 480, (1024, 768), seed=seed)
            rectifier, truth = Rectifier(scanner.rig), scanner.truth()
            captures = [scanner.capture(pattern) for pattern in sequence.render()]
            left_images = [rectifier.rectify_left(image) for image, _ in captures]
            right_images = [rectifier.rectify_right(image) for _, image in captures]
            left, right = decode(sequence, left_images), decode(sequence, right_images)
            assert left.column_px is not None
            valid = left.reasons == 0
            shadow = cv2.erode((~truth.lit).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
            off: F32 = np.abs(left.column_px - truth.column_px)[valid & truth.lit]
            data = f"{kind}, {len(sequence)} images, rendered, seed {seed}"
            share = np.count_nonzero(valid & truth.lit) / np.count_nonzero(truth.lit)
            yield Row(data, "lit pixels with a column", f"{share:.1%}")
            yield Row(data, "within 1 projector px, median", f"{np.mean(off < 1):.2%}, {np.median(off):.3f} px")
            yield Row(data, "pixels decoded in shadow, 2 px from light", str(np.count_nonzero(valid & shadow)))
            found = disparity_from_maps(left, right).disparity_px
            error = np.abs(found - truth.disparity_px)[np.isfinite(found)]
            yield Row(
                data, "disparities: within 1 px, median error", f"{np.mean(error < 1):.2%}, {np.median(error):.3f} px"
            )
        large = [cv2.resize(image, (1280, 720)) for image in left_images]
        times = median_ms(partial(decode, sequence, large), partial(blurred, large))
        yield Row(
            f"{kind}, {len(sequence)} images, 1280x720",
            "time, ratio to cv2.GaussianBlur of 5x5 of all images",
            f"{times[0]:.0f} ms, {times[0] / times[1]:.1f}",
        )


def patterns_captured(data: Path) -> Iterator[Row]:
    """Captures of other programs: a flat screen and a scene by Gray code, phases against the code of the same views."""
    screen = data / "structured_light" / "zeng_graycode_plane"
    if not screen.is_dir():
        return
    patterns = [Pattern("ambient"), Pattern("white"), Pattern("black")]
    patterns += [each for axis, offset in (("columns", 128), ("rows", 968)) for each in gray_code(axis, 12, offset)]
    sequence = PatternSequence((3840, 2160), tuple(patterns))
    left, right = (
        decode(sequence, [read_gray(screen / f"{number:02d}-{side}.png") for number in range(len(sequence))])
        for side in ("left", "right")
    )
    left_px, right_px = correspondences(left, right)
    H = cv2.findHomography(left_px, right_px, cv2.USAC_MAGSAC, 1.0)[0]
    mapped = homogeneous(left_px) @ H.T
    off = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - right_px, axis=1)
    yield Row(
        "Gray code, flat screen, 1280x720", "cells, median from one homography", f"{len(off)}, {np.median(off):.3f} px"
    )

    scene = data / "active" / "e_graycode_two_views_joep"
    patterns = [Pattern("white"), Pattern("black"), *gray_code("columns", 10), *gray_code("rows", 10)]
    sequence = PatternSequence((960, 540), tuple(patterns))
    views = [
        decode(sequence, [read_gray(scene / f"view{view}" / f"{n:02d}.jpg") for n in range(len(sequence))])
        for view in (0, 1)
    ]
    left_px, right_px = correspondences(views[0], views[1])
    lines = homogeneous(left_px) @ estimate_fundamental(left_px, right_px).F.T
    off = np.abs((homogeneous(right_px) * lines).sum(axis=1)) / np.hypot(lines[:, 0], lines[:, 1])
    yield Row(
        "Gray code, two views, 1200x800",
        "cells, within 1 px of one epipolar geometry, median",
        f"{len(off)}, {np.mean(off < 1):.1%}, {np.median(off):.3f} px",
    )

    axes = [(axis, period) for axis, length in (("columns", 960), ("rows", 540)) for period in (length / 16, length)]
    steps = [sinusoid(axis, period, shift) for axis, period in axes for shift in (0, 120, 240)]
    sequence = PatternSequence((960, 540), (Pattern("white"), Pattern("black"), *steps))
    for view, coded in enumerate(views):
        folder = data / "active" / "b_phase_two_views_joep" / f"view{view}"
        found = decode(sequence, [read_gray(folder / f"{n:02d}.jpg") for n in range(len(sequence))])
        medians = [
            float(np.nanmedian(np.abs(phase - code)))
            for phase, code in ((found.column_px, coded.column_px), (found.row_px, coded.row_px))
            if phase is not None and code is not None
        ]
        yield Row(
            f"phases, view {view}, 1200x800",
            "median from the Gray code, columns and rows",
            ", ".join(f"{median:.2f} px" for median in medians),
        )

    folder = data / "active" / "b_fringe_3freq_cfpe_david"
    images = [read_gray(folder / f"06{number:02d}h.bmp") for number in range(0, 36, 4)]
    shifts = (0, -120, -240)
    sequence = PatternSequence(
        (1920, 1080), tuple(sinusoid("columns", period, shift) for period in (42, 45, 48) for shift in shifts)
    )
    wave = wave_of_images(np.stack(images[:3]), range(3), 42, shifts, Noise(0.5), np.zeros(images[0].shape, np.uint8))
    compensated = 2 * np.pi * np.hypot(*harmonics(wave).T) / np.sqrt(2)
    times = median_ms(partial(decode, sequence, images))
    found = decode(sequence, images)
    yield Row("phases of 42, 45, 48 px, 640x480", "pixels with a column", f"{np.mean(found.reasons == 0):.1%}")
    yield Row(
        "phases of 42, 45, 48 px, 640x480",
        "error of the gamma that is compensated, rms; time",
        f"{np.hypot(*compensated[:2]):.3f} rad, {times[0]:.0f} ms",
    )


def gray_code(axis: str, bits: int, offset_px: int = 0) -> list[Pattern]:
    """Each bit and its inverse, the coarsest first."""
    return [
        Pattern("gray", axis, bit, inverse, offset_px=offset_px)
        for bit in range(bits - 1, -1, -1)
        for inverse in (False, True)
    ]


def sinusoid(axis: str, period_px: float, shift_deg: float) -> Pattern:
    return Pattern("phase", axis, period_px=period_px, shift_deg=shift_deg)


def blurred(images: Sequence[U8]) -> list[U8]:
    return [np.asarray(cv2.GaussianBlur(image, (5, 5), 0), np.uint8) for image in images]


def read_gray(path: Path) -> U8:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)


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


def focus_rendered(_: Path) -> Iterator[Row]:
    """A slanted plane and a box, 640x480, 16 images; the scene is 0.6 m deep."""
    near_m, far_m = 0.45, 1.05
    distances_m = even_distances(0.4, 1.2, 16, "inverse", "far-to-near")
    for noise in (1.0, 3.0):
        made = focal_stack(640, 480, distances_m, near_m=near_m, far_m=far_m, breathing=0.06, noise=noise)
        found = depth_from_focus(made.frames, distances_m)
        assert found.depth_m is not None and found.sigma_m is not None
        inside = found.reasons != Reason.BORDER
        valid = (found.reasons == 0) & made.textured
        off: F32 = np.abs(found.depth_m - made.depth_m)[valid]
        name = f"focal stack, rendered, noise {noise:g}"
        yield Row(name, "textured pixels with a depth", f"{valid.sum() / (made.textured & inside).sum():.1%}")
        yield Row(name, "others with a depth", f"{(found.reasons == 0)[~made.textured].mean():.2%}")
        errors = f"{np.median(off) / (far_m - near_m):.2%}, {np.percentile(off, 90) / (far_m - near_m):.2%}"
        yield Row(name, "error, of the range: median, 90 %", errors)
        yield Row(name, "median error / sigma", f"{np.median(off / found.sigma_m[valid]):.2f}")
        scales = [abs(p.scale - scale) for p, scale in zip(found.placements, made.scales, strict=True)]
        yield Row(name, "largest error of the scale, of 0.06", f"{max(scales):.4f}")


def focus_photographed(data: Path) -> Iterator[Row]:
    """A keyboard by a phone, 1280x720, 16 images without focus distances: 1 / Z of a plane is linear in the pixel."""
    frames = [read_plain_frame(path) for path in numbered_images([data / "active" / "f_focal_keyboard"])]
    for window in (9, 21):
        found = depth_from_focus(frames, window=window)
        y, x = np.nonzero(np.isfinite(found.index))
        index, kept = found.index[y, x], np.ones(len(x), bool)
        A, off = np.column_stack([x, y, np.ones_like(x)]).astype(np.float64), index
        for _ in range(10):
            off = index - A @ np.linalg.lstsq(A[kept], index[kept], rcond=None)[0]
            kept = np.abs(off) < 3 * 1.4826 * np.median(np.abs(off))
        name = f"focal stack, keyboard, window {window}"
        yield Row(name, "pixels with a depth", f"{found.valid_fraction:.1%}")
        yield Row(
            name, "off the plane, images: median; inliers, rms", f"{np.median(np.abs(off)):.2f}; {off[kept].std():.2f}"
        )
        start = time.perf_counter()
        depth_from_focus(frames, window=window)
        yield Row(name, "time", f"{time.perf_counter() - start:.1f} s")


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
