# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses of a board under patterns: folders of images, decoded, with the board found in camera and projector."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stereo_depth_ros.active.projector.board_points import board_in_projector
from stereo_depth_ros.active.projector.raster import Size
from stereo_depth_ros.active.structured_light.decoding import decode
from stereo_depth_ros.active.structured_light.manifest import MANIFEST, read_manifest
from stereo_depth_ros.active.structured_light.order import sequence_fault
from stereo_depth_ros.active.structured_light.patterns import AXES, Pattern, PatternSequence
from stereo_depth_ros.calibration.board_views import BoardView
from stereo_depth_ros.calibration.boards import Board
from stereo_depth_ros.calibration.view_finder import detected_size
from stereo_depth_ros.core.errors import BagError, CalibrationError, ConfigError, ImageError, StereoDepthError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.types import U8, Frame
from stereo_depth_ros.datasets.image_files import list_images, read_image
from stereo_depth_ros.datasets.numbered_images import numbered_images

__all__ = ["FoundPoses", "PoseFolder", "find_poses", "pose_folders"]

_EXAMINED = 4  # images without the board that are examined again for boards of other sizes


@dataclass(frozen=True)
class PoseFolder:
    """The images of one pose.

    Attributes:
        name: of the folder.
        images: files, in the order of the sequence: that of the numbers in their names.
        sequence: what they show.
    """

    name: str
    images: tuple[Path, ...]
    sequence: PatternSequence


@dataclass
class FoundPoses:
    """The poses of a board.

    Attributes:
        views: left are the corners in the raw image of the camera, right those in the projector.
        projector_size: width, height of the projector, px.
        poses: number of poses examined.
        not_found: names of the poses in which the camera does not see the board.
        skipped: a sentence for each pose that cannot be used for another reason.
        corners, corners_left_out: number of corners that the camera sees, and of those that are not surrounded by
            enough decoded pixels.
    """

    projector_size: Size
    views: list[BoardView] = field(default_factory=list)
    poses: int = 0
    not_found: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    corners: int = 0
    corners_left_out: int = 0


def pose_folders(place: Path, patterns: Path | None = None, projector_size: Size | None = None) -> list[PoseFolder]:
    """The folders with images below a folder, one for each pose, and the sequence that they show.

    The sequence is that of ``patterns``, or of a patterns.json in the folder of the pose, or else beside the folders.
    Without any of them it is the Gray code of OpenCV's ``GrayCodePattern``, for a projector of ``projector_size``:
    columns, then rows, the coarsest bit first, each followed by its inverse, with white and black before or after them.

    Raises:
        BagError: there are no such folders, or a manifest cannot be read.
        ConfigError: a manifest that is not a sequence, none at all, or projectors of different sizes.
    """
    if not place.is_dir():
        problem = "is a file, not a folder" if place.exists() else "does not exist"
        raise BagError(
            problem, subject=str(place), remedy="name the folder that holds a folder of images for each pose"
        )
    folders = sorted(path for path in place.iterdir() if path.is_dir() and list_images(path))
    if not folders:
        alone = bool(list_images(place))
        raise BagError(
            "holds images, that is one pose, and no folders with images of further poses"
            if alone
            else "holds no folders with images",
            subject=str(place),
            value=int(alone),
            remedy="put the images of each pose of the board into a folder of its own, and name the folder of them all",
        )
    found = [_pose_folder(folder, place, patterns, projector_size) for folder in folders]
    for pose in found:
        if pose.sequence.size != found[0].sequence.size:
            raise ConfigError(
                f"the projector is {_text(pose.sequence.size)}, in {found[0].name} {_text(found[0].sequence.size)}",
                subject=pose.name,
                value=pose.sequence.size,
                limit=found[0].sequence.size,
                remedy="capture all poses with one resolution of the projector",
            )
    return found


