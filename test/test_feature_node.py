# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The feature node in a live graph: its points against the features of the matcher and against the truth."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graph_harness import NS_PER_S, Graph, NodeProcess, StereoCamera, colored, ros_arguments
from sensor_msgs.msg import PointCloud2

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.features.matcher import FeatureMatcher
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.nodes.feature_node import FeatureNode
from stereo_depth_ros.stages.rectification import Rectifier

pytestmark = pytest.mark.graph

STAMP_NS = 5 * NS_PER_S + 123_456_789
INPUTS = ("left/image_rect", "right/image_rect", "left/camera_info", "right/camera_info")
TOPIC = "features/points2"


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera(frames=1, width=400, height=300)


@pytest.fixture(scope="module")
def images(camera: StereoCamera) -> tuple[U8, U8]:
    rectified = Rectifier(camera.rig).rectify(camera.frames[0].pair)
    return rectified.left, rectified.right


def messages(camera: StereoCamera, images: tuple[U8, U8], stamp_ns: int = STAMP_NS, encoding: str = "mono8") -> Any:
    """Both camera infos and both rectified images, by topic."""
    found = camera.infos(stamp_ns)
    for side, pixels in zip(("left", "right"), images, strict=True):
        shown = pixels if encoding == "mono8" else colored(pixels)
        frame_id = f"{side}_camera_optical_frame"
        found[f"{side}/image_rect"] = image_message(camera.types, shown, encoding, stamp_ns, frame_id)
    return found


def one_cloud(sent: dict[str, Any], **parameters: Any) -> PointCloud2:
    with Graph(FeatureNode, parameters=parameters) as graph:
        received = graph.listen(TOPIC, PointCloud2)
        graph.send(sent)
        graph.wait(lambda: received, f"message on {TOPIC}")
        assert len(received) == 1
        assert not graph.errors(".")
    return received[0]


def values(cloud: PointCloud2, name: str, dtype: str = "<f4") -> Any:
    """One field of all points, (N,)."""
    offset = next(field.offset for field in cloud.fields if field.name == name)
    points = np.frombuffer(cloud.data, np.uint8).reshape(cloud.width, cloud.point_step)
    return np.ascontiguousarray(points[:, offset : offset + 4]).view(dtype)[:, 0]


def xyz(cloud: PointCloud2) -> Any:
    return np.stack([values(cloud, name) for name in "xyz"], axis=1)


@pytest.fixture(scope="module")
def cloud(camera: StereoCamera, images: tuple[U8, U8]) -> PointCloud2:
    return one_cloud(messages(camera, images), disparity_range=48)


def projected(camera: StereoCamera, cloud: PointCloud2) -> tuple[Any, Any]:
    """Left pixels (N, 2) and disparities (N,) of points, by the camera matrices."""
    points = np.column_stack((xyz(cloud).astype(float), np.ones(cloud.width)))
    left, right = (points @ camera_model.P.T for camera_model in (camera.rig.left, camera.rig.right))
    left_xy, right_xy = left[:, :2] / left[:, 2:], right[:, :2] / right[:, 2:]
    np.testing.assert_allclose(left_xy[:, 1], right_xy[:, 1], atol=1e-3)
    return left_xy, left_xy[:, 0] - right_xy[:, 0]


def test_one_row_of_valid_points(cloud: PointCloud2) -> None:
    stamp = cloud.header.stamp.sec * NS_PER_S + cloud.header.stamp.nanosec
    assert (stamp, cloud.header.frame_id) == (STAMP_NS, "left_camera_optical_frame")
    assert (cloud.height, cloud.point_step, cloud.is_dense, cloud.is_bigendian) == (1, 32, True, False)
    assert cloud.row_step == len(cloud.data) == 32 * cloud.width
    assert [(field.name, field.offset, field.count) for field in cloud.fields] == [
        ("x", 0, 1),
        ("y", 4, 1),
        ("z", 8, 1),
        ("rgb", 16, 1),
    ]
    assert np.isfinite(xyz(cloud)).all()
    assert (values(cloud, "z") > 0).all()


