# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs follow the QoS of their publishers; what is lost or has no partner is counted, and said with its cause."""

from __future__ import annotations

import re

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from graph_harness import NS_PER_S, Graph, StereoCamera
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.nodes.rectify_node import RectifyNode
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode

pytestmark = pytest.mark.graph

SMALL = {"disparity_range": 32, "correlation_window_size": 9}
BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT
FIRST_NS = 10 * NS_PER_S
LEFT, RIGHT = "left/image_raw", "right/image_raw"
LEFT_INFO, RIGHT_INFO = "left/camera_info", "right/camera_info"


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera()


def input_qos(graph: Graph, topic: str) -> list[tuple[str, str]]:
    """Reliability and durability of the subscriptions of a topic."""
    found = [info.qos_profile for info in graph.subscribers(topic)]
    return [(profile.reliability.name, profile.durability.name) for profile in found]


@pytest.mark.parametrize("camera_first", [True, False])
def test_inputs_are_reliable_where_their_publishers_are(camera_first: bool) -> None:
    topics = {LEFT: Image, RIGHT: Image, LEFT_INFO: CameraInfo, RIGHT_INFO: CameraInfo}
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        if not camera_first:
            graph.listen("disparity", DisparityImage)
            graph.wait(lambda: graph.subscriptions(*topics) == [1] * 4, "subscriptions")
        for topic, kind in topics.items():
            graph.advertise(topic, kind, reliable=topic != RIGHT)
        if camera_first:
            graph.listen("disparity", DisparityImage)
        best_effort, reliable = [("BEST_EFFORT", "VOLATILE")], [("RELIABLE", "VOLATILE")]
        for topic, expected in ((LEFT, reliable), (RIGHT, best_effort), (LEFT_INFO, best_effort)):
            graph.wait(lambda t=topic, e=expected: input_qos(graph, t) == e, f"{expected} subscription of {topic}")
        graph.withdraw(LEFT)
        graph.advertise(LEFT, Image, reliable=False)
        graph.wait(lambda: input_qos(graph, LEFT) == best_effort, "best-effort subscription of a best-effort publisher")
        graph.withdraw(LEFT)
        graph.advertise(LEFT, Image)
        graph.wait(lambda: input_qos(graph, LEFT) == reliable, "reliable subscription of a reliable publisher")
        assert not graph.errors(".")


def test_first_message_of_a_reliable_camera_that_starts_later_is_received(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.wait(lambda: graph.subscriptions(LEFT, RIGHT) == [1, 1], "subscriptions")
        assert [input_qos(graph, topic) for topic in (LEFT, RIGHT)] == [[("RELIABLE", "VOLATILE")]] * 2
        graph.send(camera.infos(FIRST_NS))
        graph.send(camera.images(FIRST_NS))
        graph.wait(lambda: received, "disparity of the first pair")


def test_a_subscription_that_changes_its_qos_loses_and_repeats_nothing(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage, depth=100)
        graph.send(camera.infos(FIRST_NS))
        sent = 0
        while input_qos(graph, LEFT) != [("BEST_EFFORT", "VOLATILE")]:
            assert sent < 100, "the subscription has not changed within 100 pairs"
            if sent == 5:
                other = graph._node.create_publisher(Image, LEFT, QoSProfile(depth=1, reliability=BEST_EFFORT))
            graph.send(camera.images(FIRST_NS + sent * 10**7))
            sent += 1
            graph.wait(lambda count=sent: len(received) >= count, f"disparity {sent}")
            graph.spin(0.02)
        graph.send(camera.images(FIRST_NS + sent * 10**7))
        graph.wait(lambda: len(received) > sent, "disparity by the new subscription")
        graph._node.destroy_publisher(other)
        stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in received]
        assert stamps == [FIRST_NS + number * 10**7 for number in range(sent + 1)]
        assert graph.counter("duplicate stamps") == 0


def test_latched_camera_infos_of_before_arrive(camera: StereoCamera) -> None:
    latched = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        for topic, message in camera.infos(FIRST_NS).items():
            graph.advertise(topic, CameraInfo, qos=latched).publish(message)
        received = graph.listen("disparity", DisparityImage)
        graph.send(camera.images(FIRST_NS))
        graph.wait(lambda: received, "disparity with camera infos published before the node subscribed")
        assert sorted(input_qos(graph, LEFT_INFO)) == [("BEST_EFFORT", "VOLATILE"), ("RELIABLE", "TRANSIENT_LOCAL")]
        for topic in (LEFT_INFO, RIGHT_INFO):
            graph.withdraw(topic)
            graph.advertise(topic, CameraInfo)
        graph.wait(
            lambda: input_qos(graph, LEFT_INFO) == [("BEST_EFFORT", "VOLATILE")],
            "end of the latched one",
        )


