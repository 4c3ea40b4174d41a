# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Folders of color images with depth images of range cameras (RGB-D): numbered, or laid out as the TUM benchmark."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.datasets.image_files import IMAGE_SUFFIXES, image_size, read_image, read_level_image

__all__ = ["RgbdDataset", "RgbdFrame", "is_rgbd", "rgbd_size"]

_COLOR, _DEPTH = ("rgb", "color"), ("depth",)
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_TABLES = ("associations.txt", "associate.txt", "fr_associations.txt")
_APART_NS = 20_000_000  # between a color and a depth image of the TUM benchmark (Sturm and others 2012)
_UNIT_M, _TUM_UNIT_M = 1e-3, 1 / 5000
_MOST_BYTES = 2**26
_DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".pgm")


@dataclass(frozen=True, eq=False)
class RgbdFrame:
    """One view.

    Attributes:
        stamp_ns: of the color image, integer nanoseconds; 0 without times.
        name: of the color image.
        color: uint8 (H, W) gray or (H, W, 3) RGB, without lens distortion.
        depth_m: float32 (H, W), Z of each pixel of the color image, meters; NaN where there is none.
    """

    stamp_ns: int
    name: str
    color: U8
    depth_m: F32


class RgbdDataset:
    """Color images, and depth images of the same pixels.

    Known are rgb_N.png with depth_N.png (or color_N), such files in rgb/ or color/ and depth/, and the layout of the
    TUM benchmark (Sturm and others 2012): rgb.txt and depth.txt, or a table of both, with groundtruth.txt beside it.
    Depths are 16-bit levels, or 32-bit floats in meters; 0 is none.

    Args:
        folder: the folder.
        camera: of the color images, with or without lens distortion.
        depth_unit_m: meters of a level; None takes 1 mm, and 1/5000 m of the TUM benchmark.

    Attributes:
        files: all files that are read.
        poses: file of poses of the dataset itself; None where it has none.
        has_stamps: whether the frames have times.
        skipped: number of images without a partner.
        camera: of the frames, without lens distortion.
        step_m: difference of two levels of depth, meters; 0 of floats.

    Raises:
        BagError: no pairs of images, or a table that is damaged.
        CalibrationError: the camera is that of another image size.
    """

    def __init__(self, folder: Path, camera: CameraModel, depth_unit_m: float | None = None) -> None:
        found = _found(folder)
        if not found.pairs:
            raise _nothing(folder)
        self._pairs, self.skipped, self.has_stamps = found.pairs, found.skipped, found.has_stamps
        self._unit_m = depth_unit_m or (_TUM_UNIT_M if found.has_stamps else _UNIT_M)
        first = read_level_image(found.pairs[0][2], "a depth image")
        self.step_m = 0.0 if first.dtype.kind == "f" else self._unit_m
        truth = folder / "groundtruth.txt"
        self.poses = truth if found.has_stamps and truth.is_file() else None
        self.files = [*found.tables, *(path for _, color, depth in found.pairs for path in (color, depth))]
        size = image_size(read_image(found.pairs[0][1]))
        if size != (camera.width, camera.height):
            raise CalibrationError(
                f"is {size[0]}x{size[1]}, the camera is that of {camera.width}x{camera.height}",
                subject=str(found.pairs[0][1]),
                value=size,
                limit=(camera.width, camera.height),
                remedy="give the intrinsics of these images",
                settings=("camera_info", "intrinsics"),
            )
        self._raw = camera
        self.camera = camera.rectified() if camera.D.any() else camera

    def __len__(self) -> int:
        return len(self._pairs)

    @property
    def stamps_ns(self) -> list[int]:
        """Of the color images."""
        return [stamp_ns for stamp_ns, _, _ in self._pairs]

    def __getitem__(self, number: int) -> RgbdFrame:
        """A frame.

        Raises:
            BagError: a file that cannot be read, or an image of another size or dtype.
        """
        stamp_ns, color_path, depth_path = self._pairs[number]
        color, levels = read_image(color_path), read_level_image(depth_path, "a depth image")
        for path, pixels in ((color_path, color), (depth_path, levels)):
            if pixels.shape[:2] != (self._raw.height, self._raw.width):
                height, width = pixels.shape[:2]
                raise BagError(
                    f"is {width}x{height}, the camera is that of {self._raw.width}x{self._raw.height}",
                    subject=str(path),
                    value=(width, height),
                    limit=(self._raw.width, self._raw.height),
                    remedy="align the depth images with the color images, so that both have equal pixels",
                )
        if levels.dtype == np.uint8:
            raise BagError(
                "has 8 bits, a depth image has 16, or 32-bit floats in meters",
                subject=str(depth_path),
                value="uint8",
                limit=("uint16", "float32"),
                remedy="write the depth without scaling it to 8 bits",
            )
        unit_m = 1.0 if levels.dtype.kind == "f" else self._unit_m
        depth_m = levels.astype(np.float32) * np.float32(unit_m)
        if self._raw.D.any():
            color, depth_m = self._undistorted(color, depth_m)
        depth_m = np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, np.float32(np.nan))
        if color.ndim == 3:
            color = np.ascontiguousarray(color[:, :, ::-1])
        return RgbdFrame(stamp_ns, color_path.name, color, depth_m.astype(np.float32))

    def _undistorted(self, color: U8, depth_m: F32) -> tuple[U8, F32]:
        """Both without lens distortion; depths are those of the nearest pixels: a mean of two may be that of none."""
        model, size = self._raw, (self._raw.width, self._raw.height)
        K = self.camera.K
        if model.distortion_model == "equidistant":
            maps = cv2.fisheye.initUndistortRectifyMap(model.K, model.D, np.identity(3), K, size, cv2.CV_32FC1)
        else:
            maps = cv2.initUndistortRectifyMap(model.K, model.D, np.identity(3), K, size, cv2.CV_32FC1)
        return (
            np.asarray(cv2.remap(color, *maps, cv2.INTER_LINEAR), np.uint8),
            np.asarray(cv2.remap(depth_m, *maps, cv2.INTER_NEAREST), np.float32),
        )


