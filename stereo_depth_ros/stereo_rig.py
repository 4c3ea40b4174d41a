# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two cameras and the rig they form: what makes one usable, its baseline and its reprojection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.errors import CalibrationError
from stereo_depth_ros.types import F64

__all__ = ["CameraModel", "StereoRig"]

MIN_BASELINE_M, MAX_BASELINE_M = 1e-3, 10.0
_COEFFICIENTS: Mapping[str, tuple[int, ...]] = {
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
_NOT_SET = "is all zero, which means not set: calibrate the camera, or fill it in"
_K_FORM = ("K", "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
_P_FORM = ("P", "[[fx, 0, cx, -fx * baseline], [0, fy, cy, 0], [0, 0, 1, 0]]")


@dataclass(frozen=True, eq=False)
class CameraModel:
    """One camera as ``sensor_msgs/CameraInfo`` describes it, for the image it really delivers.

    Attributes:
        width, height: size of the image in pixels, after region of interest and binning.
        distortion_model: "plumb_bob", "rational_polynomial" or "equidistant".
        K: float64 (3, 3), intrinsics of the raw image, px.
        D: float64 (n,), coefficients of the distortion model; empty is none for plumb_bob.
        R: float64 (3, 3), rotation from the camera to the rectified camera.
        P: float64 (3, 4), projection of the rectified image, px and px * m; P[0, 3] = -fx * baseline for the right eye.
        frame_id: name of the optical frame.

    Raises:
        CalibrationError: an array has the wrong number of values.
    """

    width: int
    height: int
    distortion_model: str
    K: F64
    D: F64
    R: F64
    P: F64
    frame_id: str = ""

    def __post_init__(self) -> None:
        for name, columns in (("K", 3), ("R", 3), ("P", 4)):
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.size != 3 * columns:
                raise CalibrationError(f"{name} has {values.size} values, it takes 3 x {columns}: write all of them")
            object.__setattr__(self, name, values.reshape(3, columns))
        object.__setattr__(self, "D", np.array(self.D, dtype=np.float64).ravel())


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Left and right camera after rectification: same rows, the right eye to the right by the baseline.

    Attributes:
        left, right: the cameras; the left one is the reference.
        topics: where each came from, for the messages of errors.

    Raises:
        CalibrationError: the matrices cannot be those of a rectified pair.
    """

    left: CameraModel
    right: CameraModel
    topics: tuple[str, str] = ("left", "right")

    def __post_init__(self) -> None:
        for camera, label in zip((self.left, self.right), self._labels(), strict=True):
            _check_intrinsics(camera, label)
            _check_rectification(camera, label)
        _check_pair(self.left, self.right, *self._labels())

    @classmethod
    def from_infos(cls, left_info: Any, right_info: Any, topics: tuple[str, str] = ("left", "right")) -> StereoRig:
        """From two ``sensor_msgs/CameraInfo`` messages, or objects with the same fields."""
        from stereo_depth_ros.io.camera_info_message import camera_from_info  # builds CameraModel, so it sits above

        return cls(camera_from_info(left_info, topics[0]), camera_from_info(right_info, topics[1]), topics)

    @classmethod
    def from_yaml(cls, left_path: str | Path, right_path: str | Path) -> StereoRig:
        """From the two files that ``camera_calibration`` writes."""
        from stereo_depth_ros.io.calibration_yaml import read_camera  # builds CameraModel, so it sits above

        return cls(read_camera(left_path), read_camera(right_path), (str(left_path), str(right_path)))

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
        """From a calibration that has not been rectified, through OpenCV's ``stereoRectify``.

        Args:
            K_left, K_right: (3, 3), px.
            D_left, D_right: coefficients of ``distortion_model``.
            R, T: (3, 3) and (3,) in metres, with X_right = R X_left + T.
            size: width, height of both images, px.
            alpha: 0 shows only pixels that have a source, 1 all source pixels.
        """
        bare = np.eye(3, 4)
        left = CameraModel(*size, distortion_model, _array(K_left), _array(D_left), np.eye(3), bare, frame_id)
        right = CameraModel(*size, distortion_model, _array(K_right), _array(D_right), np.eye(3), bare, frame_id)
        _check_intrinsics(left, "left camera")
        _check_intrinsics(right, "right camera")
        _check_rotation(_array(R).reshape(3, 3), "R from the left to the right camera")
        _check_baseline(float(np.linalg.norm(_array(T))), "T from the left to the right camera")
        R_left, R_right, P_left, P_right = _rectify(left, right, _array(R), _array(T), alpha)
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
        """A rig whose images are rectified already; focal lengths and principal points in px, size (width, height)."""

        def camera(cx: float, baseline_m: float) -> CameraModel:
            P = np.array([[fx, 0, cx, -fx * baseline_m], [0, fy, cy, 0], [0, 0, 1, 0]])
            return CameraModel(*size, "plumb_bob", P[:, :3], np.zeros(5), np.eye(3), P, frame_id)

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
        """Optical frame of the left camera, the frame of all depth."""
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
        """Distance of the two optical centres, metres, positive."""
        return float(-self.right.P[0, 3] / self.right.P[0, 0])

    @property
    def doffs_px(self) -> float:
        """Disparity of a point at infinity: cx_left - cx_right, px."""
        return self.cx_left - self.cx_right

    @property
    def Q(self) -> F64:  # noqa: N802
        """float64 (4, 4): (x, y, d, 1) with d = x_left - x_right to homogeneous metres; Z = f B / (d - doffs)."""
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
        """Refuses an image that has another size than the camera infos say.

        Raises:
            CalibrationError: the sizes differ.
        """
        if (width, height) != (self.width, self.height):
            raise CalibrationError(
                f"{topic}: the image is {width}x{height}, its camera info is for {self.width}x{self.height}: calibrate "
                "at this resolution, or set binning and roi of the camera info"
            )

    def _labels(self) -> tuple[str, str]:
        left, right = self.topics
        return (
            "left camera" if left == "left" else f"left camera ({left})",
            "right camera" if right == "right" else f"right camera ({right})",
        )


def _array(values: npt.ArrayLike) -> F64:
    return np.asarray(values, dtype=np.float64)


def _rectify(left: CameraModel, right: CameraModel, R: F64, T: F64, alpha: float) -> tuple[F64, F64, F64, F64]:
    """R and P of both eyes by Bouguet's method: half the rotation each, then rows along the baseline."""
    size = (left.width, left.height)
    R, T = R.reshape(3, 3), T.reshape(3, 1)
    flags = cv2.CALIB_ZERO_DISPARITY
    if left.distortion_model == "equidistant":
        fisheye = cv2.fisheye.stereoRectify(left.K, left.D, right.K, right.D, size, R, T, flags, balance=alpha)
        return fisheye[0], fisheye[1], fisheye[2], fisheye[3]
    D_left, D_right = (camera.D if camera.D.size else np.zeros(5) for camera in (left, right))
    pinhole = cv2.stereoRectify(left.K, D_left, right.K, D_right, size, R, T, flags=flags, alpha=alpha)
    return pinhole[0], pinhole[1], pinhole[2], pinhole[3]


def _check_intrinsics(camera: CameraModel, label: str) -> None:
    if camera.width < 1 or camera.height < 1:
        raise CalibrationError(f"{label}: size {camera.width}x{camera.height} is empty: set width and height")
    if camera.distortion_model not in _COEFFICIENTS:
        raise CalibrationError(
            f"{label}: distortion_model {camera.distortion_model!r} is none of {', '.join(_COEFFICIENTS)}: "
            "calibrate with one of them, or set plumb_bob and zeros for an image without distortion"
        )
    counts = _COEFFICIENTS[camera.distortion_model]
    if camera.D.size not in counts:
        raise CalibrationError(
            f"{label}: D has {camera.D.size} coefficients, {camera.distortion_model} takes "
            f"{' or '.join(map(str, counts))}: set as many, or the distortion_model they belong to"
        )
    _check_finite(camera, label, "K", "D")
    _check_set(camera, label, "K")
    _check_form(camera.K, label, *_K_FORM)


def _check_rectification(camera: CameraModel, label: str) -> None:
    _check_finite(camera, label, "R", "P")
    _check_set(camera, label, "R", "P")
    _check_rotation(camera.R, f"{label}: R")
    _check_form(camera.P, label, *_P_FORM)


def _check_finite(camera: CameraModel, label: str, *names: str) -> None:
    for name in names:
        values = getattr(camera, name)
        if not np.isfinite(values).all():
            raise CalibrationError(
                f"{label}: {name} has a value that is not finite, {values.ravel().tolist()}: "
                "calibrate again, or write numbers"
            )


def _check_set(camera: CameraModel, label: str, *names: str) -> None:
    for name in names:
        if not getattr(camera, name).any():
            raise CalibrationError(f"{label}: {name} {_NOT_SET}")


def _check_form(matrix: F64, label: str, name: str, form: str) -> None:
    """Focal lengths above 0 and nothing where the pinhole has nothing: OpenCV would ignore a skew without a word."""
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise CalibrationError(
            f"{label}: {name} has focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g} px, they are above 0: calibrate"
        )
    rest = [matrix[0, 1], matrix[1, 0], *matrix[2, :2], matrix[2, 2] - 1, *matrix[2, 3:]]
    if np.abs(rest).max() > 1e-6:
        raise CalibrationError(f"{label}: {name} = {matrix.tolist()} is not of the form {form}: write it row by row")


def _check_rotation(R: F64, label: str) -> None:
    error = np.abs(R @ R.T - np.eye(3)).max()
    if not error <= 1e-3 or np.linalg.det(R) < 0:
        raise CalibrationError(
            f"{label} = {R.tolist()} is not a rotation (|R R^T - I| = {error:.3g}, limit 0.001; determinant +1): "
            "calibrate, or set the identity for a rectified image"
        )


def _check_baseline(baseline_m: float, label: str) -> None:
    if not MIN_BASELINE_M <= baseline_m <= MAX_BASELINE_M:
        raise CalibrationError(
            f"{label}: baseline {baseline_m:g} m is outside {MIN_BASELINE_M:g}..{MAX_BASELINE_M:g} m: "
            "units are metres, it was probably written in millimetres or as a ratio; P[0,3] is -fx * baseline"
        )


def _check_pair(left: CameraModel, right: CameraModel, left_label: str, right_label: str) -> None:
    if (left.width, left.height) != (right.width, right.height):
        raise CalibrationError(
            f"{left_label} is {left.width}x{left.height}, {right_label} is {right.width}x{right.height}: "
            "a pair has one size, set both cameras to the same resolution"
        )
    _check_left_is_reference(left, left_label)
    _check_rows_agree(left.P, right.P, left_label, right_label)
    _check_right_is_right(right.P, right_label)


def _check_left_is_reference(left: CameraModel, label: str) -> None:
    offset_m = np.abs(left.P[:2, 3] / left.P[0, 0]).max()
    if offset_m > 1e-6:
        raise CalibrationError(
            f"{label}: P[:2, 3] = {left.P[:2, 3].tolist()}, it is 0 for the left camera, the reference: "
            "left and right are probably swapped, exchange the topics"
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
                f"{limit:.3g} px apart: a rectified pair has the same rows, calibrate both cameras together"
            )


def _check_right_is_right(P: F64, label: str) -> None:
    baseline_m, vertical_m = -P[0, 3] / P[0, 0], P[1, 3] / P[1, 1]
    if abs(vertical_m) > 1e-6:
        raise CalibrationError(
            f"{label}: P[1,3] = {P[1, 3]:g} is a vertical baseline of {vertical_m:g} m, it is 0 for eyes side by side: "
            "rotate the images by 90 degrees and calibrate them as left and right"
        )
    if P[0, 3] > 0:
        raise CalibrationError(
            f"{label}: P[0,3] = {P[0, 3]:g} is positive, it is -fx * baseline and below 0: "
            "left and right are probably swapped (exchange the topics), or the sign is wrong"
        )
    if P[0, 3] == 0:
        raise CalibrationError(
            f"{label}: P[0,3] = 0 is no baseline, it is -fx * baseline and below 0: "
            "calibrate both cameras together as a stereo pair"
        )
    _check_baseline(baseline_m, label)
