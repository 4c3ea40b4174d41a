# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Surveys a running graph for the doctor: a node that only subscribes, and a function that runs it."""

from __future__ import annotations

import functools
import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from stereo_depth_ros.bags.topics import StereoTopics, find_stereo_topics
from stereo_depth_ros.core.errors import ConfigError, TopicError
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.diagnosis.survey import NEAR, PAIRS_EXAMINED, StereoSetup, Survey
from stereo_depth_ros.nodes.message_types import RclpyTypes
from stereo_depth_ros.nodes.transport import prepare_process

__all__ = ["camera_topics", "survey_graph"]

_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_IMAGE_NAMES = ("image_raw", "image_rect", "image_rect_color")
_SETTLE_S = 1.0  # after the images, the camera infos are discovered within this time
_UNSUBSCRIBE_S = 0.2


def camera_topics(namespace: str) -> tuple[str, ...]:
    """Possible image topics of a camera in this namespace, the preferred one first."""
    prefix = f"/{namespace.strip('/')}".rstrip("/")
    return tuple(f"{prefix}/{name}{end}" for name in _IMAGE_NAMES for end in ("", "/compressed"))


def survey_graph(
    left: Sequence[str],
    right: Sequence[str],
    seconds: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StereoSetup:
    """The messages of both cameras, as the nodes of this package receive them.

    Args:
        left, right: names of the image topics; the first published ones are used.
        seconds: time to wait for the publishers, and then to listen.
        progress: called with seconds elapsed and seconds to listen.

    Raises:
        ConfigError: seconds outside 0..3600.
        TopicError: an invalid topic name, topics that cannot be a pair, or no message of either camera.
    """
    if not 0 < seconds <= 3600:
        raise ConfigError(
            f"{seconds:g} is outside 0..3600",
            subject="seconds",
            value=seconds,
            limit=(0, 3600),
            remedy="set a value above 0 and up to 3600",
        )
    prepare_process()
    context = Context()
    rclpy.init(args=[], context=context)
    try:
        node = Node("stereo_depth_doctor", context=context, enable_rosout=False)
        try:
            probe = _GraphSurvey(node, seconds)
            try:
                return probe.listen(_resolved(node, left), _resolved(node, right), progress)
            finally:
                probe.close()
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


class _GraphSurvey:
    """Subscribes both images and both camera infos, and adds them to a survey."""

    def __init__(self, node: Node, seconds: float) -> None:
        self._node = node
        self._seconds = seconds
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._pairing: StereoPairing[bytes] = StereoPairing(NEAR)
        self._pairs: list[tuple[bytes, bytes]] = []
        self._next_pair = 0.0
        self._subscriptions: list[Any] = []

    def listen(self, left: Sequence[str], right: Sequence[str], progress: Callable[[int, int], None]) -> StereoSetup:
        """See :func:`survey_graph`."""
        topics = self._discover(left, right)
        infos = (topics.left_info or _info_of(topics.left_image), topics.right_info or _info_of(topics.right_image))
        images = (topics.left_image, topics.right_image)
        survey = Survey("the graph", replace(topics, left_info=infos[0], right_info=infos[1]), RclpyTypes().deserialize)
        self._subscribe_all(survey, images, infos, CompressedImage if topics.compressed else Image)
        self._spin(self._seconds, progress)
        silent = {name: self._why_silent(name) for name in (*images, *infos)}
        if survey.empty:
            raise TopicError(
                f"no messages in {self._seconds:g} s",
                subject=" and ".join(images),
                value=0,
                limit=1,
                remedy=silent[images[0]],
                settings=("left_namespace", "right_namespace"),
            )
        for pair in self._pairs:
            survey.add_pair(*pair)
        return survey.setup(silent)

    def close(self) -> None:
        """Unsubscribe, and give lazy nodes time to do so too: Fast DDS 2.14 can hang where both happen together."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._spin(_UNSUBSCRIBE_S)
        self._executor.shutdown()

    def _discover(self, left: Sequence[str], right: Sequence[str]) -> StereoTopics:
        """The topics of both cameras.

        If not all are published in time: the pair with one published camera, else the first pair.
        """
        candidates = list(zip(left, right, strict=True) if len(left) == len(right) else itertools.product(left, right))
        end, topics = time.monotonic() + self._seconds, None
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)
            types = self._published()
            pair = next((pair for pair in candidates if set(pair) <= types.keys()), None)
            if pair is None:
                continue
            if topics is None:
                end = min(end, time.monotonic() + _SETTLE_S)
            topics = find_stereo_topics(types, *pair)
            if topics.left_info is not None and topics.right_info is not None:
                break
        return topics or _assumed(candidates, self._published())

    def _published(self) -> dict[str, str]:
        """Type of each topic that has a publisher."""
        topics = self._node.get_topic_names_and_types()
        return {name: types[0] for name, types in topics if self._node.count_publishers(name)}

    def _subscribe_all(
        self, survey: Survey, images: tuple[str, str], infos: tuple[str, str], image_type: type[Any]
    ) -> None:
        for side, image, info in zip(("left", "right"), images, infos, strict=True):
            self._subscribe(CameraInfo, info, functools.partial(survey.add_info, side))
            self._subscribe(image_type, image, functools.partial(self._receive_image, survey, side))

    def _subscribe(self, kind: Any, topic: str, callback: Callable[[bytes], object]) -> None:
        subscription = self._node.create_subscription(kind, topic, callback, qos_profile_sensor_data, raw=True)
        self._subscriptions.append(subscription)

    def _spin(self, seconds: float, progress: Callable[[int, int], None] = lambda done, total: None) -> None:
        begin = time.monotonic()
        while (elapsed := time.monotonic() - begin) < seconds:
            self._executor.spin_once(timeout_sec=min(0.1, seconds - elapsed))
            progress(int(elapsed), round(seconds))

    def _receive_image(self, survey: Survey, side: str, data: bytes) -> None:
        stamp_ns = survey.add_image(side, data)
        if stamp_ns is None:
            return
        add = self._pairing.add_left if side == "left" else self._pairing.add_right
        pairs = add(stamp_ns, data)
        if pairs and len(self._pairs) < PAIRS_EXAMINED and time.monotonic() >= self._next_pair:
            self._pairs.append(pairs[0])
            self._next_pair = time.monotonic() + self._seconds / PAIRS_EXAMINED

    def _why_silent(self, topic: str) -> str:
        publishers = self._node.count_publishers(topic)
        if publishers:
            return f"{publishers} publisher(s), but no messages in {self._seconds:g} s: check that they publish"
        others = sorted(name for name, kind in self._published().items() if kind in (_IMAGE, _COMPRESSED))
        return f"no publisher: start the camera, or name its topic; images are on {', '.join(others) or 'no topic'}"


def _resolved(node: Node, names: Sequence[str]) -> list[str]:
    """The resolved names."""
    resolved = []
    for name in names:
        try:
            resolved.append(node.resolve_topic_name(name))
        except (InvalidTopicNameException, RuntimeError) as error:  # rclpy's own error of rcl is a RuntimeError
            raise _not_a_topic(name) from error
    return resolved


def _not_a_topic(name: str) -> TopicError:
    invalid = rclpy_implementation.rclpy_get_validation_error_for_full_topic_name(f"/{name.removeprefix('/')}")
    return TopicError(
        f"{name!r} is not a topic name" + (f", {invalid[0]}" if invalid else ""),
        value=name,
        limit="letters, digits, _ and /",
        remedy="name an image topic, such as /left/image_raw",
    )


def _assumed(candidates: Sequence[tuple[str, str]], types: Mapping[str, str]) -> StereoTopics:
    """The first pair of which one camera is published, else the first pair."""
    left, right = next((pair for pair in candidates if types.keys() & set(pair)), candidates[0])
    kind = types.get(left) or types.get(right) or _IMAGE
    return find_stereo_topics({left: kind, right: kind}, left, right)


def _info_of(image: str) -> str:
    """The camera info beside an image; of a transport beside its image."""
    return f"{image.removesuffix('/compressed').rpartition('/')[0]}/camera_info"
