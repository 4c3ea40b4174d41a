# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distortion models as drivers write them: taken where the numbers have one meaning, and what they mean to OpenCV."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.camera import CameraModel, check_intrinsics
from stereo_depth_ros.core.camera_yaml import camera_from_yaml, camera_to_yaml
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.stages.rectification import rectification_maps

FIVE, EIGHT = [-0.2, 0.1, 1e-3, -2e-3, 0.03], [0.5, -2.6, 8e-4, -4e-4, 1.4, 0.4, -2.4, 1.4]
K = np.array([[400.0, 0, 150], [0, 410, 97], [0, 0, 1]])
P = np.column_stack([K, np.zeros(3)])


def camera(model: str, D: Any) -> CameraModel:
    return CameraModel(320, 200, model, K, np.array(D, np.float64), np.identity(3), P)


@pytest.mark.parametrize(
    ("model", "D", "known", "coefficients"),
    [
        ("plumb_bob", FIVE, "plumb_bob", FIVE),
        ("plumb_bob", FIVE[:4], "plumb_bob", FIVE[:4]),
        ("plumb_bob", [], "plumb_bob", []),
        *(("plumb_bob", [*FIVE, *[0] * more], "plumb_bob", FIVE) for more in (1, 3, 7, 9)),
        ("plumb_bob", EIGHT, "rational_polynomial", EIGHT),
        ("plumb_bob", [*EIGHT, 0, 0, 0, 0], "rational_polynomial", EIGHT),
        ("plumb_bob", [*EIGHT, 0.1, 0, 0, 0], "rational_polynomial", [*EIGHT, 0.1, 0, 0, 0]),
        ("plumb_bob", np.zeros(14), "plumb_bob", np.zeros(5)),
        ("rational_polynomial", EIGHT, "rational_polynomial", EIGHT),
        ("rational_polynomial", FIVE, "rational_polynomial", [*FIVE, 0, 0, 0]),
        ("rational_polynomial", FIVE[:4], "rational_polynomial", [*FIVE[:4], 0, 0, 0, 0]),
        ("equidistant", FIVE[:4], "equidistant", FIVE[:4]),
        ("equidistant", [*FIVE[:4], 0], "equidistant", FIVE[:4]),
        ("equidistant", np.zeros(8), "equidistant", np.zeros(4)),
        ("KANNALA_BRANDT", FIVE[:4], "equidistant", FIVE[:4]),
        ("kannala_brandt", [*FIVE[:4], 0], "equidistant", FIVE[:4]),
        ("", [], "plumb_bob", np.zeros(5)),
        ("", np.zeros(8), "plumb_bob", np.zeros(5)),
        ("none", [], "plumb_bob", np.zeros(5)),
    ],
)
def test_taken(model: str, D: Any, known: str, coefficients: Any) -> None:
    taken = camera(model, D)
    assert taken.distortion_model == known
    np.testing.assert_array_equal(taken.D, coefficients)
    check_intrinsics(taken, "left camera")
    if known != "equidistant" and len(D) in (4, 5, 8, 12, 14):  # OpenCV knows no model names, only counts
        expected = cv2.initUndistortRectifyMap(K, np.array(D, np.float64), None, K, (320, 200), cv2.CV_16SC2)
        maps = rectification_maps(taken)
        assert (maps is None) == (not np.any(D))
        if maps is not None:
            np.testing.assert_array_equal(maps[0], expected[0])


@pytest.mark.parametrize(
    ("model", "D"),
    [
        ("plumb_bob", FIVE[:2]),
        ("plumb_bob", [*FIVE, 0.1]),
        ("plumb_bob", [*EIGHT, 0.1]),
        ("rational_polynomial", []),
        ("rational_polynomial", np.ones(16)),
        ("equidistant", []),
        ("equidistant", FIVE),
        ("", FIVE),
        ("none", FIVE[:4]),
        ("kannala_brandt", [*FIVE[:4], 400, 410, 150, 97]),
        ("fisheye", FIVE[:4]),
        ("inverse_brown_conrady", FIVE),
    ],
)
def test_refused_where_the_numbers_could_mean_something_else(model: str, D: Any) -> None:
    with pytest.raises(CalibrationError, match=r"^left camera: (D has|distortion_model)") as caught:
        check_intrinsics(camera(model, D), "left camera")
    assert caught.value.remedy
    assert ("set equidistant" in caught.value.remedy) == (model == "fisheye")


def test_a_file_without_a_model_is_plumb_bob_as_in_ros() -> None:
    lines = camera_to_yaml(camera("plumb_bob", FIVE), "left").splitlines()
    text = "\n".join(line for line in lines if not line.startswith("distortion_model"))
    assert len(text.splitlines()) == len(lines) - 1
    read = camera_from_yaml(text)
    assert read.distortion_model == "plumb_bob"
    np.testing.assert_array_equal(read.D, FIVE)


def test_a_file_with_only_p_is_of_rectified_images() -> None:
    only_P = replace(camera("", []), K=np.zeros(9), R=np.zeros(9), D=np.zeros(0))
    read = camera_from_yaml(camera_to_yaml(only_P, "left"))
    np.testing.assert_array_equal(read.K, K)
    np.testing.assert_array_equal(read.R, np.identity(3))
