# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rigs: conventions against closed forms, and every error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.camera_info import camera_info_message

FX, FY, CX_LEFT, CX_RIGHT, CY, BASELINE_M, SIZE = 400.0, 410.0, 150.0, 143.0, 97.0, 0.12, (320, 200)


@pytest.fixture
def rig() -> StereoRig:
    return StereoRig.from_rectified(FX, FY, CX_LEFT, CX_RIGHT, CY, BASELINE_M, SIZE, "left_frame")


def rotation(x: float, y: float, z: float) -> np.ndarray:
    return cv2.Rodrigues(np.array([x, y, z]))[0]


def changed(matrix: np.ndarray, at: Any, value: float) -> np.ndarray:
    result = matrix.copy()
    result[at] = value
    return result


def test_names_of_the_geometry(rig: StereoRig) -> None:
    assert (rig.width, rig.height, rig.frame_id) == (*SIZE, "left_frame")
    assert (rig.f_px, rig.fy_px, rig.cx_left, rig.cx_right, rig.cy) == (FX, FY, CX_LEFT, CX_RIGHT, CY)
    assert rig.doffs_px == CX_LEFT - CX_RIGHT
    assert rig.right.P[0, 3] == -FX * BASELINE_M
    assert rig.baseline_m == pytest.approx(BASELINE_M, rel=1e-15)


def test_q_inverts_the_projection(rig: StereoRig) -> None:
    point = np.array([0.31, -0.2, 1.7, 1.0])
    left, right = rig.left.P @ point, rig.right.P @ point
    (x_left, y), x_right = left[:2] / left[2], right[0] / right[2]
    homogeneous = rig.Q @ [x_left, y, x_left - x_right, 1.0]
    np.testing.assert_allclose(homogeneous[:3] / homogeneous[3], point[:3], rtol=1e-12)
    assert FX * BASELINE_M / (x_left - x_right - rig.doffs_px) == pytest.approx(1.7, rel=1e-12)


def test_q_is_opencvs() -> None:
    K_left, K_right = np.diag([400.0, 410.0, 1.0]), np.diag([390.0, 402.0, 1.0])
    K_left[:2, 2], K_right[:2, 2] = (150.0, 97.0), (170.0, 110.0)
    R, T, D = rotation(0.01, -0.05, 0.02), np.array([-0.12, 0.004, 0.01]), np.array([-0.2, 0.05, 1e-3, -1e-3, 0.0])
    rig = StereoRig.from_calibration(K_left, D, K_right, -D, R, T, SIZE)
    Q = cv2.stereoRectify(K_left, D, K_right, -D, SIZE, R, T[:, None], alpha=0.0)[4]
    np.testing.assert_allclose(rig.Q, Q, rtol=1e-9, atol=1e-9)
    assert rig.baseline_m == pytest.approx(np.linalg.norm(T), rel=1e-12)


def test_fisheye_has_the_baseline_of_the_calibration() -> None:
    K = np.array([[335.0, 0, 310], [0, 332, 255], [0, 0, 1]])
    D = np.array([-0.02, 0.01, -0.004, 0.001])
    R, T = rotation(0.01, -0.03, 0.02), np.array([-0.0646, 0.001, 0.002])
    crop = StereoRig.from_calibration(K, D, K, D / 2, R, T, (640, 480), "equidistant")
    whole = StereoRig.from_calibration(K, D, K, D / 2, R, T, (640, 480), "equidistant", alpha=1.0)
    assert crop.baseline_m == pytest.approx(np.linalg.norm(T), rel=1e-12)
    assert whole.f_px < crop.f_px
    assert crop.doffs_px == 0


