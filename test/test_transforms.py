# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree of frames: chains, interpolation, poses between two times, and what is missing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import TransformError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.transforms import Transforms
from stereo_depth_ros.core.types import F64

POINTS = np.array([[0.3, -1.2, 2.0], [5.0, 0.7, -0.4]])
S = 10**9


def turned(vector: list[float], translation: list[float]) -> Pose:
    return Pose(np.asarray(cv2.Rodrigues(np.array(vector))[0], np.float64), np.array(translation))


BODY_CAMERA = turned([-1.2, 1.2, -1.2], [0.3, 0.05, 0.4])
BODY_LIDAR = turned([0.0, 0.1, 0.02], [0.1, -0.2, 0.9])
ODOM_BODY = (turned([0.0, 0.0, 0.2], [1.0, 2.0, 0.0]), turned([0.0, 0.0, 0.6], [3.0, 1.0, 0.5]))


def robot() -> Transforms:
    tree = Transforms()
    tree.add("/body", "camera", BODY_CAMERA)  # with the slash of ROS 1
    tree.add("body", "lidar", BODY_LIDAR)
    tree.add("odom", "body", ODOM_BODY[1], 12 * S)
    tree.add("odom", "body", ODOM_BODY[0], 10 * S)  # in any order
    return tree


def assert_equal(found: Pose, expected: F64) -> None:
    np.testing.assert_allclose(found.matrix, expected, atol=1e-12)


def test_chains_go_up_and_down() -> None:
    expected = np.linalg.inv(BODY_CAMERA.matrix) @ BODY_LIDAR.matrix
    assert_equal(robot().pose("camera", "/lidar", 0), expected)  # of static transforms at any time
    assert_equal(robot().pose("lidar", "camera", 99 * S), np.linalg.inv(expected))
    assert_equal(robot().pose("odom", "lidar", 10 * S), ODOM_BODY[0].matrix @ BODY_LIDAR.matrix)
    assert_equal(robot().pose("camera", "camera", 0), np.identity(4))


def test_between_two_stamps_the_pose_is_interpolated() -> None:
    expected = turned([0.0, 0.0, 0.3], [1.5, 1.75, 0.125])
    assert_equal(robot().pose("odom", "body", 10 * S + S // 2), expected.matrix)


def test_from_one_time_to_another_one_nothing_moves_in_the_root() -> None:
    found = robot().pose_between("camera", 12 * S, "lidar", 10 * S)
    to_odom = ODOM_BODY[0].matrix @ BODY_LIDAR.matrix
    assert_equal(found, np.linalg.inv(BODY_CAMERA.matrix) @ np.linalg.inv(ODOM_BODY[1].matrix) @ to_odom)


def test_without_a_moving_frame_above_both_the_motion_is_not_known() -> None:
    tree = Transforms()
    tree.add("body", "camera", BODY_CAMERA)
    tree.add("body", "lidar", BODY_LIDAR, 5 * S)  # moves against the body only
    assert not tree.motion_known("camera", "lidar")
    assert robot().motion_known("camera", "lidar")
    tree.add("body", "lidar", BODY_LIDAR, 6 * S)
    assert_equal(tree.pose_between("camera", 1 * S, "lidar", 5 * S), tree.pose("camera", "lidar", 5 * S).matrix)


def test_a_static_pose_that_is_repeated_over_time_stays_static() -> None:
    tree = robot()
    tree.add("body", "lidar", BODY_CAMERA, 11 * S)
    assert_equal(tree.pose("body", "lidar", 99 * S), BODY_LIDAR.matrix)


def test_of_a_stream_only_the_newest_poses_are_kept() -> None:
    tree = Transforms(keep_ns=2 * S)
    for second in range(6):
        tree.add("odom", "body", ODOM_BODY[0], second * S)
    tree.pose("odom", "body", 3 * S)
    with pytest.raises(TransformError, match=r"0\.500 s before its first stamp"):
        tree.pose("odom", "body", 5 * S // 2)


@pytest.mark.parametrize(
    ("target", "source", "stamp_ns", "text"),
    [
        ("camera", "radar", 10 * S, "no transform from 'radar' to 'camera', the frames known are 'body', 'camera', "),
        ("odom", "camera", 13 * S, r"from 'body' to 'odom' is asked for 1\.000 s after its last stamp"),
        ("odom", "camera", 9 * S, r"1\.000 s before its first stamp"),
    ],
)
def test_what_is_missing_is_named(target: str, source: str, stamp_ns: int, text: str) -> None:
    with pytest.raises(TransformError, match=text):
        robot().pose(target, source, stamp_ns)


def test_a_loop_and_a_frame_in_itself_are_refused() -> None:
    tree = Transforms()
    with pytest.raises(TransformError, match="no transforms are known"):
        tree.pose("a", "b", 0)
    with pytest.raises(TransformError, match="not one between two frames"):
        tree.add("a", "/a", BODY_CAMERA)
    with pytest.raises(TransformError, match="not one between two frames"):
        tree.add("a", "", BODY_CAMERA)
    tree.add("a", "b", BODY_CAMERA)
    tree.add("b", "a", BODY_CAMERA)
    with pytest.raises(TransformError, match="are a loop"):
        tree.pose("a", "b", 0)


def test_another_parent_replaces_the_old_one() -> None:
    tree = robot()
    tree.add("body", "lidar", BODY_CAMERA)
    assert_equal(tree.pose("camera", "lidar", 0), np.identity(4))
    tree.add("mast", "lidar", BODY_LIDAR)
    with pytest.raises(TransformError, match="no transform"):
        tree.pose("camera", "lidar", 0)


def test_not_in_a_gap_and_within_a_rounded_stamp() -> None:
    tree = Transforms(max_gap_ns=100, rounding_ns=1000)
    for stamp in (5_000_300, 5_000_000, 5_000_100, 9_000_000):
        tree.add("map", "camera", moved(stamp), stamp)
    tree.add("camera", "lens", moved(3))

    def x(stamp_ns: int, frame: str = "camera") -> float | None:
        found = tree.find("map", frame, stamp_ns)
        return None if found is None else float(found.translation_m[0])

    assert [x(stamp) for stamp in (5_000_000, 5_000_050, 5_000_300)] == [5_000_000, 5_000_050, 5_000_300]
    assert [x(stamp) for stamp in (5_000_210, 4_999_001, 9_001_000)] == [5_000_300, 5_000_000, 9_000_000]
    assert [x(stamp) for stamp in (4_998_999, 6_500_000, 9_001_001)] == [None] * 3
    assert x(5_000_050, "lens") == 5_000_053
    with pytest.raises(TransformError, match="in a gap of"):
        tree.pose("map", "camera", 6_500_000)
    with pytest.raises(TransformError, match="no transform from"):
        tree.find("map", "moon", 5_000_000)


def test_what_is_above_a_frame_and_moves() -> None:
    tree = Transforms()
    tree.add("map", "odom", moved(1))
    tree.add("odom", "/base", moved(2), 7)
    tree.add("base", "camera", moved(3))
    assert tree.ancestors("/camera") == ["camera", "base", "odom", "map"]
    assert [tree.moves(above, "camera") for above in ("camera", "base", "/odom", "map")] == [False, False, True, True]


def moved(x_m: float) -> Pose:
    return Pose(np.identity(3), np.array([float(x_m), 0.0, 0.0]))