def test_points_are_the_features_at_sub_pixel_positions(
    cloud: PointCloud2, camera: StereoCamera, images: tuple[U8, U8]
) -> None:
    features = FeatureMatcher(MatchingConfig(num_disparities=48)).find(*images)
    left_xy, disparity_px = projected(camera, cloud)
    distance = np.abs(features.left_xy[:, None] - left_xy).max(axis=2)
    nearest = distance.argmin(axis=0)
    assert 100 < cloud.width <= len(features)
    # float32 meters: a few parts in 10^7 of some hundred pixels.
    assert distance.min(axis=0).max() < 1e-3
    np.testing.assert_allclose(disparity_px, features.disparity_px[nearest], atol=1e-3)
    assert np.mean(left_xy % 1 > 0.05) > 0.8


def test_points_agree_with_the_truth(cloud: PointCloud2, camera: StereoCamera) -> None:
    left_xy, disparity_px = projected(camera, cloud)
    columns, rows = np.rint(left_xy).astype(int).T
    truth_px = camera.frames[0].truth_disparity_px[rows, columns]
    assert np.median(np.abs(disparity_px - truth_px)) < 0.2  # the detector's own error
    assert np.mean(np.abs(disparity_px - truth_px) < 1) > 0.9


def test_no_points_outside_the_raw_images(cloud: PointCloud2, camera: StereoCamera, images: tuple[U8, U8]) -> None:
    """Raw principal points that lie left of the rectified ones: the raw images do not cover the first columns."""
    unseen = {"left": 150, "right": 140}
    sent = messages(camera, images)
    for side, columns in unseen.items():
        model = getattr(camera.rig, side)
        K = model.P[:, :3].copy()
        K[0, 2] -= columns
        raw = replace(model, K=K, D=np.zeros(5), R=np.identity(3))
        sent[f"{side}/camera_info"] = camera_info_message(camera.types, raw, STAMP_NS)
    left_xy, disparity_px = projected(camera, cloud)
    half = MatchingConfig().correlation_window_size // 2
    pixels = np.rint([left_xy[:, 0], left_xy[:, 0] - disparity_px])
    seen = (pixels[0] >= unseen["left"] + half) & (pixels[1] >= unseen["right"] + half)
    assert 0 < np.count_nonzero(~seen & (pixels[0] >= unseen["left"] + half)) < np.count_nonzero(~seen)
    np.testing.assert_array_equal(xyz(one_cloud(sent, disparity_range=48)), xyz(cloud)[seen])


def test_colors_are_those_of_the_left_image(cloud: PointCloud2, camera: StereoCamera, images: tuple[U8, U8]) -> None:
    left_xy, _ = projected(camera, cloud)
    inside = np.abs(left_xy % 1 - 0.5).max(axis=1) > 0.01  # not between two pixels
    columns, rows = np.rint(left_xy).astype(int).T
    np.testing.assert_array_equal(
        values(cloud, "rgb", "<u4")[inside], images[0][rows, columns][inside].astype(np.uint32) * 0x010101
    )
    for encoding, order in (("rgb8", (0, 1, 2)), ("bgr8", (2, 1, 0))):
        sent = messages(camera, images, encoding=encoding)
        packed = one_cloud(sent, disparity_range=48, feature_type="orb", avoid_point_cloud_padding=True)
        assert (packed.point_step, packed.width > 50) == (16, True)
        columns, rows = np.rint(projected(camera, packed)[0]).astype(int).T
        red, green, blue = colored(images[0])[rows, columns].astype(np.uint32).T[list(order)]
        np.testing.assert_array_equal(values(packed, "rgb", "<u4"), red << 16 | green << 8 | blue)


