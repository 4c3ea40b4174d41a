# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writers of calibration files in the formats of other programs, for tests; independent of the readers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from stereo_depth_ros.core.types import F64

SIZE = (640, 400)


@dataclass(frozen=True)
class Truth:
    """A rig with everything different: X_right = R X_left + T, meters."""

    model: str
    K_left: F64
    K_right: F64
    D_left: F64
    D_right: F64
    R: F64
    T: F64

    @property
    def T_right_left(self) -> F64:  # noqa: N802
        """float64 (4, 4)."""
        return np.vstack([np.column_stack([self.R, self.T]), [0, 0, 0, 1]])


def _K(fx: float, fy: float, cx: float, cy: float) -> F64:  # noqa: N802
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def truth(model: str) -> Truth:
    D = {
        "plumb_bob": ([-0.28, 0.07, 0.0011, -0.0003, 0.0], [-0.25, 0.06, -0.0007, 0.0012, 0.0]),
        "plumb_bob 5": ([-0.28, 0.07, 0.0011, -0.0003, 0.013], [-0.25, 0.06, -0.0007, 0.0012, -0.017]),
        "rational_polynomial": (
            [0.31, 0.02, 1e-4, -2e-4, 0.003, 0.65, 0.11, 0.007],
            [0.29, 0.03, -3e-4, 4e-4, 0.002, 0.61, 0.12, 0.005],
        ),
        "rational_polynomial 14": (
            [0.31, 0.02, 1e-4, -2e-4, 0.003, 0.65, 0.11, 0.007, *[1e-4, -2e-4, 3e-4, -1e-4, 0.001, -0.002]],
            [0.29, 0.03, -3e-4, 4e-4, 0.002, 0.61, 0.12, 0.005, *[2e-4, -1e-4, 1e-4, -3e-4, 0.002, -0.001]],
        ),
        "equidistant": ([-0.013, 0.0042, -0.0031, 0.0009], [-0.011, 0.0051, -0.0027, 0.0012]),
        "none": ([0.0] * 5, [0.0] * 5),
    }[model]
    R = cv2.Rodrigues(np.array([0.011, -0.017, 0.006]))[0]
    return Truth(
        model.split(" ")[0] if model != "none" else "plumb_bob",
        _K(401.25, 402.5, 322.75, 196.5),
        _K(398.5, 399.75, 317.25, 204.25),
        np.array(D[0]),
        np.array(D[1]),
        R.astype(np.float64),
        np.array([-0.1203, 0.0011, -0.0007]),
    )


def _intrinsics(K: F64) -> str:
    return f"[{K[0, 0]!r}, {K[1, 1]!r}, {K[0, 2]!r}, {K[1, 2]!r}]".replace("np.float64(", "").replace(")", "")


def _rows(T: F64) -> str:
    return "".join(f"  - {row}\n" for row in T.tolist())


def camchain(rig: Truth, lens: str, swapped: bool = False, pose: str = "T_cn_cnm1") -> str:
    sides = [(rig.K_left, rig.D_left), (rig.K_right, rig.D_right)]
    T = rig.T_right_left
    if swapped:
        sides, T = sides[::-1], np.linalg.inv(T)
    T_cam0_imu = np.vstack(
        [np.column_stack([cv2.Rodrigues(np.array([0.3, -1.1, 0.7]))[0], [0.02, -0.03, 0.05]]), [0, 0, 0, 1]]
    )
    text = ""
    for number, (K, D) in enumerate(sides):
        text += f"cam{number}:\n"
        T_cam_imu = T @ T_cam0_imu if number else T_cam0_imu
        if pose == "T_cam_imu":
            text += f"  T_cam_imu:\n{_rows(T_cam_imu)}"
        if pose == "T_imu_cam":
            text += f"  T_imu_cam: #rotation from camera to IMU\n{_rows(np.linalg.inv(T_cam_imu))}"
        if pose == "T_cn_cnm1" and number:
            text += f"  T_cn_cnm1:\n{_rows(T)}"
        coefficients = [] if lens == "none" else D[:4].tolist()
        text += f"  cam_overlaps: [{1 - number}]\n  camera_model: pinhole\n  distortion_coeffs: {coefficients}\n"
        text += f"  distortion_model: {lens}\n  intrinsics: {_intrinsics(K)}\n  resolution: [{SIZE[0]}, {SIZE[1]}]\n"
        text += f"  rostopic: /cam{number}/image_raw\n"
    return text


def opencv_matrix(name: str, values: Any, shape: tuple[int, int] | None = None) -> str:
    array = np.asarray(values, np.float64)
    rows, cols = shape or (array.shape if array.ndim == 2 else (1, array.size))
    numbers = array.ravel().tolist()
    lines = ",\n       ".join(", ".join(f"{v:.16e}" for v in numbers[at : at + 3]) for at in range(0, len(numbers), 3))
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {lines} ]\n"


