# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Serialized pairs of a bag: pairing, camera infos, shifts of stamps, parts of a bag, errors."""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from stereo_bags import cut, later, sequence, write_odd_bag, write_truth_bag

from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.errors import BagError, CalibrationError, ConfigError, MessageError, TopicError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.datasets.stereo_images import open_stereo_images
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.cdr import cdr_stamp_ns, with_stamp, without_stamp
from stereo_depth_ros.messages.image import image_message

EXACT = PairingConfig()


@pytest.fixture(scope="module")
def odd_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "odd.mcap"
    write_odd_bag(path, 5, without_right=(1, 4))
    return path


def test_pairs_have_equal_stamps_and_camera_infos_with_the_stamps_of_their_images(odd_bag: Path) -> None:
    with BagPairs(BagSelection(odd_bag), EXACT) as bag:
        pairs = list(bag.pairs())
        assert (bag.topics.left_image, bag.topics.right_image) == ("/cam0/image", "/cam1/image")
        assert (bag.unpaired_left, bag.unpaired_right) == (2, 0)
    made = sequence(5)
    assert [pair.stamp_ns for pair in pairs] == [made.stamp_ns(index) for index in (0, 2, 3)]
    for pair in pairs:
        stamps = [cdr_stamp_ns(data) for data in (pair.left, pair.right, pair.left_info, pair.right_info)]
        assert stamps == [pair.stamp_ns] * 4
    types = RosbagsTypes()
    info = types.deserialize(pairs[2].right_info, "sensor_msgs/msg/CameraInfo")
    assert info.p[3] == pytest.approx(made.rig.right.P[0, 3]), "the only camera info of the bag, at its beginning"


def test_rectified_images_are_not_rectified_again(tmp_path: Path) -> None:
    """A driver that rectifies publishes the camera infos of the raw cameras with image_rect."""
    path, frame, rig, types = tmp_path / "rect.mcap", sequence(1)[0], sequence(1).rig, RosbagsTypes()
    with BagWriter(path) as bag:
        for side, image, camera in (("left", frame.pair.left, rig.left), ("right", frame.pair.right, rig.right)):
            bag.write(f"/{side}/image_rect", image_message(types, image.pixels, "mono8", 5, side), 5)
            bag.write(f"/{side}/camera_info", camera_info_message(types, camera, 4), 4)
    with BagPairs(BagSelection(path), EXACT) as bag:
        pair = next(iter(bag.pairs()))
    infos = [types.deserialize(data, "sensor_msgs/msg/CameraInfo") for data in (pair.left_info, pair.right_info)]
    read = StereoRig.from_infos(*infos)
    np.testing.assert_array_equal(read.Q, rig.Q)
    for camera, source in ((read.left, rig.left), (read.right, rig.right)):
        assert source.D.any()
        assert not camera.D.any()
        np.testing.assert_array_equal(camera.R, np.identity(3))
        np.testing.assert_array_equal(camera.K, source.P[:, :3])


def test_part_of_a_bag_by_seconds(odd_bag: Path) -> None:
    with BagPairs(BagSelection(odd_bag, start_seconds=0.15, duration_seconds=0.1), EXACT) as bag:
        assert [pair.stamp_ns for pair in bag.pairs()] == [sequence(5).stamp_ns(2)]


@pytest.mark.parametrize(
    ("start_s", "duration_s", "count", "part"),
    [
        (0.0, 0.0, 5, ""),
        (0.1, 0.0, 4, "from 0.1 to 0.400 s of 0.400 s"),
        (0.1, 0.15, 2, "from 0.1 to 0.250 s of 0.400 s"),
        (0.0, 9.0, 5, "from 0 to 0.400 s of 0.400 s"),
        (0.3, 9.0, 2, "from 0.3 to 0.400 s of 0.400 s"),
    ],
)
def test_count_is_that_of_the_part(odd_bag: Path, start_s: float, duration_s: float, count: int, part: str) -> None:
    with BagPairs(BagSelection(odd_bag, None, None, start_s, duration_s), EXACT) as bag:
        assert (bag.count, bag.part) == (count, part)
        assert len(list(bag.pairs())) <= count


def test_a_part_after_the_end_is_refused_with_the_length(odd_bag: Path) -> None:
    with pytest.raises(ConfigError, match=r"start at 0\.5 s is beyond the end, the bag is 0\.400 s long: begin"):
        BagPairs(BagSelection(odd_bag, start_seconds=0.5), EXACT)


