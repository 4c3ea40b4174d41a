# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Surveys a bag for the doctor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.bags.topics import StereoTopics
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.diagnosis.survey import NEAR, PAIRS_EXAMINED, StereoSetup, Survey

__all__ = ["survey_bag"]

_Times: TypeAlias = tuple[int, int]  # stamp and log time of an image, ns


def survey_bag(
    path: Path,
    left: str | None = None,
    right: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StereoSetup:
    """Reads the stamps of all images and the camera infos, decodes a few pairs.

    Args:
        path: the bag.
        left, right: image topics where they are known.
        progress: called with messages read and messages to read.

    Raises:
        BagError: not a readable bag.
        TopicError: no stereo pair in it.
    """
    with BagReader(path) as reader:
        topics = reader.stereo_topics(left, right)
        survey = Survey(str(path), topics, RosbagsTypes().deserialize)
        if reader.warning:
            warning = Finding("bag", Level.WARNING, reader.warning, "whole", "record again, or repair it")
            survey.findings.append(warning)
        images = _read(reader, topics, survey, progress)
        for times in _spread(_paired(images["left"], images["right"])):
            names = (topics.left_image, topics.right_image)
            survey.add_pair(*(_image_at(reader, *place) for place in zip(names, times, strict=True)))
        return survey.setup()


def _read(
    reader: BagReader, topics: StereoTopics, survey: Survey, progress: Callable[[int, int], None]
) -> dict[str, list[_Times]]:
    """Adds all stamps and camera infos; the times of the images by side."""
    images: dict[str, list[_Times]] = {"left": [], "right": []}
    image_sides = {topics.left_image: "left", topics.right_image: "right"}
    info_sides = {topics.left_info: "left", topics.right_info: "right"}
    wanted = [topic for topic in (*image_sides, *info_sides) if topic is not None]
    total = sum(reader.topics[topic].count for topic in wanted)
    for number, message in enumerate(reader.messages(wanted), start=1):
        if side := image_sides.get(message.topic):
            if (stamp_ns := survey.add_image(side, message.data)) is not None:
                images[side].append((stamp_ns, message.log_time_ns))
        else:
            survey.add_info(info_sides[message.topic], message.data)
        progress(number, total)
    return images


def _paired(left: list[_Times], right: list[_Times]) -> list[tuple[_Times, _Times]]:
    """The times of the left and the right image of each pair."""
    pairing: StereoPairing[_Times] = StereoPairing(NEAR)
    pairs = []
    for times, is_left in sorted([(times, True) for times in left] + [(times, False) for times in right]):
        pairs += (pairing.add_left if is_left else pairing.add_right)(times[0], times)
    return pairs + pairing.flush()


def _spread(pairs: list[tuple[_Times, _Times]]) -> Iterator[tuple[_Times, _Times]]:
    """A few of the pairs, from all over the bag."""
    if pairs:
        yield from (pairs[at] for at in np.unique(np.linspace(0, len(pairs) - 1, PAIRS_EXAMINED).astype(int)))


def _image_at(reader: BagReader, topic: str, times: _Times) -> bytes:
    """The bytes of the image with this stamp."""
    stamp_ns, log_time_ns = times
    messages = reader.messages([topic], log_time_ns, log_time_ns)
    return next(message.data for stamp, message in StampedMessages().read(messages) if stamp == stamp_ns)
