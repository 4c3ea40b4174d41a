# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of parameters that nodes accept beside their own: of ROS, and of stereo_image_proc and image_proc."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

__all__ = ["QOS_OVERRIDES", "is_ros_parameter", "is_without_effect", "without_effect_text"]

QOS_OVERRIDES = "qos_overrides."
_ROS = ("use_sim_time", "start_type_description_service")

_NO_RESIZING = "images are not resized or cropped"
_REASONS: Mapping[str, str] = {
    "use_system_default_qos": "qos_overrides set the QoS",
    "interpolation": "rectification is bilinear",
    **dict.fromkeys(("use_scale", "scale_width", "scale_height", "width", "height"), _NO_RESIZING),
    **dict.fromkeys(("decimation_x", "decimation_y", "offset_x", "offset_y"), _NO_RESIZING),
}
# Parameters of the plugins of image_transport: <topic with dots>.<transport>.<name>, formerly without the transport
_PLUGIN_PARAMETER = re.compile(
    r"\.?(\w+\.)+(enable_pub_plugins|format|mode|png_level|jpeg_quality|jpeg_compress_bayer|tiff\.(res_unit|xdpi|ydpi)"
    r"|depth_max|depth_quantization|zstd_level|optimize_for|target_bitrate|quality|keyframe_frequency"
    r"|post_processing_level)"
)
_NO_PLUGINS = "no image_transport plugins are used"


def is_ros_parameter(name: str) -> bool:
    """Whether it is a parameter of every node of ROS, or an override of a QoS."""
    return name in _ROS or name.startswith(QOS_OVERRIDES)


def is_without_effect(name: str) -> bool:
    """Whether it is a parameter of the nodes of stereo_image_proc or image_proc that has no effect here."""
    return bool(_reason(name))


def without_effect_text(names: Iterable[str]) -> str:
    """One line that tells which of the parameters have no effect and why; empty if there are none."""
    by_reason: dict[str, list[str]] = {}
    for name in names:
        if reason := _reason(name):
            by_reason.setdefault(reason, []).append(name)
    groups = [f"{', '.join(found)} ({reason})" for reason, found in by_reason.items()]
    return f"parameters without effect: {'; '.join(groups)}" if groups else ""


def _reason(name: str) -> str:
    return _REASONS.get(name, "") or (_NO_PLUGINS if _PLUGIN_PARAMETER.fullmatch(name) else "")