def test_late_right_images_need_approximate_pairing(tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    write_odd_bag(path, 3, right_late_ns=3_000_000)
    with BagPairs(BagSelection(path), EXACT) as bag:
        assert list(bag.pairs()) == []
        assert (bag.unpaired_left, bag.unpaired_right) == (3, 3)
    near = PairingConfig(approximate_sync=True, approximate_sync_tolerance_seconds=0.01)
    with BagPairs(BagSelection(path), near) as bag:
        pairs = list(bag.pairs())
    assert [pair.right_stamp_ns - pair.stamp_ns for pair in pairs] == [3_000_000] * 3
    assert cdr_stamp_ns(pairs[0].right_info) == pairs[0].right_stamp_ns


def test_why_most_images_have_no_partner_is_said(tmp_path: Path) -> None:
    write_odd_bag(tmp_path / "late.mcap", 5, right_late_ns=17_000_000)
    with BagPairs(BagSelection(tmp_path / "late.mcap"), EXACT) as bag:
        assert list(bag.pairs()) == []
        assert bag.losses == (
            "stamps of /cam0/image and /cam1/image are 17.000 ms apart, the tolerance is 0 ms: set approximate_sync "
            "and an approximate_sync_tolerance_seconds above 0.017000",
        )


def restamped(odd_bag: Path, path: Path, stamp_ns: Callable[[int], int]) -> Path:
    """The bag with other stamps of its images."""
    with BagReader(odd_bag) as reader, BagWriter(path) as bag:
        for message in reader.messages():
            stamp = stamp_ns(cdr_stamp_ns(message.data)) if message.topic.endswith("image") else 0
            bag.write_raw(message.topic, message.msgtype, with_stamp(message.data, stamp), message.log_time_ns)
    return path


def test_stamps_that_are_not_set_are_said(odd_bag: Path, tmp_path: Path) -> None:
    path = restamped(odd_bag, tmp_path / "zero.mcap", lambda _: 0)
    said = (
        "the stamps of /cam0/image and /cam1/image are 0, which means not set, and images cannot be paired: let the "
        "driver stamp its images with the time of exposure"
    )
    with BagPairs(BagSelection(path), EXACT) as bag:
        assert len(list(bag.pairs())) == 1
        assert bag.losses == (said,)
    assert [str(problem) for problem in inspect_bag(path).problems] == [said]


def test_stamps_that_come_twice_are_counted(odd_bag: Path, tmp_path: Path) -> None:
    path = restamped(odd_bag, tmp_path / "twice.mcap", lambda stamp: stamp - stamp % 200_000_000)
    with BagPairs(BagSelection(path), EXACT) as bag:
        pairs = len(list(bag.pairs()))
        assert 0 < pairs < 5
        assert bag.losses == (
            "3 images left out, messages of /cam0/image or /cam1/image have the stamp of one before, and only the "
            "first is used: look for a second publisher, or a clock that stands still",
        )


def test_shifted_pair_differs_in_its_stamps_only(odd_bag: Path) -> None:
    with BagPairs(BagSelection(odd_bag), EXACT) as bag:
        pair = next(bag.pairs())
    shifted = pair.shifted(2_500_000_000)
    assert shifted.stamp_ns == pair.stamp_ns + 2_500_000_000
    for name in ("left", "right", "left_info", "right_info"):
        before, after = getattr(pair, name), getattr(shifted, name)
        assert cdr_stamp_ns(after) - cdr_stamp_ns(before) == 2_500_000_000
        assert after[:4] + after[12:] == before[:4] + before[12:]


def test_stamp_of_both_byte_orders() -> None:
    little = b"\x00\x01\x00\x00" + struct.pack("<iI", 7, 500_000_001) + b"rest"
    big = b"\x00\x00\x00\x00" + struct.pack(">iI", 7, 500_000_001) + b"rest"
    assert cdr_stamp_ns(little) == cdr_stamp_ns(big) == 7_500_000_001
    assert with_stamp(big, 3_000_000_002) == b"\x00\x00\x00\x00" + struct.pack(">iI", 3, 2) + b"rest"
    assert without_stamp(big) == without_stamp(little) == b"rest"
    with pytest.raises(MessageError, match="11 bytes, a header stamp ends at byte 12"):
        cdr_stamp_ns(little[:11])


def test_cut_bag_gives_the_pairs_before_the_cut(tmp_path: Path) -> None:
    whole = tmp_path / "whole.mcap"
    write_truth_bag(whole, 4)
    with BagPairs(BagSelection(whole), EXACT) as bag:
        all_pairs = list(bag.pairs())
        assert bag.warning == ""
    chunks = later(whole, tmp_path / "chunks.mcap", seconds=0)
    with BagPairs(BagSelection(cut(chunks, tmp_path / "cut.mcap", 0.6)), EXACT) as bag:
        pairs = list(bag.pairs())
        assert "cut in the middle" in bag.warning
    assert 1 <= len(pairs) < 4
    assert pairs == all_pairs[: len(pairs)]


def test_bag_without_stereo_names_bag_and_topics(tmp_path: Path) -> None:
    path, types = tmp_path / "mono.mcap", RosbagsTypes()
    with BagWriter(path) as bag:
        bag.write("/cam/image", image_message(types, sequence(1)[0].pair.left.pixels, "mono8", 5, "cam"), 5)
    with pytest.raises(TopicError, match=r"mono\.mcap: no stereo pair among the image topics /cam/image") as caught:
        BagPairs(BagSelection(path), EXACT)
    assert (caught.value.subject, caught.value.settings) == (str(path), ("left", "right"))


def test_bag_without_camera_infos_is_refused(tmp_path: Path) -> None:
    path, types, frame = tmp_path / "bare.mcap", RosbagsTypes(), sequence(1)[0]
    with BagWriter(path) as bag:
        for side in ("left", "right"):
            bag.write(f"/{side}/image", image_message(types, frame.pair.left.pixels, "mono8", 5, side), 5)
    with pytest.raises(TopicError, match=r"no CameraInfo topic belongs to /left/image, .*record the camera infos too"):
        BagPairs(BagSelection(path), EXACT)


def test_missing_bag_and_impossible_part_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="does not exist"):
        BagPairs(BagSelection(tmp_path / "none.mcap"), EXACT)
    with pytest.raises(ConfigError, match=r"start_seconds = -1\.0 is outside 0\.\.1e9 s"):
        BagSelection(tmp_path, start_seconds=-1.0)


