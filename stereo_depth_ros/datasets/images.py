# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Folders of left and right images with the two calibration files of camera_calibration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.datasets.dataset import DatasetFrame
from stereo_depth_ros.datasets.image_files import check_sizes, list_images, read_frame
from stereo_depth_ros.datasets.image_pairs import ImagePairs, find_image_pairs

__all__ = ["ImagesDataset"]


class ImagesDataset:
    """Images in left/ and right/, or left*.png and right*.png, paired by their names.

    Without these, all names that :func:`find_image_pairs` knows. ``skipped`` counts the images without a partner,
    ``warnings`` names them.

    Args:
        folder: holds the images, and ``left.yaml`` and ``right.yaml``.
        left_yaml, right_yaml: other calibration files.

    Raises:
        BagError: no pairs, two images of one side in a pair, or no calibration.
        CalibrationError: a calibration for another image size.
    """

    has_stamps = False

    def __init__(self, folder: Path, *, left_yaml: Path | None = None, right_yaml: Path | None = None) -> None:
        found = _find_pairs(folder)
        files = left_yaml or folder / "left.yaml", right_yaml or folder / "right.yaml"
        if missing := [str(path) for path in files if not path.exists()]:
            raise BagError(
                f"no calibration {', '.join(missing)}",
                value=missing,
                remedy="write it with camera_calibration, or name another file",
                settings=("left_yaml", "right_yaml"),
            )
        self._pairs, self.skipped, self.warnings = found.pairs, len(found.skipped), found.warnings
        self.files = [*files, *(path for pair in found.pairs for path in pair), *found.skipped]
        self.rig = _named(StereoRig.from_yaml(*files))
        for path in self._pairs[0]:
            check_sizes(self.rig, path)

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[DatasetFrame]:
        for left, right in self._pairs:
            frames = read_frame(left, self.rig.left), read_frame(right, self.rig.right)
            for path, frame in zip((left, right), frames, strict=True):
                height, width = frame.pixels.shape[:2]
                self.rig.check_image(width, height, str(path))
            yield DatasetFrame(*frames)


def _named(rig: StereoRig) -> StereoRig:
    """The same rig with a frame_id: calibration files have none."""
    left, right = (replace(camera, frame_id="left_optical_frame") for camera in (rig.left, rig.right))
    return replace(rig, left=left, right=right)


def _find_pairs(folder: Path) -> ImagePairs:
    """The pairs of the first layout that has images of both sides, so that copies in other folders are ignored."""
    for left, right in (("left/*", "right/*"), ("left*", "right*")):
        if all(list_images(folder, pattern) for pattern in (left, right)):
            return find_image_pairs(folder, left, right)
    return find_image_pairs(folder)
