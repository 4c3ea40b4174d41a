# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps of KITTI frames, from their numbers and the file of times if there is one."""

from __future__ import annotations

import re
from datetime import datetime, timezone
from pathlib import Path

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.text_files import read_text

__all__ = ["frame_numbers", "read_stamps"]

_NAME = re.compile(r"(\d+)(?:_(\d+))?")  # 000103 of a sequence; 000103_10, frame 10 of scene 103 of a benchmark
_MOST_BYTES = 2**26  # of a file of times
_PERIOD_NS = 10**8  # the cameras run at 10 Hz
_END_NS = 2**31 * 10**9  # of the stamps of ROS
_FIRST_STAMP_NS = 10**9  # of a sequence that counts from 0: a ROS time of 0 means that no time is set


def frame_numbers(images: list[Path]) -> dict[str, int]:
    """The number of each image by its file name, in the order of the numbers.

    The scenes of the stereo benchmarks are numbered one after the other. Each counts as many frames as there are
    between the lowest and the highest frame number of all scenes: one where all names end in _10.

    Raises:
        BagError: a name without a number, or two names with the same one.
    """
    parts = {path: _scene_and_frame(path) for path in images}
    first = min((frame for _, frame in parts.values()), default=0)
    frames = max((frame for _, frame in parts.values()), default=0) - first + 1
    numbered: dict[int, Path] = {}
    for path, (scene, frame) in parts.items():
        other = numbered.setdefault(scene * frames + frame - first, path)
        if other is not path:
            raise BagError(f"{other} and {path} have the same frame number", remedy="remove one of them")
    return {path.name: number for number, path in sorted(numbered.items())}


def _scene_and_frame(path: Path) -> tuple[int, int]:
    match = _NAME.fullmatch(path.stem)
    if match is None:
        raise BagError(
            "has no frame number, images of KITTI are named 000000.png or 000000_10.png",
            subject=str(path),
            value=path.stem,
            limit=_NAME.pattern,
            remedy="rename it",
        )
    return int(match[1]), int(match[2] or 0)


def read_stamps(folder: Path, camera: Path, numbers: dict[str, int], names: list[str]) -> dict[str, int]:
    """Stamp of each pair in nanoseconds, by file name: of times.txt (odometry), timestamps.txt (raw), or else 10 Hz.

    The rows of the file of times are indexed by frame number. If it has too few rows for that, but as many as there are
    images, it belongs to an excerpt: its rows are those of the images in their order.

    Args:
        folder: the sequence.
        camera: folder of the left camera within it.
        numbers: frame numbers of all left images, of :func:`frame_numbers`.
        names: names of the images that have a partner, at least one.

    Raises:
        BagError: a file that is not a list of time stamps, or has too few.
    """
    path, times = _read_times(folder, camera)
    if path is None:
        return _checked({name: _FIRST_STAMP_NS + numbers[name] * _PERIOD_NS for name in names}, folder)
    last = max(numbers[name] for name in names)
    if last >= len(times) == len(numbers):
        numbers = {name: row for row, name in enumerate(numbers)}
    elif last >= len(times):
        raise BagError(
            f"has {len(times)} times for {len(names)} pairs, the last of which is frame {last}",
            subject=str(path),
            value=len(times),
            limit=last + 1,
            remedy="copy it again, or remove it for stamps at 10 Hz",
        )
    return _checked({name: times[numbers[name]] for name in names}, path)


def _checked(stamps_ns: dict[str, int], path: Path) -> dict[str, int]:
    for name, stamp_ns in stamps_ns.items():
        if not 0 <= stamp_ns < _END_NS:
            raise BagError(
                f"the time of {name} is not one, it is outside 0..{_END_NS // 10**9} s",
                subject=str(path),
                value=stamp_ns,
                limit=_END_NS,
                remedy="correct it, or copy it again",
            )
    return stamps_ns


def _read_times(folder: Path, camera: Path) -> tuple[Path | None, list[int]]:
    """The file of times and its rows in nanoseconds."""
    try:
        if (path := folder / "times.txt").exists():
            return path, [_FIRST_STAMP_NS + round(float(time) * 1e9) for time in _text(path).split()]
        if (path := folder / camera / "timestamps.txt").exists():
            return path, [_parse_date(row) for row in _text(path).splitlines() if row.strip()]
    except (ValueError, OverflowError) as error:
        raise BagError("is not a list of time stamps", subject=str(path), remedy="copy it again") from error
    return None, []


def _text(path: Path) -> str:
    return read_text(path, BagError, "copy it again", _MOST_BYTES)


def _parse_date(row: str) -> int:
    """Nanoseconds of a row like 2011-09-26 13:02:25.964389445."""
    whole, _, fraction = row.strip().partition(".")
    seconds = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=timezone.utc)
    return int(seconds.timestamp()) * 10**9 + int(fraction.ljust(9, "0")[:9] or 0)
