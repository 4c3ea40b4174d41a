# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fields of view: of pinholes by the arc tangent, of lenses by projecting rays at the angles found."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.geometry.field_of_view import field_of_view

K = np.array([[300.0, 0, 290.0], [0, 320.0, 260.0], [0, 0, 1]])
BARE = CameraModel(640, 500, "plumb_bob", K, np.zeros(5), np.identity(3), np.identity(4)[:3])


def test_pinhole() -> None:
    found = field_of_view(BARE)
    assert found.horizontal_deg == pytest.approx(math.degrees(math.atan(290.5 / 300) + math.atan(349.5 / 300)))
    assert found.vertical_deg == pytest.approx(math.degrees(math.atan(260.5 / 320) + math.atan(239.5 / 320)))
    corners = [math.hypot(x / 300, y / 320) for x, y in ((290.5, 260.5), (349.5, 239.5))]
    assert found.diagonal_deg == pytest.approx(math.degrees(sum(map(math.atan, corners))))


@pytest.mark.parametrize(
    ("model", "D"), [("plumb_bob", [-0.2, 0.03, 0, 0, 0.0]), ("equidistant", [-0.02, 0.004, -0.001, 0.0])]
)
def test_rays_at_the_edges_are_seen_there(model: str, D: list[float]) -> None:
    """Of a camera whose principal point is in the middle, so that half of the angle is on each side."""
    middle = np.array([[300.0, 0, 319.5], [0, 320.0, 249.5], [0, 0, 1]])
    camera = replace(BARE, distortion_model=model, D=np.array(D), K=middle)
    half = np.radians(field_of_view(camera).horizontal_deg) / 2
    ray = np.array([[[math.tan(half), 0.0, 1.0]]])
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    x, y = project(ray, np.zeros(3), np.zeros(3), camera.K, camera.D)[0][0, 0]
    assert (x, y) == (pytest.approx(639.5, abs=0.01), pytest.approx(249.5, abs=0.01))
    assert field_of_view(camera).horizontal_deg > field_of_view(replace(BARE, K=middle)).horizontal_deg


def test_fisheyes_may_see_behind_themselves() -> None:
    fisheye = replace(BARE, distortion_model="equidistant", D=np.zeros(4), K=K * [[0.5, 1, 1], [1, 0.5, 1], [1, 1, 1]])
    found = field_of_view(fisheye)
    assert found.horizontal_deg == pytest.approx(math.degrees(640 / 150))
    assert found.horizontal_deg > 180


@pytest.mark.parametrize(("model", "D"), [("plumb_bob", [-0.9, 0, 0, 0, 0]), ("equidistant", [-0.4, 0, 0, 0])])
def test_beyond_the_distortion_range_there_is_no_field_of_view(model: str, D: list[float]) -> None:
    found = field_of_view(replace(BARE, distortion_model=model, D=np.array(D)))
    assert math.isnan(found.diagonal_deg)