def test_lines_without_color(camera: StereoCamera, images: tuple[U8, U8]) -> None:
    sent = messages(camera, images)
    # The node is for features, whatever other nodes match with.
    lines = one_cloud(sent, disparity_range=48, feature_type="lines", use_color=False, stereo_algorithm=1)
    assert ([field.name for field in lines.fields], lines.point_step) == (["x", "y", "z"], 16)
    rows = projected(camera, lines)[0][:, 1]
    assert len(rows) > 100
    np.testing.assert_allclose(rows, np.rint(rows), atol=1e-3)


def test_images_without_features_give_an_empty_cloud(camera: StereoCamera) -> None:
    flat = np.full((300, 400), 90, np.uint8)
    empty = one_cloud(messages(camera, (flat, flat)), disparity_range=48)
    assert (empty.height, empty.width, len(empty.data), empty.is_dense) == (1, 0, 0, True)


def test_inputs_are_subscribed_while_the_output_is() -> None:
    with Graph(FeatureNode) as graph:
        graph.spin(0.2)
        assert graph.subscriptions(*INPUTS) == [0] * 4
        graph.listen(TOPIC, PointCloud2)
        graph.wait(lambda: graph.subscriptions(*INPUTS) == [1] * 4, "subscription of all inputs")
        graph.stop_listening(TOPIC)
        graph.wait(lambda: graph.subscriptions(*INPUTS) == [0] * 4, "end of the subscriptions")
        assert graph.status().message == "ok"


def test_bad_images_are_reported_and_survived(camera: StereoCamera, images: tuple[U8, U8]) -> None:
    with Graph(FeatureNode, parameters={"disparity_range": 48}) as graph:
        received = graph.listen(TOPIC, PointCloud2)
        small = (images[0][::2, ::2].copy(), images[1][::2, ::2].copy())
        graph.send(messages(camera, small))
        graph.wait_error("/left/image_rect: the image is 200x150, its camera info is for 400x300")
        graph.send(messages(camera, images[::-1], STAMP_NS + NS_PER_S))
        graph.wait_error("cameras look swapped: .* exchange the image topics of left and right")
        graph.send(messages(camera, images, STAMP_NS + 2 * NS_PER_S))
        graph.wait(lambda: received, "cloud after bad images")
        assert received[0].header.stamp.sec == (STAMP_NS + 2 * NS_PER_S) // NS_PER_S
        assert [graph.counter(name) for name in ("CalibrationError", "ImageError", "paired")] == [1, 1, 3]
        assert any(item.key == "match p50 ms" for item in graph.status().values)


def test_parameters_change_while_running(camera: StereoCamera, images: tuple[U8, U8]) -> None:
    with Graph(FeatureNode, parameters={"disparity_range": 48}) as graph:
        received = graph.listen(TOPIC, PointCloud2)
        graph.send(messages(camera, images))
        graph.wait(lambda: len(received) == 1, "cloud of corners")
        assert graph.set_parameter("feature_type", "lines", "feature_node").successful
        refused = graph.set_parameter("feature_type", "surf", "feature_node")
        assert (refused.successful, "is not one of sift, orb, lines" in refused.reason) == (False, True)
        graph.send(messages(camera, images, STAMP_NS + 1))
        graph.wait(lambda: len(received) == 2, "cloud of lines")
    assert received[0].width != received[1].width


def test_equal_topics_are_refused() -> None:
    with pytest.raises(TopicError, match="left/image_rect and right/image_rect are both /same: remap them"):
        Graph(FeatureNode, remaps={"left/image_rect": "/same", "right/image_rect": "/same"})


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_process_ends_with_exit_code_0(tmp_path: Path, number: signal.Signals) -> None:
    process = NodeProcess("feature_node", ros_arguments({"feature_type": "orb"}), tmp_path)
    try:
        process.wait_ready()
        process.signal(number)
        assert process.exit_code() == 0, process.text
        assert "Traceback" not in process.text
    finally:
        process.kill()
