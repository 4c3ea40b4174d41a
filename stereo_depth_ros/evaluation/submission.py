# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Disparities in the files that the benchmarks of KITTI, Middlebury and ETH3D take, of pairs with and without truth."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.datasets.image_files import list_images, read_image
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.matching import create_matcher

__all__ = ["SubmittedPair", "find_submitted", "submit"]

KITTI_LEVELS = 256  # per px
_LAYOUTS = {"image_2": ("image_3", "disp_0"), "image_0": ("image_1", "."), "colored_0": ("colored_1", ".")}


class SubmittedPair(NamedTuple):
    """A pair of a benchmark.

    Attributes:
        name: of the pair.
        left, right: the images.
        disparities, runtime: files that are written, relative to the folder of a submission; ``{}`` stands for the name
            of the method. KITTI takes no file with the time.
        ndisp: disparities that the calibration of the pair announces; None where it does not.
        calibration: the file that was read; None without one.
    """

    name: str
    left: Path
    right: Path
    disparities: str
    runtime: str | None
    ndisp: int | None
    calibration: Path | None

    def files(self, folder: Path, method: str) -> list[Path]:
        """The files that :func:`submit` writes."""
        return [folder / name.format(method) for name in (self.disparities, self.runtime) if name is not None]


def find_submitted(folder: Path) -> list[SubmittedPair]:
    """The pairs in a folder of KITTI stereo, Middlebury or ETH3D, or in its folders one and two levels down.

    Of KITTI these are the pairs of the frames ``_10``, which are evaluated.

    Raises:
        BagError: there are none.
    """
    found = list(_of_folder(folder))
    for pattern in () if found else ("*", "*/*"):
        found += [pair for path in sorted(folder.glob(pattern)) if path.is_dir() for pair in _of_folder(path)]
    if not found:
        raise BagError(
            "holds no pair of KITTI stereo, Middlebury or ETH3D, neither do its folders one and two levels down",
            subject=str(folder),
            value=0,
            remedy="name a folder with image_2 and image_3, or with im0, im1 and calib.txt",
        )
    return found


def _of_folder(folder: Path) -> Iterator[SubmittedPair]:
    for left, (right, written) in _LAYOUTS.items():
        if (folder / left).is_dir() and (folder / right).is_dir():
            for image in list_images(folder / left, "*_10.*"):
                disparities = (Path(written) / f"{image.stem}.png").as_posix()
                yield SubmittedPair(image.stem, image, folder / right / image.name, disparities, None, None, None)
            return
    images = [next(iter(list_images(folder, f"{name}.*")), None) for name in ("im0", "im1")]
    calibration = folder / "calib.txt"
    if images[0] is None or images[1] is None or not calibration.is_file():
        return
    text, scene = read_text(calibration, BagError, "copy it again"), folder.resolve()
    count = _count(text)
    if re.search(r"(?m)^isint\s*=", text):  # of Middlebury only
        parent = f"{scene.parent.name}/{scene.name}"
        disparities, runtime = f"{parent}/disp0{{}}.pfm", f"{parent}/time{{}}.txt"
    else:
        disparities, runtime = f"low_res_two_view/{scene.name}.pfm", f"low_res_two_view/{scene.name}.txt"
    yield SubmittedPair(scene.name, images[0], images[1], disparities, runtime, count, calibration)


def _count(text: str) -> int | None:
    """Disparities by the calibration; that of ETH3D announces the width of the image, which says nothing."""
    found = {key: int(value) for key, value in re.findall(r"(?m)^(ndisp|width)\s*=\s*(\d+)\s*$", text)}
    count = found.get("ndisp")
    return None if count is None or count >= found.get("width", 0) > 0 else count


def submit(
    pair: SubmittedPair, folder: Path, method: str, config: MatchingConfig, given: bool, *, overwrite: bool = False
) -> float:
    """Match a pair and write its disparities, and the time where the benchmark asks for it; returns the seconds.

    Pixels without a disparity are 0 in PNG files of KITTI, which interpolates them, and infinite in PFM files.

    Args:
        folder: of the submission.
        method: name of the matcher.
        config: its parameters; the range is that of the calibration of the pair unless ``given``, never of a truth.

    Raises:
        BagError: an image that cannot be read.
        ImageError, ConfigError: the pair cannot be matched.
        OutputError: a file cannot be written.
    """
    left, right = _gray(pair.left), _gray(pair.right)
    if pair.ndisp is not None and not given:
        config = replace(config, num_disparities=max(32, -(-pair.ndisp // 16) * 16))
    matcher = create_matcher(method, config)
    matcher.match(left, right)  # compiles and allocates
    start = time.perf_counter()
    found = matcher.match(left, right)
    seconds = time.perf_counter() - start
    files = pair.files(folder, method)
    write_file(files[0], _encoded(found.disparity_px, files[0].suffix), overwrite=overwrite, make_folders=True)
    if len(files) > 1:
        text = f"{seconds:.4f}\n" if "time" in files[1].name else f"runtime {seconds:.4f}\n"
        write_file(files[1], text, overwrite=overwrite, make_folders=True)
    return seconds


def _encoded(disparity_px: F32, suffix: str) -> bytes:
    """A PNG of 16 bits, or a PFM, whose rows are from the bottom to the top."""
    if suffix == ".png":
        with np.errstate(invalid="ignore"):
            levels = np.clip(np.rint(KITTI_LEVELS * disparity_px), 1, 65535)
        ok, data = cv2.imencode(".png", np.where(np.isnan(disparity_px), 0, levels).astype(np.uint16))
        assert ok  # any uint16 image can be encoded
        return bytes(data)
    height, width = disparity_px.shape
    values = np.where(np.isnan(disparity_px), np.float32(np.inf), disparity_px)[::-1].astype("<f4")
    return f"Pf\n{width} {height}\n-1\n".encode() + values.tobytes()


def _gray(path: Path) -> U8:
    pixels = read_image(path)
    return pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)