def test_from_infos_and_from_yaml_keep_every_number(rig: StereoRig, tmp_path: Path) -> None:
    types = RosbagsTypes()
    infos = [camera_info_message(types, camera, 5) for camera in (rig.left, rig.right)]
    paths = [tmp_path / "left.yaml", tmp_path / "right.yaml"]
    for path, camera in zip(paths, (rig.left, rig.right), strict=True):
        write_camera(path, camera, path.stem)
    for copy in (StereoRig.from_infos(*infos), StereoRig.from_yaml(*paths)):
        np.testing.assert_array_equal(copy.left.P, rig.left.P)
        np.testing.assert_array_equal(copy.right.P, rig.right.P)
        np.testing.assert_array_equal(copy.right.D, rig.right.D)
    assert StereoRig.from_infos(*infos).frame_id == "left_frame"


def test_errors_name_the_topic(rig: StereoRig) -> None:
    types = RosbagsTypes()
    left, right = (camera_info_message(types, camera, 0) for camera in (rig.left, rig.right))
    right.k[:] = 0
    with pytest.raises(CalibrationError, match=r"right camera \(/b/camera_info\): K is all zero"):
        StereoRig.from_infos(left, right, ("/a/camera_info", "/b/camera_info"))
    with pytest.raises(CalibrationError, match=r"^right camera: K is all zero"):
        StereoRig.from_infos(left, right)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"width": 0}, "size 0x200 is empty"),
        (
            {"distortion_model": "fisheye"},
            "distortion_model 'fisheye' is not one of plumb_bob, rational_polynomial, eq",
        ),
        ({"D": np.ones(7)}, "D has 7 coefficients, plumb_bob takes 0 or 4 or 5"),
        ({"D": np.array([0.1, 0.2])}, "D has 2 coefficients, plumb_bob takes 0 or 4 or 5"),
        (
            {"distortion_model": "rational_polynomial", "D": np.ones(15)},
            "D has 15 coefficients, rational_polynomial takes 8 or 12 or 14",
        ),
        ({"distortion_model": "equidistant", "D": np.ones(5)}, "D has 5 coefficients, equidistant takes 4"),
        ({"distortion_model": "", "D": np.ones(4)}, "distortion_model '' is not one of"),
        ({"K": np.zeros((3, 3))}, "K is all zero, which means not set"),
        ({"R": np.zeros((3, 3))}, "R is all zero, which means not set"),
        ({"P": np.zeros((3, 4))}, "P is all zero, which means not set"),
        ({"K": np.full((3, 3), np.nan)}, "K has a value that is not finite"),
        ({"D": np.array([0.1, np.nan, 0, 0, 0])}, r"D has a value that is not finite, \[0.1, nan"),
        ({"R": np.full((3, 3), np.inf)}, "R has a value that is not finite"),
        ({"P": np.full((3, 4), -np.inf)}, "P has a value that is not finite"),
        ({"K": np.diag([400.0, -410.0, 1.0])}, "K has focal lengths 400 and -410 px"),
        ({"P": np.identity(4)[:3] * [[-1], [1], [1]]}, "P has focal lengths -1 and 1 px"),
        ({"K": np.array([[400.0, 2.5, 150], [0, 410, 97], [0, 0, 1]])}, r"K = .* is not of the form"),
        ({"P": np.array([[400.0, 0, 150, 0], [0, 410, 97, 0], [0, 0, 1, 0.3]])}, r"P = .* is not of the form"),
        ({"R": np.diag([1.0, 1.0, 1.01])}, r"R = .* is not a rotation .*0.0201, limit 0.001"),
        ({"R": np.diag([1.0, 1.0, -1.0])}, r"R = .* is not a rotation"),
    ],
)
def test_refused_cameras(rig: StereoRig, side: str, changes: dict[str, Any], match: str) -> None:
    broken = replace(getattr(rig, side), **changes)
    with pytest.raises(CalibrationError, match=f"^{side} camera: {match}") as caught:
        replace(rig, **{side: broken})
    assert caught.value.subject == f"{side} camera"
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("side", "at", "value", "match"),
    [
        ("right", (0, 3), 48.0, r"P\[0,3\] = 48 is positive.*swapped"),
        ("right", (0, 3), 0.0, r"P\[0,3\] = 0 is not a baseline"),
        ("right", (0, 3), -48000.0, r"baseline 120 m is outside 0.001..10 m: units are meters"),
        ("right", (0, 3), -0.12, r"baseline 0.0003 m is outside"),
        ("right", (1, 3), -41.0, r"P\[1,3\] = -41 is a vertical baseline of -0.1 m"),
        ("left", (0, 3), -48.0, r"left camera: P\[:2, 3\] = \[-48.0, 0.0\], it is 0 .*swapped"),
        ("right", (0, 0), 400.5, "fx of P is 400 px in left camera and 400.5 px in right camera, limit 0.4 px"),
        ("right", (1, 1), 409.5, "fy of P is 410 px in left camera and 409.5 px"),
        ("right", (1, 2), 97.02, "cy of P is 97 px in left camera and 97.02 px in right camera, limit 0.01 px"),
    ],
)
def test_refused_pairs(rig: StereoRig, side: str, at: tuple[int, int], value: float, match: str) -> None:
    camera: CameraModel = getattr(rig, side)
    with pytest.raises(CalibrationError, match=match):
        replace(rig, **{side: replace(camera, P=changed(camera.P, at, value))})


