# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Interface of all datasets: a rig, and pairs of frames with true disparities where they are known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, Frame

__all__ = ["DatasetFrame", "StereoDataset", "Sweep"]


@dataclass(frozen=True, eq=False)
class Sweep:
    """One sweep of a laser scanner.

    Attributes:
        points: float32 (N, 4): x, y, z in meters, and intensity.
        stamp_ns: integer nanoseconds.
        frame_id: frame of the scanner.
    """

    points: F32
    stamp_ns: int
    frame_id: str


@dataclass(frozen=True)
class DatasetFrame:
    """One stereo pair of a dataset.

    Attributes:
        left, right: the images as the dataset stores them; the rig of the dataset states whether they are rectified.
        truth_disparity_px: float32 (H, W), x_left - x_right in pixels of the rectified left image, NaN where unknown;
            None where the dataset has no truth for this pair.
        sweep: of a laser scanner, at about this time; None without one.
    """

    left: Frame
    right: Frame
    truth_disparity_px: F32 | None = None
    sweep: Sweep | None = None


class StereoDataset(Protocol):
    """Pairs of one rig.

    Attributes:
        rig: calibration of all pairs.
        has_stamps: whether the frames have times; otherwise all stamps are 0.
        files: all files that are read.
    """

    rig: StereoRig
    has_stamps: bool
    files: list[Path]

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[DatasetFrame]: ...
