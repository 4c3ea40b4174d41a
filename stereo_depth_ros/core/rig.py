# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stereo rig of two cameras: the checks of a rectified pair, its baseline and its reprojection matrix."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.camera import CameraModel, check_intrinsics, check_rectification, check_rotation
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.camera_yaml import camera_from_yaml
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.core.types import F64

__all__ = ["Rig", "StereoRig", "check_reference", "check_vertical"]

MIN_BASELINE_M, MAX_BASELINE_M = 1e-3, 10.0
MAX_OFFSET = 1e-3  # of P[0,3] in the left camera, relative to the right one: as much as focal lengths may differ
MAX_VERTICAL = 0.01  # of P[1,3] relative to P[0,3]: 1 px between the rows at a disparity of 100 px


class Rig(Protocol):
    """Two cameras whose images can be rectified: a :class:`StereoRig`, or an uncalibrated rig.

    Attributes:
        metric: disparities give depth in meters.
    """

    metric: ClassVar[bool]

    @property
    def left(self) -> CameraModel:
        """The left camera, raw and rectified; the reference."""

    @property
    def right(self) -> CameraModel:
        """The right camera."""

    @property
    def topics(self) -> tuple[str, str]:
        """Source of each camera (topic or file), for error messages."""

    @property
    def width(self) -> int:
        """Width of both images, px."""

    @property
    def height(self) -> int:
        """Height of both images, px."""

    @property
    def doffs_px(self) -> float:
        """Disparity of a point at infinity, px; -inf where it is not known."""

    def check_image(self, width: int, height: int, topic: str) -> None:
        """Raise CalibrationError for an image of another size."""


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Left and right camera after rectification: same rows, the right camera to the right by the baseline.

    Attributes:
        left, right: the cameras; the left one is the reference.
        topics: source of each camera (topic or file), for error messages.

    Raises:
        CalibrationError: the matrices cannot be those of a rectified pair.
    """

    left: CameraModel
    right: CameraModel
    topics: tuple[str, str] = ("left", "right")

    metric: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for camera, label in zip((self.left, self.right), self._labels(), strict=True):
            check_intrinsics(camera, label)
            check_rectification(camera, label)
        _check_pair(self.left, self.right, *self._labels())

    @classmethod
    def from_infos(
        cls, left_info: Any, right_info: Any, topics: tuple[str, str] = ("left", "right"), *, rectified: bool = False
    ) -> StereoRig:
        """From two ``sensor_msgs/CameraInfo`` messages, or objects with the same fields.

        Args:
            left_info, right_info: the messages.
            topics: their topics, for error messages.
            rectified: the images are rectified already, so that only size and P count.

        Raises:
            CalibrationError: camera infos that are not those of a rectified pair.
        """
        left, right = (camera_from_info(i, t) for i, t in zip((left_info, right_info), topics, strict=True))
        return cls(left.rectified(), right.rectified(), topics) if rectified else cls(left, right, topics)

    @classmethod
    def from_yaml(cls, left_path: str | Path, right_path: str | Path) -> StereoRig:
        """From the two files that ``camera_calibration`` writes.

        Raises:
            CalibrationError: a file cannot be read or is not a camera file, or the cameras are not a rectified pair.
        """
        remedy = "name a file of camera_calibration"
        texts = (read_text(Path(path), CalibrationError, remedy) for path in (left_path, right_path))
        left, right = map(camera_from_yaml, texts, (str(left_path), str(right_path)))
        return cls(left, right, (str(left_path), str(right_path)))

    @classmethod
    def from_calibration(
        cls,
        K_left: npt.ArrayLike,
        D_left: npt.ArrayLike,
        K_right: npt.ArrayLike,
        D_right: npt.ArrayLike,
        R: npt.ArrayLike,
        T: npt.ArrayLike,
        size: tuple[int, int],
        distortion_model: str = "plumb_bob",
        frame_id: str = "left_optical_frame",
        alpha: float = 0.0,
    ) -> StereoRig:
        """From a calibration without rectification, by OpenCV's ``stereoRectify``.

        Args:
            K_left, K_right: (3, 3), px.
            D_left, D_right: coefficients of ``distortion_model``.
            R, T: (3, 3) and (3,) in meters, with X_right = R X_left + T.
            size: width, height of both images, px.
            alpha: 0 keeps only valid pixels, 1 keeps all source pixels.
        """
        bare = np.identity(4)[:3]
        left = CameraModel(*size, distortion_model, _array(K_left), _array(D_left), np.identity(3), bare, frame_id)
        right = CameraModel(*size, distortion_model, _array(K_right), _array(D_right), np.identity(3), bare, frame_id)
        check_intrinsics(left, "left camera")
        check_intrinsics(right, "right camera")
        check_rotation(_array(R).reshape(3, 3), "R from the left to the right camera")
        _check_baseline(float(np.linalg.norm(_array(T))), "T from the left to the right camera")
        try:
            R_left, R_right, P_left, P_right = _rectify(left, right, _array(R), _array(T), alpha)
        except cv2.error as error:
            raise CalibrationError(
                "these cameras cannot be rectified", value=(K_left, K_right), remedy="calibrate again"
            ) from error
        return cls(replace(left, R=R_left, P=P_left), replace(right, R=R_right, P=P_right))

    @classmethod
    def from_rectified(
        cls,
        fx: float,
        fy: float,
        cx_left: float,
        cx_right: float,
        cy: float,
        baseline_m: float,
        size: tuple[int, int],
        frame_id: str = "left_optical_frame",
    ) -> StereoRig:
        """A rig of rectified images; focal lengths and principal points in px, size (width, height)."""

        def camera(cx: float, baseline_m: float) -> CameraModel:
            # As Python's numbers, which are infinite without a warning: the checks of a rig refuse them.
            P = np.array([[fx, 0, cx, -float(fx) * float(baseline_m)], [0, fy, cy, 0], [0, 0, 1, 0]])
            return CameraModel(*size, "plumb_bob", P[:, :3], np.zeros(5), np.identity(3), P, frame_id)

        return cls(camera(cx_left, 0.0), camera(cx_right, baseline_m))

    @property
    def width(self) -> int:
        """Width of both images, px."""
        return self.left.width

    @property
    def height(self) -> int:
        """Height of both images, px."""
        return self.left.height

    @property
    def frame_id(self) -> str:
        """Optical frame of the left camera, the frame of depth and points."""
        return self.left.frame_id

    @property
    def f_px(self) -> float:
        """Horizontal focal length of the rectified images, px."""
        return float(self.right.P[0, 0])

    @property
    def fy_px(self) -> float:
        """Vertical focal length of the rectified images, px."""
        return float(self.right.P[1, 1])

    @property
    def cx_left(self) -> float:
        """Column of the left principal point, px."""
        return float(self.left.P[0, 2])

    @property
    def cx_right(self) -> float:
        """Column of the right principal point, px."""
        return float(self.right.P[0, 2])

    @property
    def cy(self) -> float:
        """Row of both principal points, px."""
        return float(self.left.P[1, 2])

    @property
    def baseline_m(self) -> float:
        """Distance of the two optical centers, meters, positive."""
        return float(-self.right.P[0, 3] / self.right.P[0, 0])

    @property
    def doffs_px(self) -> float:
        """Disparity of a point at infinity: cx_left - cx_right, px."""
        return self.cx_left - self.cx_right

    @property
    def Q(self) -> F64:  # noqa: N802
        """float64 (4, 4): (x, y, d, 1) with d = x_left - x_right to homogeneous meters; Z = f B / (d - doffs)."""
        aspect = self.f_px / self.fy_px
        return np.array(
            [
                [1.0, 0.0, 0.0, -self.cx_left],
                [0.0, aspect, 0.0, -self.cy * aspect],
                [0.0, 0.0, 0.0, self.f_px],
                [0.0, 0.0, 1.0 / self.baseline_m, -self.doffs_px / self.baseline_m],
            ]
        )

    def check_image(self, width: int, height: int, topic: str) -> None:
        """Check the size of an image against the camera infos.

        Raises:
            CalibrationError: the sizes differ.
        """
        if (width, height) == (2 * self.width, self.height):
            raise CalibrationError(
                f"the image is {width}x{height}, its camera info is for {self.width}x{self.height}: it looks like both "
                "images side by side",
                subject=topic,
                value=(width, height),
                limit=(self.width, self.height),
                remedy="read both from it, or split it in the driver",
                settings=("side_by_side",),
            )
        if (width, height) != (self.width, self.height):
            raise CalibrationError(
                f"the image is {width}x{height}, its camera info is for {self.width}x{self.height}",
                subject=topic,
                value=(width, height),
                limit=(self.width, self.height),
                remedy="calibrate at this resolution, or set binning and roi of the camera info",
            )

    def check_side(self, side: str, frame_id: str, topic: str) -> None:
        """Check that an image does not have the frame of the other camera.

        Args:
            side: "left" or "right".
            frame_id: frame of the image.
            topic: of the image, the subject of the error.

        Raises:
            CalibrationError: the image is of the other camera.
        """
        own, other = (self.left, self.right) if side == "left" else (self.right, self.left)
        if frame_id and frame_id != own.frame_id and frame_id == other.frame_id:
            raise CalibrationError(
                f"frame_id is {quoted(frame_id)}, the frame of the other camera, expected {quoted(own.frame_id)}",
                subject=topic,
                value=frame_id,
                limit=own.frame_id,
                remedy="cameras are swapped, exchange the image topics of left and right",
            )

    def _labels(self) -> tuple[str, str]:
        left, right = self.topics
        return (
            "left camera" if left == "left" else f"left camera ({left})",
            "right camera" if right == "right" else f"right camera ({right})",
        )


def _array(values: npt.ArrayLike) -> F64:
    return np.ascontiguousarray(values, dtype=np.float64)  # OpenCV's fisheye functions refuse parts of a matrix


def _rectify(left: CameraModel, right: CameraModel, R: F64, T: F64, alpha: float) -> tuple[F64, F64, F64, F64]:
    """R and P of both cameras by Bouguet's method: half the rotation each, then the rows along the baseline."""
    size = (left.width, left.height)
    R, T = R.reshape(3, 3), T.reshape(3, 1)
    flags = cv2.CALIB_ZERO_DISPARITY
    if left.distortion_model == "equidistant":
        fisheye = cv2.fisheye.stereoRectify(left.K, left.D, right.K, right.D, size, R, T, flags, balance=alpha)
        return fisheye[0], fisheye[1], fisheye[2], fisheye[3]
    D_left, D_right = (camera.D if camera.D.size else np.zeros(5) for camera in (left, right))
    pinhole = cv2.stereoRectify(left.K, D_left, right.K, D_right, size, R, T, flags=flags, alpha=alpha)
    return pinhole[0], pinhole[1], pinhole[2], pinhole[3]


