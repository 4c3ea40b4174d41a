# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Both images side by side in one topic: the pairs, depth and findings of two topics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import CommandLine
from stereo_bags import PARAMETERS, messages_of, sequence, write_truth_bag

from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.stereo_topics import CameraImages, bag_topics
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import BagError, CalibrationError, MessageError, TopicError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.datasets.stereo_images import BagImages
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.evaluation.bag_scenes import BagScenes
from stereo_depth_ros.evaluation.bag_score import TRUTH_TOPIC
from stereo_depth_ros.messages.image import compressed_message, decode, image_message
from stereo_depth_ros.messages.side_by_side import split_message
from stereo_depth_ros.messages.types import make_header
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.offline.pairs import read_pairs

TYPES, FRAMES = RosbagsTypes(), 2
RNG = np.random.default_rng(4)
SAME_BYTES = ("/left/image_rect", "/right/image_rect", "/disparity", "/depth/image_rect", "/points2")


def pixels(width: int, channels: int = 1, dtype: type = np.uint8, height: int = 6) -> Any:
    """Noise of full depth."""
    shape = (height, width, channels) if channels > 1 else (height, width)
    return RNG.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


def raw(encoding: str, array: Any, padding: int = 0, big: bool = False) -> Any:
    """An Image of any encoding: rows with padding."""
    rows = array.astype(array.dtype.newbyteorder(">" if big else "<")).view(np.uint8).reshape(len(array), -1)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=7)
    height = len(array) * 2 // 3 if encoding.startswith("nv") else len(array)
    channels = 2 if encoding in ("yuyv", "uyvy") else int(array.shape[2]) if array.ndim == 3 else 1
    width = rows.shape[1] // channels // array.itemsize
    return TYPES.Image(
        header=make_header(TYPES, 7, "both"),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=int(big),
        step=padded.shape[1],
        data=padded.ravel(),
    )