def opencv_yaml(entries: dict[str, Any], dashes: bool = True) -> str:
    text = "%YAML:1.0\n" + "---\n" * dashes
    for name, value in entries.items():
        if isinstance(value, str):
            text += f'{name}: "{value}"\n'
        elif np.ndim(value):
            text += f"{name}: [ {value[0]}, {value[1]} ]\n" if np.size(value) == 2 else opencv_matrix(name, value)
        else:
            text += f"{name}: {value}\n"
    return text


def opencv_xml(entries: dict[str, Any]) -> str:
    text = '<?xml version="1.0"?>\n<opencv_storage>\n'
    for name, value in entries.items():
        if np.ndim(value) and np.size(value) > 2:
            array = np.atleast_2d(np.asarray(value, np.float64))
            data = " ".join(f"{number:.16e}" for number in array.ravel())
            shape = f"<rows>{array.shape[0]}</rows>\n  <cols>{array.shape[1]}</cols>"
            text += f'<{name} type_id="opencv-matrix">\n  {shape}\n  <dt>d</dt>\n  <data>\n    {data}</data></{name}>\n'
        else:
            words = " ".join(str(each) for each in np.atleast_1d(np.asarray(value)).tolist())
            text += f"<{name}>\n  {words}</{name}>\n"
    return text + "</opencv_storage>\n"


def opencv_json(entries: dict[str, Any]) -> str:
    def plain(value: Any) -> Any:
        array = np.asarray(value)
        if array.size <= 2:
            return array.tolist()
        array = np.atleast_2d(array)
        shape = {"rows": array.shape[0], "cols": array.shape[1]}
        return {"type_id": "opencv-matrix", **shape, "dt": "d", "data": array.ravel().tolist()}

    return json.dumps({name: plain(value) for name, value in entries.items()}, indent=4)


def opencv_intrinsics(rig: Truth) -> dict[str, Any]:
    return {"M1": rig.K_left, "D1": rig.D_left, "M2": rig.K_right, "D2": rig.D_right}


def opencv_extrinsics(rig: Truth, rectified: bool) -> dict[str, Any]:
    entries: dict[str, Any] = {"R": rig.R, "T": rig.T.reshape(3, 1)}
    if rectified:
        R1, R2, P1, P2, Q, *_ = cv2.stereoRectify(
            *(rig.K_left, rig.D_left, rig.K_right, rig.D_right, SIZE, rig.R, rig.T.reshape(3, 1)),
            flags=cv2.CALIB_ZERO_DISPARITY,
            alpha=1,
        )
        entries |= {"R1": R1, "R2": R2, "P1": P1, "P2": P2, "Q": Q}
    return entries


def camodocal(rig: Truth, side: str, model: str) -> str:
    K, D = (rig.K_left, rig.D_left) if side == "left" else (rig.K_right, rig.D_right)
    focal = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    if model == "KANNALA_BRANDT":
        focal = {
            **dict(zip(("k2", "k3", "k4", "k5"), D, strict=True)),
            "mu": K[0, 0],
            "mv": K[1, 1],
            "u0": K[0, 2],
            "v0": K[1, 2],
        }
    text = (
        f"%YAML:1.0\n---\nmodel_type: {model}\ncamera_name: {side}\nimage_width: {SIZE[0]}\nimage_height: {SIZE[1]}\n"
    )
    if model == "MEI":
        text += "mirror_parameters:\n   xi: 1.2\n"
    if model != "KANNALA_BRANDT":
        count = 8 if model == "PINHOLE_FULL" else 4
        text += "distortion_parameters:\n" + "".join(
            f"   {n}: {float(v)!r}\n" for n, v in zip(names[:count], D, strict=False)
        )
    return (
        text + "projection_parameters:\n" + "".join(f"   {name}: {float(value)!r}\n" for name, value in focal.items())
    )


def camodocal_extrinsics(rig: Truth) -> str:
    angle = float(np.linalg.norm(cv2.Rodrigues(rig.R)[0]))
    axis = cv2.Rodrigues(rig.R)[0].ravel() / angle
    q = np.sin(angle / 2) * axis
    rows = [f"   q_{n}: {float(v)!r}" for n, v in zip("xyz", q, strict=True)] + [
        f"   q_w: {float(np.cos(angle / 2))!r}"
    ]
    rows += [f"   t_{n}: {float(v)!r}" for n, v in zip("xyz", rig.T, strict=True)]
    return "%YAML:1.0\n---\ntransform:\n" + "\n".join(rows) + "\n"


def vins(rig: Truth, swapped: bool = False) -> str:
    T_body_left = np.vstack(
        [np.column_stack([cv2.Rodrigues(np.array([-0.4, 1.3, 0.2]))[0], [0.01, 0.07, -0.02]]), [0, 0, 0, 1]]
    )
    bodies, names = [T_body_left, T_body_left @ np.linalg.inv(rig.T_right_left)], ["left", "right"]
    if swapped:
        bodies, names = bodies[::-1], names[::-1]
    text = f'%YAML:1.0\n\nimu: 1\nnum_of_cam: 2\nimu_topic: "/imu0"\ncam0_calib: "cam_{names[0]}.yaml"\n'
    text += f'cam1_calib: "cam_{names[1]}.yaml"\nimage_width: {SIZE[0]}\nimage_height: {SIZE[1]}\n\n'
    return text + opencv_matrix("body_T_cam0", bodies[0]) + "\n" + opencv_matrix("body_T_cam1", bodies[1])


