# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PointCloud2 messages, organized from disparities or sparse from points."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.messages.types import MessageTypes, make_header
from stereo_depth_ros.stages.point_cloud import CloudLayout, pack_points

__all__ = ["cloud_message", "sparse_cloud_message", "valued_cloud_message"]

_FLOAT32 = 7


def cloud_message(
    types: MessageTypes,
    disparity_px: F32,
    triangulation: Triangulation,
    layout: CloudLayout,
    *,
    stamp_ns: int,
    frame_id: str,
    color: U8 | None = None,
    color_encoding: str = "mono8",
    quality: tuple[F32, F32] | None = None,
    payload: tuple[Any, U8] | None = None,
) -> Any:
    """An organized PointCloud2, NaN where invalid.

    Args:
        types: the message classes.
        disparity_px: float32 (H, W), NaN where invalid.
        triangulation: the geometry of the rig.
        layout: memory layout of a point.
        stamp_ns, frame_id: header, that of the left image.
        color, color_encoding: the left rectified image, if the layout has a color.
        quality: confidence and standard deviation of the depth, meters, float32 (H, W), if the layout has them.
        payload: a reused ``types.payload(H * W * point_step)``, initially zeroed, or None for a new one.

    Raises:
        ImageError: see :func:`pack_points`.
    """
    height, width = disparity_px.shape
    data, view = payload or types.payload(height * width * layout.point_step)
    pack_points(disparity_px, triangulation, layout, view, color, color_encoding, quality)
    return _message(types, layout, (height, width), data, make_header(types, stamp_ns, frame_id), is_dense=False)


def sparse_cloud_message(
    types: MessageTypes, points_m: F64, rgb: U8 | None, layout: CloudLayout, *, stamp_ns: int, frame_id: str
) -> Any:
    """A PointCloud2 of one row of points, all of them valid.

    Args:
        types: the message classes.
        points_m: float64 (N, 3), meters.
        rgb: uint8 (N, 3), their colors, if the layout has a color.
        layout: memory layout of a point.
        stamp_ns, frame_id: header, that of the left image.
    """
    data, view = types.payload(len(points_m) * layout.point_step)
    words = view.view(np.float32).reshape(len(points_m), layout.point_step // 4)
    words[:, :3] = points_m
    if layout.rgb_offset is not None and rgb is not None:
        red, green, blue = rgb.astype(np.uint32).T
        words.view(np.uint32)[:, layout.rgb_offset // 4] = red << 16 | green << 8 | blue
    return _message(types, layout, (1, len(points_m)), data, make_header(types, stamp_ns, frame_id), is_dense=True)


def valued_cloud_message(
    types: MessageTypes, points_m: F64, values: Mapping[str, F32], *, stamp_ns: int, frame_id: str
) -> Any:
    """A PointCloud2 of one row of points with a float32 for each of some values, all of them valid.

    Args:
        types: the message classes.
        points_m: float64 (N, 3), meters.
        values: float32 (N,) by name of the field; RViz and Foxglove color by ``intensity``.
        stamp_ns, frame_id: header.
    """
    names = ("x", "y", "z", *values)
    data, view = types.payload(4 * len(names) * len(points_m))
    words = view.view(np.float32).reshape(len(points_m), len(names))
    words[:, :3] = points_m
    for number, each in enumerate(values.values(), start=3):
        words[:, number] = each
    offsets = {name: 4 * number for number, name in enumerate(names)}
    header = make_header(types, stamp_ns, frame_id)
    return _message_of(types, offsets, 4 * len(names), (1, len(points_m)), data, header, is_dense=True)


def _message(
    types: MessageTypes, layout: CloudLayout, shape: tuple[int, int], data: Any, header: Any, *, is_dense: bool
) -> Any:
    offsets = {"x": 0, "y": 4, "z": 8}
    if layout.rgb_offset is not None:
        offsets["rgb"] = layout.rgb_offset
    if layout.quality_offset is not None:
        offsets |= {"confidence": layout.quality_offset, "sigma": layout.quality_offset + 4}
    return _message_of(types, offsets, layout.point_step, shape, data, header, is_dense=is_dense)


def _message_of(
    types: MessageTypes,
    offsets: Mapping[str, int],
    point_step: int,
    shape: tuple[int, int],
    data: Any,
    header: Any,
    *,
    is_dense: bool,
) -> Any:
    height, width = shape
    return types.PointCloud2(
        header=header,
        height=height,
        width=width,
        fields=[types.PointField(name=n, offset=o, datatype=_FLOAT32, count=1) for n, o in offsets.items()],
        is_bigendian=sys.byteorder == "big",
        point_step=point_step,
        row_step=point_step * width,
        data=data,
        is_dense=is_dense,
    )