def _check_baseline(baseline_m: float, label: str) -> None:
    if not MIN_BASELINE_M <= baseline_m <= MAX_BASELINE_M:
        raise CalibrationError(
            f"baseline {baseline_m:g} m is outside {MIN_BASELINE_M:g}..{MAX_BASELINE_M:g} m",
            subject=label,
            value=baseline_m,
            limit=(MIN_BASELINE_M, MAX_BASELINE_M),
            remedy="units are meters, it was probably written in millimeters or as a ratio; P[0,3] is -fx * baseline",
        )


def _check_pair(left: CameraModel, right: CameraModel, left_label: str, right_label: str) -> None:
    if (left.width, left.height) != (right.width, right.height):
        raise CalibrationError(
            f"{left_label} is {left.width}x{left.height}, {right_label} is {right.width}x{right.height}",
            value=(right.width, right.height),
            limit=(left.width, left.height),
            remedy="both images must have the same size: set both cameras to the same resolution",
        )
    check_reference(left.P, right.P, left_label)
    _check_rows_agree(left.P, right.P, left_label, right_label)
    check_vertical(left.P, right.P, right_label)
    _check_right_is_right(right.P, right_label)


def check_reference(P_left: F64, P_right: F64, label: str = "") -> None:
    """Raise CalibrationError with subject ``label`` where the left camera is not the origin of both P.

    Args:
        P_left, P_right: float64 (3, 4), with focal lengths above 0.
    """
    limit = MAX_OFFSET * np.maximum(abs(P_right[0, 3]), P_left[0, 0] * MIN_BASELINE_M)
    if np.abs(P_left[0, 3]) > limit or np.abs(P_left[1, 3]) > max(limit, _row_limit(P_right)):
        raise CalibrationError(
            f"P[:2, 3] = {P_left[:2, 3].tolist()}, it is 0 for the left camera, the reference",
            subject=label,
            value=P_left[:2, 3],
            limit=float(limit),
            remedy=_reference_remedy(float(P_left[0, 3]), float(P_right[0, 3]), limit),
        )


