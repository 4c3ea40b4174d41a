# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Points of a range sensor in the left rectified image: where they lie, and which of them the camera does not see."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from rendered_lidar import CAMERA_AXES, hidden_points, lidar_points

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.ranging.projection import project, rectified_from_left
from stereo_depth_ros.ranging.sensor_points import SensorPoints, compensated
from stereo_depth_ros.synthetic.rig import synthetic_rig
from stereo_depth_ros.synthetic.scene import Cylinder, Rectangle, Scene

SIZE = (320, 240)
CAMERA = Triangulation(f_px=430.0, fy_px=417.0, cx_px=156.0, cy_px=118.0, baseline_m=0.12, doffs_px=3.5)
IN_PLACE = Pose.identity()


def scene_with_pole(radius_m: float, distance_m: float = 2.5) -> Scene:
    """A pole and a board before a wall, on a floor."""
    return Scene(
        (
            Rectangle((-8.0, -5.0, 6.0), (16.0, 0.0, 0.0), (0.0, 10.0, 0.0)),
            Rectangle((-8.0, 1.1, 0.5), (16.0, 0.0, 0.0), (0.0, 0.0, 5.5)),
            Cylinder((0.15, -3.0, distance_m), (0.1, 4.1, 0.0), radius_m),
            Rectangle((-0.75, -0.3, 3.2), (0.35, 0.0, 0.1), (0.0, 0.5, 0.0)),
        ),
        1,
    )


def looking_ahead(*position_m: float) -> Pose:
    return Pose(CAMERA_AXES, np.array(position_m))


def test_pixels_and_disparities_by_definition() -> None:
    points = np.array([[0.3, -0.2, 2.0], [-0.5, 0.1, 4.0], [0.0, 0.0, -1.0], [9.0, 0.0, 3.0]], np.float32)
    turn = Pose(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.05, -0.02, 0.4]))
    found = project(points, 0.02, turn, CAMERA, SIZE)
    assert (found.points, found.behind, found.outside, found.occluded, found.merged) == (4, 1, 1, 0, 0)
    for at in (0, 1):
        x, y, z = turn.apply(points[at : at + 1].astype(np.float64))[0]
        pixel = round(417.0 * y / z + 118.0), round(430.0 * x / z + 156.0)
        assert found.index[pixel] == at
        np.testing.assert_allclose(found.disparity_px[pixel], 430.0 * 0.12 / z + 3.5, rtol=1e-6)
        np.testing.assert_allclose(found.sigma_px[pixel], 430.0 * 0.12 / z**2 * 0.02, rtol=1e-6)
    assert found.visible == np.count_nonzero(np.isfinite(found.disparity_px)) == np.count_nonzero(found.index >= 0) == 2


def test_the_nearest_point_of_a_pixel_counts() -> None:
    points = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 2.0], [0.001, 0.0, 2.001]], np.float32)
    found = project(points, 0.01, IN_PLACE, CAMERA, SIZE)
    assert found.index[118, 156] == 1
    assert (found.occluded, found.merged, found.visible) == (1, 1, 1)


# rings and the step of the rays, degrees: dense, as of 64 rings on a car, as of 16 rings
@pytest.mark.parametrize(("rings", "step_deg"), [(256, 0.1), (120, 0.17), (64, 0.35), (25, 0.2)])
@pytest.mark.parametrize("position_m", [(0.0, -0.3, 0.0), (0.25, -0.1, -0.2), (-0.3, 0.0, 0.0)])
def test_what_a_sensor_sees_behind_a_pole_is_removed(
    rings: int, step_deg: float, position_m: tuple[float, float, float]
) -> None:
    for radius_m in (0.02, 0.1):
        scene, lidar = scene_with_pole(radius_m), looking_ahead(*position_m)
        points = lidar_points(scene, lidar, rings=rings, step_deg=step_deg)
        found = project(points, 0.02, lidar, CAMERA, SIZE)
        wrong = hidden_points(scene, lidar.apply(points.astype(np.float64)), np.zeros(3))
        kept = found.index[found.index >= 0]
        assert np.count_nonzero(wrong[kept]) <= 0.01 * len(kept)
        assert np.count_nonzero(~wrong[kept]) >= 0.9 * _right(points, lidar, wrong)


def _right(points: F32, lidar: Pose, wrong: npt.NDArray[np.bool_]) -> int:
    """Pixels that the visible points have, when nothing hides them."""
    without_wrong = points[~wrong]
    x, y, z = lidar.apply(without_wrong.astype(np.float64)).T
    u, v = np.rint(430.0 * x / z + 156.0), np.rint(417.0 * y / z + 118.0)
    inside = (z > 0) & (u >= 0) & (u < SIZE[0]) & (v >= 0) & (v < SIZE[1])
    return len(set(zip(u[inside], v[inside], strict=True)))


def test_a_raw_camera_looks_along_another_axis_than_the_rectified_one() -> None:
    rig = synthetic_rig(*SIZE)
    point = np.array([[0.4, -0.1, 2.5]])
    rectified = rig.left.P[:, :3] @ rig.left.R @ point[0]
    found = project(point.astype(np.float32), 0.0, rectified_from_left(rig), Triangulation.from_rig(rig), SIZE)
    row, column = np.argwhere(found.index == 0)[0]
    np.testing.assert_allclose([column, row], rectified[:2] / rectified[2], atol=0.5)
    depth = rig.f_px * rig.baseline_m / (found.disparity_px[row, column] - rig.doffs_px)
    np.testing.assert_allclose(depth, rectified[2], rtol=1e-6)


def test_points_of_another_type_are_refused() -> None:
    with pytest.raises(ImageError, match=r"points are float64 \(4, 3\)"):
        project(np.zeros((4, 3)), 0.02, IN_PLACE, CAMERA, SIZE)  # type: ignore[arg-type]


def test_without_points_nothing_is_seen() -> None:
    found = project(np.zeros((0, 3), np.float32), 0.02, IN_PLACE, CAMERA, SIZE)
    assert found.visible == found.points == 0
    assert np.isnan(found.disparity_px).all()


def test_points_of_a_moving_sensor_are_each_at_its_own_time() -> None:
    def pose_at(stamp_ns: int) -> Pose:
        angle, way = 0.3 * (stamp_ns - 10**9) / 1e8, 2.0 * (stamp_ns - 10**9) / 1e8
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        return Pose(turn, np.array([way, 0.1, 0.0]))

    rng = np.random.default_rng(3)
    points = rng.uniform(-8, 8, (500, 3)).astype(np.float32)
    times = rng.integers(-2 * 10**7, 8 * 10**7, 500)
    expected = [
        pose_at(10**9 + int(t)).apply(p[None].astype(np.float64))[0] for p, t in zip(points, times, strict=True)
    ]
    found = compensated(SensorPoints(points, 0.02, 10**9, "lidar", times), pose_at)
    np.testing.assert_allclose(found, expected, atol=2e-3)
    at_once = compensated(SensorPoints(points, 0.02, 10**9, "lidar"), pose_at)
    np.testing.assert_allclose(at_once, pose_at(10**9).apply(points.astype(np.float64)), rtol=1e-6)
