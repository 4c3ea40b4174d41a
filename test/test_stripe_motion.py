# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of a light stripe scanner: matrices, frames, interpolation, tables, and merged synthetic scans with truth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.active.light_stripe.light_plane import LightPlane
from stereo_depth_ros.active.light_stripe.motion import (
    MotionTrack,
    StripeMotion,
    Turntable,
    parse_axis,
    pose_matrix,
    turn,
)
from stereo_depth_ros.active.light_stripe.motion_table import read_motion_table
from stereo_depth_ros.active.light_stripe.scanner import MergedCloud, StripeScanner
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.errors import BagError, ConfigError
from stereo_depth_ros.core.types import F64, Frame
from stereo_depth_ros.synthetic.light_stripe import PLANE, SyntheticStripe
from stereo_depth_ros.synthetic.scene import Rectangle, Scene, Texture

TABLE = Turntable(np.array([0.0, -0.8, -0.6]), np.array([0.02, 0.05, 0.5]))
POINT = np.array([[0.1, -0.2, 0.7], [0.0, 0.1, 0.4]])


def moved(points: F64, motion: F64) -> F64:
    return np.asarray(points @ motion[:3, :3].T + motion[:3, 3])


def test_turns_are_right_handed_about_the_axis() -> None:
    quarter = turn(Turntable(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 5.0])), np.pi / 2)
    np.testing.assert_allclose(moved(np.array([[2.0, 0.0, 3.0]]), quarter), [[1.0, 1.0, 3.0]], atol=1e-12)
    np.testing.assert_allclose(
        moved(TABLE.point_m[None] + 0.3 * TABLE.axis, turn(TABLE, 1.1))[0], TABLE.point_m + 0.3 * TABLE.axis
    )


def test_poses_are_those_of_their_quaternion() -> None:
    vector = np.array([0.3, -0.5, 0.2])
    angle = float(np.linalg.norm(vector))
    quaternion = np.append(np.sin(angle / 2) * vector / angle, np.cos(angle / 2))
    matrix = pose_matrix(np.concatenate(([1.0, 2.0, 3.0], 1.01 * quaternion)))
    np.testing.assert_allclose(matrix[:3, :3], cv2.Rodrigues(vector)[0], atol=1e-12)
    np.testing.assert_array_equal(matrix[:3, 3], [1, 2, 3])


@pytest.mark.parametrize(
    ("kind", "value"), [("linear", [0.03]), ("turntable", [0.4]), ("pose", [0.1, 0, 0.2, 0, 0.6, 0, 0.8])]
)
@pytest.mark.parametrize("rectified", [False, True])
def test_points_of_a_moved_object_and_of_a_moved_sensor_return(kind: str, value: list[float], rectified: bool) -> None:
    R = cv2.Rodrigues(np.array([0.05, -0.1, 0.02]))[0] if rectified else None
    in_camera = (lambda points: points @ R.T) if R is not None else (lambda points: points)
    for moving in ("object", "sensor"):
        motion = StripeMotion(kind, moving, np.array([0.6, 0.0, 0.8]), TABLE, R)
        matrix = motion.matrix(np.array(value))
        seen = in_camera(moved(POINT, matrix if moving == "object" else np.linalg.inv(matrix)))
        expected = POINT if kind == "pose" else in_camera(POINT)
        np.testing.assert_allclose(motion.merged(seen, matrix), expected, atol=1e-12)


def test_only_the_light_plane_moves() -> None:
    plane, motion = LightPlane.exact(PLANE[:3], float(PLANE[3])), StripeMotion("linear", "plane", np.array([1.0, 0, 0]))
    matrix = motion.matrix(np.array([0.05]))
    assert motion.merged(POINT, matrix) is POINT
    on_plane = POINT - plane.distances(POINT)[:, None] * plane.normal
    np.testing.assert_allclose(motion.plane(plane, matrix).distances(on_plane + np.array([0.05, 0, 0])), 0, atol=1e-12)
    assert StripeMotion("linear", "object", np.array([1.0, 0, 0])).plane(plane, matrix) is plane


def test_frames_of_the_merged_cloud() -> None:
    names = [StripeMotion("pose", moving).merged_frame("camera", "base") for moving in ("object", "sensor", "plane")]
    assert names == ["scanned_object", "base", "camera"]
    assert StripeMotion("linear", "sensor").merged_frame("camera", "base") == "camera"