def _reference_remedy(left: float, right: float, limit: float) -> str:
    """The change of P[0, 3] that makes a rig, px * m."""
    if abs(left) <= limit:
        return "calibrate both cameras together as a stereo pair"
    if abs(left - right) <= limit:
        sign = f", and P[0,3] of the right camera to {-right:.6g}" if right > 0 else ""
        return (
            "both camera infos carry the baseline, they are not swapped: set P[0,3] of the left camera to 0, it "
            f"belongs to the right camera only{sign}"
        )
    if right > left:
        return "left and right are probably swapped, exchange the topics"
    return (
        f"P is relative to another camera: set P[0,3] of the left camera to 0, of the right one to {right - left:.6g}"
    )


def _check_rows_agree(P_left: F64, P_right: F64, left_label: str, right_label: str) -> None:
    for name, at, limit in (
        ("fx", (0, 0), 1e-3 * P_left[0, 0]),
        ("fy", (1, 1), 1e-3 * P_left[1, 1]),
        ("cy", (1, 2), 0.01),
    ):
        if abs(P_left[at] - P_right[at]) > limit:
            raise CalibrationError(
                f"{name} of P is {P_left[at]:.6g} px in {left_label} and {P_right[at]:.6g} px in {right_label}, limit "
                f"{limit:.3g} px apart",
                value=float(abs(P_left[at] - P_right[at])),
                limit=limit,
                remedy="a rectified pair has the same rows, calibrate both cameras together",
            )


