# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all datasets have in common: a rig, and pairs of frames with the true disparities where they are known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, Frame

__all__ = ["DatasetFrame", "StereoDataset"]


@dataclass(frozen=True)
class DatasetFrame:
    """One pair.

    Attributes:
        left, right: the images as the dataset has them: raw or rectified, as the rig of the dataset says.
        truth_disparity_px: float32 (H, W), x_left - x_right of the rectified left image, NaN where unknown; None where
            the dataset has no truth for this pair.
    """

    left: Frame
    right: Frame
    truth_disparity_px: F32 | None = None


class StereoDataset(Protocol):
    """A folder of pairs that one calibration describes.

    Attributes:
        rig: the calibration.
        has_stamps: the stamps of the frames are times; otherwise all are 0, and who needs times counts the frames.
        files: all that is read.
    """

    rig: StereoRig
    has_stamps: bool
    files: list[Path]

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[DatasetFrame]: ...
