# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics whose first pairs fit are used instead of better named ones whose pairs do not, by every command alike."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import CommandLine
from rosbags.rosbag2 import Writer
from stereo_bags import PARAMETERS

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.stereo_topics import bag_topics
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.diagnosis.stereo_choice import choose_topics
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.cdr import with_stamp
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.offline.pairs import read_pairs
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.sequence import SyntheticFrame, SyntheticSequence

TYPES, MADE = RosbagsTypes(), SyntheticSequence(2, 320, 240)
RAW, RECTIFIED = (f"/zed/left/image_{kind}_color and /zed/right/image_{kind}_color" for kind in ("raw", "rect"))


@functools.cache
def frames() -> list[SyntheticFrame]:
    return list(MADE)


def zed_bag(path: Path, info: str | None, *, raw_info: str | None = None, without: Iterable[str] = ()) -> Path:
    """A bag as of a ZED: both kinds of images in one namespace for each camera.

    Args:
        info, raw_info: "raw" or "rectified" cameras in camera_info and camera_info_raw, or "none", which was never
            calibrated; None writes none.
        without: names of images that are left out.
    """
    types, rectifier = RosbagsTypes(), Rectifier(MADE.rig)
    with BagWriter(path) as bag:
        for frame in frames():
            rectified = rectifier.rectify(frame.pair)
            for side, camera, raw, rect in (
                ("left", MADE.rig.left, frame.pair.left, rectified.left),
                ("right", MADE.rig.right, frame.pair.right, rectified.right),
            ):
                stamp_ns = raw.stamp_ns
                images: dict[str, U8] = {"image_raw_color": raw.pixels, "image_rect_color": rect}
                for name, pixels in images.items():
                    if name not in without:
                        message = image_message(types, pixels, "mono8", stamp_ns, camera.frame_id)
                        bag.write(f"/zed/{side}/{name}", message, stamp_ns)
                for name, kind in (("camera_info", info), ("camera_info_raw", raw_info)):
                    if kind is not None:
                        bag.write(f"/zed/{side}/{name}", info_message(types, camera, kind, stamp_ns), stamp_ns)
    return path


def info_message(types: RosbagsTypes, camera: CameraModel, kind: str, stamp_ns: int) -> Any:
    message = camera_info_message(types, camera.rectified() if kind == "rectified" else camera, stamp_ns)
    return replace(message, width=0, height=0, k=np.zeros(9), p=np.zeros(12)) if kind == "none" else message


def used(path: Path) -> tuple[str, str]:
    """The left image that is used, and what is said about it."""
    selection, note = choose_topics(BagSelection(path))
    with BagPairs(selection, PairingConfig()) as pairs:
        return pairs.topics.left_image, note


def test_raw_images_have_the_camera_infos_of_raw_ones(tmp_path: Path) -> None:
    path = zed_bag(tmp_path / "zed.mcap", "rectified", raw_info="raw")
    assert used(path) == ("/zed/left/image_raw_color", "")
    with BagPairs(BagSelection(path), PairingConfig()) as pairs:
        assert pairs.topics.right_info == "/zed/right/camera_info_raw"


@pytest.mark.parametrize(
    ("info", "raw_info", "why"),
    [
        ("rectified", None, r"rows of left and right differ by \d+\.\d px \(limit 1 px\)$"),
        ("rectified", "none", r"/zed/left/camera_info_raw\): not calibrated, the size is 0x0, K and P are all zero$"),
    ],
)
def test_rectified_images_that_fit_are_used_instead_of_raw_ones_that_do_not(
    info: str, raw_info: str | None, why: str, tmp_path: Path, command_line: CommandLine
) -> None:
    path, output = zed_bag(tmp_path / "zed.mcap", info, raw_info=raw_info), tmp_path / "out.mcap"
    left, note = used(path)
    assert left == "/zed/left/image_rect_color"
    assert note.startswith(f"{RECTIFIED} are used, since {RAW} do not fit their camera infos: ")
    assert re.search(why, note)
    report = process_bag(BagSelection(path, duration_seconds=0.05), output, pipeline_config(PARAMETERS))
    (warning,) = report.warnings  # of the first pair alone
    assert warning.partition(":")[0] == note.partition(":")[0]
    assert report.score is not None and report.score.valid_fraction > 0.8
    code, out, err = command_line("info")(path)
    assert code == 0 and note in err and "/zed/left/image_rect_color" in out
    with pytest.warns(UserWarning, match=re.escape(note)):
        next(read_pairs(path))
    setup = survey_bag(BagSelection(path))
    assert setup.left.image_topic == left and [finding.value for finding in setup.findings] == [note]


