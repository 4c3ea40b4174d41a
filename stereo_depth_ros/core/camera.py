# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera model, and the checks of its matrices."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stereo_depth_ros.core.distortion import COEFFICIENTS, known_distortion
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64

__all__ = ["MAX_PIXELS", "CameraModel", "check_calibrated", "check_intrinsics", "check_rectification", "check_rotation"]

MAX_PIXELS = 2**26  # of an image or a camera; the largest sensors of machine vision have 65 million

_LARGEST = 1e12  # of the numbers in K, D, R and P: products of them are finite
_SHORTEST_PX = 1e-3  # focal length

_K_FORM = ("K", "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
_P_FORM = ("P", "[[fx, 0, cx, -fx * baseline], [0, fy, cy, 0], [0, 0, 1, 0]]")


@dataclass(frozen=True, eq=False)
class CameraModel:
    """One camera as ``sensor_msgs/CameraInfo`` describes it, for the image as published.

    Attributes:
        width, height: size of the image in pixels, after region of interest and binning.
        distortion_model: "plumb_bob", "rational_polynomial" or "equidistant"; other names and counts of coefficients
            become one of them where they have one meaning, see :func:`known_distortion`.
        K: float64 (3, 3), intrinsics of the raw image, px.
        D: float64 (n,), coefficients of the distortion model; for plumb_bob, empty means no distortion.
        R: float64 (3, 3), rotation from the camera to the rectified camera.
        P: float64 (3, 4), projection of the rectified image, px and px * m; P[0, 3] = -fx * baseline for the right
            camera.
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
                raise CalibrationError(
                    f"{name} has {values.size} values, it takes 3 x {columns}",
                    value=values.size,
                    limit=3 * columns,
                    remedy="write all of them",
                )
            object.__setattr__(self, name, values.reshape(3, columns))
        model, D = known_distortion(self.distortion_model, np.array(self.D, dtype=np.float64).ravel())
        object.__setattr__(self, "distortion_model", model)
        object.__setattr__(self, "D", D)

    def rectified(self) -> CameraModel:
        """The camera whose raw images are the rectified images of this one: K from P, no distortion, no rotation."""
        return replace(self, distortion_model="plumb_bob", K=self.P[:, :3], D=np.zeros(5), R=np.identity(3))

    def described(self) -> CameraModel:
        """The rectified camera where only P is set (K, D and R all zero): then the images are rectified; else this."""
        return self.rectified() if self.P.any() and not any(part.any() for part in (self.K, self.D, self.R)) else self

    @property
    def calibrated(self) -> bool:
        """Whether the size is set, and K, P or D."""
        return bool((self.width or self.height) and (self.K.any() or self.P.any() or self.D.any()))


def check_calibrated(camera: CameraModel, label: str) -> None:
    """Raise CalibrationError with subject ``label`` for the camera info of a camera that was never calibrated."""
    if not camera.calibrated:
        matrices = "" if camera.K.any() or camera.P.any() else ", K and P are all zero"
        raise CalibrationError(
            f"not calibrated, the size is {camera.width}x{camera.height}{matrices}",
            subject=label,
            value=(camera.width, camera.height),
            limit="a size, K and P",
            remedy="calibrate both cameras together, and load the calibration in the driver",
        )


def check_intrinsics(camera: CameraModel, label: str) -> None:
    """Raise CalibrationError with subject ``label`` where the size, the distortion model, K or D is not possible."""
    check_calibrated(camera, label)
    if camera.width < 1 or camera.height < 1:
        raise CalibrationError(
            f"size {camera.width}x{camera.height} is empty",
            subject=label,
            value=(camera.width, camera.height),
            limit=(1, 1),
            remedy="set width and height",
        )
    if camera.width * camera.height > MAX_PIXELS:
        raise CalibrationError(
            f"size {camera.width}x{camera.height} is more than {MAX_PIXELS} px",
            subject=label,
            value=(camera.width, camera.height),
            limit=MAX_PIXELS,
            remedy="set width and height of the images",
        )
    if camera.distortion_model not in COEFFICIENTS:
        raise CalibrationError(
            f"distortion_model {quoted(camera.distortion_model)} is not one of {', '.join(COEFFICIENTS)}",
            subject=label,
            value=camera.distortion_model,
            limit=tuple(COEFFICIENTS),
            remedy=_model_remedy(camera.distortion_model),
        )
    counts = COEFFICIENTS[camera.distortion_model]
    if camera.D.size not in counts:
        raise CalibrationError(
            f"D has {camera.D.size} coefficients, {camera.distortion_model} takes {' or '.join(map(str, counts))}",
            subject=label,
            value=camera.D.size,
            limit=counts,
            remedy="set as many, or the distortion_model they belong to",
        )
    _check_finite(camera, label, "K", "D")
    _check_set(camera, label, "K")
    _check_form(camera.K, label, *_K_FORM)


def _model_remedy(model: str) -> str:
    if model.lower() == "fisheye":
        return "set equidistant, if the four coefficients are those of OpenCV's fisheye model"
    return "calibrate with one of them, or set plumb_bob and zeros for an image without distortion"


def check_rectification(camera: CameraModel, label: str) -> None:
    """Raise CalibrationError with subject ``label`` where R or P is not possible."""
    _check_finite(camera, label, "R", "P")
    _check_set(camera, label, "R", "P")
    check_rotation(camera.R, "R", label)
    _check_form(camera.P, label, *_P_FORM)


def _check_finite(camera: CameraModel, label: str, *names: str) -> None:
    for name in names:
        values = getattr(camera, name)
        if not np.isfinite(values).all():
            raise CalibrationError(
                f"{name} has a value that is not finite, {values.ravel().tolist()}",
                subject=label,
                value=values,
                limit="finite numbers",
                remedy="calibrate again, or write numbers",
            )
        if values.size and np.abs(values).max() > _LARGEST:
            raise CalibrationError(
                f"{name} has the value {values.flat[np.abs(values).argmax()]:g}, {_LARGEST:g} is the limit",
                subject=label,
                value=values,
                limit=_LARGEST,
                remedy="calibrate again",
            )


def _check_set(camera: CameraModel, label: str, *names: str) -> None:
    for name in names:
        if not getattr(camera, name).any():
            raise CalibrationError(
                f"{name} is all zero, which means not set",
                subject=label,
                value=0,
                remedy="calibrate the camera, or fill it in",
            )


def _check_form(matrix: F64, label: str, name: str, form: str) -> None:
    """Focal lengths above 0 and the zeros of a pinhole camera: OpenCV would silently ignore a skew."""
    shortest = min(matrix[0, 0], matrix[1, 1])
    if shortest < _SHORTEST_PX:
        limit = 0 if shortest <= 0 else _SHORTEST_PX
        raise CalibrationError(
            f"{name} has focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g} px, they must be above {limit:g}",
            subject=label,
            value=(float(matrix[0, 0]), float(matrix[1, 1])),
            limit=limit,
            remedy="calibrate",
        )
    zeros = [matrix[0, 1], matrix[1, 0], *matrix[2, :2], matrix[2, 2] - 1, *matrix[2, 3:]]
    if np.abs(zeros).max() > 1e-6:
        raise CalibrationError(
            f"{name} = {matrix.tolist()} is not of the form {form}",
            subject=label,
            value=matrix,
            limit=form,
            remedy="write it row by row",
        )


def check_rotation(R: F64, name: str, label: str = "") -> None:
    """Raise CalibrationError with subject ``label`` where the float64 (3, 3) called ``name`` is not a rotation."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(R @ R.T - np.identity(3)).max()
    if not error <= 1e-3 or np.linalg.det(R) < 0:
        raise CalibrationError(
            f"{name} = {R.tolist()} is not a rotation (|R R^T - I| = {error:.3g}, limit 0.001; determinant +1)",
            subject=label,
            value=R,
            limit=1e-3,
            remedy="calibrate, or set the identity for a rectified image",
        )
