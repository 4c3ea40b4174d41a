# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags and folders of a synthetic sequence with the poses of its camera, of a robot that carries it, for tests."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from stereo_bags import sequence

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.bag import write_synthetic_bag

# The robot: its base is 0.4 m below and 0.2 m behind the left camera, x forward, y left, z up; the world is turned too.
BASE_FROM_CAMERA = Pose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.2, 0.05, 0.4]))
MAP_FROM_SCENE = Pose(
    np.asarray(cv2.Rodrigues(np.array([0.0, 0.0, 0.7]))[0]) @ BASE_FROM_CAMERA.rotation, np.array([3.0, -2.0, 0.5])
)
FRAME = "left_camera_optical_frame"


def camera_pose(stamp_ns: int, frames: int = 3) -> Pose:
    """The pose of the raw left camera in the scene, at any time."""
    made = sequence(frames)
    R, center = made.pose((stamp_ns - made.stamp_ns(0)) / 1e9 * made.rate_hz)  # type: ignore[arg-type]
    return Pose(R, center)


def base_pose(stamp_ns: int) -> Pose:
    """The pose of the base of the robot in the map."""
    return MAP_FROM_SCENE @ camera_pose(stamp_ns) @ BASE_FROM_CAMERA.inverse()


def stamps(frames: int, every_ns: int = 20_000_000, before_ns: int = 7_000_000) -> range:
    """Times of poses that are not those of the images, around all of them."""
    first = sequence(frames).stamp_ns(0)
    return range(first - before_ns, sequence(frames).stamp_ns(frames - 1) + every_ns, every_ns)


Message = Callable[[RosbagsTypes, int], Any]


def types_of(types: RosbagsTypes) -> Any:
    return types.typestore.types


def header(types: RosbagsTypes, stamp_ns: int, frame: str) -> Any:
    sec, nanosec = divmod(stamp_ns, 10**9)
    return types.Header(stamp=types.Time(sec=sec, nanosec=nanosec), frame_id=frame)


def pose_message(types: RosbagsTypes, pose: Pose) -> Any:
    known = types_of(types)
    x, y, z = map(float, pose.translation_m)
    qx, qy, qz, qw = map(float, pose.quaternion)
    return known["geometry_msgs/msg/Pose"](
        position=known["geometry_msgs/msg/Point"](x=x, y=y, z=z),
        orientation=known["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
    )


def transform(types: RosbagsTypes, stamp_ns: int, parent: str, child: str, pose: Pose) -> Any:
    known, found = types_of(types), pose_message(types, pose)
    p = found.position
    return known["geometry_msgs/msg/TransformStamped"](
        header=header(types, stamp_ns, parent),
        child_frame_id=child,
        transform=known["geometry_msgs/msg/Transform"](
            translation=known["geometry_msgs/msg/Vector3"](x=p.x, y=p.y, z=p.z), rotation=found.orientation
        ),
    )


def tree(types: RosbagsTypes, transforms: Sequence[Any]) -> Any:
    return types_of(types)["tf2_msgs/msg/TFMessage"](transforms=list(transforms))


def with_covariance(types: RosbagsTypes, pose: Pose) -> Any:
    return types_of(types)["geometry_msgs/msg/PoseWithCovariance"](
        pose=pose_message(types, pose), covariance=np.zeros(36)
    )


def odometry(types: RosbagsTypes, stamp_ns: int, child: str, pose: Pose) -> Any:
    known = types_of(types)
    zero = known["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    return known["nav_msgs/msg/Odometry"](
        header=header(types, stamp_ns, "map"),
        child_frame_id=child,
        pose=with_covariance(types, pose),
        twist=known["geometry_msgs/msg/TwistWithCovariance"](
            twist=known["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=np.zeros(36)
        ),
    )


def stamped(types: RosbagsTypes, stamp_ns: int, pose: Pose, *, covariance: bool = False) -> Any:
    known, head = types_of(types), header(types, stamp_ns, "map")
    if covariance:
        return known["geometry_msgs/msg/PoseWithCovarianceStamped"](header=head, pose=with_covariance(types, pose))
    return known["geometry_msgs/msg/PoseStamped"](header=head, pose=pose_message(types, pose))


def write_bag(path: Path, frames: int, messages: Iterable[tuple[str, int, Message]]) -> Path:
    """The pairs of the sequence and further messages: topic, time, and what makes the message."""
    images = path.with_name(f"images_of_{path.name}")
    write_synthetic_bag(images, sequence(frames))
    types = RosbagsTypes()
    with BagReader(images) as reader, BagWriter(path) as bag:
        for message in reader.messages():
            bag.write_raw(message.topic, message.msgtype, message.data, message.log_time_ns)
        for topic, stamp_ns, make in messages:
            bag.write(topic, make(types, stamp_ns), stamp_ns)
    return path


def fixed(*links: tuple[str, str, Pose]) -> tuple[str, int, Message]:
    """A message of /tf_static."""
    first = sequence(1).stamp_ns(0)
    return "/tf_static", first, lambda types, stamp_ns: tree(types, [transform(types, 0, *link) for link in links])


# base_link -> camera_link -> the optical frame
CAMERA_LINK = Pose(np.identity(3), BASE_FROM_CAMERA.translation_m)
STATIC = fixed(
    ("base_link", "camera_link", CAMERA_LINK), ("/camera_link", FRAME, Pose(BASE_FROM_CAMERA.rotation, np.zeros(3)))
)


def write_kitti(folder: Path, frames: int = 3) -> Path:
    """The pairs as those of KITTI: of a rectified rig, with poses of its camera."""
    made = sequence(frames)
    rig = made.rig
    rectifier, rows = Rectifier(rig), []
    for index in range(frames):
        pair = rectifier.rectify(made[index].pair)
        for name, image in (("image_0", pair.left), ("image_1", pair.right)):
            (folder / name).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / name / f"{index:06d}.png"), image)
        pose = camera_pose(made.stamp_ns(index)) @ Pose(rig.left.R.T, np.zeros(3))
        rows.append(" ".join(f"{value:.9g}" for value in pose.matrix[:3].ravel()))
    (folder / "poses.txt").write_text("\n".join(rows))
    calibration = []
    for number, camera in enumerate((rig.left, rig.right)):
        calibration.append(f"P{number}: " + " ".join(f"{value:.12g}" for value in camera.P.ravel()))
    (folder / "calib.txt").write_text("\n".join(calibration))
    return folder


def write_drive(path: Path, frames: int = 3, before_ns: int = 0) -> Path:
    """Pairs and the odometry of a robot, which ends so long before the last pair."""
    end_ns = sequence(frames).stamp_ns(frames - 1) + 20_000_000 - before_ns
    times = [stamp_ns for stamp_ns in stamps(frames) if stamp_ns < end_ns]
    poses = [("/odom", t, lambda types, t: odometry(types, t, "base_link", base_pose(t))) for t in times]
    return write_bag(path, frames, [STATIC, *poses])
