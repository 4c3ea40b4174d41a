# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bad input: the node continues, publishes nothing for it, reports the fault and the remedy once, and counts it."""

from __future__ import annotations

import array
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from graph_harness import NS_PER_S, Graph, StereoCamera, image_pixels
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.nodes import base
from stereo_depth_ros.nodes.depth_node import DepthNode
from stereo_depth_ros.nodes.disparity_node import DisparityNode
from stereo_depth_ros.nodes.feature_node import FeatureNode
from stereo_depth_ros.nodes.point_cloud_node import PointCloudNode
from stereo_depth_ros.nodes.rectify_node import RectifyNode
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode
from stereo_depth_ros.stages import rectification
from stereo_depth_ros.stages.rectification import Rectifier

pytestmark = pytest.mark.graph

SMALL = {"disparity_range": 32, "correlation_window_size": 9}
FIRST_NS, BAD_NS, NEXT_NS = 10 * NS_PER_S, 20 * NS_PER_S, 30 * NS_PER_S
LEFT, RIGHT = "left/image_raw", "right/image_raw"
LEFT_INFO, RIGHT_INFO = "left/camera_info", "right/camera_info"
Messages = dict[str, Any]


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera()


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * NS_PER_S + int(message.header.stamp.nanosec)


def wait_for_pairs(graph: Graph, count: int) -> None:
    counters = graph.nodes[0].diagnostics.counters
    graph.wait(lambda: counters["paired"] == count, f"{count} pairs")


@dataclass(frozen=True)
class Case:
    """A fault in the messages of a pair, the error that the node reports and the counter."""

    name: str
    spoil: Callable[[Messages], None]
    says: str
    counts: str


def set_field(topic: str, name: str, value: Any) -> Callable[[Messages], None]:
    return lambda messages: setattr(messages[topic], name, value)


def set_matrix(topics: tuple[str, ...], name: str, change: Callable[[Any], None]) -> Callable[[Messages], None]:
    def spoil(messages: Messages) -> None:
        for topic in topics:
            matrix = np.array(getattr(messages[topic], name))
            change(matrix)
            setattr(messages[topic], name, matrix if name != "d" else array.array("d", matrix))

    return spoil


def zero(matrix: Any) -> None:
    matrix[:] = 0


def scale_baseline(factor: float) -> Callable[[Any], None]:
    def change(P: Any) -> None:
        P[3] *= factor

    return change


def not_a_number(D: Any) -> None:
    D[1] = np.nan


def cut_short(messages: Messages) -> None:
    messages[RIGHT].data = messages[RIGHT].data[:-1]


def smaller(*topics: str) -> Callable[[Messages], None]:
    def spoil(messages: Messages) -> None:
        for topic in topics:
            image = messages[topic]
            image.width, image.height, image.step = 100, 60, 100
            image.data = image.data[:6000]

    return spoil


def swap_images(messages: Messages) -> None:
    messages[LEFT].data, messages[RIGHT].data = messages[RIGHT].data, messages[LEFT].data


def swap_frames(messages: Messages) -> None:
    messages[LEFT].header, messages[RIGHT].header = messages[RIGHT].header, messages[LEFT].header


def info_size(*topics: str) -> Callable[[Messages], None]:
    def spoil(messages: Messages) -> None:
        for topic in topics:
            messages[topic].width, messages[topic].height = 640, 480

    return spoil


def swap_topics(messages: Messages) -> None:
    messages[LEFT], messages[RIGHT] = messages[RIGHT], messages[LEFT]
    messages[LEFT_INFO], messages[RIGHT_INFO] = messages[RIGHT_INFO], messages[LEFT_INFO]


