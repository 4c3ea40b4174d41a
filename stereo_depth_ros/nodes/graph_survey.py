# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Listens to a running graph for a while, for the doctor: a node that only subscribes, and a call for programs."""

from __future__ import annotations

import functools
import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.topics import StereoTopics, find_stereo_topics
from stereo_depth_ros.core.errors import ConfigError, MessageError, TopicError
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.diagnosis.checks.streams import NEAR
from stereo_depth_ros.diagnosis.finding import Finding
from stereo_depth_ros.diagnosis.survey import PAIRS_LOOKED_AT, CameraRecord, StereoSetup
from stereo_depth_ros.messages.cdr import cdr_stamp_ns, without_stamp
from stereo_depth_ros.messages.image import decode
from stereo_depth_ros.nodes.transport import prepare_process

__all__ = ["camera_topics", "survey_graph"]

_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_KINDS = {_IMAGE: Image, _COMPRESSED: CompressedImage}
_IMAGE_NAMES = ("image_raw", "image_rect", "image_rect_color")
_SETTLE_S = 1.0  # after the images, the camera infos are discovered within this time
_UNSUBSCRIBE_S = 0.2


def camera_topics(namespace: str) -> tuple[str, ...]:
    """Names that the images of a camera of this namespace may have, the best one first."""
    prefix = f"/{namespace.strip('/')}".rstrip("/")
    return tuple(f"{prefix}/{name}{end}" for name in _IMAGE_NAMES for end in ("", "/compressed"))