def test_the_better_named_ones_are_used_where_none_fit_or_they_are_named(tmp_path: Path) -> None:
    path = zed_bag(tmp_path / "bad.mcap", "none")
    assert used(path) == ("/zed/left/image_raw_color", "")
    path = zed_bag(tmp_path / "zed.mcap", "rectified")
    named = BagSelection(path, "/zed/left/image_raw_color", "/zed/right/image_raw_color")
    assert choose_topics(named) == (named, "")


def test_one_pair_of_topics_is_not_examined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = zed_bag(tmp_path / "zed.mcap", "rectified", without=("image_rect_color",))
    monkeypatch.setattr("stereo_depth_ros.diagnosis.stereo_choice.BagPairs", None)
    assert choose_topics(BagSelection(path)) == (BagSelection(path), "")


def test_topics_without_messages_are_not_preferred(tmp_path: Path) -> None:
    """rosbag2 lists every topic that was there, also those on which nothing came."""
    path, types = zed_bag(tmp_path / "zed.mcap", "rectified", without=("image_raw_color",)), RosbagsTypes().typestore
    with BagReader(path) as reader, Writer(tmp_path / "folder", version=9) as writer:
        for side in ("left", "right"):
            writer.add_connection(f"/zed/{side}/image_raw", "sensor_msgs/msg/Image", typestore=types)
        topics = {n: writer.add_connection(n, i.msgtype, typestore=types) for n, i in reader.topics.items()}
        for message in reader.messages():
            writer.write(topics[message.topic], message.log_time_ns, message.data)
    with BagPairs(BagSelection(tmp_path / "folder"), PairingConfig()) as pairs:
        assert pairs.topics.left_image == "/zed/left/image_rect_color"
    with BagReader(tmp_path / "folder") as reader:
        assert bag_topics(reader, left="/zed/left/image_raw").right_image == "/zed/right/image_raw"


def test_a_damaged_image_and_pairs_without_texture_are_passed_over(tmp_path: Path) -> None:
    """A camera that starts dark, and a first image that is cut, say nothing about the topics."""
    path = zed_bag(tmp_path / "zed.mcap", "rectified")
    dark, cut = tmp_path / "dark.mcap", tmp_path / "cut.mcap"
    with BagReader(path) as reader, BagWriter(dark) as of_dark, BagWriter(cut) as of_cut:
        messages = list(reader.messages())
        start_ns = messages[0].log_time_ns
        for number in range(12):  # of 12 pairs without texture, ten are examined; the next ones at the 20th and 30th
            for message in messages[: len(messages) // 2]:
                data = message.data
                if "image" in message.topic:
                    image = reader.deserialize(message)
                    data = TYPES.serialize(replace(image, data=np.zeros_like(image.data)))
                stamp_ns = start_ns + number * 10**7
                of_dark.write_raw(message.topic, message.msgtype, with_stamp(data, stamp_ns), stamp_ns)
        for number in range(12, 31):
            for message in messages[: len(messages) // 2]:
                stamp_ns = start_ns + number * 10**7
                of_dark.write_raw(message.topic, message.msgtype, with_stamp(message.data, stamp_ns), stamp_ns)
        for number, message in enumerate(messages):
            raw = "image_raw" in message.topic
            data = message.data[:-7] if raw and number < len(messages) // 2 else message.data
            of_cut.write_raw(message.topic, message.msgtype, data, message.log_time_ns)
    for bag in (dark, cut):
        left, note = used(bag)
        assert left == "/zed/left/image_rect_color" and "rows of left and right differ by" in note