def find_poses(
    folders: Sequence[PoseFolder],
    board: Board,
    board_of_size: Callable[[tuple[int, int]], Board],
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> FoundPoses:
    """Find the board in all poses, in the camera and in the projector.

    Poses that cannot be used are skipped and named.

    Args:
        folders: of the poses.
        board: to detect, in the white image, or where there is none in the brightest gray level of each pixel.
        board_of_size: creates the same board with another size, to report the right one if the board is not found.
        progress: called with the number of poses done and the total.

    Raises:
        CalibrationError: no pose can be used.
        ImageError: the patterns code columns or rows only.
    """
    found, without = FoundPoses(folders[0].sequence.size), []
    for pose in folders:
        progress(found.poses, len(folders))
        found.poses += 1
        _check_axes(pose)
        try:
            images = _read(pose)
            projector_map = decode(pose.sequence, images)
        except (BagError, ImageError) as error:
            found.skipped.append(_sentence(pose.name, error))
            continue
        bright = _bright(pose.sequence, images)
        corners = board.detect(bright)
        if corners is None:
            found.not_found.append(pose.name)
            without.append(bright)
            continue
        in_projector = board_in_projector(corners, projector_map)
        found.corners += len(corners.ids)
        found.corners_left_out += len(corners.ids) - len(in_projector.ids)
        found.views.append(BoardView(pose.name, (bright.shape[1], bright.shape[0]), corners, in_projector))
    if not found.views:
        raise _none_found(found, board, board_of_size, without)
    return found


def _pose_folder(folder: Path, place: Path, patterns: Path | None, projector_size: Size | None) -> PoseFolder:
    images = tuple(numbered_images([folder]))
    near = (folder / MANIFEST, place / MANIFEST)
    manifest = patterns or next((path for path in near if path.is_file()), None)
    if manifest is not None:
        return PoseFolder(folder.name, images, read_manifest(manifest))
    if projector_size is None:
        raise ConfigError(
            f"there is no {MANIFEST} in it or beside it, which states what its images show",
            subject=str(folder),
            remedy="name the manifest that `stereo-depth patterns` writes, or one by hand; or give the size of the "
            "projector, such as 1024x768, if the images are the Gray code of OpenCV's GrayCodePattern",
            settings=("patterns", "projector_size"),
        )
    return PoseFolder(folder.name, images, _opencv_sequence(images, projector_size))


def _opencv_sequence(images: Sequence[Path], size: Size) -> PatternSequence:
    coded = [
        Pattern("gray", axis, bit, inverse)
        for axis, length in zip(AXES, size, strict=True)
        for bit in range((length - 1).bit_length() - 1, -1, -1)
        for inverse in (False, True)
    ]
    ends = [Pattern("white"), Pattern("black")]
    if len(images) != len(coded) + 2:  # find_poses names it
        return PatternSequence(size, (*coded, *ends))
    first, last = (_difference(*pair) for pair in (images[:2], images[-2:]))
    return PatternSequence(size, (*ends, *coded) if first > last else (*coded, *ends))


def _difference(white: Path, black: Path) -> float:
    """Mean gray level of two images, the first minus the second."""
    return float(read_image(white).mean() - read_image(black).mean())


def _check_axes(pose: PoseFolder) -> None:
    if missing := [axis for axis in AXES if axis not in pose.sequence.axes]:
        raise ImageError(
            f"the patterns do not code {' and '.join(missing)}, a projector is calibrated by columns and rows",
            subject=pose.name,
            value=pose.sequence.axes,
            limit=AXES,
            remedy=f"project patterns of {' and '.join(missing)} too",
        )


def _read(pose: PoseFolder) -> list[U8]:
    """The images, gray.

    Raises:
        BagError: an image that cannot be read.
        ImageError: they are not the sequence.
    """
    images = [_gray(read_image(path)) for path in pose.images]
    if fault := sequence_fault(pose.sequence, images):
        raise ImageError(fault, value=len(images), limit=len(pose.sequence), remedy="capture every pattern once")
    return images


def _gray(pixels: U8) -> U8:
    return to_gray(Frame(pixels, 0, "", "mono8" if pixels.ndim == 2 else "bgr8"))


def _bright(sequence: PatternSequence, images: Sequence[U8]) -> U8:
    """The white image, or the brightest gray level of each pixel."""
    white = sequence.index("white")
    return images[white] if white is not None else np.maximum.reduce(images)


def _sentence(name: str, error: StereoDepthError) -> str:
    return f"{name}: skipped, {error.subject + ': ' if error.subject else ''}{error.problem}"


def _none_found(
    found: FoundPoses, board: Board, board_of_size: Callable[[tuple[int, int]], Board], without: Sequence[U8]
) -> CalibrationError:
    counted = f"size counts {board.counted}, columns x rows"
    seen = f"no board of {_text(board.size)} {board.counted} in {found.poses} poses"
    if not without:
        return CalibrationError(
            f"none of {found.poses} poses can be used ({'; '.join(found.skipped)})",
            value=0,
            limit=1,
            remedy="capture all patterns of the sequence in each pose, and list them in the manifest in this order",
            settings=("patterns",),
        )
    images = without[:_EXAMINED]
    other = detected_size(board, board_of_size, images)
    if other is not None:
        count, size = other
        return CalibrationError(
            f"{seen}, but one of {_text(size)} in {count} of {len(images)} images examined again",
            value=board.size,
            limit=size,
            remedy=f"{counted}: give {_text(size)}",
            settings=("size",),
        )
    skipped = f" ({'; '.join(found.skipped)})" if found.skipped else ""
    return CalibrationError(
        f"{seen}{skipped}",
        value=board.size,
        remedy=f"{counted}; check the kind of board, the exposure of the white image, and that the board is in view",
        settings=("size", "board"),
    )


def _text(size: Size) -> str:
    return f"{size[0]}x{size[1]}"