def check_vertical(P_left: F64, P_right: F64, label: str = "") -> None:
    """Raise CalibrationError with subject ``label`` where the baseline is not along the rows.

    The rows of a point then differ by the share of its disparity that P[1,3] is of P[0,3].

    Args:
        P_left, P_right: float64 (3, 4), with focal lengths above 0.
    """
    vertical, limit = float(P_right[1, 3] - P_left[1, 3]), _row_limit(P_right)
    if abs(vertical) > limit:
        raise CalibrationError(
            f"P[1,3] = {P_right[1, 3]:g} is a vertical baseline of {vertical / P_right[1, 1]:g} m, it is 0 for cameras "
            f"side by side, limit {limit:.3g}: {MAX_VERTICAL:g} of P[0,3], 1 px between the rows at a disparity of "
            f"{1 / MAX_VERTICAL:g} px",
            subject=label,
            value=vertical,
            limit=limit,
            remedy="calibrate both cameras together; where one is above the other, rotate the images by 90 degrees "
            "before and calibrate them as left and right",
        )


def _row_limit(P_right: F64) -> float:
    return float(MAX_VERTICAL * max(abs(P_right[0, 3]), P_right[0, 0] * MIN_BASELINE_M))


def _check_right_is_right(P: F64, label: str) -> None:
    if P[0, 3] > 0:
        raise CalibrationError(
            f"P[0,3] = {P[0, 3]:g} is positive, it is -fx * baseline and below 0",
            subject=label,
            value=float(P[0, 3]),
            limit=0,
            remedy="left and right are probably swapped (exchange the topics), or the sign is wrong",
        )
    if P[0, 3] == 0:
        raise CalibrationError(
            "P[0,3] = 0 is not a baseline, it is -fx * baseline and below 0",
            subject=label,
            value=0,
            limit=0,
            remedy="calibrate both cameras together as a stereo pair",
        )
    _check_baseline(float(-P[0, 3] / P[0, 0]), label)