@pytest.mark.parametrize("name", ["start_seconds", "duration_seconds"])
def test_the_largest_value_in_the_message_is_allowed(name: str) -> None:
    assert getattr(BagSelection(Path("a.mcap"), **{name: 1e9}), name) == 1e9  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=rf"{name} = 1000000001\.0 is outside 0\.\.1e9 s"):
        BagSelection(Path("a.mcap"), **{name: 1e9 + 1})  # type: ignore[arg-type]


def test_stamps_that_no_clock_gives_are_left_out_and_counted(tmp_path: Path) -> None:
    """In images and camera infos; where pairs are read, by the inspection, the doctor and the calibration alike."""
    path, bad = tmp_path / "bag.mcap", tmp_path / "bad.mcap"
    write_truth_bag(path, 4)
    counts: Counter[str] = Counter()
    with BagReader(path) as reader, BagWriter(bad) as writer:
        for message in reader.messages():
            counts[message.topic] += 1
            later_images = message.topic == "/left/image_raw" and counts[message.topic] > 1
            first_info = message.topic == "/right/camera_info" and counts[message.topic] == 1
            nanosec = (4 * 10**9).to_bytes(4, "little") if later_images or first_info else message.data[8:12]
            data = message.data[:8] + nanosec + message.data[12:]
            writer.write_raw(message.topic, message.msgtype, data, message.log_time_ns)
    said = r"messages are left out, the first one is of /\w+/\w+: nanosec = 4000000000 of the stamp is outside 0"
    with BagPairs(BagSelection(bad), EXACT) as pairs:
        assert len(list(pairs.pairs())) == 1
        assert re.search(f"4 {said}", "; ".join(pairs.losses))
    assert any(re.search(f"3 {said}", str(problem)) for problem in inspect_bag(bad).problems)
    assert any("nanosec = 4000000000" in finding.value for finding in survey_bag(BagSelection(bad)).findings)
    images = open_stereo_images(bad)
    assert len(list(images)) == 1
    assert any(re.search(f"3 {said}", text) for text in images.warnings)


def test_nothing_is_built_for_camera_infos_of_another_size(tmp_path: Path) -> None:
    path, bad = tmp_path / "bag.mcap", tmp_path / "bad.mcap"
    write_truth_bag(path, 1)
    types = RosbagsTypes()
    with BagReader(path) as reader, BagWriter(bad) as writer:
        for message in reader.messages():
            data = message.data
            if message.topic.endswith("camera_info"):
                info = reader.deserialize(message)
                info.width, info.height = 8000, 8000
                data = types.serialize(info)
            writer.write_raw(message.topic, message.msgtype, data, message.log_time_ns)
    built: list[StereoRig] = []
    per_calibration = PerCalibration(types, built.append)
    with BagPairs(BagSelection(bad), EXACT) as pairs:
        (pair,) = pairs.pairs()
        with pytest.raises(CalibrationError, match="the image is 200x150, its camera info is for 8000x8000"):
            per_calibration.of(pair, pairs.topics.image_type)
    assert built == []