def test_infos_that_are_not_latched_arrive_beside_latched_ones(camera: StereoCamera) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        graph.listen("disparity", DisparityImage)
        for topic, message in camera.infos(FIRST_NS).items():
            graph.advertise(topic, CameraInfo, qos=latched).publish(message)
        graph.wait(lambda: len(input_qos(graph, LEFT_INFO)) == 2, "transient local subscription")
        other = graph._node.create_publisher(CameraInfo, LEFT_INFO, 1)
        graph.wait(lambda: other.get_subscription_count() == 1, "connection of a publisher that does not latch")
        left_info = next(item for item in graph.nodes[0]._inputs if item.topic == LEFT_INFO)
        received = left_info._received
        other.publish(camera.infos(FIRST_NS)[LEFT_INFO])
        graph.wait(lambda: left_info._received == received + 1, "its camera info")


def test_messages_replaced_in_the_queue_of_a_busy_node_are_counted(camera: StereoCamera) -> None:
    with Graph(RectifyNode) as graph:
        received = graph.listen("left/image_rect", Image, depth=100)
        graph.send({**camera.infos(FIRST_NS), LEFT: camera.images(FIRST_NS)[LEFT]})
        graph.wait(lambda: received, "first image")
        for number in range(1, 13):  # while the node does something else; its queue holds 5
            graph.advertise(LEFT, Image).publish(camera.images(FIRST_NS + number * 10**8)[LEFT])
        graph.wait(lambda: len(received) == 6, "the images that are left")
        assert graph.counter("replaced left/image_raw") == 7
        assert graph.counter("replaced right/image_raw") == 0
        status = graph.status()
        assert status.level == DiagnosticStatus.WARN
        assert status.message == (
            "7 replaced left/image_raw (7 in all): /left/image_raw arrives faster than this node takes it, and newer "
            "messages replaced older ones: lower its rate, choose a faster matcher, or raise queue_size (5)"
        )


