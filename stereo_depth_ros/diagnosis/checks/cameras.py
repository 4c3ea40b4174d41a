# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of one camera: all faults, not only the first one.

The checks are those of the nodes, which stop at the first fault; here they are called once for each part, with all
other parts replaced by valid ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from stereo_depth_ros.core.camera import CameraModel, check_intrinsics, check_rectification
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.diagnosis.finding import Finding, Level

__all__ = ["check_camera", "check_resolution", "fits_image"]

FAR_FROM_CENTER = (0.7, 1.4)  # 2 cx / width: lenses and usual crops are within, half and double resolution are not
SAME_SCALE = 1.15  # the resolutions of both axes agree within this factor
SCALES = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 2, 2.0, 3.0, 4.0)
FIELD_OF_VIEW_DEG = {"pinhole": (8.0, 140.0), "equidistant": (20.0, 230.0)}
MAX_ASPECT = 1.25  # of fx and fy; pixels are nearly square
_ANY_MATRIX = np.identity(3)


def check_camera(camera: CameraModel, side: str, *, rectified: bool = False) -> list[Finding]:
    """Size, K, distortion, R and P of one camera, separately; of ``rectified`` images size and P only.

    ``side`` is "left" or "right".
    """
    findings = []
    for name, check, alone, value, limit in _parts(camera):
        if rectified and name not in ("size", "P"):
            continue
        try:
            check(alone, side)
        except CalibrationError as error:
            findings.append(_camera_fault(camera, f"{side} {name}", name, error, limit))
        else:
            findings.append(Finding(f"{side} {name}", Level.OK, value, limit))
    return findings


def _parts(camera: CameraModel) -> Iterator[tuple[str, Callable[[CameraModel, str], None], CameraModel, str, str]]:
    """Name, check, the camera with all other parts valid, value, limit."""
    K, P = camera.K, camera.P
    bare = CameraModel(1, 1, "plumb_bob", _ANY_MATRIX, np.zeros(0), _ANY_MATRIX, np.identity(4)[:3])
    size = replace(bare, width=camera.width, height=camera.height)
    yield "size", check_intrinsics, size, f"{camera.width}x{camera.height}", "above 0"
    yield "K", check_intrinsics, replace(bare, K=K), _projection(K), "set, finite"
    distortion = replace(bare, distortion_model=camera.distortion_model, D=camera.D)
    text = f"{camera.distortion_model}, {camera.D.size} coefficients"
    yield "distortion", check_intrinsics, distortion, text, "a known model"
    angle_deg = np.degrees(np.arccos(np.clip((np.trace(camera.R) - 1) / 2, -1, 1)))
    R_alone = replace(camera, P=np.identity(4)[:3])
    yield "R", check_rectification, R_alone, f"rotation of {angle_deg:.2f} deg", "a rotation"
    yield "P", check_rectification, replace(camera, R=_ANY_MATRIX), _projection(P), "a projection"


def _projection(matrix: F64) -> str:
    return f"f {matrix[0, 0]:.1f}, {matrix[1, 1]:.1f}, center {matrix[0, 2]:.1f}, {matrix[1, 2]:.1f} px"


def _camera_fault(camera: CameraModel, check: str, name: str, error: CalibrationError, limit: str) -> Finding:
    if name == "P" and _is_intrinsics_times_rotation(camera):
        value = "P is K R, which is not the projection of a rectified image"
        remedy = f"calibrate again with the lens model {camera.distortion_model}: some tools write K R for a fisheye"
        return Finding(check, Level.ERROR, value, limit, remedy)
    return Finding.refused(check, error, limit)


def _is_intrinsics_times_rotation(camera: CameraModel) -> bool:
    if not camera.P.any() or not all(np.isfinite(part).all() for part in (camera.K, camera.R, camera.P)):
        return False
    near = 1e-3 * abs(camera.K[0, 0])
    with np.errstate(over="ignore", invalid="ignore"):  # numbers that the checks refuse
        return bool(np.allclose(camera.P[:, :3], camera.K @ camera.R, rtol=0, atol=near))


def check_resolution(camera: CameraModel, side: str, width: int, height: int) -> list[Finding]:
    """Whether K is for an image of this size: its center and its field of view.

    A calibration of another resolution has its principal point far from the center of the image, in both axes by the
    same factor.

    Args:
        width, height: of the images as published, px.
    """
    sized = replace(camera, width=width, height=height)
    return [_check_center(sized, side), _check_field_of_view(sized, side)]


def _check_center(camera: CameraModel, side: str) -> Finding:
    low, high = FAR_FROM_CENTER
    check, limit = f"{side} center", f"{low:g}..{high:g}"
    across, down = 2 * camera.K[0, 2] / camera.width, 2 * camera.K[1, 2] / camera.height
    value = f"{across:.2f}, {down:.2f} of half the image"
    figures = {"across": across, "down": down}
    outside = [not low <= ratio <= high for ratio in (across, down)]
    if not any(outside):
        return Finding(check, Level.OK, value, limit, "", figures)
    same = min(across, down) > 0 and max(across, down) <= SAME_SCALE * min(across, down)
    if all(outside) and same:
        scale = min(SCALES, key=lambda known: abs(np.log(known / np.sqrt(across * down))))
        remedy = (
            f"K is that of an image of about {camera.width * scale:.0f}x{camera.height * scale:.0f}: calibrate at "
            f"{camera.width}x{camera.height}, or multiply the first two rows of K and P by {1 / scale:.4g}"
        )
        return Finding(check, Level.ERROR, value, limit, remedy, {**figures, "scale": scale})
    remedy = "check that K was calibrated with these images, not with a crop or another resolution"
    return Finding(check, Level.WARNING, value, limit, remedy, figures)


def _check_field_of_view(camera: CameraModel, side: str) -> Finding:
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    fisheye = camera.distortion_model == "equidistant"
    low, high = FIELD_OF_VIEW_DEG["equidistant" if fisheye else "pinhole"]
    angle = np.degrees(camera.width / fx if fisheye else 2 * np.arctan(camera.width / (2 * fx)))
    check, limit = f"{side} field of view", f"{low:g}..{high:g} deg, {1 / MAX_ASPECT:g}..{MAX_ASPECT:g}"
    value = f"{angle:.1f} deg, fx / fy {fx / fy:.3f}"
    figures = {"degrees": float(angle), "aspect": float(fx / fy)}
    if not low <= angle <= high:
        remedy = "K does not fit the image size: calibrate at this resolution, focal lengths are pixels"
        return Finding(check, Level.WARNING, value, limit, remedy, figures)
    if not 1 / MAX_ASPECT <= fx / fy <= MAX_ASPECT:
        remedy = "width and height were scaled differently: calibrate at this resolution"
        return Finding(check, Level.WARNING, value, limit, remedy, figures)
    return Finding(check, Level.OK, value, limit, "", figures)


def fits_image(camera: CameraModel, width: int, height: int) -> bool:
    """Whether the principal point lies near the center of an image of this size, px."""
    low, high = FAR_FROM_CENTER
    return bool(low <= 2 * camera.K[0, 2] / width <= high and low <= 2 * camera.K[1, 2] / height <= high)