def test_values_are_interpolated_over_time() -> None:
    track = MotionTrack(most=3)
    for stamp, value in ((20, 2.0), (10, 0.0), (40, 3.0)):
        track.add(stamp, np.array([value]))
    assert [track.at(stamp) for stamp in (9, 41)] == [None, None]
    assert [float(track.at(stamp)[0]) for stamp in (10, 15, 20, 30, 40)] == [0, 1, 2, 2.5, 3]  # type: ignore[index]
    assert (track.reaches(40), track.reaches(41)) == (True, False)
    track.add(50, np.array([9.0]))
    assert (len(track), track.at(15)) == (3, None)


def test_poses_are_interpolated_along_the_shortest_way() -> None:
    track = MotionTrack()
    half = np.radians([0, 60]) / 2
    for stamp, angle, sign in ((0, half[0], 1), (100, half[1], -1)):  # q and -q are one rotation
        track.add(stamp, np.array([0.01 * stamp, 0, 0, 0, 0, sign * np.sin(angle), sign * np.cos(angle)]))
    between = track.at(25)
    assert between is not None
    np.testing.assert_allclose(
        pose_matrix(between)[:3, :3], cv2.Rodrigues(np.array([0, 0, np.radians(15)]))[0], atol=1e-9
    )
    assert between[0] == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("image,position_mm\na.png,3\nb.png, 4.5\n", "linear", [0.0045]),
        ("image, angle_deg\na.png,0\nb.png,90", "turntable", [np.pi / 2]),
        ("image,angle_rad\nb.png,1.5", "turntable", [1.5]),
        ("# poses\nimage,x,y,z,qx,qy,qz,qw\nb.png,1,2,3,0,0,0,1", "pose", [1, 2, 3, 0, 0, 0, 1]),
    ],
)
def test_tables_by_image(tmp_path: Path, text: str, kind: str, value: list[float]) -> None:
    (tmp_path / "t.csv").write_text(text)
    table = read_motion_table(tmp_path / "t.csv")
    assert table.kind == kind
    np.testing.assert_allclose(table.by_image["b.png"], value)


def test_a_table_over_time(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("stamp_s,position_m\n1.5,0.1\n2.5,0.3\n")
    table = read_motion_table(tmp_path / "t.csv")
    assert not table.by_image
    np.testing.assert_allclose(table.track.at(2 * 10**9), [0.2])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "is not a table of a motion"),
        ("image,angle_deg\n", "is not a table of a motion"),
        ("name,angle_deg\na,1", "is not a table of a motion"),
        ("image,angle\na,1", "has the columns 'angle' of a motion"),
        ("image,angle_deg\na,one", "row 2 holds what is not a number"),
        ("image,angle_deg\na,nan", "row 2 has not 2 finite values"),
        ("image,angle_deg\na,1,2", "row 2 has not 2 finite values"),
        ("image,angle_deg\na,1\na,2", "row 3 names 'a' again"),
        ("image,x,y,z,qx,qy,qz,qw\na,1,2,3,0,0,0,0", "row 2 has a quaternion that is not of length 1"),
    ],
)
def test_other_tables_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(BagError, match=problem) as found:
        read_motion_table(tmp_path / "t.csv")
    assert "write a header of image or stamp_s" in str(found.value)


def test_axes_are_three_numbers() -> None:
    np.testing.assert_allclose(parse_axis("0, 3 4"), [0, 0.6, 0.8])
    for text in ("", "1 0", "0 0 0", "a b c", "1 0 inf", "nan 0 1"):
        with pytest.raises(ConfigError, match="is not a direction"):
            parse_axis(text)


def flat_scene() -> tuple[Scene, F64, float]:
    """A tilted board, its normal and its distance."""
    corner, u, v = np.array([-0.3, -0.25, 0.52]), np.array([0.6, 0.0, 0.08]), np.array([0.0, 0.5, -0.06])
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    board = Rectangle(tuple(corner), tuple(u), tuple(v), Texture(200.0, 0.0))  # type: ignore[arg-type]
    return Scene((board,), 3), normal, float(normal @ corner)


