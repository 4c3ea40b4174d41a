# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stereo bags of the rendered room with a range sensor beside the cameras, of each kind."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from range_messages import TYPES, depth_image, laser_scan, odometry, tf_message, xyz_cloud
from rendered_lidar import CAMERA_AXES, lidar_points
from stereo_bags import HEIGHT, WIDTH, sequence

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.messages.camera_info import rectified_camera_info
from stereo_depth_ros.synthetic.bag import write_synthetic_bag

FRAMES = 3
LEFT_LIDAR = Pose(CAMERA_AXES, np.array([0.12, -0.25, -0.1]))
LEFT = "left_camera_optical_frame"
BODY_LEFT = Pose(CAMERA_AXES.T, np.array([0.2, 0.1, 0.5]))  # of a body with the axes of a scanner
NOISE_M = 0.005


def world_from_left(index: int, later_s: float = 0.0) -> Pose:
    made = sequence(FRAMES)
    return Pose(*made.pose(index + later_s * made.rate_hz))  # type: ignore[arg-type]  # the motion is a function of time


@functools.cache
def sweep(index: int, later_s: float = 0.0) -> F32:
    """Points in the frame of the scanner; those of a scanner that is late by some seconds."""
    pose = world_from_left(index, later_s) @ LEFT_LIDAR
    return lidar_points(sequence(FRAMES).scene, pose, seed=index, step_deg=0.5, azimuth_deg=48, noise_m=NOISE_M)


def _scan(index: int, stamp_ns: int) -> Any:
    """One ring of the scanner as a LaserScan; rays without a surface are infinite."""
    pose = world_from_left(index) @ LEFT_LIDAR
    made = lidar_points(sequence(FRAMES).scene, pose, rings=1, elevation_deg=(0.0, 0.0), azimuth_deg=30, step_deg=0.25)
    ranges = np.linalg.norm(made, axis=1).astype(np.float32)  # the room is closed: each ray has a range
    ranges[::40] = np.inf
    return laser_scan(ranges, stamp_ns, "lidar", angle_increment=np.radians(0.25), time_increment=0.0)


def write_range_bag(
    path: Path, kind: str = "cloud", *, late_ns: int = 0, static: bool = True, moving: str = "", later_s: float = 0.0
) -> None:
    """The pairs of the room, their truth, and a topic /sensor/points.

    Args:
        path: of the bag.
        kind: cloud, scan or depth.
        late_ns: added to the stamps of the sensor.
        static: write /tf_static.
        moving: how the motion is known: by "tf", "odometry" or not at all.
        later_s: what the scanner sees is that of so much later.
    """
    made = sequence(FRAMES)
    plain = path.with_name(f"plain_{path.name}")
    write_synthetic_bag(plain, made)
    with BagReader(plain) as reader, BagWriter(path) as bag:
        for message in reader.messages():
            bag.write_raw(message.topic, message.msgtype, message.data, message.log_time_ns)
        start = made.stamp_ns(0)
        if static:
            of_lidar = tf_message(("body", LEFT, BODY_LEFT, start), ("body", "lidar", BODY_LEFT @ LEFT_LIDAR, start))
            bag.write("/tf_static", of_lidar, start)
        for index in range(FRAMES):
            stamp_ns = made.stamp_ns(index)
            _write_sensor(bag, kind, index, stamp_ns + late_ns, later_s)
        for step in range(-2, 12 * FRAMES if moving else -2):
            stamp_ns, pose = start + step * 10**7, world_from_left(0, step / 100) @ BODY_LEFT.inverse()
            if moving == "tf":
                bag.write("/tf", tf_message(("odom", "body", pose, stamp_ns)), stamp_ns)
            else:
                bag.write("/odometry", odometry("odom", "body", pose, stamp_ns), stamp_ns)
    plain.unlink()


def _write_sensor(bag: BagWriter, kind: str, index: int, stamp_ns: int, later_s: float) -> None:
    made = sequence(FRAMES)
    if kind == "cloud":
        bag.write("/sensor/points", xyz_cloud(sweep(index, later_s), stamp_ns), stamp_ns)
    elif kind == "scan":
        bag.write("/sensor/points", _scan(index, stamp_ns), stamp_ns)
    else:
        depth_m = made[index].truth_depth_m[::2, ::2]
        left = made.rig.left
        half = np.diag([0.5, 0.5, 1.0])
        P = half @ left.P
        info = rectified_camera_info(TYPES, left, stamp_ns)
        info.width, info.height = WIDTH // 2, HEIGHT // 2
        info.p, info.k, info.r = P.ravel(), P[:, :3].ravel(), left.R.ravel()
        bag.write("/sensor/camera_info", info, stamp_ns)
        bag.write("/sensor/points", depth_image(depth_m, "16UC1", stamp_ns, LEFT), stamp_ns)
