# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boards with numbered markers: ChArUco and aprilgrid, detected by cv2.aruco."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.calibration.boards import MIN_CORNERS, Corners, check_board_size, refine_corners
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F64, U8

__all__ = ["AprilGrid", "CharucoBoard", "marker_detector"]

_TAGS = 587  # of the family 36h11
_SMALL_WIDTH = 1000  # px; smaller images are enlarged twice to detect tags
_MAX_MISFIT = 0.25  # of a tag's side: above the effect of lens distortion, below that of a wrong layout


class CharucoBoard:
    """A chessboard with markers in its white squares; part of it in the image is sufficient.

    Args:
        size: columns, rows of squares.
        square_m, marker_m: side of a square and of a marker, meters.
        dictionary: name of the markers' dictionary, such as "DICT_4X4_50".

    Raises:
        ConfigError: a size or length out of range, an unknown name, or an OpenCV before 4.7.
    """

    counted = "squares"

    def __init__(self, size: tuple[int, int], square_m: float, marker_m: float, dictionary: str) -> None:
        check_board_size(size, square_m, 3, self.counted)
        if not 0 < marker_m < square_m:
            raise ConfigError(
                f"marker {marker_m:g} m is not within 0..{square_m:g} m, the side of a square",
                value=marker_m,
                limit=(0.0, square_m),
                remedy="measure the side of a marker, in meters",
                settings=("marker",),
            )
        self.size = size
        markers = _aruco_dictionary(dictionary)
        count = size[0] * size[1] // 2
        if count > len(markers.bytesList):
            raise ConfigError(
                f"{dictionary} has {len(markers.bytesList)} markers, {size[0]}x{size[1]} squares have {count}",
                value=count,
                limit=len(markers.bytesList),
                remedy="use the dictionary that the board was generated with",
                settings=("dictionary", "size"),
            )
        board = cv2.aruco.CharucoBoard(size, square_m, marker_m, markers)
        self._board_m = np.asarray(board.getChessboardCorners(), np.float64)
        self._detectors = [cv2.aruco.CharucoDetector(board)]
        if hasattr(board, "setLegacyPattern") and size[1] % 2 == 0:
            # Before OpenCV 4.6 boards with an even number of rows had a white first square
            old = cv2.aruco.CharucoBoard(size, square_m, marker_m, markers)
            old.setLegacyPattern(True)
            self._detectors.append(cv2.aruco.CharucoDetector(old))

    def detect(self, gray: U8) -> Corners | None:
        """Corners next to a detected marker, or None."""
        for detector in self._detectors:
            corners, ids, _, _ = detector.detectBoard(gray)
            if ids is None or len(ids) < MIN_CORNERS:
                continue
            order = np.argsort(ids.ravel())
            numbers = np.asarray(ids, np.int64).ravel()[order]
            corners_px = np.asarray(corners, np.float64).reshape(-1, 2)[order]
            refined = refine_corners(gray, corners_px, _spacing_px(corners_px))
            square_m = self._board_m[1, 0] - self._board_m[0, 0]
            found = _checked(Corners(numbers, self._board_m[numbers], refined), square_m)
            if found is not None:
                return found
        return None

    def align(self, left: Corners, right: Corners) -> Corners:
        """The right corners as they are: the markers number them."""
        return right


