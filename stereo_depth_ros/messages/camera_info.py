# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""CameraInfo messages of camera models."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.messages.types import MessageTypes, make_header

__all__ = ["camera_info_message", "rectified_camera_info"]


def camera_info_message(types: MessageTypes, camera: CameraModel, stamp_ns: int, frame_id: str | None = None) -> Any:
    """A sensor_msgs/CameraInfo of a camera, at the resolution of its image: no binning, no region of interest.

    Args:
        types: the family of messages.
        camera: the camera model.
        stamp_ns: header stamp, integer nanoseconds.
        frame_id: header frame; that of the camera by default.
    """
    return types.CameraInfo(
        header=make_header(types, stamp_ns, camera.frame_id if frame_id is None else frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model=camera.distortion_model,
        d=types.float64s(camera.D),
        k=camera.K.ravel(),
        r=camera.R.ravel(),
        p=camera.P.ravel(),
        binning_x=0,
        binning_y=0,
        roi=types.RegionOfInterest(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def rectified_camera_info(types: MessageTypes, left: CameraModel, stamp_ns: int, frame_id: str | None = None) -> Any:
    """The sensor_msgs/CameraInfo of an image in the rectified left frame, such as depth.

    K is that of the rectified image, D zero, R the identity; arguments as for :func:`camera_info_message`.
    """
    K = left.P[:, :3]
    camera = replace(left.rectified(), P=np.column_stack([K, np.zeros(3)]))
    return camera_info_message(types, camera, stamp_ns, frame_id)
