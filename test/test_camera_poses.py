# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses of the left rectified camera: of topics and of files."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posed_bags import (
    BASE_FROM_CAMERA,
    FRAME,
    MAP_FROM_SCENE,
    STATIC,
    Message,
    base_pose,
    camera_pose,
    fixed,
    odometry,
    stamped,
    stamps,
    transform,
    tree,
    write_bag,
)
from stereo_bags import sequence

from stereo_depth_ros.bags.poses import pose_topics, read_bag_poses
from stereo_depth_ros.core.errors import BagError, ConfigError, MessageError, TopicError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.datasets.posed import PosedDataset
from stereo_depth_ros.offline.camera_poses import CameraPoses, poses_of_file, poses_of_topic

FRAMES, GAP_NS = 3, 500_000_000
SHIFT = Pose(np.identity(3), np.array([1.0, 0.0, 0.0]))


def expected(stamp_ns: int) -> Pose:
    """The pose of the left rectified camera in the map."""
    R = sequence(FRAMES).rig.left.R
    return MAP_FROM_SCENE @ camera_pose(stamp_ns) @ Pose(R.T, np.zeros(3))


def check(poses: CameraPoses, world_from_map: Pose | None = None) -> None:
    """The poses are those of the camera, at the times of the images and between."""
    made = sequence(FRAMES)
    for number, stamp_ns in enumerate([made.stamp_ns(i) for i in range(FRAMES)]):
        found = poses.at(partial(int, number), stamp_ns, FRAME, made.rig)
        assert found is not None
        wanted = (world_from_map or Pose.identity()) @ expected(stamp_ns)
        np.testing.assert_allclose(found.matrix, wanted.matrix, atol=2e-4)  # of the interpolation
    assert poses.at(int, made.stamp_ns(0) - 10**9, FRAME, made.rig) is None