@pytest.mark.parametrize(
    ("encoding", "array", "width"),
    [
        ("mono8", pixels(10), 10),
        ("mono8", pixels(6), 6),
        ("mono16", pixels(10, 1, np.uint16), 10),
        ("rgb8", pixels(10, 3), 10),
        ("bgra8", pixels(10, 4), 10),
        ("bayer_gbrg8", pixels(12), 12),
        ("yuyv", pixels(24), 12),
        ("nv12", pixels(12, height=9), 12),
    ],
)
@pytest.mark.parametrize(("padding", "big"), [(0, False), (3, True)])
def test_each_half_has_the_stored_samples_of_its_columns(
    encoding: str, array: Any, width: int, padding: int, big: bool
) -> None:
    padding *= array.itemsize
    whole = raw(encoding, array, padding, big)
    assert whole.width == width
    halves = split_message(TYPES, whole, "/both", ("one", "other"))
    middle = array.shape[1] // 2
    for half, part, frame in zip(halves, (array[:, :middle], array[:, middle:]), ("one", "other"), strict=True):
        alone = replace(raw(encoding, part, 0, big), header=half.header)
        assert (half.width, half.height, half.header.frame_id) == (width // 2, whole.height, frame)
        assert bytes(half.data) == bytes(alone.data) and half.header.stamp == whole.header.stamp
        assert decode(half) == decode(alone)
        assert TYPES.serialize(half) == TYPES.serialize(alone)


@pytest.mark.parametrize(
    ("array", "encoding", "format"),
    [(pixels(12), "mono8", "png"), (pixels(12, 3), "bgr8", "png"), (pixels(64, 3, height=16), "rgb8", "jpeg")],
)
def test_halves_of_a_compressed_image_are_those_of_its_pixels(array: Any, encoding: str, format: Any) -> None:
    packed = compressed_message(TYPES, array, encoding, format, 7, "both")
    whole, halves = decode(packed), split_message(TYPES, packed)
    middle = array.shape[1] // 2
    for half, columns in zip(halves, (slice(None, middle), slice(middle, None)), strict=True):
        np.testing.assert_array_equal(decode(half).pixels, whole.pixels[:, columns])
        assert decode(half).encoding == whole.encoding


def test_halves_of_a_compressed_mosaic_and_of_16_bit_are_kept() -> None:
    mosaic = compressed_message(TYPES, pixels(12), "mono8", "png", 7, "both")
    left, _ = split_message(TYPES, replace(mosaic, format="bayer_gbrg8; png compressed "))
    assert left.encoding == "bayer_gbrg8"
    array = pixels(12, 1, np.uint16)
    ok, data = cv2.imencode(".png", array)
    assert ok
    left, right = split_message(TYPES, replace(mosaic, format="mono16; png compressed ", data=data.ravel()))
    assert left.encoding == "mono16"
    joined = np.concatenate([half.data.view("<u2").reshape(6, 6) for half in (left, right)], axis=1)
    np.testing.assert_array_equal(joined, array)


@pytest.mark.parametrize(("encoding", "width"), [("mono8", 11), ("bayer_rggb8", 10), ("yuyv", 10)])
def test_a_width_without_two_halves_is_refused(encoding: str, width: int) -> None:
    whole = raw(encoding, pixels(2 * width if encoding == "yuyv" else width))
    with pytest.raises(MessageError, match=rf"image of /both: an image of {width}x6 {encoding} has no two halves"):
        split_message(TYPES, whole, "/both")


def joint_bag(source: Path, path: Path, *, packed: bool = False, odd: int = 0, infos: bool = True) -> Path:
    """Both images of each pair of a bag in one topic; the first ``odd`` lack a column."""
    parts: dict[int, dict[str, Any]] = {}
    with BagReader(source) as reader, BagWriter(path) as bag:
        for message in reader.messages():
            if message.topic.endswith("camera_info") and infos:
                bag.write_raw(f"/stereo{message.topic}", message.msgtype, message.data, message.log_time_ns)
            elif message.topic == TRUTH_TOPIC:
                bag.write_raw(message.topic, message.msgtype, message.data, message.log_time_ns)
            elif "image" in message.topic:
                image = reader.deserialize(message)
                array = image.data.reshape(image.height, image.width)
                parts.setdefault(message.log_time_ns, {})[message.topic.split("/")[1]] = array
        for number, (stamp_ns, sides) in enumerate(parts.items()):
            both = np.concatenate([sides["left"], sides["right"]], axis=1)
            both = np.ascontiguousarray(both[:, : both.shape[1] - (number < odd)])
            if packed:
                message = compressed_message(TYPES, both, "mono8", "png", stamp_ns, "stereo")
                bag.write("/stereo/image_raw/compressed", message, stamp_ns)
            else:
                bag.write("/stereo/image_raw", image_message(TYPES, both, "mono8", stamp_ns, "stereo"), stamp_ns)
    return path


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plain") / "in.mcap"
    write_truth_bag(path, FRAMES)
    return path


@pytest.mark.parametrize("packed", [False, True])
def test_depth_has_the_bytes_of_two_topics(plain: Path, tmp_path: Path, packed: bool) -> None:
    joint = joint_bag(plain, tmp_path / "joint.mcap", packed=packed)
    config = pipeline_config(PARAMETERS)
    report = process_bag(BagSelection(joint, side_by_side=True), tmp_path / "joint_out.mcap", config)
    assert (report.pairs, report.unpaired_left, report.warnings) == (FRAMES, 0, ())
    process_bag(BagSelection(plain), tmp_path / "plain_out.mcap", config)
    for topic in SAME_BYTES:
        found, expected = (messages_of(tmp_path / f"{name}_out.mcap", topic) for name in ("joint", "plain"))
        assert found == expected and len(found) == FRAMES, topic


def test_pairs_are_raw_images_with_the_frames_of_their_cameras(plain: Path, tmp_path: Path) -> None:
    joint = joint_bag(plain, tmp_path / "joint.mcap", packed=True)
    for (pair, _), (expected, _) in zip(read_pairs(joint, side_by_side=True), read_pairs(plain), strict=True):
        assert pair == expected
    with (
        BagPairs(BagSelection(joint, side_by_side=True), PairingConfig()) as found,
        BagPairs(BagSelection(plain), PairingConfig()) as of_plain,
    ):
        assert found.topics.image_type == "sensor_msgs/msg/Image"
        for pair, plain_pair in zip(found.pairs(), of_plain.pairs(), strict=True):
            images = pair.images(TYPES, found.topics.image_type)
            assert images == plain_pair.images(TYPES, of_plain.topics.image_type)
            rig = pair.rig(TYPES)
            assert (images.left.frame_id, images.right.frame_id) == (rig.left.frame_id, rig.right.frame_id)


def test_info_doctor_and_calibrate_read_both_from_one_topic(plain: Path, tmp_path: Path) -> None:
    joint = joint_bag(plain, tmp_path / "joint.mcap")
    info, of_plain = inspect_bag(joint, side_by_side=True), inspect_bag(plain)
    assert info.usable and (info.exact_pairs, info.left_image, info.right_image) == (
        of_plain.exact_pairs,
        of_plain.left_image,
        of_plain.right_image,
    )
    setup, expected = survey_bag(BagSelection(joint, side_by_side=True)), survey_bag(BagSelection(plain))
    assert list(setup.pairs) == list(expected.pairs) and len(setup.pairs) == FRAMES
    assert setup.left.stamps_ns == setup.right.stamps_ns == expected.left.stamps_ns
    assert not setup.findings
    for one, other in zip(BagImages(joint, side_by_side=True), BagImages(plain), strict=True):
        np.testing.assert_array_equal(one.left, other.left)
        np.testing.assert_array_equal(one.right, other.right)


def test_scenes_of_evaluate_are_those_of_two_topics(plain: Path, tmp_path: Path) -> None:
    joint = joint_bag(plain, tmp_path / "joint.mcap")
    found, expected = (BagScenes(BagSelection(bag, side_by_side=bag is joint)) for bag in (joint, plain))
    for scene, of_plain in zip(found, expected, strict=True):
        for name in ("left", "right", "truth_px"):
            np.testing.assert_array_equal(getattr(scene.load(), name), getattr(of_plain.load(), name))


def test_images_without_halves_are_left_out_and_counted(plain: Path, tmp_path: Path) -> None:
    joint = joint_bag(plain, tmp_path / "odd.mcap", odd=1)
    with BagPairs(BagSelection(joint, side_by_side=True), PairingConfig()) as pairs:
        assert len(list(pairs.pairs())) == FRAMES - 1
        (loss,) = pairs.losses
    assert loss.startswith("1 images left out, image of /stereo/image_raw: an image of 399x150 mono8 has no two halves")
    joint = joint_bag(plain, tmp_path / "all.mcap", odd=FRAMES)
    with pytest.raises(BagError, match=r"no pair could be processed: 2 images left out, .* has no two halves"):
        process_bag(BagSelection(joint, side_by_side=True), tmp_path / "out.mcap", pipeline_config(PARAMETERS))
    (problem,) = inspect_bag(joint, side_by_side=True).problems
    assert "has no two halves" in str(problem)
    (finding,) = survey_bag(BagSelection(joint, side_by_side=True)).findings
    assert "has no two halves" in finding.value


def test_one_topic_with_both_images_is_named_with_the_remedy(
    plain: Path, tmp_path: Path, command_line: CommandLine
) -> None:
    joint = joint_bag(plain, tmp_path / "joint.mcap")
    said = f"{joint}: /stereo/image_raw looks like both images side by side, 400x150 where the camera infos are for "
    said += "200x150: read both from it (--side-by-side)"
    for command, options in (("info", ()), ("doctor", ()), ("process", ("-o", tmp_path / "out.mcap"))):
        code, _, err = command_line(command)(joint, *options)
        assert code == 1 and err.splitlines()[-1].partition(": ")[2] == said, command
    bare = joint_bag(plain, tmp_path / "bare.mcap", infos=False)
    (problem,) = inspect_bag(bare).problems
    assert "/stereo/image_raw looks like both images side by side, 400x150: read" in str(problem)
    (problem,) = inspect_bag(bare, side_by_side=True).problems
    assert isinstance(problem, TopicError) and "record the camera infos too" in str(problem)


def test_the_topic_with_both_images_is_found_among_others(plain: Path, tmp_path: Path) -> None:
    joint, more = joint_bag(plain, tmp_path / "joint.mcap"), tmp_path / "more.mcap"
    with BagReader(joint) as reader, BagWriter(more) as bag:
        for message in reader.messages():
            bag.write_raw(message.topic, message.msgtype, message.data, message.log_time_ns)
        bag.write("/rear/image_raw", image_message(TYPES, pixels(200, height=150), "mono8", 5, "rear"), 5)
    assert inspect_bag(more, side_by_side=True).usable
    (problem,) = inspect_bag(more).problems
    assert "/stereo/image_raw looks like both images side by side, 400x150 where" in str(problem)


def test_images_without_camera_infos_have_two_frames(plain: Path, tmp_path: Path) -> None:
    """Their calibration comes from files; the doctor compares the frames of both images with those of the cameras."""
    bare = joint_bag(plain, tmp_path / "bare.mcap", infos=False)
    with BagReader(bare) as reader:
        topics = bag_topics(reader, side_by_side=True)
        images = CameraImages(reader, topics)
        halves = [data for _, data in images.of(next(reader.messages(images.names)))]
    frames = [TYPES.deserialize(data, topics.image_type).header.frame_id for data in halves]
    assert frames == ["stereo", "stereo_right"]


def test_images_of_one_camera_are_not_taken_for_two(plain: Path, tmp_path: Path) -> None:
    with BagReader(plain) as reader, BagWriter(tmp_path / "mono.mcap") as bag:
        for message in reader.messages([topic for topic in reader.topics if "/left/" in topic]):
            bag.write_raw(message.topic, message.msgtype, message.data, message.log_time_ns)
    (problem,) = inspect_bag(tmp_path / "mono.mcap").problems
    assert "no stereo pair among the image topics /left/image_raw: name both image topics" in str(problem)


def test_an_image_twice_as_wide_as_its_calibration_is_named() -> None:
    rig: StereoRig = sequence(1).rig
    with pytest.raises(
        CalibrationError, match=r"400x150, .* 200x150: it looks like both images side by side"
    ) as caught:
        rig.check_image(400, 150, "/left/image")
    assert caught.value.settings == ("side_by_side",)
