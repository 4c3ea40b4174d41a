# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectification: against OpenCV's projection of points in space, and on a real sequence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ruamel.yaml import YAML

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import Frame, RectifiedPair, StereoPair
from stereo_depth_ros.stages.rectification import Rectifier

SIZE = WIDTH, HEIGHT = 320, 200
K_LEFT = np.array([[250.0, 0, 148], [0, 262, 103], [0, 0, 1]])
K_RIGHT = np.array([[257.0, 0, 171], [0, 249, 96], [0, 0, 1]])
ROTATION_VECTOR, T = np.array([0.02, -0.06, 0.03]), np.array([-0.12, 0.004, 0.01])
R = cv2.Rodrigues(ROTATION_VECTOR)[0]
DISTORTIONS = {
    "plumb_bob": [-0.28, 0.08, 1e-3, -2e-3, 0.01],
    "rational_polynomial": [0.4, -0.2, 1e-3, -2e-3, 0.05, 0.7, -0.1, 0.08],
    "equidistant": [-0.03, 0.02, -0.01, 0.003],
}
# Maps have steps of 1/32 px, so half a step is lost at most; the rest is float32.
MAP_TOLERANCE_PX = 1 / 64 + 1e-3


def verged_rig(model: str = "plumb_bob") -> StereoRig:
    D = np.array(DISTORTIONS[model])
    return StereoRig.from_calibration(K_LEFT, D, K_RIGHT, 0.8 * D, R, T, SIZE, model)


def random_frame(seed: int, encoding: str = "mono8") -> Frame:
    shape = (HEIGHT, WIDTH) if encoding == "mono8" else (HEIGHT, WIDTH, 3)
    pixels = np.random.default_rng(seed).integers(1, 256, shape, np.uint8)
    pixels.setflags(write=False)
    return Frame(pixels, 5, "left_frame", encoding)


def project(points: np.ndarray, rvec: np.ndarray, tvec: np.ndarray, K: np.ndarray, D: Any, model: str) -> np.ndarray:
    D = np.array(D)
    if model == "equidistant":
        return cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), rvec, tvec, K, D)[0].reshape(-1, 2)
    return cv2.projectPoints(points, rvec, tvec, K, D)[0].reshape(-1, 2)


@pytest.mark.parametrize("model", DISTORTIONS)
def test_a_point_has_one_row_and_its_disparity(model: str) -> None:
    """Points on whole rectified pixels (x, y) with whole disparities: both raw projections must be found there."""
    rig = verged_rig(model)
    y, x, d = (grid.ravel() for grid in np.mgrid[5:HEIGHT:13, 30:WIDTH:17, 3:28:8])
    homogeneous = np.stack([x, y, d, np.ones_like(x)]).T @ rig.Q.T
    points = homogeneous[:, :3] / homogeneous[:, 3:] @ rig.left.R  # rows times R is R^T times columns
    raw_left = project(points, np.zeros(3), np.zeros(3), K_LEFT, rig.left.D, model)
    raw_right = project(points, ROTATION_VECTOR, T, K_RIGHT, rig.right.D, model)

    # Pixel values are their positions, so the rectified images give the source of each pixel.
    places: Any = np.dstack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))).astype(np.float32)
    rectifier = Rectifier(rig)
    from_left = rectifier.rectify_left(places)[y, x]
    from_right = rectifier.rectify_right(places)[y, x - d]
    seen = rectifier.left_source[y, x] & rectifier.right_source[y, x - d]
    assert seen.mean() > 0.5
    assert np.abs(from_left - raw_left)[seen].max() < MAP_TOLERANCE_PX
    assert np.abs(from_right - raw_right)[seen].max() < MAP_TOLERANCE_PX
    assert np.abs(raw_left - raw_right)[seen, 1].max() > 3  # the raw rows did not agree


def test_source_masks_are_the_pixels_inside_the_raw_image() -> None:
    rig = StereoRig.from_calibration(K_LEFT, [], K_RIGHT, [], R, T, SIZE, alpha=1.0)
    rectifier = Rectifier(rig)
    for mask, camera in ((rectifier.left_source, rig.left), (rectifier.right_source, rig.right)):
        map_x, map_y = cv2.initUndistortRectifyMap(camera.K, np.zeros(5), camera.R, camera.P[:, :3], SIZE, cv2.CV_32FC1)
        beyond = np.maximum(np.abs(map_x - (WIDTH - 1) / 2) - (WIDTH - 1) / 2, np.abs(map_y - 99.5) - 99.5)
        assert mask[beyond < -1 / 32].all()
        assert not mask[beyond > 1 / 32].any()
        assert 0.3 < mask.mean() < 1


def test_distortion_alone_is_removed() -> None:
    rig = StereoRig.from_rectified(250, 262, 148, 171, 103, 0.12, SIZE)
    rig = replace(rig, left=replace(rig.left, D=np.array([-0.1, 0, 0, 0])))
    frame = random_frame(1)
    rectified = Rectifier(rig).rectify(StereoPair(frame, frame))
    assert not np.array_equal(rectified.left, frame.pixels)
    assert rectified.right is frame.pixels


def test_zero_distortion_still_rotates() -> None:
    rig = StereoRig.from_calibration(K_LEFT, np.zeros(5), K_LEFT, [], R, T, SIZE)
    frame = random_frame(1)
    rectified = Rectifier(rig).rectify(StereoPair(frame, frame))
    assert not np.array_equal(rectified.left, frame.pixels)
    assert not np.array_equal(rectified.right, frame.pixels)


