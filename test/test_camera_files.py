# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration files of every format: the rig that was written, checked by the pixels of 3-D points in OpenCV."""

from __future__ import annotations

import io
import math
import tarfile
from pathlib import Path

import camera_file_texts as texts
import cv2
import numpy as np
import pytest
from camera_file_texts import SIZE, Truth, truth

from stereo_depth_ros.camera_files.formats import FORMATS
from stereo_depth_ros.camera_files.reading import read_rig_files, rig_file_paths
from stereo_depth_ros.core.camera_yaml import camera_to_yaml
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

POINTS = np.array([[-0.31, 0.12, 1.1], [0.42, -0.27, 1.7], [0.05, 0.03, 0.6], [-0.9, -0.5, 3.0]])


def pixels(model: str, K: F64, D: F64, points: F64) -> F64:
    """The pixels of points in the frame of a camera, by OpenCV; float64 (N, 2)."""
    origin = np.zeros(3)
    if model == "equidistant":
        found = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), origin, origin, K, D)[0]
    else:
        found = cv2.projectPoints(points, origin, origin, K, D)[0]
    return found.reshape(-1, 2)


def check(rig: StereoRig, true: Truth, tolerance: float = 1e-9) -> None:
    """K, D, model and size of the file, and the pixels of the points: raw in both cameras, and rectified."""
    assert (rig.width, rig.height) == SIZE
    right = POINTS @ true.R.T + true.T
    rectified = POINTS @ rig.left.R.T
    found_right = (rectified - [rig.baseline_m, 0, 0]) @ rig.right.R
    for camera, K, D, expected, found in (
        (rig.left, true.K_left, true.D_left, POINTS, POINTS),
        (rig.right, true.K_right, true.D_right, right, found_right),
    ):
        assert camera.distortion_model == true.model
        np.testing.assert_allclose(camera.K, K, rtol=tolerance)
        used = max(len(np.trim_zeros(D, "b")), 4)
        np.testing.assert_allclose(camera.D[:used], D[:used], rtol=tolerance)
        assert not camera.D[used:].any()
        np.testing.assert_allclose(
            pixels(camera.distortion_model, camera.K, camera.D, found),
            pixels(true.model, K, D, expected),
            atol=1e5 * tolerance,
        )
    x_left = rig.f_px * rectified[:, 0] / rectified[:, 2] + rig.cx_left
    x_right = rig.f_px * (rectified[:, 0] - rig.baseline_m) / rectified[:, 2] + rig.cx_right
    assert (x_left - x_right > rig.doffs_px).all()
    assert rig.baseline_m == pytest.approx(float(np.linalg.norm(true.T)), rel=1e-6)


def write(folder: Path, files: dict[str, str]) -> list[Path]:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return [folder / name for name in files]


def opencv_pair(rig: Truth, **changes: object) -> dict[str, str]:
    return {
        "intrinsics.yml": texts.opencv_yaml(
            {**texts.opencv_intrinsics(rig), "image_width": SIZE[0], "image_height": SIZE[1]}
        ),
        "extrinsics.yml": texts.opencv_yaml(texts.opencv_extrinsics(rig, rectified=True), **changes),  # type: ignore[arg-type]
    }


def other_names(rig: Truth) -> dict[str, object]:
    return {
        "cameraMatrixLeft": rig.K_left,
        "cameraMatrixRight": rig.K_right,
        "distCoeffsLeft": rig.D_left,
        "distCoeffsRight": rig.D_right,
        "imageSize": list(SIZE),
        "rotationMatrix": rig.R,
        "translationVector": rig.T.reshape(3, 1),
    }


def short_names(rig: Truth) -> dict[str, object]:
    sizes = {"image_width": SIZE[0], "image_height": SIZE[1]}
    poses = {"R": cv2.Rodrigues(rig.R)[0], "T": rig.T.reshape(3, 1)}
    return {"K1": rig.K_left, "K2": rig.K_right, "D1": rig.D_left, "D2": rig.D_right, **sizes, **poses}


def extrinsics(rig: Truth) -> dict[str, str]:
    return {"extrinsics.yaml": texts.camodocal_extrinsics(rig)}


