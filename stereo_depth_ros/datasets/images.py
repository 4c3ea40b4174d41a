# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Folders of left and right images with calibration files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from stereo_depth_ros.camera_files.reading import read_rig_files, rig_file_paths
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.datasets.dataset import DatasetFrame
from stereo_depth_ros.datasets.image_files import extended, framed, image_frame, image_size, list_images, read_pair
from stereo_depth_ros.datasets.image_pairs import ImagePairs, find_image_pairs

__all__ = ["ImagesDataset"]


class ImagesDataset:
    """Images in left/ and right/, or left*.png and right*.png, paired by their names.

    Images of two sizes, such as rectified images cropped to an object, each with its calibration, are extended to one
    size with black, at the right and at the bottom.

    Without these names, all that :func:`find_image_pairs` knows. ``skipped`` counts the images without a partner,
    ``warnings`` names them.

    Args:
        folder: holds the images, and ``left.yaml`` and ``right.yaml``.
        camera_files: other calibration files, of any known format.
        side_by_side: each file holds both images.

    Raises:
        BagError: no pairs, two images of one side in a pair, or no calibration.
        CalibrationError: a calibration for another image size.
    """

    has_stamps = False

    def __init__(self, folder: Path, camera_files: Sequence[Path] = (), *, side_by_side: bool = False) -> None:
        found = find_image_pairs(folder, side_by_side=True) if side_by_side else _find_pairs(folder)
        files = camera_files or (folder / "left.yaml", folder / "right.yaml")
        if not camera_files and (missing := [str(path) for path in files if not path.exists()]):
            raise BagError(
                f"no calibration {', '.join(missing)}",
                value=missing,
                remedy="write it with camera_calibration, or name other files",
                settings=("camera_info",),
            )
        self._pairs, self.skipped, self.warnings = found.pairs, len(found.skipped), found.warnings
        self.files = [*rig_file_paths(files), *(path for pair in found.pairs for path in pair), *found.skipped]
        left, right = (image_size(pixels) for pixels in read_pair(*self._pairs[0]))
        self._sizes = None if left == right else (left, right)
        self.rig = framed(read_rig_files(files, left, self._sizes))
        self._frame(*self._pairs[0])

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[DatasetFrame]:
        return (self._frame(*pair) for pair in self._pairs)

    def _frame(self, left: Path, right: Path) -> DatasetFrame:
        images = list(read_pair(left, right))
        for side, size in enumerate(self._sizes or ()):
            if image_size(images[side]) == size:
                images[side] = extended(images[side], self.rig.left)
        for path, pixels in zip((left, right), images, strict=True):
            self.rig.check_image(*image_size(pixels), str(path))
        return DatasetFrame(image_frame(images[0], self.rig.left), image_frame(images[1], self.rig.right))


def _find_pairs(folder: Path) -> ImagePairs:
    """The pairs of the first layout that has images of both sides, so that copies in other folders are ignored."""
    for left, right in (("left/*", "right/*"), ("left*", "right*")):
        if all(list_images(folder, pattern) for pattern in (left, right)):
            return find_image_pairs(folder, left, right)
    return find_image_pairs(folder)
