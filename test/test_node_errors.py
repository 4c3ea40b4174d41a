# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors that nodes report name the parameters of their remedy."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="the nodes need ROS 2")

from graph_harness import Graph

from stereo_depth_ros.core.errors import MessageError, StereoDepthError, TopicError
from stereo_depth_ros.nodes.parameters import error_text
from stereo_depth_ros.nodes.rectify_node import RectifyNode

UNPAIRED = TopicError(
    "no pairs, stamps differ by up to 4 ms",
    subject="/left/image_raw",
    limit=0,
    remedy="pair stamps that differ",
    settings=("approximate_sync", "approximate_sync_tolerance_seconds"),
)
TEXT = (
    "/left/image_raw: no pairs, stamps differ by up to 4 ms: pair stamps that differ "
    "(parameters: approximate_sync, approximate_sync_tolerance_seconds)"
)


def test_parameters_of_a_remedy_are_appended() -> None:
    assert error_text(UNPAIRED) == TEXT


def test_one_parameter_and_a_field_of_another_name() -> None:
    error = StereoDepthError("this needs a model", remedy="use another matcher", settings=("matcher",))
    assert error_text(error) == "this needs a model: use another matcher (parameter: stereo_algorithm)"


@pytest.mark.parametrize("name", ["board", "size", "square", "marker", "dictionary", "spacing", "model"])
def test_parameters_of_the_board(name: str) -> None:
    error = StereoDepthError("the board is too small", remedy="use a larger one", settings=(name,))
    parameter = {"board": "board", "model": "lens_model"}.get(name, f"board_{name}")
    assert error_text(error) == f"the board is too small: use a larger one (parameter: {parameter})"


def test_settings_that_are_not_parameters_are_not_appended() -> None:
    error = StereoDepthError("P2 = 400 is not above P1 = 500", remedy="raise it", settings=("P2", "json_file"))
    assert error_text(error) == "P2 = 400 is not above P1 = 500: raise it (parameter: P2)"
    assert error_text(StereoDepthError("broken")) == "broken"


def test_names_of_another_node() -> None:
    error = StereoDepthError("two stereo pairs", remedy="name the topics", settings=("left", "right"))
    names = {"left": "left_topic", "right": "right_topic"}
    assert error_text(error, names) == "two stereo pairs: name the topics (parameters: left_topic, right_topic)"


@pytest.mark.graph
def test_the_log_names_the_parameters() -> None:
    with Graph(RectifyNode) as graph:
        with graph.nodes[0].diagnostics.catch():
            raise UNPAIRED
        assert graph.wait_error("no pairs") == TEXT
        assert graph.status().message == TEXT


@pytest.mark.graph
def test_two_faults_of_one_class_are_both_logged_and_in_the_status() -> None:
    faults = [
        MessageError("encoding 'nonsense' is not supported", subject="/left/image_raw"),
        MessageError("step 7 is below 640", subject="/left/image_raw"),
        MessageError("step 7 is below 640", subject="/right/image_raw"),
    ]
    with Graph(RectifyNode) as graph:
        for error in faults:
            for _ in range(3):
                with graph.nodes[0].diagnostics.catch():
                    raise error
        graph.wait_error("/right/image_raw: step 7")
        assert graph.errors(".") == [str(error) for error in faults]
        assert graph.status().message == "; ".join(str(error) for error in faults)
        assert graph.counter("MessageError") == 9