IMAGE_CASES = (
    Case(
        "step below a row",
        set_field(LEFT, "step", 190),
        r"/left/image_raw: step = 190 bytes is below a row of width 200 px \* 1 = 200 .*: set step",
        "MessageError",
    ),
    Case(
        "short payload",
        cut_short,
        r"/right/image_raw: data has 23999 bytes, .* takes 24000: send complete rows",
        "MessageError",
    ),
    Case(
        "unknown encoding",
        set_field(LEFT, "encoding", "nv99"),
        "/left/image_raw: encoding = 'nv99' is not supported: publish one of mono8",
        "MessageError",
    ),
    Case("no pixels", set_field(RIGHT, "height", 0), "/right/image_raw: height = 0 px cannot be mono8", "MessageError"),
    Case(
        "left and right of different sizes",
        smaller(RIGHT),
        "/right/image_raw: the image is 100x60, its camera info is for 200x120: calibrate at this resolution",
        "CalibrationError",
    ),
    Case(
        "camera infos of another resolution",
        info_size(LEFT_INFO, RIGHT_INFO),
        "the image is 200x120, its camera info is for 640x480: calibrate at this resolution, or set binning",
        "CalibrationError",
    ),
    Case(
        "image with the frame of the other camera",
        swap_frames,
        "/left/image_raw: frame_id is 'right_camera_optical_frame', the frame of the other camera, .*: "
        "cameras are swapped",
        "CalibrationError",
    ),
)
INFO_CASES = (
    Case(
        "camera infos of two sizes",
        info_size(RIGHT_INFO),
        r"left/camera_info\) is 200x120, .*right/camera_info\) is 640x480: both images must have the same size",
        "CalibrationError",
    ),
    *(
        Case(
            f"{topic} without {name.upper()}",
            set_matrix((topic,), name, zero),
            rf"{topic}\): {name.upper()} is all zero, which means not set: calibrate",
            "CalibrationError",
        )
        for topic in (LEFT_INFO, RIGHT_INFO)
        for name in ("k", "r", "p")
    ),
    Case(
        "positive baseline term",
        set_matrix((RIGHT_INFO,), "p", scale_baseline(-1.0)),
        r"P\[0,3\] = 16\.1323 is positive, it is -fx \* baseline and below 0: .*exchange the topics",
        "CalibrationError",
    ),
    Case(
        "baseline in millimeters",
        set_matrix((RIGHT_INFO,), "p", scale_baseline(1000.0)),
        r"baseline 120\.054 m is outside 0\.001\.\.10 m: units are meters",
        "CalibrationError",
    ),
    Case(
        "no baseline",
        set_matrix((RIGHT_INFO,), "p", scale_baseline(0.0)),
        r"P\[0,3\] = 0 is not a baseline, .*: calibrate both cameras together",
        "CalibrationError",
    ),
    Case(
        "distortion that is not a number",
        set_matrix((LEFT_INFO,), "d", not_a_number),
        r"left/camera_info\): D has a value that is not finite, \[-0\.21, nan, .*: calibrate again",
        "CalibrationError",
    ),
    Case(
        "unknown distortion model",
        set_field(RIGHT_INFO, "distortion_model", "fov"),
        "distortion_model 'fov' is not one of plumb_bob, rational_polynomial, equidistant: calibrate",
        "CalibrationError",
    ),
    Case(
        "cameras crossed, camera infos too",
        swap_topics,
        "it is 0 for the left camera, the reference: left and right are probably swapped, exchange the topics",
        "CalibrationError",
    ),
)