def depthai(rig: Truth, fisheye: bool = False, size: tuple[int, int] = SIZE, link: str = "left") -> str:
    """Sockets 1 (left) and 2 (right), the color camera in socket 0; the link from left to right or back."""

    def extrinsics(T: F64, to: int) -> dict[str, Any]:
        shift = dict(zip("xyz", (100 * T[:3, 3]).tolist(), strict=True))
        return {
            "rotationMatrix": T[:3, :3].tolist(),
            "specTranslation": {"x": -7.5, "y": 0.0, "z": 0.0},
            "toCameraSocket": to,
            "translation": shift,
        }

    none = {
        "rotationMatrix": [],
        "specTranslation": {"x": 0.0, "y": 0.0, "z": 0.0},
        "toCameraSocket": -1,
        "translation": {"x": 0.0, "y": 0.0, "z": 0.0},
    }
    T = rig.T_right_left
    links = {1: extrinsics(T, 2), 2: none} if link == "left" else {1: none, 2: extrinsics(np.linalg.inv(T), 1)}

    def camera(K: F64, D: F64, link: dict[str, Any]) -> dict[str, Any]:
        return {
            "cameraType": int(fisheye),
            "distortionCoeff": [*D.tolist(), *[0.0] * (14 - D.size)],
            "extrinsics": link,
            "height": size[1],
            "intrinsicMatrix": K.tolist(),
            "lensPosition": 0,
            "specHfovDeg": 71.86,
            "width": size[0],
        }

    color = camera(_K(1500.5, 1501.5, 960.25, 540.75), np.zeros(14), none)
    cameras = [
        [0, color],
        [1, camera(rig.K_left, rig.D_left, links[1])],
        [2, camera(rig.K_right, rig.D_right, links[2])],
    ]
    stereo = {
        "leftCameraSocket": 1,
        "rectifiedRotationLeft": np.identity(3).tolist(),
        "rectifiedRotationRight": np.identity(3).tolist(),
        "rightCameraSocket": 2,
    }
    return json.dumps(
        {"boardName": "BW1098OBC", "cameraData": cameras, "stereoRectificationData": stereo, "version": 7}, indent=4
    )


def euroc(rig: Truth, side: str) -> str:
    K, D = (rig.K_left, rig.D_left) if side == "left" else (rig.K_right, rig.D_right)
    T_body_left = np.vstack(
        [np.column_stack([cv2.Rodrigues(np.array([0.4, -0.3, 1.2]))[0], [0.03, -0.01, 0.02]]), [0, 0, 0, 1]]
    )
    T = T_body_left if side == "left" else T_body_left @ np.linalg.inv(rig.T_right_left)
    return (
        "# General sensor definitions.\nsensor_type: camera\ncomment: VI-Sensor\n\nT_BS:\n  cols: 4\n  rows: 4\n"
        f"  data: {T.ravel().tolist()}\n\nrate_hz: 20\nresolution: [{SIZE[0]}, {SIZE[1]}]\ncamera_model: pinhole\n"
        f"intrinsics: {_intrinsics(K)} #fu, fv, cu, cv\ndistortion_model: radial-tangential\n"
        f"distortion_coefficients: {D[:4].tolist()}\n"
    )


def orb_slam(rig: Truth, model: str) -> str:
    text = f'%YAML:1.0\n\nFile.version: "1.0"\n\nCamera.type: "{model}"\n\n'
    names = ("k1", "k2", "p1", "p2", "k3") if model == "PinHole" else ("k1", "k2", "k3", "k4")
    for number, K, D in ((1, rig.K_left, rig.D_left), (2, rig.K_right, rig.D_right)):
        values = [("fx", K[0, 0]), ("fy", K[1, 1]), ("cx", K[0, 2]), ("cy", K[1, 2]), *zip(names, D, strict=True)]
        text += "".join(f"Camera{number}.{name}: {float(value)!r}\n" for name, value in values) + "\n"
    text += f"Camera.width: {SIZE[0]}\nCamera.height: {SIZE[1]}\nCamera.fps: 20\nCamera.RGB: 1\nStereo.ThDepth: 60.0\n"
    return text + opencv_matrix("Stereo.T_c1_c2", np.linalg.inv(rig.T_right_left))


def videre(cameras: list[tuple[str, F64, F64, F64, F64]]) -> str:
    """Name, K, D, R and P of each camera, as camera_calibration's ost()."""

    def rows(matrix: F64) -> str:
        return "".join(
            " ".join(f"{value!r}".replace("np.float64(", "").replace(")", "") for value in row) + "\n" for row in matrix
        )

    text = ""
    for name, K, D, R, P in cameras:
        text += f"# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n{SIZE[0]}\n\nheight\n{SIZE[1]}\n\n[{name}]\n\n"
        text += f"camera matrix\n{rows(K)}\ndistortion\n{rows(D.reshape(1, -1))}\n"
        text += f"rectification\n{rows(R)}\nprojection\n{rows(P)}\n"
    return text
