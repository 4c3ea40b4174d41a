# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of range sensors to points: PointCloud2, LaserScan and depth images, for rclpy and rosbags."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.camera import CameraModel, check_intrinsics
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.messages.depth import depth_pixels
from stereo_depth_ros.messages.types import NS_PER_S, stamp_ns
from stereo_depth_ros.ranging.sensor_points import DEFAULT_SIGMA_M, I64, SensorPoints

__all__ = [
    "IMAGE_TYPE",
    "RANGE_TYPES",
    "cloud_points",
    "depth_info_topic",
    "depth_points",
    "range_points",
    "scan_points",
]

IMAGE_TYPE = "sensor_msgs/msg/Image"
RANGE_TYPES = ("sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan", IMAGE_TYPE)

_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # of PointField
# Names that drivers give to the time of a point, with the type that tells the unit: whole numbers are nanoseconds after
# the stamp (Ouster, Livox), others seconds (Velodyne), of the clock where they are large (Hesai, RoboSense).
_TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
_CLOCK_S = 1e6  # a time above it is not one after the stamp
_CLOCK_NS = 1e15  # seconds of a clock are below it until the year 31 million
_LONGEST_NS = 10 * NS_PER_S  # of a sweep


def range_points(
    msg: Any, topic: str = "", camera: CameraModel | None = None, sigma_m: float = DEFAULT_SIGMA_M
) -> SensorPoints:
    """The points of a PointCloud2, a LaserScan or a depth image, told apart by their fields.

    Args:
        msg: the message, of any family.
        topic: subject of errors.
        camera: of a depth image.
        sigma_m: standard deviation of the ranges, meters.

    Raises:
        MessageError: another message, a depth image without its camera, or as the function of its kind.
        CalibrationError: the camera of a depth image is not calibrated.
    """
    if hasattr(msg, "point_step"):
        return cloud_points(msg, topic, sigma_m)
    if hasattr(msg, "ranges"):
        return scan_points(msg, topic, sigma_m)
    if hasattr(msg, "encoding") and camera is not None:
        return depth_points(msg, camera, topic, sigma_m)
    raise MessageError(
        "a depth image lacks its camera info" if hasattr(msg, "encoding") else f"is a {type(msg).__name__}",
        subject=topic,
        value=type(msg).__name__,
        limit=RANGE_TYPES,
        remedy="use a topic of type PointCloud2, LaserScan, or Image with a camera_info beside it",
    )


def cloud_points(msg: Any, topic: str = "", sigma_m: float = DEFAULT_SIGMA_M) -> SensorPoints:
    """The points of a sensor_msgs/PointCloud2: fields in any order and of any type, with padding.

    Points that are not finite, and those at the origin, which drivers write for rays without a return, are dropped. A
    field t, time, timestamp, time_stamp or offset_time has the times of the points: nanoseconds after the stamp where
    it is a whole number, else seconds after it, or of the clock.

    Raises:
        MessageError: x, y or z is missing or not one number, a field outside of its point, or too few bytes.
    """
    layout = _layout(msg, topic)
    count = msg.width * msg.height
    needed = msg.row_step * (msg.height - 1) + msg.point_step * msg.width if count else 0
    data = np.frombuffer(msg.data, np.uint8) if len(msg.data) else np.zeros(0, np.uint8)
    if data.size < needed or (msg.height > 1 and msg.row_step < msg.point_step * msg.width):
        raise MessageError(
            f"data has {data.size} bytes and rows of {msg.row_step}, {msg.width}x{msg.height} points of "
            f"{msg.point_step} bytes take {needed}",
            subject=topic,
            value=data.size,
            limit=needed,
            remedy="the payload is truncated, or row_step is wrong",
        )
    records = np.ndarray(
        (msg.height, msg.width), layout, data, strides=(msg.row_step, msg.point_step) if count else None
    ).ravel()
    with np.errstate(over="ignore", invalid="ignore"):
        points = np.stack([records[name].astype(np.float32) for name in "xyz"], axis=1).reshape(-1, 3)
        returned = np.asarray((points != 0).any(axis=1), np.bool_)
    finite = np.asarray(np.isfinite(points).all(axis=1), np.bool_)
    kept = finite & returned
    dropped = {"not finite": _count(~finite), "at the origin": _count(~returned)}
    stamp = stamp_ns(msg.header, topic)
    times = _times(records, stamp)
    return SensorPoints(
        np.ascontiguousarray(points[kept]),
        sigma_m,
        stamp,
        msg.header.frame_id,
        None if times is None else times[kept],
        _counted(dropped),
    )


