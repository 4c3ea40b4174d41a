# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Surveys a bag for the doctor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from stereo_depth_ros.bags.file_infos import file_infos
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.bags.stereo_topics import CameraImages, bag_topics
from stereo_depth_ros.bags.topics import StereoTopics
from stereo_depth_ros.core.errors import BagError, MessageError
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.diagnosis.stereo_choice import CHOICE_REMEDY, choose_topics
from stereo_depth_ros.diagnosis.survey import NEAR, PAIRS_EXAMINED, StereoSetup, Survey

__all__ = ["survey_bag"]

_Times: TypeAlias = tuple[int, int]  # stamp and log time of an image, ns
_Images: TypeAlias = tuple[list[_Times], list[_Times]]  # of the left and the right ones


def survey_bag(selection: BagSelection, progress: Callable[[int, int], None] = lambda done, total: None) -> StereoSetup:
    """Reads the stamps of all images and the camera infos, decodes a few pairs.

    Args:
        selection: the bag and its topics; it is read to the end.
        progress: called with messages read and messages to read.

    Raises:
        BagError: not a readable bag.
        TopicError: no stereo pair in it.
        CalibrationError, MessageError: calibration files that are not those of its images.
    """
    chosen, note = choose_topics(selection)
    with BagReader(chosen.path) as reader:
        topics = bag_topics(reader, chosen.left, chosen.right, side_by_side=chosen.side_by_side)
        cameras, types = CameraImages(reader, topics), RosbagsTypes()
        infos = file_infos(reader, topics, chosen.camera_files) if chosen.camera_files else None
        survey = Survey(str(chosen.path), topics if infos is None else infos.topics, types.deserialize)
        if infos is not None:
            topics = replace(topics, left_info=None, right_info=None)  # those of the bag are not read
            for side, data in zip(("left", "right"), infos.messages(types), strict=True):
                survey.add_info(side, data)
        if note:
            survey.findings.append(Finding("topics", Level.WARNING, note, "the preferred ones fit", CHOICE_REMEDY))
        images: _Images = [], []
        try:
            _read(reader, topics, cameras, survey, images, progress)
        except BagError as error:  # no message can be read
            damage = Finding.refused("bag", error)
        else:  # known when everything is read
            damage = Finding("bag", Level.WARNING, reader.warning, "whole", "record again, or repair it")
        if damage.value:
            survey.findings.insert(0, damage)
        names = (topics.left_image, topics.right_image)
        for times in _spread(_paired(*images)):
            try:
                left, right = (_image_at(reader, cameras, side, names[side], times[side]) for side in (0, 1))
            except MessageError as error:  # of images side by side that have no halves
                survey.findings.append(Finding.refused(f"images of {names[0]}", error))
                break
            survey.add_pair(left, right)
        return survey.setup()


def _read(
    reader: BagReader,
    topics: StereoTopics,
    cameras: CameraImages,
    survey: Survey,
    images: _Images,
    progress: Callable[[int, int], None],
) -> None:
    """Adds all stamps and camera infos to the survey, and the times of the images."""
    info_sides = {topics.left_info: "left", topics.right_info: "right"}
    wanted = [topic for topic in (*cameras.names, *info_sides) if topic is not None]
    total = sum(reader.topics[topic].count for topic in wanted)
    for number, message in enumerate(reader.messages(wanted), start=1):
        if message.topic in cameras.names:
            for side in cameras.sides(message.topic):
                if (stamp_ns := survey.add_image(("left", "right")[side], message.data)) is not None:
                    images[side].append((stamp_ns, message.log_time_ns))
        else:
            survey.add_info(info_sides[message.topic], message.data)
        progress(number, total)


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


def _image_at(reader: BagReader, cameras: CameraImages, side: int, topic: str, times: _Times) -> bytes:
    """The bytes of the image of a side with this stamp."""
    stamp_ns, log_time_ns = times
    messages = reader.messages([topic], log_time_ns, log_time_ns)
    message = next(message for stamp, message in StampedMessages().read(messages) if stamp == stamp_ns)
    return dict(cameras.of(message))[side]
