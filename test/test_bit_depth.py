# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cameras of 8 to 16 bits in 16-bit images: one scale for both cameras, which only grows; the same live and offline."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from stereo_bags import HEIGHT, PARAMETERS, WIDTH, messages_of, sequence
from test_message_types import RclpyTypes

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.diagnosis.doctor import diagnose
from stereo_depth_ros.diagnosis.finding import Level
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import decode, decode_pair, image_message
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.offline.pairs import read_pairs

TOPICS = ("left", "right")
RECTIFIED = ("left/image_rect", "right/image_rect")
HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=2), frame_id="l")


def image(samples: Any, encoding: str = "mono16", bigendian: int = 0) -> Any:
    samples = np.asarray(samples, np.uint16)
    data = samples.astype(">u2" if bigendian else "<u2").tobytes()
    height, width = samples.shape[:2]
    step = len(data) // height
    return SimpleNamespace(
        header=HEADER, height=height, width=width, encoding=encoding, is_bigendian=bigendian, step=step, data=data
    )


def png(samples: Any) -> Any:
    data = cv2.imencode(".png", np.asarray(samples, np.uint16))[1].tobytes()
    return SimpleNamespace(header=HEADER, format="mono16; png compressed ", data=data)


@pytest.mark.parametrize("make", [image, png])
@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_every_value_of_a_depth_is_rounded_to_the_nearest_of_8_bits(bits: int, make: Any) -> None:
    values = np.arange(2**bits).reshape(-1, 64)
    full = 2**bits - 1
    np.testing.assert_array_equal(decode(make(values)).pixels, (2 * 255 * values + full) // (2 * full))


@pytest.mark.parametrize(("largest", "full"), [(255, 255), (256, 1023), (1023, 1023), (1024, 4095), (4095, 4095),
                                              (4096, 16383), (16384, 65535)])  # fmt: skip
def test_depth_is_the_smallest_that_holds_the_largest_sample(largest: int, full: int) -> None:
    frame = decode(image([[largest, 100], [0, 50]]))
    assert frame.pixels[0].tolist() == [round(255 * largest / full), round(255 * 100 / full)]


def test_samples_in_the_upper_bits_keep_their_share_of_the_range() -> None:
    twelve_bit = np.array([[0, 4095, 2048], [1000, 16, 3333]])
    np.testing.assert_allclose(decode(image(twelve_bit << 4)).pixels, twelve_bit * 255 / 4095, atol=0.51 + 255 / 4096)


@pytest.mark.parametrize("bigendian", [0, 1])
@pytest.mark.parametrize("make", [image, png])
def test_both_images_of_a_pair_have_the_scale_of_the_brighter_one(make: Any, bigendian: int) -> None:
    options = {"bigendian": bigendian} if make is image else {}
    dark, bright = np.array([[900, 40]]), np.array([[3000, 400]])
    for left, right in ((dark, bright), (bright, dark)):
        pair = decode_pair(make(left, **options), make(right, **options), TOPICS)
        np.testing.assert_array_equal(pair.left.pixels, np.rint(left * 255 / 4095))
        np.testing.assert_array_equal(pair.right.pixels, np.rint(right * 255 / 4095))


@pytest.mark.parametrize(("encoding", "decoded"), [("rgb16", "rgb8"), ("bgr16", "bgr8"), ("rgba16", "rgb8"),
                                                  ("bgra16", "bgr8")])  # fmt: skip
@pytest.mark.parametrize("bigendian", [0, 1])
def test_16_bit_color_keeps_its_order_and_its_alpha_has_no_say_in_the_depth(
    encoding: str, decoded: str, bigendian: int
) -> None:
    colors = np.array([[[4095, 0, 100], [2048, 1000, 16], [7, 4000, 300]]])
    samples = np.dstack([colors, np.full((1, 3), 65535)]) if "a" in encoding else colors
    frame = decode(image(samples, encoding, bigendian))
    assert frame.encoding == decoded
    np.testing.assert_array_equal(frame.pixels, np.rint(colors * 255 / 4095))


def test_mosaic_of_12_bit_is_scaled() -> None:
    frame = decode(image(np.full((6, 8), 4095), "bayer_rggb16"))
    assert frame.encoding == "bgr8" and frame.pixels.min() == 255


# ------------------------------------------------------------------------------------------------ bags, nodes, doctor

# Left and right images of the first two pairs have different depths by themselves: 10 and 12, 12 and 14.
GAINS = ((3, 5), (15, 60), (3, 3))


def write_12_bit(path: Path, gains: tuple[tuple[int, int], ...] = GAINS) -> None:
    """Pairs of the synthetic sequence in mono16, times their gains."""
    made, types = sequence(len(gains)), RosbagsTypes()
    with BagWriter(path) as bag:
        for frame, (left, right) in zip(made, gains, strict=True):
            stamp = frame.pair.left.stamp_ns
            for side, one, gain in (("left", frame.pair.left, left), ("right", frame.pair.right, right)):
                camera = getattr(made.rig, side)
                message = image_message(types, one.pixels.astype(np.uint16) * gain, "16UC1", stamp, one.frame_id)
                message.encoding = "mono16"
                bag.write(f"/{side}/camera_info", camera_info_message(types, camera, stamp), stamp)
                bag.write(f"/{side}/image_raw", message, stamp)


def live_pairs() -> list[dict[str, Any]]:
    """The messages of the same pairs, right images first."""
    made, types, pairs = sequence(len(GAINS)), RclpyTypes(), []
    for frame, gains in zip(made, GAINS, strict=True):
        messages = {}
        for side, gain in (("right", gains[1]), ("left", gains[0])):
            one, stamp = getattr(frame.pair, side), frame.pair.left.stamp_ns
            messages[f"{side}/camera_info"] = camera_info_message(types, getattr(made.rig, side), stamp)
            message = image_message(types, one.pixels.astype(np.uint16) * gain, "16UC1", stamp, one.frame_id)
            message.encoding = "mono16"
            messages[f"{side}/image_raw"] = message
        pairs.append(messages)
    return pairs


def test_depth_of_a_bag_grows_for_both_cameras_and_never_shrinks(tmp_path: Path) -> None:
    write_12_bit(tmp_path / "in.mcap")
    decoded = [pair for pair, _ in read_pairs(tmp_path / "in.mcap")]
    for pair, made, gains, full in zip(decoded, sequence(3), GAINS, (4095, 16383, 16383), strict=True):
        assert made.pair.right.pixels.max() > 205  # so that the depths are these
        for side, gain in zip(("left", "right"), gains, strict=True):
            samples = getattr(made.pair, side).pixels.astype(int) * gain
            np.testing.assert_array_equal(getattr(pair, side).pixels, np.rint(samples * 255 / full))


@pytest.mark.graph
@pytest.mark.parametrize("name", ["StereoDepthNode", "RectifyNode"])
def test_live_images_have_the_bytes_of_the_offline_engine(name: str, tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    from graph_harness import Graph, image_pixels
    from sensor_msgs.msg import Image
    from stereo_msgs.msg import DisparityImage

    from stereo_depth_ros.nodes.disparity_node import DisparityNode
    from stereo_depth_ros.nodes.rectify_node import RectifyNode
    from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode

    node_types = {"StereoDepthNode": (StereoDepthNode,), "RectifyNode": (RectifyNode, DisparityNode)}[name]
    write_12_bit(tmp_path / "in.mcap")
    process_bag(BagSelection(tmp_path / "in.mcap"), tmp_path / "out.mcap", pipeline_config(PARAMETERS))
    with Graph(*node_types, parameters=PARAMETERS) as graph:
        received = {topic: graph.listen(topic, Image) for topic in RECTIFIED}
        disparities = graph.listen("disparity", DisparityImage)
        outputs = (*received.values(), disparities)
        for number, messages in enumerate(live_pairs(), start=1):
            infos = {topic: message for topic, message in messages.items() if topic.endswith("camera_info")}
            graph.send(infos, subscribers=len(node_types))
            graph.send({topic: message for topic, message in messages.items() if topic not in infos})
            graph.wait(lambda number=number: all(len(r) == number for r in outputs), f"pair {number}")
    for topic, messages in received.items():
        offline = [RosbagsTypes().deserialize(data, "sensor_msgs/msg/Image")
                   for data in messages_of(tmp_path / "out.mcap", f"/{topic}").values()]  # fmt: skip
        for live, other in zip(messages, offline, strict=True):
            assert live.encoding == other.encoding == "mono16"
            np.testing.assert_array_equal(image_pixels(live), other.data.view("<u2").reshape(HEIGHT, WIDTH))
    offline = [RosbagsTypes().deserialize(data, "stereo_msgs/msg/DisparityImage")
               for data in messages_of(tmp_path / "out.mcap", "/disparity").values()]  # fmt: skip
    for live, other in zip(disparities, offline, strict=True):
        assert bytes(live.image.data) == bytes(other.image.data)


def test_doctor_names_the_depth_and_does_not_see_black_images(tmp_path: Path) -> None:
    write_12_bit(tmp_path / "in.mcap", gains=((15, 15),) * 2)
    found = {finding.check: finding for finding in diagnose(survey_bag(BagSelection(tmp_path / "in.mcap"))).findings}
    assert found["left image"].level is found["right image"].level is Level.OK
    assert (found["bit depth"].level, found["bit depth"].value) == (Level.OK, "12 bit in 16-bit samples")


def test_doctor_warns_of_16_bit_images_with_8_bits(tmp_path: Path) -> None:
    write_12_bit(tmp_path / "in.mcap", gains=((1, 1),) * 2)
    found = {finding.check: finding for finding in diagnose(survey_bag(BagSelection(tmp_path / "in.mcap"))).findings}
    assert found["bit depth"].level is Level.WARNING
    assert "remove the lens cap" in found["bit depth"].remedy and "mono8" in found["bit depth"].remedy