def survey_graph(
    left: Sequence[str],
    right: Sequence[str],
    seconds: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StereoSetup:
    """What both cameras send, as the nodes of this package would receive it.

    Args:
        left, right: names of the image topics, the first ones that are published are taken.
        seconds: how long is waited for the publishers, and then listened.
        progress: called with seconds gone and seconds to listen.

    Raises:
        ConfigError: no time.
        TopicError: a name that no topic can have, left and right cannot be a pair, or nothing came from either.
    """
    if not 0 < seconds <= 3600:
        raise ConfigError(f"seconds = {seconds:g} is outside 0..3600: listen for some seconds, for example 5")
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
    """Subscribes both images and both camera infos, and keeps their stamps and a few pairs."""

    def __init__(self, node: Node, seconds: float) -> None:
        self._node = node
        self._seconds = seconds
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._pairing: StereoPairing[bytes] = StereoPairing(NEAR)
        self._stamps: dict[str, list[int]] = {"left": [], "right": []}
        self._infos: dict[str, dict[bytes, bytes]] = {"left": {}, "right": {}}
        self._pairs: list[tuple[bytes, bytes]] = []
        self._next_pair = 0.0
        self._subscriptions: list[Any] = []

    def listen(self, left: Sequence[str], right: Sequence[str], progress: Callable[[int, int], None]) -> StereoSetup:
        """See :func:`survey_graph`."""
        topics = self._discover(left, right)
        names = {"left": topics.left_info or _info_of(topics.left_image)}
        names["right"] = topics.right_info or _info_of(topics.right_image)
        image_kind = _COMPRESSED if topics.compressed else _IMAGE
        images = {"left": topics.left_image, "right": topics.right_image}
        for side in ("left", "right"):
            self._subscribe(CameraInfo, names[side], functools.partial(self._receive_info, side))
            self._subscribe(_KINDS[image_kind], images[side], functools.partial(self._receive_image, side))
        self._spin(self._seconds, progress)
        silent = {name: self._why_silent(name) for name in (*images.values(), *names.values())}
        if not any((*self._stamps.values(), *self._infos.values())):
            raise TopicError(
                f"nothing came on {' and '.join(images.values())} in {self._seconds:g} s: {silent[images['left']]}"
            )
        types, findings = RosbagsTypes(), list[Finding]()
        infos = {side: self._decode_infos(types, side, names[side], findings) for side in images}
        pairs = [_decode_pair(types, image_kind, images, pair, findings) for pair in self._pairs]
        return StereoSetup(
            "the graph",
            CameraRecord(images["left"], names["left"], self._stamps["left"], infos["left"]),
            CameraRecord(images["right"], names["right"], self._stamps["right"], infos["right"]),
            [pair for pair in pairs if pair is not None],
            topics.rectified,
            findings,
            silent,
        )

    def close(self) -> None:
        """Stop listening, and give lazy nodes time to do so too: Fast DDS 2.14 can hang where both go in one moment."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._spin(_UNSUBSCRIBE_S)
        self._executor.shutdown()

    def _discover(self, left: Sequence[str], right: Sequence[str]) -> StereoTopics:
        """The topics of both cameras; where they are not published in time those of one that is, else the first."""
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

    def _subscribe(self, kind: Any, topic: str, callback: Callable[[bytes], None]) -> None:
        made = self._node.create_subscription(kind, topic, callback, qos_profile_sensor_data, raw=True)
        self._subscriptions.append(made)

    def _spin(self, seconds: float, progress: Callable[[int, int], None] = lambda done, total: None) -> None:
        begin = time.monotonic()
        while (gone := time.monotonic() - begin) < seconds:
            self._executor.spin_once(timeout_sec=min(0.1, seconds - gone))
            progress(int(gone), round(seconds))

    def _receive_info(self, side: str, data: bytes) -> None:
        self._infos[side].setdefault(without_stamp(data), data)

    def _receive_image(self, side: str, data: bytes) -> None:
        stamp_ns = cdr_stamp_ns(data)
        self._stamps[side].append(stamp_ns)
        add = self._pairing.add_left if side == "left" else self._pairing.add_right
        pairs = add(stamp_ns, data)
        if pairs and len(self._pairs) < PAIRS_LOOKED_AT and time.monotonic() >= self._next_pair:
            self._pairs.append(pairs[0])
            self._next_pair = time.monotonic() + self._seconds / PAIRS_LOOKED_AT

    def _why_silent(self, topic: str) -> str:
        publishers = self._node.count_publishers(topic)
        if publishers:
            return f"{publishers} publisher(s) are there, nothing came in {self._seconds:g} s: check that they send"
        others = sorted(name for name, kind in self._published().items() if kind in _KINDS)
        return f"nobody publishes it: start the camera, or name its topic, images are on {', '.join(others) or 'none'}"

    def _decode_infos(self, types: RosbagsTypes, side: str, topic: str, findings: list[Finding]) -> list[Any]:
        infos = []
        for data in self._infos[side].values():
            try:
                infos.append(types.deserialize(data, "sensor_msgs/msg/CameraInfo"))
            except MessageError as error:
                findings.append(Finding.refused(f"message of {topic}", error))
        return infos


def _decode_pair(
    types: RosbagsTypes, kind: str, topics: Mapping[str, str], pair: tuple[bytes, bytes], findings: list[Finding]
) -> StereoPair | None:
    """The frames of a pair; of images that cannot be decoded the first error is told."""
    try:
        left, right = (
            decode(types.deserialize(data, kind), topic) for data, topic in zip(pair, topics.values(), strict=True)
        )
    except MessageError as error:
        if not any(finding.check == "images" for finding in findings):
            findings.append(Finding.refused("images", error))
        return None
    return StereoPair(left, right)


def _resolved(node: Node, names: Sequence[str]) -> list[str]:
    """The names as they are in the graph."""
    resolved = []
    for name in names:
        try:
            resolved.append(node.resolve_topic_name(name))
        except (InvalidTopicNameException, RuntimeError) as error:  # rclpy's own error of rcl is a RuntimeError
            why = str(error).splitlines()[0].removeprefix("failed to resolve name: ").partition(", at ")[0]
            raise TopicError(f"{name!r} cannot be a topic: {why}: name an image topic") from error
    return resolved


def _assumed(candidates: Sequence[tuple[str, str]], types: Mapping[str, str]) -> StereoTopics:
    """The first pair of which one camera is published, else the first one of all."""
    left, right = next((pair for pair in candidates if types.keys() & set(pair)), candidates[0])
    kind = types.get(left) or types.get(right) or _IMAGE
    return find_stereo_topics({left: kind, right: kind}, left, right)


def _info_of(image: str) -> str:
    """The camera info beside an image, or beside the image whose transport it is."""
    return f"{image.removesuffix('/compressed').rpartition('/')[0]}/camera_info"