def test_publishers_of_one_image_topic_are_named_while_there_are_two(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        graph.listen("disparity", DisparityImage)
        others = [rclpy.create_node(name, namespace="/cam", use_global_arguments=False) for name in ("a", "b")]
        publishers = [node.create_publisher(Image, f"/{LEFT}", 10) for node in others]
        graph.wait(lambda: len(graph.publishers(f"/{LEFT}")) == 2, "2 publishers")
        graph.wait(lambda: graph.status().level == DiagnosticStatus.WARN, "level WARN")
        said = "/left/image_raw has 2 publishers, /cam/a and /cam/b, and their images are mixed: stop or remap one"
        assert graph.status().message == said
        graph.nodes[0].diagnostics.publish()
        graph.wait(lambda: any(log.msg == said for log in graph.logs), "warning in the log")
        assert len([log for log in graph.logs if log.msg == said]) == 1
        others[1].destroy_publisher(publishers[1])
        graph.wait(lambda: graph.status().level == DiagnosticStatus.OK, "level OK with one publisher")
        for node in others:
            node.destroy_node()


def test_stamps_that_are_not_set_are_said_once_with_the_remedy(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        graph.listen("disparity", DisparityImage)
        graph.send(camera.infos(0))
        for _ in range(5):
            graph.send(camera.images(0))
            graph.spin(0.02)
        error = graph.wait_error("which means not set")
        assert error == (
            "the stamps of /left/image_raw and /right/image_raw are 0, which means not set, and images cannot be "
            "paired: let the driver stamp its images with the time of exposure"
        )
        status = graph.status()
        assert (status.level, status.message) == (DiagnosticStatus.ERROR, error)
        assert graph.counter("duplicate stamps") == 8
        assert len([log for log in graph.logs if log.level >= Log.WARN]) == 1


def test_stamps_that_come_twice_are_a_loss(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.send(camera.pair(FIRST_NS))
        graph.wait(lambda: received, "disparity")
        graph.send({LEFT: camera.images(FIRST_NS)[LEFT]})
        graph.wait(lambda: graph.counter("duplicate stamps") == 1, "duplicate")
        status = graph.status()
        assert status.level == DiagnosticStatus.WARN
        assert status.message == (
            "1 duplicate stamps (1 in all): messages of /left/image_raw or /right/image_raw have the stamp of one "
            "before, and only the first is used: look for a second publisher, or a clock that stands still"
        )


def test_a_side_later_than_the_queue_is_measured(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        graph.listen("disparity", DisparityImage)
        graph.send(camera.infos(FIRST_NS))
        arrivals = graph.nodes[0]._pairs._arrivals
        for number in range(20):
            stamp, late = FIRST_NS + number * 10**8, FIRST_NS + (number - 8) * 10**8
            graph.send({LEFT: camera.images(stamp)[LEFT]})
            graph.wait(lambda s=stamp: (0, s) in arrivals, f"left image {number}")
            if number >= 8:
                graph.send({RIGHT: camera.images(late)[RIGHT]})
                graph.wait(lambda s=late: (1, s) in arrivals, f"right image {number}")
        graph.wait(lambda: "queue_size" in graph.status().message, "lag")
        assert graph.status().message.endswith(
            "/right/image_raw arrives 8 messages (800 ms) after those of /left/image_raw with its stamps, and "
            "queue_size keeps 5: set queue_size to 9 or more, or find what delays it"
        )


def test_stamps_that_never_match_are_measured(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        graph.listen("disparity", DisparityImage)
        graph.send(camera.infos(FIRST_NS))
        for number in range(12):
            left = camera.images(FIRST_NS + number * 10**8)
            right = camera.images(FIRST_NS + number * 10**8 + 17_000_000)
            graph.send({LEFT: left[LEFT]})
            graph.send({RIGHT: right[RIGHT]})
            graph.spin(0.01)
        graph.wait(lambda: graph.counter("unpaired left/image_raw") > 5, "unpaired images")
        status = graph.status()
        assert status.level == DiagnosticStatus.WARN
        assert re.fullmatch(
            r"\d+ unpaired left/image_raw \(\d+ in all\), \d+ unpaired right/image_raw \(\d+ in all\): "
            r"stamps of /left/image_raw and /right/image_raw are 17\.000 ms apart, the tolerance is 0 ms: "
            r"set approximate_sync and an approximate_sync_tolerance_seconds above 0\.017000",
            status.message,
        ), status.message
        graph.wait(lambda: [log for log in graph.logs if log.msg == status.message], "warning in the log")
        assert len([log for log in graph.logs if log.level == Log.WARN]) == 1


def test_images_of_one_side_lost_are_counted_and_named(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage, depth=100)
        graph.send(camera.infos(FIRST_NS))
        for number in range(10):
            images = camera.images(FIRST_NS + number * 10**8)
            graph.send({LEFT: images[LEFT]})
            if number not in (4, 6, 7):
                graph.send({RIGHT: images[RIGHT]})
                header = images[LEFT].header
                graph.wait(lambda h=header: received and received[-1].header == h, f"disparity {number}")
        assert graph.counter("unpaired left/image_raw") == 3
        assert graph.counter("unpaired right/image_raw") == 0
        status = graph.status()
        assert status.level == DiagnosticStatus.WARN
        assert status.message.startswith(
            "3 unpaired left/image_raw (3 in all): of /left/image_raw and /right/image_raw"
        )


def test_a_start_on_one_side_is_not_a_loss(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.send(camera.infos(FIRST_NS))
        graph.send({LEFT: camera.images(FIRST_NS - 10**8)[LEFT]})
        graph.spin(0.05)
        graph.send(camera.images(FIRST_NS))
        graph.wait(lambda: received, "disparity")
        assert graph.counter("unpaired left/image_raw") == 1
        assert (graph.status().level, graph.status().message) == (DiagnosticStatus.OK, "ok")


def test_frames_that_waited_for_the_first_camera_infos_are_not_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """They come at once; what comes after them waits within queue_size again."""
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        (node,) = graph.nodes
        frames, dropped = node.frames, "pairs dropped while others were matched"
        assert frames is not None
        frames.begin_overlap()
        monkeypatch.setattr(frames, "_prepare", lambda frame: frame)
        monkeypatch.setattr(frames, "_work", lambda frame: frame)
        monkeypatch.setattr(frames, "_at_once", lambda frame: 1)
        monkeypatch.setattr(frames, "_deliver", lambda result: None)
        burst = 4 * 5
        for number in range(burst):
            node.add_frame(number)
        assert node.diagnostics.counters[dropped] == 0
        while frames.run_one():
            pass
        for number in range(8):
            node.add_frame(number)
        assert node.diagnostics.counters[dropped] == 2  # queue_size of them wait, and one is the next


def test_frames_that_are_too_many_from_the_start_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        (node,) = graph.nodes
        assert node.frames is not None
        node.frames.begin_overlap()
        for number in range(30):
            node.add_frame(number)
        assert node.diagnostics.counters["pairs dropped while others were matched"] == 30 - 6
