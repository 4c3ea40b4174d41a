# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images have the encoding and the pixels that image_proc publishes, in both shapes of the graph and offline."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from stereo_bags import PARAMETERS, messages_of, sequence
from test_bit_depth import image

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import decode, decode_pair
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.stages.rectification import Rectifier

# What image_proc calls: the short names of OpenCV start one row and one column later than those of ROS.
VNG = {
    "rggb": cv2.COLOR_BayerBG2BGR_VNG,
    "bggr": cv2.COLOR_BayerRG2BGR_VNG,
    "gbrg": cv2.COLOR_BayerGR2BGR_VNG,
    "grbg": cv2.COLOR_BayerGB2BGR_VNG,
}
BILINEAR = {
    "rggb": cv2.COLOR_BayerBG2BGR,
    "bggr": cv2.COLOR_BayerRG2BGR,
    "gbrg": cv2.COLOR_BayerGR2BGR,
    "grbg": cv2.COLOR_BayerGB2BGR,
}
GRAY = {
    "rggb": cv2.COLOR_BayerBG2GRAY,
    "bggr": cv2.COLOR_BayerRG2GRAY,
    "gbrg": cv2.COLOR_BayerGR2GRAY,
    "grbg": cv2.COLOR_BayerGB2GRAY,
}


def raw_of(gray: Any, encoding: str) -> Any:
    """Samples of ``encoding`` of an image, whose channels differ; 16-bit ones have 12 bits."""
    channels = {"mono": 1, "rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4}.get(encoding.rstrip("0123456789"), 1)
    samples = np.dstack([gray, 255 - gray, gray // 2, 200 + gray // 8][:channels]).squeeze()
    return samples.astype(np.uint16) * 16 if encoding.endswith("16") else samples


def mosaic(dtype: Any, scale: int = 1) -> Any:
    return (np.random.default_rng(7).integers(0, 256, (40, 52)) * scale).astype(dtype)


def of_8_bits(samples: Any, encoding: str) -> Any:
    message = image(np.zeros((1, 1)), encoding)
    message.height, message.width = samples.shape[:2]
    message.step, message.data = samples[0].nbytes, samples.tobytes()
    return message


@pytest.mark.parametrize("pattern", VNG)
def test_8_bit_mosaic_has_the_colors_of_image_proc(pattern: str) -> None:
    samples = mosaic(np.uint8)
    camera = decode(of_8_bits(samples, f"bayer_{pattern}8")).camera
    assert camera is not None and camera.encoding == "bgr8"
    np.testing.assert_array_equal(camera.color(), cv2.cvtColor(samples, VNG[pattern]))
    assert not np.array_equal(camera.color(), camera.color(0))
    for debayer in (0, 1, 2):
        np.testing.assert_array_equal(camera.color(debayer), cv2.cvtColor(samples, BILINEAR[pattern]))


@pytest.mark.parametrize("bigendian", [0, 1])
@pytest.mark.parametrize("scale", [4, 16, 64, 257])  # 10, 12, 14 and 16 bits
@pytest.mark.parametrize("pattern", VNG)
def test_16_bit_mosaic_keeps_its_bits_in_gray_and_color(pattern: str, scale: int, bigendian: int) -> None:
    samples = mosaic(np.uint16, scale)
    camera = decode(image(samples, f"bayer_{pattern}16", bigendian)).camera
    assert camera is not None and camera.encoding == "bgr16"
    np.testing.assert_array_equal(camera.gray(), cv2.cvtColor(samples, GRAY[pattern]))
    np.testing.assert_array_equal(camera.color(), cv2.cvtColor(samples, BILINEAR[pattern]))  # OpenCV's VNG takes 8 bits


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8", "8UC1", "yuv422"])
def test_8_bit_images_without_alpha_and_mosaic_are_their_pixels(encoding: str) -> None:
    shape = (4, 6, 3) if encoding in ("rgb8", "bgr8") else (4, 6, 2) if encoding == "yuv422" else (4, 6)
    assert decode(of_8_bits(np.zeros(shape, np.uint8), encoding)).camera is None


def test_what_a_camera_sent_is_read_only_compared_and_kept_by_copies() -> None:
    frames = [decode(image([[1000, value], [3, 4]])) for value in (2000, 2001)]  # 2000 and 2001 are one level of 8 bits
    assert np.array_equal(frames[0].pixels, frames[1].pixels) and frames[0] != frames[1]
    assert copy.deepcopy(frames[0]) == frames[0] == pickle.loads(pickle.dumps(frames[0]))
    assert frames[0].camera is not None and not frames[0].camera.samples.flags.writeable


def test_images_are_scaled_to_8_bits_after_rectification() -> None:
    made = sequence(1)
    raw = [raw_of(frame.pixels, "mono16") for frame in (made[0].pair.left, made[0].pair.right)]
    pair = decode_pair(image(raw[0]), image(raw[1]), ("left", "right"))
    depth = BitDepth()
    depth.include(np.full((1, 1), 9000, np.uint16))  # an earlier pair had 14 bits
    rectifier = Rectifier(made.rig)
    rectified = rectifier.rectify(pair, depth)
    for camera, samples, wide, narrow in (
        (made.rig.left, raw[0], rectified.left_16, rectified.left),
        (made.rig.right, raw[1], rectified.right_16, rectified.right),
    ):
        size = (camera.width, camera.height)
        maps = cv2.initUndistortRectifyMap(camera.K, camera.D, camera.R, camera.P[:, :3], size, cv2.CV_16SC2)
        expected = cv2.remap(samples, *maps, cv2.INTER_LINEAR)
        np.testing.assert_array_equal(wide, expected)
        np.testing.assert_array_equal(narrow, np.rint(expected * (255 / 16383)))
    alone = rectifier.rectify(StereoPair(pair.left, pair.right)).left
    np.testing.assert_array_equal(alone, np.rint(rectified.left_16 * (255 / 4095)))


@pytest.mark.parametrize(("debayer", "codes"), [(3, VNG), (0, BILINEAR), (2, BILINEAR)])
def test_parameter_debayer_has_an_effect_on_the_published_colors(debayer: int, codes: dict[str, int]) -> None:
    made = sequence(1)
    messages = [of_8_bits(frame.pixels, "bayer_grbg8") for frame in (made[0].pair.left, made[0].pair.right)]
    pair = decode_pair(*messages, ("left", "right"))
    pipeline = StereoPipeline(pipeline_config(PARAMETERS), made.rig)
    result = pipeline.with_config(pipeline_config({**PARAMETERS, "debayer": debayer})).process(pair)
    expected = Rectifier(made.rig).rectify_left(cv2.cvtColor(made[0].pair.left.pixels, codes["grbg"]))
    np.testing.assert_array_equal(result.left_image[0], expected)


# ----------------------------------------------------------------------------------------------- live, offline

# encoding of the camera: of image_rect and image_rect_color
PUBLISHED = {
    "mono16": ("mono16", "mono16"),
    "bgra8": ("mono8", "bgra8"),
    "rgba16": ("mono16", "rgba16"),
    "bayer_rggb8": ("mono8", "bgr8"),
    "bayer_gbrg16": ("mono16", "bgr16"),
}
GRAY_CODES = {
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba16": cv2.COLOR_RGBA2GRAY,
    "bayer_rggb8": cv2.COLOR_BayerBG2GRAY,
    "bayer_gbrg16": cv2.COLOR_BayerGR2GRAY,
}
COLOR_CODES = {"bayer_rggb8": cv2.COLOR_BayerBG2BGR_VNG, "bayer_gbrg16": cv2.COLOR_BayerGR2BGR}


def raw_messages(types: Any, encoding: str) -> dict[str, Any]:
    """Camera infos and raw images of the first pair of the synthetic sequence."""
    made = sequence(1)
    pair, messages = made[0].pair, {}
    for side, frame, camera in (("left", pair.left, made.rig.left), ("right", pair.right, made.rig.right)):
        samples = raw_of(frame.pixels, encoding)
        message = types.Image(
            header=camera_info_message(types, camera, frame.stamp_ns).header,
            **{"height": samples.shape[0], "width": samples.shape[1], "encoding": encoding, "is_bigendian": 0},
            **{"step": samples[0].nbytes, "data": payload_of(types, samples)},
        )
        messages[f"{side}/camera_info"] = camera_info_message(types, camera, frame.stamp_ns)
        messages[f"{side}/image_raw"] = message
    return messages


def payload_of(types: Any, samples: Any) -> Any:
    data, view = types.payload(samples.nbytes)
    view[:] = np.ascontiguousarray(samples).reshape(-1).view(np.uint8)
    return data


def expected_images(encoding: str) -> dict[str, Any]:
    """The pixels that image_proc publishes, by topic."""
    made, found = sequence(1), {}
    rectifier, pair = Rectifier(made.rig), made[0].pair
    for side, frame, rectify in (
        ("left", pair.left, rectifier.rectify_left),
        ("right", pair.right, rectifier.rectify_right),
    ):
        samples = raw_of(frame.pixels, encoding)
        gray = cv2.cvtColor(samples, GRAY_CODES[encoding]) if encoding in GRAY_CODES else samples
        color = cv2.cvtColor(samples, COLOR_CODES[encoding]) if encoding in COLOR_CODES else samples
        found |= {f"{side}/image_mono": gray, f"{side}/image_color": color}
        found |= {f"{side}/image_rect": rectify(gray), f"{side}/image_rect_color": rectify(color)}
    return found


@pytest.mark.graph
@pytest.mark.parametrize("encoding", PUBLISHED)
def test_encoding_is_kept_live_and_offline_and_both_shapes_agree(encoding: str, tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    from graph_harness import Graph, image_pixels
    from sensor_msgs.msg import Image, PointCloud2
    from stereo_msgs.msg import DisparityImage
    from test_message_types import RclpyTypes
    from test_nodes import one_pair

    from stereo_depth_ros.nodes.disparity_node import DisparityNode
    from stereo_depth_ros.nodes.point_cloud_node import PointCloudNode
    from stereo_depth_ros.nodes.rectify_node import RectifyNode
    from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode

    fused_images = ("left/image_rect", "right/image_rect", "left/image_rect_color")
    results = {"points2": PointCloud2, "disparity": DisparityImage}
    expected, messages = expected_images(encoding), raw_messages(RclpyTypes(), encoding)
    with Graph(RectifyNode, DisparityNode, PointCloudNode, parameters=PARAMETERS) as graph:
        separate = one_pair(graph, messages, {**dict.fromkeys(expected, Image), **results})
    with Graph(StereoDepthNode, parameters=PARAMETERS) as graph:
        images = dict.fromkeys((*fused_images, "right/image_rect_color"), Image)
        fused = one_pair(graph, messages, {**images, **results})
    offline = offline_outputs(encoding, tmp_path, {**dict.fromkeys(fused_images, "Image"), "points2": "PointCloud2"})

    for topic, pixels in expected.items():
        gray, color = PUBLISHED[encoding]
        assert separate[topic].encoding == (color if topic.endswith("color") else gray), topic
        np.testing.assert_array_equal(image_pixels(separate[topic]), pixels, topic)
    for topic in fused_images:
        assert fused[topic].encoding == separate[topic].encoding == offline[topic].encoding
        assert bytes(fused[topic].data) == bytes(separate[topic].data) == bytes(offline[topic].data), topic
    right = "right/image_rect_color"  # not recorded
    assert (fused[right].encoding, bytes(fused[right].data)) == (separate[right].encoding, bytes(separate[right].data))
    assert bytes(fused["disparity"].image.data) == bytes(separate["disparity"].image.data)
    assert bytes(fused["points2"].data) == bytes(separate["points2"].data) == bytes(offline["points2"].data)


def offline_outputs(encoding: str, folder: Path, kinds: dict[str, str]) -> dict[str, Any]:
    types = RosbagsTypes()
    with BagWriter(folder / "in.mcap") as bag:
        for topic, message in raw_messages(types, encoding).items():
            stamp = message.header.stamp
            bag.write(f"/{topic}", message, 10**9 * stamp.sec + stamp.nanosec)
    process_bag(BagSelection(folder / "in.mcap"), folder / "out.mcap", pipeline_config(PARAMETERS))
    found = {topic: list(messages_of(folder / "out.mcap", f"/{topic}").values()) for topic in kinds}
    return {topic: types.deserialize(data[0], f"sensor_msgs/msg/{kinds[topic]}") for topic, data in found.items()}
