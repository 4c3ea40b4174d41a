# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plain folders of left and right images with the two calibration files of ROS."""

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
    """Images in DIR/left and DIR/right, or DIR/left*.png with DIR/right*.png, paired by their names.

    Where DIR has neither, other names that :func:`find_image_pairs` takes, in it or below; ``left_out`` counts the
    images without a partner, ``warnings`` names them.

    Args:
        folder: what holds the images, and ``left.yaml`` and ``right.yaml``.
        left_yaml, right_yaml: calibration files in another place.

    Raises:
        BagError: no pairs, two images that could be the same one of a pair, or no calibration.
        CalibrationError: a calibration that does not fit the images.
    """

    has_stamps = False

    def __init__(self, folder: Path, *, left_yaml: Path | None = None, right_yaml: Path | None = None) -> None:
        found = _find_pairs(folder)
        files = left_yaml or folder / "left.yaml", right_yaml or folder / "right.yaml"
        if missing := [str(path) for path in files if not path.exists()]:
            raise BagError(f"no calibration {', '.join(missing)}: write it with camera_calibration, or name another")
        self._pairs, self.left_out, self.warnings = found.pairs, len(found.left_out), found.warnings
        self.files = [*files, *(path for pair in found.pairs for path in pair), *found.left_out]
        self.rig = _named(StereoRig.from_yaml(*files))
        for path in self._pairs[0]:
            check_sizes(self.rig, path)

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[DatasetFrame]:
        for left, right in self._pairs:
            yield DatasetFrame(read_frame(left, self.rig.left), read_frame(right, self.rig.right))


def _named(rig: StereoRig) -> StereoRig:
    """The same rig in an optical frame: the files name none."""
    left, right = (replace(camera, frame_id="left_optical_frame") for camera in (rig.left, rig.right))
    return replace(rig, left=left, right=right)


def _find_pairs(folder: Path) -> ImagePairs:
    """Those of the first place that has images of both sides, so that copies in other folders are no frames."""
    for left, right in (("left/*", "right/*"), ("left*", "right*")):
        if all(list_images(folder, pattern) for pattern in (left, right)):
            return find_image_pairs(folder, left, right)
    return find_image_pairs(folder)