def scan_points(msg: Any, topic: str = "", sigma_m: float = DEFAULT_SIGMA_M) -> SensorPoints:
    """The points of a sensor_msgs/LaserScan in the plane z = 0 of its frame, with their times.

    Rays without a return, infinite or NaN, and ranges outside of range_min..range_max are dropped.

    Raises:
        MessageError: angles or limits that are not finite.
    """
    angles = (msg.angle_min, msg.angle_increment, msg.range_min, msg.time_increment)
    if not np.isfinite(angles).all() or np.isnan(msg.range_max):
        raise MessageError(
            f"angle_min, angle_increment, range_min and time_increment are {[float(value) for value in angles]}",
            subject=topic,
            value=angles,
            limit="finite numbers",
            remedy="check its publisher",
        )
    with np.errstate(invalid="ignore"):  # some patterns of NaN are reported when they are converted
        ranges = np.asarray(msg.ranges, np.float64)
    finite = np.isfinite(ranges)
    inside = finite & (ranges >= msg.range_min) & (ranges <= msg.range_max) & (ranges > 0)
    rays = np.flatnonzero(inside)
    angle = msg.angle_min + rays * float(msg.angle_increment)
    points = np.stack([ranges[rays] * np.cos(angle), ranges[rays] * np.sin(angle), np.zeros(rays.size)], axis=1)
    increment_ns = float(msg.time_increment) * NS_PER_S
    has_times = 0 < abs(increment_ns) * ranges.size <= _LONGEST_NS
    dropped = {"not finite": _count(~finite), "out of range": _count(finite & ~inside)}
    return SensorPoints(
        points.astype(np.float32),  # finite: ranges are float32
        sigma_m,
        stamp_ns(msg.header, topic),
        msg.header.frame_id,
        np.rint(rays * increment_ns).astype(np.int64) if has_times else None,
        _counted(dropped),
    )


def depth_points(msg: Any, camera: CameraModel, topic: str = "", sigma_m: float = DEFAULT_SIGMA_M) -> SensorPoints:
    """The points of a depth image, in the frame of its camera.

    The image is rectified, as depth_image_proc takes it: its camera is P of the camera info, or K where P is not set.

    Raises:
        MessageError: as :func:`depth_pixels`, or an image of another size than that of the camera.
        CalibrationError: the camera is not calibrated.
    """
    depth_m = depth_pixels(msg, topic)
    is_rectified = bool(camera.P.any())
    check_intrinsics(camera.rectified() if is_rectified else camera, topic)
    height, width = depth_m.shape
    if (width, height) != (camera.width, camera.height):
        raise MessageError(
            f"the depth image is {width}x{height}, its camera info is for {camera.width}x{camera.height}",
            subject=topic,
            value=(width, height),
            limit=(camera.width, camera.height),
            remedy="publish the camera info of this image",
        )
    K = camera.P[:, :3] if is_rectified else camera.K
    y, x = np.nonzero(np.isfinite(depth_m))
    z = depth_m[y, x].astype(np.float64)
    points = np.stack([(x - K[0, 2]) / K[0, 0] * z, (y - K[1, 2]) / K[1, 1] * z, z], axis=1)
    if is_rectified and camera.R.any():
        points = points @ camera.R  # R^T X for rows: from the rectified camera to that of the frame
    dropped = {"without depth": depth_m.size - z.size}
    return SensorPoints(
        points.astype(np.float32), sigma_m, stamp_ns(msg.header, topic), msg.header.frame_id, None, _counted(dropped)
    )


def depth_info_topic(topic: str) -> str:
    """The topic of the camera info of a depth image: camera_info beside it."""
    return f"{topic.rpartition('/')[0]}/camera_info"


def _layout(msg: Any, topic: str) -> np.dtype[Any]:
    """The fields of a point that are read."""
    order = ">" if msg.is_bigendian else "<"
    known = {field.name: field for field in msg.fields}
    if missing := [name for name in "xyz" if name not in known]:
        raise MessageError(
            f"has no field {' and '.join(missing)}, it has {quoted(', '.join(known))}",
            subject=topic,
            value=list(known),
            limit=("x", "y", "z"),
            remedy="use a topic with the points in meters",
        )
    names = [*"xyz", *(name for name in _TIME_FIELDS if name in known)][:4]
    for name in names:
        field = known[name]
        size = np.dtype(_DATATYPES.get(field.datatype, "u1")).itemsize
        if field.datatype not in _DATATYPES or field.count > 1 or field.offset + size > msg.point_step:
            raise MessageError(
                f"field {name} is {field.count} values of datatype {field.datatype} at byte {field.offset} of "
                f"{msg.point_step}",
                subject=topic,
                value=(field.datatype, field.count, field.offset),
                limit=msg.point_step,
                remedy="check its publisher: one value of datatype 1 to 8 inside of a point",
            )
    return np.dtype(
        {
            "names": names,
            "formats": [order + _DATATYPES[known[name].datatype] for name in names],
            "offsets": [known[name].offset for name in names],
            "itemsize": msg.point_step,
        }
    )


def _times(records: npt.NDArray[Any], stamp: int) -> I64 | None:
    """Nanoseconds after the stamp of each point; None where there is no field of them, or it is none of times."""
    name = next((name for name in _TIME_FIELDS if name in (records.dtype.names or ())), None)
    if name is None or not records.size:
        return None
    values = records[name]
    if values.dtype.kind in "iu":
        times: F64 = values.astype(np.float64)
    else:
        with np.errstate(invalid="ignore"):
            seconds: F64 = np.nan_to_num(values.astype(np.float64), posinf=0.0, neginf=0.0)
        largest = abs(seconds).max()
        unit = 1.0 if largest > _CLOCK_NS else NS_PER_S
        of_clock = largest > _CLOCK_S
        whole, part = divmod(stamp, NS_PER_S)
        origin = (whole if unit != 1.0 else stamp) if of_clock else 0
        with np.errstate(over="ignore"):
            times = (seconds - origin) * unit - (part if of_clock and unit != 1.0 else 0)
    if abs(times).max() > _LONGEST_NS:
        return None
    return np.rint(times).astype(np.int64)


def _count(mask: npt.NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(mask))


def _counted(dropped: Mapping[str, int]) -> dict[str, int]:
    return {reason: count for reason, count in dropped.items() if count}