class AprilGrid:
    """A grid of AprilTags 36h11 in Kalibr's layout: tag 0 at the lower left, numbered to the right, then upward.

    Args:
        size: columns, rows of tags.
        tag_m: side of a tag, its black border included, meters.
        spacing: gap between two tags as a share of ``tag_m``.

    Raises:
        ConfigError: a size or length out of range, or an OpenCV before 4.7.
    """

    counted = "tags"

    def __init__(self, size: tuple[int, int], tag_m: float, spacing: float) -> None:
        check_board_size(size, tag_m, 2, self.counted)
        if not 0 < spacing < 2:
            raise ConfigError(
                f"spacing {spacing:g} is outside 0..2",
                value=spacing,
                limit=(0, 2),
                remedy="give the gap between two tags divided by a tag's side",
                settings=("spacing",),
            )
        if size[0] * size[1] > _TAGS:
            raise ConfigError(
                f"{size[0]}x{size[1]} tags are more than the {_TAGS} of the family 36h11",
                value=size[0] * size[1],
                limit=_TAGS,
                remedy="count the columns and rows of tags",
                settings=("size",),
            )
        self.size, self._tag_m = size, tag_m
        pitch_m = tag_m * (1 + spacing)
        tags = np.arange(size[0] * size[1])
        origins = pitch_m * np.column_stack([tags % size[0], tags // size[0]])
        square = tag_m * np.array([[0, 1], [1, 1], [1, 0], [0, 0]])  # upper left first, then clockwise
        corners = (origins[:, None] + square).reshape(-1, 2)
        self._board_m = np.column_stack([corners, np.zeros(len(corners))])
        self._detectors = [_tag_detector(bits) for bits in (2, 1)]  # Kalibr's border is two cells wide, others' one

    def detect(self, gray: U8) -> Corners | None:
        """Corners of the detected tags, or None where they are too few or not in the layout of this grid."""
        for detector in list(self._detectors):
            tags, corners_px = self._tags(detector, gray)
            if 4 * len(tags) < MIN_CORNERS:
                continue
            self._detectors.sort(key=lambda one, first=detector: one is not first)  # type: ignore[misc]
            refined = refine_corners(gray, corners_px.reshape(-1, 2), _spacing_px(corners_px.reshape(-1, 2)))
            return self._numbered(tags, refined.reshape(-1, 4, 2))
        return None

    def align(self, left: Corners, right: Corners) -> Corners:
        """The right corners as they are: the tags number them."""
        return right

    def _tags(self, detector: Any, gray: U8) -> tuple[npt.NDArray[np.int64], F64]:
        """Numbers (N,) and corners (N, 4, 2) of the tags that belong to the grid."""
        numbers, corners_px = _all_tags(detector, gray)
        once = np.array([np.count_nonzero(numbers == number) == 1 for number in numbers], bool)
        mine = once & (numbers < self.size[0] * self.size[1])
        order = np.argsort(numbers[mine])
        return numbers[mine][order], corners_px[mine][order]

    def _numbered(self, tags: npt.NDArray[np.int64], corners_px: F64) -> Corners | None:
        """Corners with their numbers; tag generators differ in which corner is the first one."""
        turned = [self._corners(tags, np.roll(corners_px, turn, axis=1)) for turn in range(4)]
        misfits = [_misfit(each, self._tag_m) for each in turned]
        best = int(np.argmin(misfits))
        return turned[best] if misfits[best] <= _MAX_MISFIT else None

    def _corners(self, tags: npt.NDArray[np.int64], corners_px: F64) -> Corners:
        ids = (4 * tags[:, None] + np.arange(4)).ravel()
        return Corners(ids, self._board_m[ids], corners_px.reshape(-1, 2))


def _checked(corners: Corners, length_m: float) -> Corners | None:
    """The corners, or None where they are nearly collinear or not in the layout of the board."""
    return corners if _misfit(corners, length_m) <= _MAX_MISFIT else None


def _misfit(corners: Corners, length_m: float) -> float:
    """Median distance of the corners from a homography of the board, in units of ``length_m``."""
    if np.linalg.svd(corners.board_m[:, :2] - corners.board_m[:, :2].mean(axis=0), compute_uv=False)[1] < length_m / 2:
        return np.inf
    to_board, _ = cv2.findHomography(corners.image_px, corners.board_m[:, :2])
    if to_board is None:
        return np.inf
    found = cv2.perspectiveTransform(corners.image_px[None], to_board)[0]
    return float(np.median(np.linalg.norm(found - corners.board_m[:, :2], axis=1)) / length_m)


def _spacing_px(corners_px: F64) -> float:
    distances = np.linalg.norm(corners_px[:, None] - corners_px[None], axis=2)
    return float(distances[~np.identity(len(corners_px), dtype=bool)].min())


def _all_tags(detector: Any, gray: U8) -> tuple[npt.NDArray[np.int64], F64]:
    """Numbers (N,) and corners (N, 4, 2) of tags, in the image or in the dilated one, whichever gives more tags.

    The black squares between the tags of Kalibr's boards touch the tags' corners. Dilation separates them, but removes
    too much of the cells of small tags.
    """
    enlarged = 2 if gray.shape[1] < _SMALL_WIDTH else 1
    image = cv2.resize(gray, None, fx=enlarged, fy=enlarged, interpolation=cv2.INTER_CUBIC) if enlarged > 1 else gray
    dilated = cv2.dilate(image, np.ones((3, 3), np.uint8))
    quads, ids, _ = max((detector.detectMarkers(each) for each in (image, dilated)), key=lambda found: len(found[0]))
    if ids is None:
        return np.zeros(0, np.int64), np.zeros((0, 4, 2))
    corners_px = (np.asarray(quads, np.float64).reshape(-1, 4, 2) + 0.5) / enlarged - 0.5
    return np.asarray(ids, np.int64).ravel(), corners_px


def _require_detectors() -> None:
    if not hasattr(cv2, "aruco") or not hasattr(cv2.aruco, "CharucoDetector"):
        raise ConfigError(
            f"OpenCV {cv2.__version__} has no marker detectors, which were added in 4.7",
            value=cv2.__version__,
            limit="4.7",
            remedy="install a newer opencv-python-headless with pip, or use a chessboard",
            settings=("board",),
        )


def _aruco_dictionary(name: str) -> Any:
    _require_detectors()
    known = [each for each in dir(cv2.aruco) if each.startswith("DICT_")]
    if name not in known:
        raise ConfigError(
            f"dictionary {name!r} is not one of {', '.join(known)}",
            value=name,
            limit=tuple(known),
            remedy="use the dictionary that the board was generated with",
            settings=("dictionary",),
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def marker_detector(name: str) -> Any:
    """OpenCV's detector of single markers of a dictionary, by its OpenCV name.

    Raises:
        ConfigError: an unknown name, or an OpenCV before 4.7.
    """
    return cv2.aruco.ArucoDetector(_aruco_dictionary(name), cv2.aruco.DetectorParameters())


def _tag_detector(border_bits: int) -> Any:
    dictionary = _aruco_dictionary("DICT_APRILTAG_36h11")
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    return cv2.aruco.ArucoDetector(dictionary, parameters)
