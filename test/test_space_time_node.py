# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Space-time stereo in a live graph: each disparity is that of the pairs so far, in one node and in separate ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from graph_harness import NS_PER_S, Graph, StereoCamera
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.config.matchers import matcher_number
from stereo_depth_ros.core.types import F32, Frame, StereoPair
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.nodes.disparity_node import DisparityNode
from stereo_depth_ros.nodes.rectify_node import RectifyNode
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode
from stereo_depth_ros.pipeline import StereoPipeline

pytestmark = pytest.mark.graph

SHOWN = (0, 1, 2, 0, 1)
STAMPS_NS = (10 * NS_PER_S, 10 * NS_PER_S + 10**8, 10 * NS_PER_S + 2 * 10**8, 15 * NS_PER_S, 15 * NS_PER_S + 10**8)
NUMBER = matcher_number("spacetime")


def offline(camera: StereoCamera) -> list[F32]:
    """The disparities of the pairs without a graph."""
    pipeline = StereoPipeline(
        PipelineConfig(matching=MatchingConfig(stereo_algorithm=NUMBER, temporal_window=3)), camera.rig
    )

    def at(frame: Frame, stamp_ns: int) -> Frame:
        return replace(frame, stamp_ns=stamp_ns)

    found = []
    for index, stamp_ns in zip(SHOWN, STAMPS_NS, strict=True):
        pair = camera.frames[index].pair
        result = pipeline.process(StereoPair(at(pair.left, stamp_ns), at(pair.right, stamp_ns)))
        found.append(result.disparity.disparity_px)
    return found


@pytest.mark.parametrize("nodes", [(StereoDepthNode,), (RectifyNode, DisparityNode)], ids=["fused", "separate"])
def test_live_disparities_are_those_of_the_pairs_so_far(nodes: tuple[Callable[[], Any], ...]) -> None:
    """The fourth pair comes after a gap, and is matched alone."""
    camera = StereoCamera()
    expected = offline(camera)
    with Graph(*nodes, parameters={"stereo_algorithm": NUMBER, "temporal_window": 3}) as graph:
        heard = graph.listen("disparity", DisparityImage)
        for number, (index, stamp_ns) in enumerate(zip(SHOWN, STAMPS_NS, strict=True), start=1):
            graph.send(camera.pair(stamp_ns, index))
            graph.wait(lambda n=number: len(heard) == n, f"disparity {number}")
        for message, disparity_px in zip(heard, expected, strict=True):
            np.testing.assert_array_equal(matched_disparity(message, camera.rig), disparity_px)
    np.testing.assert_array_equal(expected[3], expected[0])  # the same pair, alone both times
    assert not np.array_equal(expected[2], expected[0], equal_nan=True)
