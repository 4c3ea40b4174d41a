# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans with a light stripe: image_raw and a motion to the points of each profile, and to their merged cloud."""

from __future__ import annotations

import functools
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from stereo_depth_ros.active.light_stripe.motion import MotionTrack, StripeMotion, parse_axis
from stereo_depth_ros.active.light_stripe.plane_file import check_same_camera, read_plane
from stereo_depth_ros.active.light_stripe.scanner import MergedCloud, StripeScanner
from stereo_depth_ros.active.light_stripe.stripe_messages import (
    MERGED_TOPIC,
    PROFILE_TOPIC,
    merged_message,
    profile_message,
)
from stereo_depth_ros.active.light_stripe.turntable_file import read_turntable
from stereo_depth_ros.config import LightStripeConfig, PairingConfig, StripeMotionConfig
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.messages.motion import joint_value, pose_value
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.interface import NodeInterface
from stereo_depth_ros.nodes.pair_input import decode_from
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.nodes.triggers import add_trigger

__all__ = ["LightStripeNode", "main"]

_LATE = "images dropped while their motion or camera info was awaited"
_UNKNOWN = "images before the first motion"
_CLOUD = "sensor_msgs/msg/PointCloud2"


class LightStripeNode(StereoNode):
    """One camera and a laser; laser_file has its light plane, and is required.

    Each image gives the points of its profile on stripe/points2. With stripe_motion linear or turntable, the joint of
    joint_states moves, with pose the motion is that of motion/pose; an image waits for the motion at its time.
    ~/merge publishes the points of all profiles in one frame on stripe/merged, latched; ~/restart forgets them.
    """

    interface = NodeInterface(
        "light_stripe_node",
        configs=(PairingConfig, LightStripeConfig, StripeMotionConfig),
        inputs={
            "image_raw": "sensor_msgs/msg/Image",
            "camera_info": "sensor_msgs/msg/CameraInfo",
            "joint_states": "sensor_msgs/msg/JointState",
            "motion/pose": "geometry_msgs/msg/PoseStamped",
        },
        outputs={PROFILE_TOPIC: _CLOUD, MERGED_TOPIC: _CLOUD},
        services={f"~/{name}": "std_srvs/srv/Trigger" for name in ("merge", "restart")},
        lazy=False,
    )

    def __init__(self) -> None:
        super().__init__()
        config = self.parameters.get(StripeMotionConfig)
        if not config.laser_file:
            raise ConfigError(
                "laser_file is empty, the light plane is not known",
                value="",
                remedy="set it to the file that `stereo-depth calibrate-laser` has written",
                settings=("laser_file",),
            )
        self._plane, self._camera = read_plane(Path(config.laser_file))
        self._motion = _motion(config)
        self._track, self._pose_frame = MotionTrack(), ""
        self._camera_known = False
        self._waiting: deque[Any] = deque()
        self._merged = MergedCloud(config.max_profiles)
        self._last = 0, ""
        self._scanner_of = functools.lru_cache(maxsize=1)(self._make_scanner)
        self._profile_output = self.add_output(PROFILE_TOPIC)
        self._merged_output = self.add_output(MERGED_TOPIC, latched=True)
        self.add_input("camera_info", self._on_info)
        self.add_input("image_raw", self._on_image)
        if config.stripe_motion in ("linear", "turntable"):
            self.add_input("joint_states", self._on_joint)
        elif config.stripe_motion == "pose":
            self.add_input("motion/pose", self._on_pose)
        add_trigger(self, "~/merge", self._merge)
        add_trigger(self, "~/restart", self._restart)
        self.diagnostics.watch_loss(_LATE, lambda: "publish the motion, and the camera info, or raise queue_size")
        self.diagnostics.watch_loss(_UNKNOWN, lambda: "publish the motion before the images")
        self.diagnostics.watch_loss("profiles dropped", lambda: "the merged cloud is full: raise max_profiles")

    def _make_scanner(self, config: LightStripeConfig) -> StripeScanner:
        return StripeScanner(self._plane, self._camera, config, self._motion)

    def _on_info(self, message: Any) -> None:
        self._camera_known = False
        topic = self.resolve_topic_name("camera_info")
        check_same_camera(camera_from_info(message, topic), self._camera, topic)
        self._camera_known = True
        self._scan_waiting()

    def _on_joint(self, message: Any) -> None:
        joint, topic = self.parameters.get(StripeMotionConfig).motion_joint, self.resolve_topic_name("joint_states")
        if joint and joint not in message.name:
            self.diagnostics.counters["joint states without the joint"] += 1  # other publishers have other joints
            return
        self._track.add(*joint_value(message, joint, topic))
        self._scan_waiting()

    def _on_pose(self, message: Any) -> None:
        self._track.add(*pose_value(message, self.resolve_topic_name("motion/pose")))
        self._pose_frame = message.header.frame_id
        self._scan_waiting()

    def _on_image(self, message: Any) -> None:
        self._waiting.append(message)
        self._scan_waiting()
        while len(self._waiting) > self.parameters.get(PairingConfig).queue_size:
            self._waiting.popleft()
            self.diagnostics.counters[_LATE] += 1

    def _scan_waiting(self) -> None:
        """Scan the images that wait, in their order, as far as their motion is known."""
        while self._waiting and self._camera_known and self._reached(self._waiting[0]):
            message = self._waiting.popleft()
            with self.diagnostics.catch():
                self._scan(message)

    def _reached(self, message: Any) -> bool:
        return self._motion.kind == "none" or self._track.reaches(stamp_ns(message.header))

    def _scan(self, message: Any) -> None:
        value = np.zeros(0) if self._motion.kind == "none" else self._track.at(stamp_ns(message.header))
        if value is None:
            self.diagnostics.counters[_UNKNOWN] += 1
            return
        frame = decode_from(self, "image_raw", message)
        with self.diagnostics.timed("scan"):
            profile = self._scanner_of(self.parameters.get(LightStripeConfig)).scan(frame, value)
        self.diagnostics.counters["profiles dropped"] += self._merged.add(profile)
        self.diagnostics.counters.update({f"lines {name}": count for name, count in profile.reasons().items()})
        self.diagnostics.counters["profiles"] += 1
        self._last = profile.stamp_ns, self._motion.merged_frame(profile.frame_id, self._pose_frame)
        if self._profile_output.wanted:
            self._profile_output.publish(profile_message(self.types, profile))

    def _merge(self) -> str:
        if not len(self._merged):
            raise CalibrationError("no profile has been scanned", value=0, limit=1, remedy="publish images first")
        message = merged_message(self.types, self._merged, *self._last)
        self._merged_output.publish(message)
        return f"{message.width} points of {len(self._merged)} profiles published on {self._merged_output.topic}"

    def _restart(self) -> str:
        count, self._merged = len(self._merged), MergedCloud(self.parameters.get(StripeMotionConfig).max_profiles)
        self._waiting.clear()
        return f"{count} profiles forgotten"


def _motion(config: StripeMotionConfig) -> StripeMotion:
    kind = config.stripe_motion
    if kind == "turntable" and not config.turntable_file:
        raise ConfigError(
            "stripe_motion is turntable, and turntable_file is empty",
            value="",
            remedy="set it to the file that `stereo-depth calibrate-turntable` has written",
            settings=("turntable_file",),
        )
    axis = parse_axis(config.linear_axis) if kind == "linear" else None
    table = read_turntable(Path(config.turntable_file)) if kind == "turntable" else None
    return StripeMotion(kind, config.moving, axis, table)


def main() -> int:
    """Run the node."""
    return run(LightStripeNode)


if __name__ == "__main__":
    raise SystemExit(main())