@pytest.mark.parametrize("case", IMAGE_CASES + INFO_CASES, ids=lambda case: case.name)
def test_bad_pair_is_reported_counted_and_survived(case: Case, camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.send(camera.pair(FIRST_NS))
        graph.wait(lambda: received, "disparity of the first pair")
        before = graph.counter(case.counts)
        for repeat in range(3):
            messages = camera.pair(BAD_NS + repeat)
            case.spoil(messages)
            graph.send(messages)
        graph.wait_error(case.says)
        graph.send(camera.pair(NEXT_NS))
        graph.wait(lambda: len(received) > 1, "disparity of the pair after the bad ones")
        assert [stamp_ns(message) for message in received] == [FIRST_NS, NEXT_NS]
        assert received[1].image.data == received[0].image.data
        assert len(graph.errors(".")) == 1, "the same error three times is reported once"
        assert graph.counter(case.counts) - before >= 3
        status = graph.status()
        assert status.level == DiagnosticStatus.ERROR
        assert re.search(case.says, status.message)


def test_bad_calibration_at_the_start_is_reported_and_survived(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        messages = camera.pair(BAD_NS)
        set_matrix((LEFT_INFO, RIGHT_INFO), "p", zero)(messages)
        graph.send(messages)
        graph.wait_error("P is all zero")
        graph.send(camera.pair(NEXT_NS))
        graph.wait(lambda: received, "disparity of the good pair")
        assert [stamp_ns(message) for message in received] == [NEXT_NS]
        assert graph.counter("dropped without calibration") == 1


@pytest.mark.parametrize("node_type", [StereoDepthNode, DisparityNode])
def test_swapped_images_at_the_start_are_reported_and_survived(node_type: Any, camera: StereoCamera) -> None:
    # Rectified images of the disparity node's topics; the fused node takes raw ones.
    image = "image_raw" if node_type is StereoDepthNode else "image_rect"
    with Graph(node_type, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        for time_ns, spoil in ((BAD_NS, swap_images), (NEXT_NS, None)):
            messages = camera.pair(time_ns) if image == "image_raw" else rectified_pair(camera, time_ns)
            if spoil:
                spoil(messages)
            graph.send({topic.replace("image_raw", image): message for topic, message in messages.items()})
        graph.wait(lambda: received, "disparity of the good pair")
        graph.wait_error(
            "cameras look swapped: .* % of the pixels match .*: exchange the image topics of left and right"
        )
        assert [stamp_ns(message) for message in received] == [NEXT_NS]
        assert graph.counter("ImageError") == 1


def rectified_pair(camera: StereoCamera, time_ns: int) -> Messages:
    """As StereoCamera.pair, with rectified pixels."""
    messages = camera.pair(time_ns)
    rectified = Rectifier(camera.rig).rectify(camera.frames[0].pair)
    for topic, pixels in ((LEFT, rectified.left), (RIGHT, rectified.right)):
        messages[topic].data = array.array("B", pixels.tobytes())
    return messages


def test_images_wait_for_their_camera_infos(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters={**SMALL, "queue_size": 1}) as graph:
        received = graph.listen("disparity", DisparityImage)
        for frame in range(5):  # four times queue_size wait
            graph.send(camera.images(FIRST_NS + frame))
            wait_for_pairs(graph, frame + 1)
        error = graph.wait_error("images arrive, but no message on")
        assert error.endswith("on /left/camera_info, /right/camera_info: publish camera infos, or remap them")
        graph.send(camera.infos(FIRST_NS))
        graph.wait(lambda: len(received) == 4, "disparities of the four pairs that waited")
        assert [stamp_ns(message) for message in received] == [FIRST_NS + frame for frame in range(1, 5)]
        assert graph.counter("dropped without calibration") == 1


def test_camera_infos_that_are_published_and_do_not_arrive_have_another_remedy(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters={**SMALL, "queue_size": 1}) as graph:
        graph.listen("disparity", DisparityImage)
        for topic, message in camera.infos(FIRST_NS).items():
            graph.advertise(topic, type(message))
        for number in range(5):
            graph.send(camera.images(FIRST_NS + number))
            wait_for_pairs(graph, number + 1)
        error = graph.wait_error("images arrive, but no message on")
        assert error.endswith("or give the driver more shared memory, as config/fastdds.xml does")


def test_damaged_compressed_image(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters={**SMALL, "image_transport": "compressed"}) as graph:
        graph.listen("disparity", DisparityImage)
        graph.send(camera.infos(FIRST_NS))
        header = camera.images(FIRST_NS)[LEFT].header
        broken = CompressedImage(header=header, format="jpeg", data=array.array("B", b"no jpeg"))
        graph.send({f"{LEFT}/compressed": broken, f"{RIGHT}/compressed": broken})
        graph.wait_error("/left/image_raw: data of 7 bytes with format 'jpeg' is not a complete jpeg or png")
        assert graph.counter("MessageError") == 1


@dataclass(frozen=True)
class StageCase:
    """As Case, for a node that runs one stage."""

    node_type: Any
    output: tuple[str, Any]
    spoil: Callable[[Messages], None]
    says: str
    topics: tuple[str, ...]
    parameters: dict[str, Any] = field(default_factory=dict)


def smaller_disparity(messages: Messages) -> None:
    image = messages["disparity"].image
    image.width, image.height, image.step, image.data = 100, 60, 400, bytes(24000)


def wrong_color_size(messages: Messages) -> None:
    smaller("left/image_rect_color")(messages)


DISPARITY_INPUTS = ("left/image_rect", "right/image_rect")
CLOUD_INPUTS = ("disparity", "left/image_rect_color")
STAGE_CASES = (
    StageCase(
        RectifyNode,
        ("left/image_rect", Image),
        set_field(LEFT, "step", 3),
        "/left/image_raw: step = 3",
        (LEFT, RIGHT),
    ),
    StageCase(
        RectifyNode,
        ("left/image_rect", Image),
        smaller(LEFT),
        "/left/image_raw: the image is 100x60, its camera info is for 200x120",
        (LEFT, RIGHT),
    ),
    StageCase(
        DisparityNode,
        ("disparity", DisparityImage),
        smaller("left/image_rect"),
        "/left/image_rect: the image is 100x60, its camera info is for 200x120",
        DISPARITY_INPUTS,
        SMALL,
    ),
    StageCase(
        DepthNode,
        ("depth/image_rect", Image),
        set_field("disparity", "f", 0.0),
        r"/disparity: f = 0\.0, T = 0\.12.*both must be positive",
        ("disparity",),
    ),
    StageCase(
        DepthNode,
        ("depth/image_rect", Image),
        set_field("disparity", "t", 0.24),
        r"/disparity: f = 134\.375 px, T = 0\.24 m, the camera infos have .* 0\.120054 m \(limit 0\.1 %\): subscribe",
        ("disparity",),
    ),
    StageCase(
        PointCloudNode,
        ("points2", PointCloud2),
        lambda messages: setattr(messages["disparity"].image, "encoding", "16UC1"),
        "/disparity: encoding '16UC1', a DisparityImage holds 32FC1: publish float32",
        CLOUD_INPUTS,
    ),
    StageCase(
        PointCloudNode,
        ("points2", PointCloud2),
        wrong_color_size,
        r"left image of \(60, 100\), the disparities have \(120, 200\) \(rows, columns\): pass the left image",
        CLOUD_INPUTS,
    ),
    StageCase(
        PointCloudNode,
        ("points2", PointCloud2),
        wrong_color_size,
        r"/left/image_rect_color: left image of \(60, 100\)",
        CLOUD_INPUTS,
    ),
    *(
        StageCase(
            node_type,
            output,
            smaller_disparity,
            "/disparity: the disparities are 100x60, the camera infos are for 200x120: subscribe to the camera infos",
            topics,
        )
        for node_type, output, topics in (
            (DepthNode, ("depth/image_rect", Image), ("disparity",)),
            (PointCloudNode, ("points2", PointCloud2), CLOUD_INPUTS),
        )
    ),
)


def stage_messages(camera: StereoCamera, disparity: DisparityImage, time_ns: int) -> Messages:
    """What the nodes of single stages take; raw images stand in for rectified ones."""
    images = camera.images(time_ns)
    message = DisparityImage(
        header=images[LEFT].header,
        image=Image(
            header=images[LEFT].header,
            width=disparity.image.width,
            height=disparity.image.height,
            encoding="32FC1",
            step=disparity.image.step,
            data=disparity.image.data,
        ),
        f=disparity.f,
        t=disparity.t,
        min_disparity=disparity.min_disparity,
        max_disparity=disparity.max_disparity,
    )
    rectified = {f"{side}/image_rect": camera.images(time_ns)[f"{side}/image_raw"] for side in ("left", "right")}
    color = {"left/image_rect_color": camera.images(time_ns)[LEFT]}
    return {**camera.infos(time_ns), **images, **rectified, **color, "disparity": message}


@pytest.fixture(scope="module")
def disparity(camera: StereoCamera) -> DisparityImage:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.send(camera.pair(FIRST_NS))
        graph.wait(lambda: received, "disparity")
    return received[0]


@pytest.mark.parametrize("case", STAGE_CASES, ids=lambda case: f"{case.node_type.__name__}-{case.says[:24]}")
def test_bad_input_of_one_stage(case: StageCase, camera: StereoCamera, disparity: DisparityImage) -> None:
    topics = (LEFT_INFO, RIGHT_INFO, *case.topics)
    with Graph(case.node_type, parameters=case.parameters) as graph:
        received = graph.listen(*case.output)
        for time_ns, spoil in ((FIRST_NS, None), (BAD_NS, case.spoil), (NEXT_NS, None)):
            messages = stage_messages(camera, disparity, time_ns)
            if spoil:
                spoil(messages)
            graph.send({topic: messages[topic] for topic in topics})
        graph.wait(lambda: len(received) > 1, "output of the good input after the bad one")
        graph.wait_error(case.says)
        assert [stamp_ns(message) for message in received] == [FIRST_NS, NEXT_NS]
        assert len(graph.errors(".")) == 1
        counters = ("MessageError", "CalibrationError", "ImageError")
        assert sum(graph.counter(name) for name in counters) == 1


def stream(graph: Graph, camera: StereoCamera, left_ns: list[int], right_ns: list[int]) -> None:
    """Sends images of these stamps, alternating between the cameras."""
    for i in range(max(len(left_ns), len(right_ns))):
        for topic, stamps in ((LEFT, left_ns), (RIGHT, right_ns)):
            if i < len(stamps):
                graph.send({topic: camera.images(stamps[i])[topic]})


@pytest.mark.parametrize(
    ("left_ms", "right_ms", "paired_ms", "counters"),
    [
        pytest.param(
            [0, 100, 200, 300],
            [0, 200, 300],
            [0, 200, 300],
            {"paired": 3, "unpaired left/image_raw": 1, "unpaired right/image_raw": 0},
            id="a frame is lost",
        ),
        pytest.param(
            [0, 100, 100, 200],
            [0, 0, 100, 200],
            [0, 100, 200],
            {"paired": 3, "duplicate stamps": 2, "unpaired left/image_raw": 0},
            id="stamps come twice",
        ),
        pytest.param(
            [0, 100, 200, 300],
            [0, 200, 100, 300],
            [0, 200, 300],
            {"paired": 3, "unpaired left/image_raw": 1, "unpaired right/image_raw": 1, "stamps went backwards": 0},
            id="a frame is late",
        ),
    ],
)
def test_lost_late_and_repeated_frames_are_counted(
    camera: StereoCamera, left_ms: list[int], right_ms: list[int], paired_ms: list[int], counters: dict[str, int]
) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.send(camera.infos(FIRST_NS))
        in_ns = [[FIRST_NS + ms * 1_000_000 for ms in stamps] for stamps in (left_ms, right_ms, paired_ms)]
        stream(graph, camera, *in_ns[:2])
        graph.wait(lambda: len(received) == len(paired_ms), f"{len(paired_ms)} disparities")
        assert [stamp_ns(message) for message in received] == in_ns[2]
        assert {name: graph.counter(name) for name in counters} == counters


def test_pairing_restarts_after_stamps_that_go_back(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        stamps = [NEXT_NS, NEXT_NS + NS_PER_S, BAD_NS, BAD_NS + NS_PER_S]
        for count, time_ns in enumerate(stamps, start=1):
            graph.send(camera.pair(time_ns))
            wait_for_pairs(graph, count)
        graph.wait(lambda: len(received) == len(stamps), f"{len(stamps)} disparities")
        assert [stamp_ns(message) for message in received] == stamps
        error = graph.wait_error("/left/image_raw, /right/image_raw: stamps went backwards")
        assert "waiting messages were dropped" in error
        assert error.endswith("check the clock of the camera driver")
        assert graph.counter("stamps went backwards") == 1
        assert graph.counter("paired") == 4


@pytest.mark.parametrize(
    ("advertised", "remedy"),
    [
        (False, "no publisher: start the camera or remap the topic"),
        (True, r"1 publisher\(s\): check their QoS and that they publish"),
    ],
)
def test_silent_camera_is_named(
    camera: StereoCamera, monkeypatch: pytest.MonkeyPatch, advertised: bool, remedy: str
) -> None:
    monkeypatch.setattr(base, "_SILENCE_S", 0.25)
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        if advertised:
            graph.advertise(RIGHT, Image)
        for frame in range(100):
            messages = camera.pair(FIRST_NS + frame)
            del messages[RIGHT]
            graph.send(messages)
            graph.spin(0.02)
            if graph.errors("nothing received"):
                break
        graph.wait_error(rf"^/right/image_raw: nothing received for 0\.25 s; {remedy}")
        assert len(graph.errors(".")) == 1, "the other topics are not silent"
        assert graph.counter("silent right/image_raw") >= 1
        graph.send(camera.pair(NEXT_NS))
        graph.wait(lambda: received, "disparity once both cameras see")


def test_silence_is_reported_after_a_whole_interval_only(camera: StereoCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(base, "_SILENCE_S", 0.6)
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        graph.spin(0.4)
        graph.listen("disparity", DisparityImage)
        graph.wait(lambda: graph.subscriptions(LEFT) == [1], "subscription")
        graph.spin(0.4)  # the node's clock ticks 0.2 s after the subscription
        assert not graph.errors("nothing received")
        error = graph.wait_error("nothing received")
        assert error == (
            "/left/camera_info, /right/camera_info, /left/image_raw, /right/image_raw: nothing received for 0.6 s; "
            "no publisher: start the camera or remap the topic"
        )


def test_silent_inputs_are_one_error_with_the_remedy_of_each(
    camera: StereoCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(base, "_SILENCE_S", 0.25)
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        graph.listen("disparity", DisparityImage)
        for topic, kind in ((LEFT, Image), (LEFT_INFO, CameraInfo)):
            graph.advertise(topic, kind)
        graph.wait(lambda: graph.subscriptions(LEFT, LEFT_INFO) == [1, 1], "subscriptions")
        error = graph.wait_error("nothing received")
        assert error == (
            "/left/camera_info, /left/image_raw: nothing received for 0.25 s; "
            "1 publisher(s): check their QoS and that they publish. "
            "/right/camera_info, /right/image_raw: nothing received for 0.25 s; "
            "no publisher: start the camera or remap the topic"
        )
        assert len(graph.errors(".")) == 1
        counts = {topic: graph.counter(f"silent {topic}") for topic in (LEFT, RIGHT, LEFT_INFO, RIGHT_INFO)}
        assert set(counts.values()) == {graph.counter("silent inputs")}, counts
        assert graph.status().message == error


def test_qos_that_cannot_match_is_named_and_can_be_overridden(camera: StereoCamera) -> None:
    override = f"qos_overrides./{LEFT}.subscription.reliability"
    with Graph(StereoDepthNode, parameters={**SMALL, override: "reliable"}) as graph:
        graph.advertise(LEFT, Image, reliable=False)
        received = graph.listen("disparity", DisparityImage)
        error = graph.wait_error("^/left/image_raw: a publisher offers less RELIABILITY than is requested")
        assert error.endswith(f"change the publisher, or set {override}")
        assert graph.counter("incompatible qos left/image_raw") == 1
        graph.withdraw(LEFT)
        graph.send(camera.pair(FIRST_NS))  # this publisher is reliable
        graph.wait(lambda: received, "disparity by the reliable publisher")


def test_best_effort_cameras_match_by_default(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        for topic, kind in ((LEFT, Image), (RIGHT, Image), (LEFT_INFO, CameraInfo), (RIGHT_INFO, CameraInfo)):
            graph.advertise(topic, kind, reliable=False)
        received = graph.listen("disparity", DisparityImage)
        graph.send(camera.pair(FIRST_NS))
        graph.wait(lambda: received, "disparity")
        assert not graph.errors(".")


def test_qos_override_of_an_output(camera: StereoCamera) -> None:
    override = "qos_overrides./disparity.publisher.reliability"
    with Graph(StereoDepthNode, parameters={**SMALL, override: "best_effort"}) as graph:
        received = graph.listen("disparity", DisparityImage, reliable=False)
        graph.send(camera.pair(FIRST_NS))
        graph.wait(lambda: received, "disparity")
        (found,) = graph.publishers("/disparity")
        assert found.qos_profile.reliability.name == "BEST_EFFORT"
    assert np.isfinite(image_pixels(received[0].image)).all()


def test_messages_that_cannot_be_read_are_counted_and_reported_once(
    camera: StereoCamera, capfd: pytest.CaptureFixture[str]
) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.send(camera.pair(FIRST_NS))
        graph.wait(lambda: received, "disparity")
        image, info = serialize_message(camera.pair(BAD_NS)[LEFT]), serialize_message(camera.pair(BAD_NS)[RIGHT_INFO])
        capfd.readouterr()
        for _ in range(3):
            graph.advertise(LEFT, Image).publish(image[:-1])
            graph.advertise(RIGHT_INFO, CameraInfo).publish(info.replace(b"plumb_bob", b"plumb_b\xff\xfe"))
        late = camera.pair(BAD_NS)[RIGHT]
        late.header.stamp.nanosec = 4 * NS_PER_S
        graph.advertise(RIGHT, Image).publish(late)
        graph.wait(lambda: graph.nodes[0].diagnostics.counters["MessageError"] == 7, "seven errors")
        out, err = capfd.readouterr()
        assert "exceeds" not in out + err and "Traceback" not in out + err
        graph.wait_error(rf"^/left/image_raw: {len(image) - 1} bytes are not a sensor_msgs/msg/Image: its publisher is")
        graph.wait_error(rf"^/right/camera_info: {len(info)} bytes are not a sensor_msgs/msg/CameraInfo: its publisher")
        graph.wait_error("^/right/image_raw: nanosec = 4000000000 of the stamp is outside 0..999999999: the message is")
        assert len(graph.errors("bytes are not|nanosec")) == 3
        graph.send(camera.pair(NEXT_NS))
        graph.wait(lambda: len(received) == 2, "next disparity")


def test_nothing_of_the_size_of_wrong_camera_infos_is_built(
    camera: StereoCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = []
    real = rectification.rectification_maps
    monkeypatch.setattr(rectification, "rectification_maps", lambda c: (sizes.append((c.width, c.height)), real(c))[1])
    rectified = {f"{side}/image_rect": f"{side}/image_raw" for side in ("left", "right")}
    with Graph(StereoDepthNode, RectifyNode, DisparityNode, FeatureNode, parameters=SMALL, remaps=rectified) as graph:
        for topic in ("disparity", "left/image_rect_color", "features/points2"):
            graph.listen(topic, {"disparity": DisparityImage, "features/points2": PointCloud2}.get(topic, Image))
        messages = camera.pair(BAD_NS)
        info_size(LEFT_INFO, RIGHT_INFO)(messages)
        graph.send(messages, subscribers=4)
        for node in graph.nodes:
            graph.wait(
                lambda node=node: node.diagnostics.counters["CalibrationError"], f"an error of {node.get_name()}"
            )
        assert sizes == []
