# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of range sensors and transforms for tests, made by rosbags."""

from __future__ import annotations

from typing import Any

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.messages.types import make_header

TYPES = RosbagsTypes()
KNOWN = TYPES.typestore.types
NAMES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def cloud(
    records: np.ndarray[Any, Any], stamp_ns: int = 10**9, frame_id: str = "lidar", *, row_padding: int = 0
) -> Any:
    """A PointCloud2 of structured records (W,) or (H, W), with bytes after each row."""
    rows = records if records.ndim == 2 else records[None]
    order = records.dtype["x"].byteorder
    step = rows.dtype.itemsize * rows.shape[1] + row_padding
    data = np.zeros((len(rows), step), np.uint8)
    for at, row in enumerate(rows):
        data[at, : rows.dtype.itemsize * rows.shape[1]] = np.frombuffer(row.tobytes(), np.uint8)
    fields = [
        TYPES.PointField(name=name, offset=offset, datatype=NAMES[kind.str[1:]], count=1)
        for name, (kind, offset) in ((n, f[:2]) for n, f in (records.dtype.fields or {}).items())
    ]
    return TYPES.PointCloud2(
        header=make_header(TYPES, stamp_ns, frame_id),
        height=len(rows),
        width=rows.shape[1],
        fields=fields,
        is_bigendian=order == ">",
        point_step=rows.dtype.itemsize,
        row_step=step,
        data=data.ravel(),
        is_dense=False,
    )


def xyz_cloud(points_m: F32, stamp_ns: int = 10**9, frame_id: str = "lidar") -> Any:
    """A PointCloud2 of float32 x, y, z, intensity."""
    records = np.zeros(len(points_m), np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")]))
    for at, name in enumerate("xyz"):
        records[name] = points_m[:, at]
    return cloud(records, stamp_ns, frame_id)


def laser_scan(ranges: F32, stamp_ns: int = 10**9, frame_id: str = "laser", **changed: float) -> Any:
    """A LaserScan from -30 degrees on in steps of 1 degree, of 0.1 to 12 m, 1 ms for each ray."""
    values = {"angle_min": -np.pi / 6, "angle_increment": np.pi / 180, "time_increment": 1e-3}
    values |= {"range_min": 0.1, "range_max": 12.0} | changed
    return KNOWN["sensor_msgs/msg/LaserScan"](
        header=make_header(TYPES, stamp_ns, frame_id),
        angle_max=values["angle_min"] + values["angle_increment"] * (len(ranges) - 1),
        scan_time=0.1,
        ranges=ranges,
        intensities=np.zeros(0, np.float32),
        **values,
    )


def depth_image(depth_m: F32, encoding: str, stamp_ns: int = 10**9, frame_id: str = "tof", *, padding: int = 0) -> Any:
    """A depth image of 16UC1 or 32FC1, 0 or NaN where there is none, little-endian, with padded rows."""
    levels = np.round(1e3 * np.nan_to_num(depth_m)).astype("<u2") if encoding == "16UC1" else depth_m.astype("<f4")
    rows = np.pad(levels.view(np.uint8).reshape(len(levels), -1), ((0, 0), (0, padding)))
    return TYPES.Image(
        header=make_header(TYPES, stamp_ns, frame_id),
        height=depth_m.shape[0],
        width=depth_m.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.ravel(),
    )


def tf_message(*transforms: tuple[str, str, Pose, int]) -> Any:
    """A TFMessage of parent, child, pose of the child in the parent, stamp."""
    stamped = []
    for parent, child, pose, stamp_ns in transforms:
        (x, y, z, w), (a, b, c) = map(float, pose.quaternion), map(float, pose.translation_m)
        stamped.append(
            KNOWN["geometry_msgs/msg/TransformStamped"](
                header=make_header(TYPES, stamp_ns, parent),
                child_frame_id=child,
                transform=KNOWN["geometry_msgs/msg/Transform"](
                    translation=KNOWN["geometry_msgs/msg/Vector3"](x=a, y=b, z=c),
                    rotation=KNOWN["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
                ),
            )
        )
    return KNOWN["tf2_msgs/msg/TFMessage"](transforms=stamped)


def odometry(parent: str, child: str, pose: Pose, stamp_ns: int) -> Any:
    """A nav_msgs/Odometry without velocity."""
    (x, y, z, w), (a, b, c) = map(float, pose.quaternion), map(float, pose.translation_m)
    zero = KNOWN["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    return KNOWN["nav_msgs/msg/Odometry"](
        header=make_header(TYPES, stamp_ns, parent),
        child_frame_id=child,
        pose=KNOWN["geometry_msgs/msg/PoseWithCovariance"](
            pose=KNOWN["geometry_msgs/msg/Pose"](
                position=KNOWN["geometry_msgs/msg/Point"](x=a, y=b, z=c),
                orientation=KNOWN["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
            ),
            covariance=np.zeros(36),
        ),
        twist=KNOWN["geometry_msgs/msg/TwistWithCovariance"](
            twist=KNOWN["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=np.zeros(36)
        ),
    )