def euroc(rig: Truth, place: str = "") -> dict[str, str]:
    return {f"{place}cam{at}/sensor.yaml": texts.euroc(rig, side) for at, side in enumerate(("left", "right"))}


def camodocal_pair(rig: Truth, model: str) -> dict[str, str]:
    return {f"cam_{side}.yaml": texts.camodocal(rig, side, model) for side in ("left", "right")}


def four_coefficients(rig: Truth) -> dict[str, str]:
    lens = {"D1": rig.D_left[:4], "D2": rig.D_right[:4], "distortion_model": "plumb_bob"}
    return {"s.yml": texts.opencv_yaml({**short_names(rig), **lens})}


P5, P8, P14, FISH = "plumb_bob 5", "rational_polynomial", "rational_polynomial 14", "equidistant"
# Format, lens, the files, and how many of them are given
WRITTEN = {
    "kalibr radtan": ("plumb_bob", lambda rig: {"camchain.yaml": texts.camchain(rig, "radtan")}, 1),
    "kalibr equi": (FISH, lambda rig: {"camchain.yaml": texts.camchain(rig, "equidistant")}, 1),
    "kalibr equi, short": (FISH, lambda rig: {"camchain.yaml": texts.camchain(rig, "equi")}, 1),
    "kalibr none": ("none", lambda rig: {"camchain.yaml": texts.camchain(rig, "none")}, 1),
    "kalibr, cam0 is right": ("plumb_bob", lambda rig: {"c.yaml": texts.camchain(rig, "radtan", swapped=True)}, 1),
    "kalibr imu": ("plumb_bob", lambda rig: {"c.yaml": texts.camchain(rig, "radtan", pose="T_cam_imu")}, 1),
    "openvins": (
        FISH,
        lambda rig: {"c.yaml": "%YAML:1.0\n\n" + texts.camchain(rig, "equidistant", pose="T_imu_cam")},
        1,
    ),
    "opencv rectified": (P5, opencv_pair, 2),
    "opencv other order": (P5, lambda rig: dict(reversed(opencv_pair(rig).items())), 2),
    "opencv no dashes": (P5, lambda rig: opencv_pair(rig, dashes=False), 2),
    "opencv folder": (P5, opencv_pair, 0),
    "opencv one file": (P8, lambda rig: {"stereo.yml": texts.opencv_yaml(other_names(rig))}, 1),
    "opencv rotation vector": (P14, lambda rig: {"stereo.yml": texts.opencv_yaml(short_names(rig))}, 1),
    "opencv xml": (P5, lambda rig: {"stereo.xml": texts.opencv_xml(other_names(rig))}, 1),
    "opencv json": (P14, lambda rig: {"stereo.json": texts.opencv_json(short_names(rig))}, 1),
    "opencv fisheye": (
        FISH,
        lambda rig: {"stereo.yml": texts.opencv_yaml({**short_names(rig), "fisheye_model": 1})},
        1,
    ),
    "opencv named": (
        "plumb_bob",
        lambda rig: four_coefficients(rig),
        1,
    ),
    "camodocal": ("plumb_bob", lambda rig: {**camodocal_pair(rig, "PINHOLE"), **extrinsics(rig)}, 2),
    "camodocal fisheye": (FISH, lambda rig: {**camodocal_pair(rig, "KANNALA_BRANDT"), **extrinsics(rig)}, 1),
    "camodocal full": (P8, lambda rig: {**camodocal_pair(rig, "PINHOLE_FULL"), **extrinsics(rig)}, 2),
    "vins": ("plumb_bob", lambda rig: {"vins.yaml": texts.vins(rig), **camodocal_pair(rig, "PINHOLE")}, 1),
    "vins, cam0 is right": (
        FISH,
        lambda rig: {"vins.yaml": texts.vins(rig, swapped=True), **camodocal_pair(rig, "KANNALA_BRANDT")},
        1,
    ),
    "depthai": (P14, lambda rig: {"calib.json": texts.depthai(rig)}, 1),
    "depthai, other link": (P14, lambda rig: {"calib.json": texts.depthai(rig, link="right")}, 1),
    "depthai fisheye": (FISH, lambda rig: {"calib.json": texts.depthai(rig, fisheye=True)}, 1),
    "euroc": ("plumb_bob", euroc, 2),
    "euroc folder": ("plumb_bob", lambda rig: euroc(rig, "mav0/"), 0),
    "orb-slam": (P5, lambda rig: {"stereo.yaml": texts.orb_slam(rig, "PinHole")}, 1),
    "orb-slam fisheye": (FISH, lambda rig: {"stereo.yaml": texts.orb_slam(rig, "KannalaBrandt8")}, 1),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_what_was_written_is_read(tmp_path: Path, name: str) -> None:
    lens, files, given = WRITTEN[name]
    true = truth(lens)
    paths = write(tmp_path, files(true))
    check(read_rig_files(paths[:given] if given else [tmp_path]), true)


def rectified_rig(model: str = "plumb_bob 5") -> tuple[StereoRig, Truth]:
    true = truth(model)
    matrices = true.K_left, true.D_left, true.K_right, true.D_right, true.R, true.T
    return StereoRig.from_calibration(*matrices, SIZE, true.model), true


def ros_yaml(rig: StereoRig) -> dict[str, str]:
    return {f"{side}.yaml": camera_to_yaml(camera, side) for side, camera in (("left", rig.left), ("right", rig.right))}


def ost(rig: StereoRig) -> str:
    sides = (("narrow_stereo/left", rig.left), ("narrow_stereo/right", rig.right))
    return texts.videre([(name, each.K, each.D, each.R, each.P) for name, each in sides])


@pytest.mark.parametrize("lens", [P5, P8])
def test_videre_ini(tmp_path: Path, lens: str) -> None:
    rig, true = rectified_rig(lens)
    left, right = ost(rig).split("# oST")[1:]
    check(read_rig_files(write(tmp_path, {"ost.txt": ost(rig)})), true)
    check(read_rig_files(write(tmp_path, {"left.ini": f"# oST{left}", "right.ini": f"# oST{right}"})), true)
    check(read_rig_files([tmp_path / "right.ini"]), true)


@pytest.mark.parametrize("suffix", ["tar.gz", "tar"])
@pytest.mark.parametrize("kind", ["yaml", "ost"])
def test_calibrationdata(tmp_path: Path, suffix: str, kind: str) -> None:
    rig, true = rectified_rig()
    files = {"left-0000.png": "\x89PNG" * 9999, "ost.txt": ost(rig), "ost.yaml": ros_yaml(rig)["left.yaml"]}
    files |= ros_yaml(rig) if kind == "yaml" else {}
    path = tmp_path / f"calibrationdata.{suffix}"
    with tarfile.open(path, "w:gz" if suffix == "tar.gz" else "w") as archive:
        for name, text in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(text.encode())
            archive.addfile(member, io.BytesIO(text.encode()))
    check(read_rig_files([path]), true)
    check(read_rig_files([tmp_path] if suffix == "tar.gz" else [path]), true)
    assert rig_file_paths([path]) == [path]


def test_camera_calibration_with_what_opencv_writes(tmp_path: Path) -> None:
    """The same keys with tags, without distortion_model: plumb_bob."""
    rig, true = rectified_rig()
    files = {}
    for name, text in ros_yaml(rig).items():
        text = text.replace("distortion_model: plumb_bob\n", "").replace(
            "camera_matrix:", "camera_matrix: !!opencv-matrix"
        )
        files[f"narrow_{name}"] = f"%YAML:1.0\n---\n{text}"
    write(tmp_path, files)
    check(read_rig_files([tmp_path / "narrow_right.yaml"]), true)


def test_kalibr_fov(tmp_path: Path) -> None:
    """The oracle: the formula of Devernay and Faugeras."""
    true, w = truth("none"), 0.93
    path = tmp_path / "camchain.yaml"
    text = texts.camchain(true, "fov").replace("distortion_coeffs: [0.0, 0.0, 0.0, 0.0]", f"distortion_coeffs: [{w}]")
    path.write_text(text)
    rig = read_rig_files([path])
    found = pixels(rig.left.distortion_model, rig.left.K, rig.left.D, POINTS)
    flat = POINTS[:, :2] / POINTS[:, 2:]
    radius = np.linalg.norm(flat, axis=1)
    distorted = np.arctan(2 * radius * math.tan(w / 2)) / w
    expected = true.K_left[[0, 1], [2, 2]] + flat * (distorted / radius)[:, None] * true.K_left[[0, 1], [0, 1]]
    np.testing.assert_allclose(found, expected, atol=0.1)
    path.write_text(text.replace(f"[{w}]", "[4.1]"))
    with pytest.raises(CalibrationError, match=r"camchain\.yaml: w of the FOV model is 4\.1, not 0 to pi"):
        read_rig_files([path])


def test_rectified_formats(tmp_path: Path) -> None:
    stereodemo = '{"width": 640, "height": 400, "baseline_meters": 0.075, "fx": 451.5, "fy": 452, "cy": 190.25, '
    kitti = "P0: 451.5 0 299 0 0 452 190.25 0 0 0 1 0\nP1: 451.5 0 303.5 -33.8625 0 452 190.25 0 0 0 1 0\n"
    middlebury = "cam0=[451.5 0 299; 0 452 190.25; 0 0 1]\ncam1=[451.5 0 303.5; 0 452 190.25; 0 0 1]\ndoffs=4.5\n"
    orb = 'Camera.type: "Rectified"\nCamera1.fx: 451.5\nCamera1.fy: 452.0\nCamera1.cx: 299.0\nCamera1.cy: 190.25\n'
    texts_by_name = {
        "a.json": stereodemo + '"cx0": 299, "cx1": 303.5}',
        "calib.txt": kitti,
        "numbers.txt": kitti.replace("P0: ", "").replace("P1: ", ""),
        "m.txt": middlebury + "baseline=75\nwidth=640\nheight=400\nndisp=64\n",
        "orb.yaml": orb + "Stereo.b: 0.075\n",
    }
    for path in write(tmp_path, texts_by_name):
        rig = read_rig_files([path], SIZE)
        cx_right = 299 if path.name == "orb.yaml" else 303.5
        assert (rig.f_px, rig.fy_px, rig.cx_left, rig.cx_right, rig.cy) == (451.5, 452, 299, cx_right, 190.25)
        assert rig.baseline_m == pytest.approx(0.075) and (rig.width, rig.height) == SIZE
    for name in ("calib.txt", "orb.yaml"):
        with pytest.raises(CalibrationError, match=f"{name}: does not state the size of the images"):
            read_rig_files([tmp_path / name])


@pytest.mark.parametrize(
    ("size", "scale", "shift"), [((320, 200), 0.5, (0, 0)), ((640, 360), 1.0, (0, 20)), ((300, 200), 0.5, (10, 0))]
)
def test_depthai_of_smaller_images(
    tmp_path: Path, size: tuple[int, int], scale: float, shift: tuple[float, float]
) -> None:
    """As DepthAI: scaled so that the image is filled, what sticks out is cropped on both sides."""
    true = truth("rational_polynomial 14")
    (path,) = write(tmp_path, {"calib.json": texts.depthai(true)})
    rig = read_rig_files([path], size)
    expected = np.diag([scale, scale, 1]) @ true.K_left
    expected[:2, 2] -= shift
    np.testing.assert_allclose(rig.left.K, expected)
    assert (rig.width, rig.height) == size


def test_the_size_of_the_images_where_the_file_has_none(tmp_path: Path) -> None:
    true = truth("plumb_bob 5")
    entries = {**texts.opencv_intrinsics(true), **texts.opencv_extrinsics(true, rectified=False)}
    paths = write(tmp_path, {"stereo.yml": texts.opencv_yaml(entries)})
    check(read_rig_files(paths, SIZE), true)
    with pytest.raises(CalibrationError, match=r"stereo\.yml: M1: does not state the size") as caught:
        read_rig_files(paths)
    assert caught.value.settings == ("size",)


def test_every_format_has_a_test_and_a_row_in_the_documentation() -> None:
    table = (Path(__file__).resolve().parents[1] / "docs" / "calibration.md").read_text()
    assert [form.name for form in FORMATS if f"| {form.name} |" not in table] == []


def chain(lens: str, **changes: str) -> str:
    return texts.camchain(truth("plumb_bob"), lens, **changes)  # type: ignore[arg-type]


def stereo(lens: str, **changes: object) -> dict[str, str]:
    return {"s.yml": texts.opencv_yaml({**short_names(truth(lens)), **changes})}


PLUMB_BOB, T = truth("plumb_bob"), truth("plumb_bob").T.reshape(3, 1)
VINS, DEPTHAI, ORB = texts.vins(PLUMB_BOB), texts.depthai(truth(P14)), texts.orb_slam(truth(P5), "PinHole")
REFUSED = {
    "kalibr omni": (
        {"c.yaml": chain("radtan").replace("pinhole", "omni")},
        r"c\.yaml: Kalibr camchain of a camera of model 'omni' \(cam0\)",
    ),
    "kalibr ds": ({"c.yaml": chain("none").replace("pinhole", "ds")}, "Kalibr camchain of a camera of model 'ds'"),
    "kalibr one": ({"c.yaml": chain("radtan").split("cam1:")[0]}, r"c\.yaml: Kalibr camchain, one camera"),
    "kalibr no pose": ({"c.yaml": chain("radtan", pose="none")}, "camchain without the pose of cam1, T_cn_cnm1"),
    "kalibr lens": ({"c.yaml": chain("double")}, "Kalibr camchain with distortion_model 'double'"),
    "kalibr count": (
        {"c.yaml": chain("radtan").replace("[-0.28, ", "[")},
        r"cam0\.distortion_coeffs has 3 values, not 4",
    ),
    "opencv intrinsics": (
        {"i.yml": texts.opencv_yaml(texts.opencv_intrinsics(truth(P5)))},
        r"i\.yml: OpenCV FileStorage, intrinsics only: give the file of R and T too",
    ),
    "opencv extrinsics": (
        {"e.yml": texts.opencv_yaml(texts.opencv_extrinsics(truth(P5), True))},
        r"e\.yml: OpenCV FileStorage, extrinsics only: give the file of the intrinsics",
    ),
    "opencv millimeters": (stereo(P5, T=1000 * T), "baseline 120.307 m is outside .* millimeters"),
    "opencv swapped": (stereo(P5, T=-T), "left and right are probably swapped"),
    "opencv four": (stereo(FISH), r"s\.yml: D1 has 4 coefficients, which may be those of a pinhole .* add the row"),
    "opencv shear": (stereo(P5, R=1.1 * np.identity(3)), "R = .* is not a rotation"),
    "mei": (
        camodocal_pair(PLUMB_BOB, "MEI"),
        r"cam_left\.yaml: camodocal camera of model_type 'MEI', an omnidirectional camera",
    ),
    "camodocal": (camodocal_pair(PLUMB_BOB, "PINHOLE"), r"cam_left\.yaml: camodocal camera, intrinsics only"),
    "vins one": ({"v.yaml": VINS.split("body_T_cam1")[0]}, r"v\.yaml: VINS settings of one camera"),
    "vins alone": ({"v.yaml": VINS}, r"v\.yaml: .*cam_left\.yaml: does not exist"),
    "depthai one": (
        {"d.json": DEPTHAI.replace("[\n            2,", "[\n            5,")},
        "DepthAI calibration without the camera of socket 2",
    ),
    "depthai links": (
        {"d.json": DEPTHAI.replace('"toCameraSocket": 2', '"toCameraSocket": -1')},
        "DepthAI calibration without extrinsics from socket 1 to 2",
    ),
    "orb one": ({"o.yaml": ORB.replace("Camera2.", "Camera3.")}, "ORB-SLAM3 settings of one camera"),
    "unknown": ({"u.yaml": "a: 1\nb: 2\n"}, r"u\.yaml: is not a calibration of a known format, it has 'a', 'b'"),
    "text": ({"u.yaml": "hello\n"}, r"u\.yaml: is not a calibration file, it has no keys"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_named_by_its_format(tmp_path: Path, name: str) -> None:
    files, match = REFUSED[name]
    paths = write(tmp_path, files)
    with pytest.raises(CalibrationError, match=match) as caught:
        read_rig_files(paths)
    assert caught.value.subject and caught.value.remedy and "\n" not in str(caught.value)