def test_rectified_images_pass_uncopied() -> None:
    rig = StereoRig.from_rectified(250, 262, 148, 171, 103, 0.12, SIZE)
    pair = StereoPair(random_frame(1), random_frame(2, "bgr8"))
    rectified = Rectifier(rig).rectify(pair)
    assert rectified.left is pair.left.pixels
    assert rectified.left_color is pair.left.pixels
    np.testing.assert_array_equal(rectified.right, cv2.cvtColor(pair.right.pixels, cv2.COLOR_BGR2GRAY))
    assert Rectifier(rig).left_source.all()


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8"])
def test_pair_has_the_bytes_of_single_images(encoding: str) -> None:
    rectifier = Rectifier(verged_rig())
    pair = StereoPair(random_frame(1, encoding), random_frame(2, encoding))
    to_gray = {"mono8": None, "rgb8": cv2.COLOR_RGB2GRAY, "bgr8": cv2.COLOR_BGR2GRAY}[encoding]
    grays = [f.pixels if to_gray is None else cv2.cvtColor(f.pixels, to_gray) for f in (pair.left, pair.right)]
    rectified = rectifier.rectify(pair)
    np.testing.assert_array_equal(rectified.left, rectifier.rectify_left(grays[0]))
    np.testing.assert_array_equal(rectified.right, rectifier.rectify_right(grays[1]))
    np.testing.assert_array_equal(rectified.left_color, rectifier.rectify_left(pair.left.pixels))
    assert rectified.color_encoding == encoding
    assert (rectified.left_color is rectified.left) == (encoding == "mono8")


@pytest.mark.parametrize("encoding", ["mono8", "rgb8"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_out_is_written(encoding: str, side: str) -> None:
    rectifier = Rectifier(verged_rig())
    rectify = rectifier.rectify_left if side == "left" else rectifier.rectify_right
    first, second = random_frame(1, encoding).pixels, random_frame(3, encoding).pixels
    out = rectify(first)
    fresh, reused = rectify(second), rectify(second, out)
    assert reused is out
    np.testing.assert_array_equal(reused, fresh)


def test_pixels_without_source_are_black() -> None:
    rectifier = Rectifier(StereoRig.from_calibration(K_LEFT, [], K_RIGHT, [], R, T, SIZE, alpha=1.0))
    rectified = rectifier.rectify(StereoPair(random_frame(1), random_frame(2)))
    far_outside = cv2.dilate(rectifier.left_source.astype(np.uint8), np.ones((5, 5))) == 0
    assert far_outside.any()
    assert (rectified.left[far_outside] == 0).all()
    assert (rectified.left[rectifier.left_source] > 0).all()


def test_another_size_is_refused() -> None:
    rectifier = Rectifier(verged_rig())
    small = Frame(np.zeros((HEIGHT, WIDTH - 1), np.uint8), 0, "")
    with pytest.raises(CalibrationError, match="left: the image is 319x200, its camera info is for 320x200"):
        rectifier.rectify(StereoPair(small, random_frame(1)))
    with pytest.raises(CalibrationError, match="right: the image is 319x200, its camera info is for 320x200"):
        rectifier.rectify(StereoPair(random_frame(1), small))


def euroc_rig(folder: Path) -> StereoRig:
    left, right = (
        YAML(typ="safe", pure=True).load((folder / cam / "sensor.yaml").read_text().replace("%YAML:1.0", ""))
        for cam in ("cam0", "cam1")
    )
    T_body_left, T_body_right = (np.reshape(cam["T_BS"]["data"], (4, 4)) for cam in (left, right))
    T_right_left = np.linalg.inv(T_body_right) @ T_body_left
    K_left, K_right = (
        np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1]]) for fu, fv, cu, cv in (left["intrinsics"], right["intrinsics"])
    )
    return StereoRig.from_calibration(
        K_left, left["distortion_coefficients"], K_right, right["distortion_coefficients"],
        T_right_left[:3, :3], T_right_left[:3, 3], left["resolution"],
    )  # fmt: skip


def median_row_error(left: np.ndarray, right: np.ndarray) -> float:
    sift = cv2.SIFT_create(800)
    (points_left, features_left), (points_right, features_right) = (
        sift.detectAndCompute(image, None) for image in (left, right)
    )
    matches = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(features_left, features_right)
    best = sorted(matches, key=lambda match: match.distance)[:150]
    rows = [points_left[m.queryIdx].pt[1] - points_right[m.trainIdx].pt[1] for m in best]
    assert len(rows) == 150
    return float(np.median(np.abs(rows)))


@pytest.mark.real_data
def test_rows_of_a_real_camera_agree(stereo_data: Path) -> None:
    folder = stereo_data / "euroc" / "V1_01_micro" / "mav0"
    rig = euroc_rig(folder)
    assert rig.baseline_m == pytest.approx(0.1101, abs=1e-4)
    name = sorted((folder / "cam0" / "data").glob("*.png"))[7].name
    left, right = (
        Frame(cv2.imread(str(folder / cam / "data" / name), cv2.IMREAD_GRAYSCALE), int(name[:-4]), cam)
        for cam in ("cam0", "cam1")
    )
    rectified: RectifiedPair = Rectifier(rig).rectify(StereoPair(left, right))
    assert median_row_error(left.pixels, right.pixels) > 5
    assert median_row_error(rectified.left, rectified.right) < 0.3