@pytest.mark.parametrize(("kind", "moving"), [("linear", "object"), ("turntable", "object"), ("linear", "plane")])
def test_profiles_of_a_moving_board_are_merged_to_one_plane(kind: str, moving: str) -> None:
    """Each profile is where the motion puts it: the sweep has the right extent, and all points are on the board."""
    scene, normal, distance = flat_scene()
    scanner = SyntheticStripe(240, 180, scene, sigma_m=0.006)
    plane, config = LightPlane.exact(PLANE[:3], float(PLANE[3])), LightStripeConfig(stripe_channel="green")
    motion = StripeMotion(kind, moving, np.array([1.0, 0.0, 0.0]), TABLE)
    stripes, cloud = StripeScanner(plane, scanner.rig.left, config, motion), MergedCloud(10)
    steps = (-0.03, 0.0, 0.03) if kind == "linear" else (-0.1, 0.0, 0.1)
    means = []
    for number, step in enumerate(steps):
        matrix = motion.matrix(np.array([step]))
        images = scanner.capture(*((None, matrix) if moving == "plane" else (matrix, None)), number)
        profile = stripes.scan(Frame(images[0], number, "camera", "rgb8"), np.array([step]))
        inside = (profile.found.lines > 70) & (profile.found.lines < 110)
        assert np.count_nonzero(inside) > 30
        assert float(np.abs(profile.merged_m[inside] @ normal - distance).max()) < 0.0008
        means.append(profile.merged_m[inside].mean(axis=0))
        assert not cloud.add(profile)
    apart = np.linalg.norm(np.diff(means, axis=0), axis=1)
    if kind == "linear":  # the stripe moves over the board by the step, along the board
        along = 0.03 / abs(np.array([1, 0, 0.08 / 0.6]) / np.hypot(1, 0.08 / 0.6) @ plane.normal) * abs(plane.normal[0])
        np.testing.assert_allclose(apart, along, rtol=0.05)
    points, level, sigma = cloud.points()
    assert len(points) == len(level) == len(sigma) == cloud.reasons["POINTS"]
    assert len(cloud) == 3


def test_points_far_from_the_axis_are_neither_sought_nor_kept() -> None:
    """A second stripe of the background does not disturb where it is too far from the axis."""
    scanner = SyntheticStripe(240, 180, flat_scene()[0], sigma_m=0.006)
    left = scanner.capture()[0]
    plane, motion = LightPlane.exact(PLANE[:3], float(PLANE[3])), StripeMotion("turntable", "object", None, TABLE)
    config = LightStripeConfig(stripe_channel="green", max_axis_distance=0.06)
    found = StripeScanner(plane, scanner.rig.left, config, motion).scan(Frame(left, 0, "", "rgb8"), np.zeros(1)).found
    far = np.linalg.norm(np.cross(found.points_m - TABLE.point_m, TABLE.axis), axis=1)
    assert len(far) > 20
    assert float(far.max()) <= 0.06
    doubled = np.maximum(left, np.roll(left, -70, axis=1))
    again = (
        StripeScanner(plane, scanner.rig.left, config, motion).scan(Frame(doubled, 0, "", "rgb8"), np.zeros(1)).found
    )
    assert len(set(found.lines) & set(again.lines)) > 0.9 * len(found.lines)
    everywhere = StripeScanner(plane, scanner.rig.left, LightStripeConfig(stripe_channel="green"), motion)
    counts = everywhere.scan(Frame(doubled, 0, "", "rgb8"), np.zeros(1)).found.profile.reason_counts()
    assert counts["TWO_STRIPES"] > 50


def test_a_full_cloud_drops_the_oldest() -> None:
    scanner = SyntheticStripe(64, 48, flat_scene()[0], sigma_m=0.02)
    stripes = StripeScanner(LightPlane.exact(PLANE[:3], float(PLANE[3])), scanner.rig.left, LightStripeConfig())
    profile = stripes.scan(Frame(scanner.capture()[0], 0, "", "rgb8"))
    cloud = MergedCloud(2)
    assert [cloud.add(profile) for _ in range(3)] == [False, False, True]
    assert len(cloud) == 2
    assert MergedCloud(1).points()[0].shape == (0, 3)