def rgbd_size(folder: Path) -> tuple[int, int]:
    """Width and height of the first color image, px.

    Raises:
        BagError: no color images with depth images, or one that cannot be read.
    """
    found = _found(folder)
    if not found.pairs:
        raise _nothing(folder)
    return image_size(read_image(found.pairs[0][1]))


def is_rgbd(folder: Path) -> bool:
    """Whether a folder holds color images with depth images."""
    try:
        return folder.is_dir() and bool(_found(folder).pairs)
    except BagError:
        return True  # a table that is damaged; reading it tells why


def _nothing(folder: Path) -> BagError:
    return BagError(
        "holds no color images with depth images",
        subject=str(folder),
        remedy="name them rgb_0.png and depth_0.png, or put them into rgb/ and depth/ under equal numbers",
    )


@dataclass(frozen=True)
class _Found:
    """Stamp, color image and depth image of each frame, and what was read to find them."""

    pairs: list[tuple[int, Path, Path]]
    skipped: int
    has_stamps: bool
    tables: tuple[Path, ...] = ()


def _found(folder: Path) -> _Found:
    for name in _TABLES:
        if (folder / name).is_file():
            return _of_table(folder, folder / name)
    lists = (folder / "rgb.txt", folder / "depth.txt")
    if all(path.is_file() for path in lists):
        return _of_lists(folder, *lists)
    color, depth = _numbered(folder, _COLOR), _numbered(folder, _DEPTH)
    numbers = sorted(color.keys() & depth.keys(), key=float)
    skipped = len(color.keys() ^ depth.keys())
    return _Found([(0, color[number], depth[number]) for number in numbers], skipped, False)


def _numbered(folder: Path, words: tuple[str, ...]) -> dict[str, Path]:
    """Images of folders of these names, or whose names begin with them, by their last number."""
    suffixes = _DEPTH_SUFFIXES if words == _DEPTH else IMAGE_SUFFIXES
    found: dict[str, Path] = {}
    for word in words:
        places = [path for path in (folder / word).glob("*") if not path.name.startswith(".")]
        places += [path for path in folder.glob(f"{word}[_0-9-]*") if path.is_file()]
        for path in sorted(places):
            numbers = _NUMBER.findall(path.stem)
            if path.suffix.lower() in suffixes and numbers:
                whole, _, part = numbers[-1].partition(".")
                found.setdefault(f"{int(whole)}.{part}" if part else str(int(whole)), path)
        if found:
            break
    return found


def _of_table(folder: Path, table: Path) -> _Found:
    rows = _rows(table, 4)
    pairs = []
    for row in rows:
        first, second = (folder / name for name in (row[1], row[3]))
        color, depth = (second, first) if "depth" in row[1].lower() else (first, second)
        pairs.append((_stamp_ns(row[0], table), color, depth))
    return _Found(sorted(pairs), 0, True, (table,))


def _of_lists(folder: Path, color: Path, depth: Path) -> _Found:
    """Each color image with the depth image next to it in time."""
    lists = [sorted((_stamp_ns(row[0], table), folder / row[1]) for row in _rows(table, 2)) for table in (color, depth)]
    stamps = np.array([stamp for stamp, _ in lists[1]], np.int64)
    pairs, used = [], set()
    for stamp, path in lists[0]:
        place = int(np.argmin(np.abs(stamps - stamp))) if len(stamps) else -1
        if place >= 0 and place not in used and abs(int(stamps[place]) - stamp) <= _APART_NS:
            used.add(place)
            pairs.append((stamp, path, lists[1][place][1]))
    return _Found(pairs, len(lists[0]) + len(lists[1]) - 2 * len(pairs), True, (color, depth))


def _rows(table: Path, least: int) -> list[list[str]]:
    text = read_text(table, BagError, "give the table of the benchmark", _MOST_BYTES)
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < least:
            raise BagError(
                f"line {number} has {len(words)} words, {least} are needed",
                subject=str(table),
                value=len(words),
                limit=least,
                remedy="write a time and a file name for each image",
            )
        rows.append(words)
    return rows


def _stamp_ns(word: str, table: Path) -> int:
    whole, _, part = word.partition(".")
    if not (whole.isdecimal() and len(whole) < 12 and (not part or part.isdecimal())):
        raise BagError(
            f"{word[:40]} is not a time in seconds",
            subject=str(table),
            value=word,
            remedy="write a time and a file name for each image",
        )
    return int(whole) * 10**9 + int(f"{part[:9]:0<9}")