@pytest.mark.parametrize(("at", "value"), [((0, 0), 400.3), ((1, 1), 410.4), ((1, 2), 97.009), ((0, 3), -4000.0)])
def test_accepted_differences(rig: StereoRig, at: tuple[int, int], value: float) -> None:
    replace(rig, right=replace(rig.right, P=changed(rig.right.P, at, value)))


def test_swapped_cameras_are_reported(rig: StereoRig) -> None:
    with pytest.raises(CalibrationError, match="left and right are probably swapped"):
        StereoRig(rig.right, rig.left)


def test_sizes_must_agree(rig: StereoRig) -> None:
    with pytest.raises(CalibrationError, match="left camera is 320x200, right camera is 160x100"):
        StereoRig(rig.left, replace(rig.right, width=160, height=100))


def test_image_must_have_the_size_of_the_infos(rig: StereoRig) -> None:
    rig.check_image(320, 200, "/left/image_raw")
    with pytest.raises(CalibrationError, match="/left/image_raw: the image is 200x320, its camera info is for 320x200"):
        rig.check_image(200, 320, "/left/image_raw")


def test_wrong_number_of_values(rig: StereoRig) -> None:
    with pytest.raises(CalibrationError, match="P has 9 values, it takes 3 x 4"):
        replace(rig.left, P=np.identity(3))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"T": [-120.0, 1.0, 0.0]}, "T from the left to the right camera: baseline 120.004 m is outside"),
        ({"T": [0.0, 0.0, 0.0]}, "T from the left to the right camera: baseline 0 m is outside"),
        ({"T": [np.nan, 0.0, 0.0]}, "baseline nan m is outside"),
        ({"T": [0.12, 0.0, 0.0]}, r"right camera: P\[0,3\] = .* is positive"),
        ({"T": [0.01, -0.12, 0.0]}, "vertical baseline"),
        ({"R": np.zeros((3, 3))}, "R from the left to the right camera = .* is not a rotation"),
        ({"K_right": np.zeros((3, 3))}, "right camera: K is all zero"),
        ({"D_left": np.zeros(3)}, "left camera: D has 3 coefficients"),
        ({"distortion_model": "radtan"}, "distortion_model 'radtan' is not one of"),
    ],
)
def test_refused_calibrations(changes: dict[str, Any], match: str) -> None:
    K = np.array([[400.0, 0, 150], [0, 410, 97], [0, 0, 1]])
    calibration: dict[str, Any] = {
        "K_left": K, "D_left": [], "K_right": K, "D_right": np.zeros(4),
        "R": np.identity(3), "T": [-0.12, 0.0, 0.0], "size": SIZE,
    }  # fmt: skip
    assert StereoRig.from_calibration(**calibration).baseline_m == pytest.approx(0.12)
    with pytest.raises(CalibrationError, match=match):
        StereoRig.from_calibration(**{**calibration, **changes})
