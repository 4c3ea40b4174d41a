# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor on a live graph: messages are examined, missing ones are reported."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from command_line import CommandLine
from graph_harness import NS_PER_S, Graph, StereoCamera
from sensor_msgs.msg import Image

from stereo_depth_ros.core.errors import ConfigError, TopicError
from stereo_depth_ros.diagnosis.doctor import diagnose
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.messages.image import compressed_message
from stereo_depth_ros.nodes.graph_survey import camera_topics, survey_graph

pytestmark = pytest.mark.graph

PERIOD_S = 0.05
LEFT, RIGHT = camera_topics("left"), camera_topics("/right/")


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera(frames=1, width=400, height=300)


@contextmanager
def sending(graph: Graph, make: Callable[[int], dict[str, Any]]) -> Iterator[None]:
    """Publishes the messages of ``make`` for a new stamp twenty times a second, from a thread."""
    publishers = {topic: graph.advertise(topic, type(message)) for topic, message in make(NS_PER_S).items()}
    stop = threading.Event()

    def send() -> None:
        stamp_ns = 5 * NS_PER_S
        while not stop.wait(PERIOD_S):
            stamp_ns += round(PERIOD_S * NS_PER_S)
            for topic, message in make(stamp_ns).items():
                publishers[topic].publish(message)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def by_check(findings: Any) -> dict[str, Finding]:
    return {finding.check: finding for finding in findings}


def test_topics_of_a_namespace() -> None:
    assert LEFT[:2] == ("/left/image_raw", "/left/image_raw/compressed")
    assert RIGHT[2] == "/right/image_rect"
    assert camera_topics("")[0] == "/image_raw"


def test_no_time_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"seconds: 0 is outside 0\.\.3600"):
        survey_graph(LEFT, RIGHT, 0)


def test_names_that_cannot_be_are_refused() -> None:
    with pytest.raises(
        TopicError, match="'left camera' is not a topic name, topic name must not contain characters other"
    ):
        survey_graph(["left camera"], ["right"], 0.1)
    with pytest.raises(TopicError, match="'a//b' is not a topic name, topic name must not contain repeated"):
        survey_graph(["left"], ["a//b"], 0.1)


def test_a_healthy_graph(camera: StereoCamera) -> None:
    with Graph() as graph, sending(graph, camera.pair):
        setup = survey_graph(LEFT, RIGHT, 1.0)
    assert (setup.left.image_topic, setup.right.info_topic) == ("/left/image_raw", "/right/camera_info")
    assert not setup.rectified and not setup.findings
    assert len(setup.left.infos) == 1, "equal camera infos are one"
    assert len(setup.left.stamps_ns) >= 8
    assert 3 <= len(setup.pairs) <= 6
    assert all(pair.left.stamp_ns == pair.right.stamp_ns for pair in setup.pairs)
    found = by_check(diagnose(replace(setup, pairs=setup.pairs[:1])).findings)
    best_effort = ("pairs", "left drops", "right drops")  # a busy machine may lose some
    assert max(finding.level for finding in found.values() if finding.check not in best_effort) is Level.OK
    assert found["baseline"].figures["baseline_m"] == pytest.approx(camera.rig.baseline_m)
    assert found["rates"].figures["left_hz"] == pytest.approx(1 / PERIOD_S)
    assert found["rows"].figures["median_px"] < 0.15


def test_missing_messages_are_reported(camera: StereoCamera) -> None:
    def left_camera(stamp_ns: int) -> dict[str, Any]:
        return {topic: message for topic, message in camera.pair(stamp_ns).items() if topic.startswith("left")}

    with Graph() as graph, sending(graph, left_camera):
        graph.advertise("right/image_raw", Image)  # exists, but does not publish
        setup = survey_graph(LEFT, RIGHT, 2)
    found = by_check(diagnose(setup).findings)
    assert found["left camera info"].level is Level.OK
    assert found["right images"].level is Level.ERROR
    assert found["right images"].value == "nothing on /right/image_raw"
    assert "1 publisher(s), but no messages in 2 s" in found["right images"].remedy
    assert found["right camera info"].value == "nothing on /right/camera_info"
    assert "no publisher" in found["right camera info"].remedy


def test_compressed_images_in_other_namespaces(camera: StereoCamera) -> None:
    def compressed(stamp_ns: int) -> dict[str, Any]:
        made: dict[str, Any] = {f"rig/{topic}": message for topic, message in camera.infos(stamp_ns).items()}
        pair = camera.frames[0].pair
        for side, frame in (("left", pair.left), ("right", pair.right)):
            image = compressed_message(camera.types, frame.pixels, "mono8", "png", stamp_ns, frame.frame_id)
            made[f"rig/{side}/image_raw/compressed"] = image
        return made

    with Graph() as graph, sending(graph, compressed):
        setup = survey_graph(camera_topics("rig/left"), camera_topics("rig/right"), 2)
    assert setup.left.image_topic == "/rig/left/image_raw/compressed"
    assert setup.left.info_topic == "/rig/left/camera_info"
    assert len(setup.right.infos) == 1
    np.testing.assert_array_equal(setup.pairs[0].right.pixels, camera.frames[0].pair.right.pixels)


def test_images_that_cannot_be_decoded_are_reported(camera: StereoCamera) -> None:
    def odd(stamp_ns: int) -> dict[str, Any]:
        made = camera.pair(stamp_ns)
        made["right/image_raw"].encoding = "magic"
        return made

    with Graph() as graph, sending(graph, odd):
        setup = survey_graph(LEFT, RIGHT, 2)
    assert not setup.pairs
    assert [finding.check for finding in setup.findings] == ["images of /right/image_raw"], (
        "the first error stands for all"
    )
    assert "encoding = 'magic' is not supported" in setup.findings[0].value


def test_the_command_listens_and_names_the_published_images(camera: StereoCamera, command_line: CommandLine) -> None:
    run = command_line("doctor")
    with Graph() as graph, sending(graph, camera.pair):
        seconds = "--seconds=4"  # DDS announces participants every 3 s
        code, out, err = run("--live", "--left-namespace=a", "--right-namespace=b", seconds, "--json=-")
    assert code == 1
    assert not out and err.count("\n") == 1
    assert "/a/image_raw and /b/image_raw: no messages in 4 s: no publisher: start the camera" in err
    assert "images are on /left/image_raw, /right/image_raw" in err