CAMERA_POSE: Message = lambda types, stamp_ns: stamped(types, stamp_ns, MAP_FROM_SCENE @ camera_pose(stamp_ns))  # noqa: E731
MESSAGES: dict[str, Message] = {
    "/odom": lambda types, stamp_ns: odometry(types, stamp_ns, "base_link", base_pose(stamp_ns)),
    "/camera_pose": CAMERA_POSE,
    "/base_pose": lambda types, stamp_ns: stamped(types, stamp_ns, base_pose(stamp_ns), covariance=True),
    "/transform": lambda types, stamp_ns: transform(types, stamp_ns, "map", "base_link", base_pose(stamp_ns)),
    "/tf": lambda types, stamp_ns: tree(
        types,
        [
            transform(types, stamp_ns, "world", "map", SHIFT),
            transform(types, stamp_ns, "map", "base_link", base_pose(stamp_ns)),
        ],
    ),
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with the poses in every type."""
    messages: list[tuple[str, int, Any]] = [STATIC]
    messages += [(topic, stamp, make) for topic, make in MESSAGES.items() for stamp in stamps(FRAMES)]
    return write_bag(tmp_path_factory.mktemp("posed") / "posed.mcap", FRAMES, messages)


@pytest.mark.parametrize(
    ("topic", "frame", "world", "world_from_map"),
    [
        ("/odom", None, None, None),
        ("/camera_pose", None, None, None),
        ("/camera_pose", "camera", None, None),
        ("/camera_pose", FRAME, None, None),
        ("/base_pose", "base_link", None, None),
        ("/transform", None, None, None),
        ("/tf", None, None, SHIFT),
        ("/tf", None, "map", None),
    ],
)
def test_topics(bag: Path, topic: str, frame: str | None, world: str | None, world_from_map: Pose | None) -> None:
    check(poses_of_topic(topic, read_bag_poses(bag, topic, GAP_NS), GAP_NS, frame, world), world_from_map)


def test_rectified_poses_are_taken_as_they_are(bag: Path) -> None:
    made, poses = sequence(FRAMES), read_bag_poses(bag, "/camera_pose", GAP_NS)
    stamp_ns = made.stamp_ns(1)
    found = poses_of_topic("/camera_pose", poses, GAP_NS, "rectified").at(partial(int, 1), stamp_ns, FRAME, made.rig)
    assert found is not None
    np.testing.assert_allclose(found.matrix, (MAP_FROM_SCENE @ camera_pose(stamp_ns)).matrix, atol=2e-4)


def test_topics_that_do_not_reach_the_camera(bag: Path, tmp_path: Path) -> None:
    made = sequence(FRAMES)
    assert {*pose_topics(bag)} == {*MESSAGES}
    with pytest.raises(TopicError, match="is not a topic of poses; the bag has /base_pose, /camera_pose"):
        read_bag_poses(bag, "/left/image_raw", GAP_NS)
    arguments = (partial(int, 1), made.stamp_ns(1), FRAME, made.rig)
    lost = poses_of_topic("/base_pose", read_bag_poses(bag, "/base_pose", GAP_NS), GAP_NS, "gripper")
    with pytest.raises(TopicError, match="those of gripper, and /tf_static does not connect it") as caught:
        lost.at(*arguments)
    assert caught.value.settings == ("pose_frame",) and "base_link" in caught.value.problem
    for world, problem in (("base_link", "does not move in base_link"), ("moon", "is not below moon")):
        fast = poses_of_topic("/tf", read_bag_poses(bag, "/tf", GAP_NS), GAP_NS, None, world)
        with pytest.raises(TopicError, match=problem):
            fast.at(*arguments)
    with pytest.raises(ConfigError, match="pose_frame has no effect"):
        poses_of_topic("/tf", read_bag_poses(bag, "/tf", GAP_NS), GAP_NS, "camera")
    with pytest.raises(ConfigError, match="world_frame has no effect"):
        poses_of_topic("/odom", read_bag_poses(bag, "/odom", GAP_NS), GAP_NS, None, "map")
    several = write_bag(
        tmp_path / "several.mcap",
        1,
        [("/odom", t, lambda types, t: odometry(types, t, f"robot{t % 2}", SHIFT)) for t in (10, 11)],
    )
    with pytest.raises(TopicError, match="several frames: robot0 and robot1"):
        read_bag_poses(several, "/odom", GAP_NS)
    zero = Pose(np.zeros((3, 3)), np.zeros(3))
    broken = write_bag(
        tmp_path / "broken.mcap", 1, [fixed(), ("/pose", 10, lambda types, t: _without_rotation(types, t, zero))]
    )
    with pytest.raises(MessageError, match="quaternion has the length 0"):
        read_bag_poses(broken, "/pose", GAP_NS)


def _without_rotation(types: Any, stamp_ns: int, pose: Pose) -> Any:
    message = stamped(types, stamp_ns, SHIFT)
    message.pose.orientation.w = 0.0
    return message


def tum(path: Path) -> Path:
    """Poses of the camera as TUM, with four decimals of the seconds."""
    rows = []
    for stamp_ns in stamps(FRAMES):
        pose = MAP_FROM_SCENE @ camera_pose(stamp_ns)
        rows.append(" ".join([f"{stamp_ns / 1e9:.6f}", *(f"{v:.9f}" for v in [*pose.translation_m, *pose.quaternion])]))
    path.write_text("# seconds x y z qx qy qz qw\n" + "\n".join(rows))
    return path


def euroc(path: Path, body_from_camera: Pose) -> Path:
    """Poses of a body as EuRoC."""
    rows = []
    for stamp_ns in stamps(FRAMES):
        pose = MAP_FROM_SCENE @ camera_pose(stamp_ns) @ body_from_camera.inverse()
        x, y, z, w = pose.quaternion
        rows.append(",".join([str(stamp_ns), *(f"{v:.9f}" for v in [*pose.translation_m, w, x, y, z])]))
    path.parent.mkdir(exist_ok=True)
    path.write_text("#timestamp,...\n" + "\n".join(rows))
    return path


def posed(**values: Any) -> PosedDataset:
    """A dataset of the sequence, as far as poses need one."""

    class Dataset:
        has_stamps = values.pop("has_stamps", True)

    numbers = values.pop("numbers", [*range(FRAMES)])
    return PosedDataset(Dataset(), None, numbers, values.pop("image_numbers", numbers), **values)  # type: ignore[arg-type]


def test_files_over_time(tmp_path: Path) -> None:
    check(poses_of_file(tum(tmp_path / "tum.txt"), GAP_NS))
    of_body = euroc(tmp_path / "data.csv", BASE_FROM_CAMERA)
    check(poses_of_file(of_body, GAP_NS, None, posed(body_from_left=BASE_FROM_CAMERA)))
    check(poses_of_file(euroc(tmp_path / "camera.csv", Pose.identity()), GAP_NS, "camera"))
    with pytest.raises(ConfigError, match="those of a body, and the pose of the camera in it is not known"):
        poses_of_file(of_body, GAP_NS)
    with pytest.raises(ConfigError, match="pose_frame = imu is not camera"):
        poses_of_file(of_body, GAP_NS, "imu")
    with pytest.raises(BagError, match="the images have no times"):
        poses_of_file(tmp_path / "tum.txt", GAP_NS, None, posed(has_stamps=False))


def test_poses_of_a_sensor_on_the_body(tmp_path: Path) -> None:
    """The sensor.yaml beside the file tells where the sensor is."""
    values = ", ".join(f"{v:.9f}" for v in BASE_FROM_CAMERA.matrix.ravel())
    body_from_camera = SHIFT  # the file poses the sensor: body_from_sensor = BASE_FROM_CAMERA
    path = euroc(tmp_path / "vicon0" / "data.csv", BASE_FROM_CAMERA.inverse() @ body_from_camera)
    (tmp_path / "vicon0" / "sensor.yaml").write_text(f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{values}]\n")
    check(poses_of_file(path, GAP_NS, None, posed(body_from_left=body_from_camera)))
    (tmp_path / "vicon0" / "sensor.yaml").write_text("rate_hz: 100\n")
    with pytest.raises(BagError, match=r"is not a sensor.yaml"):
        poses_of_file(path, GAP_NS, None, posed(body_from_left=body_from_camera))


def test_rows_of_frames(tmp_path: Path) -> None:
    rows = [
        " ".join(f"{v:.9f}" for v in Pose(np.identity(3), np.array([i, 0.0, 0])).matrix[:3].ravel()) for i in range(5)
    ]
    path, rig = tmp_path / "poses.txt", sequence(FRAMES).rig
    path.write_text("\n".join(rows))

    def x(poses: CameraPoses, number: int) -> float | None:
        found = poses.at(partial(int, number), 0, "", rig)
        return None if found is None else float(found.translation_m[0])

    of_all = poses_of_file(path, GAP_NS, None, posed(numbers=[1, 3, 4]))
    assert [x(of_all, number) for number in (1, 3, 4)] == [1, 3, 4]
    excerpt = poses_of_file(path, GAP_NS, None, posed(numbers=[101, 104], image_numbers=[*range(100, 105)]))
    assert [x(excerpt, number) for number in (101, 104)] == [1, 4]
    with pytest.raises(BagError, match="has 5 poses for 4 images, the last one is frame 103"):
        poses_of_file(path, GAP_NS, None, posed(numbers=[101, 103], image_numbers=[*range(100, 104)]))
    assert [x(poses_of_file(path, GAP_NS), number) for number in (4, 5)] == [4, None]  # of a bag
    right = poses_of_file(path, GAP_NS, None, posed(reference_from_left=SHIFT))
    assert x(right, 2) == 3  # of the color camera, 1 m to the right
    path.write_text("\n".join(f"{2 * number} {row}" for number, row in enumerate(rows)))
    assert [x(poses_of_file(path, GAP_NS), number) for number in (2, 3, 8)] == [1, None, 4]
