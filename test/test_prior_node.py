# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A range sensor of a live graph as a prior: what is matched with it, and what is counted and said without it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from graph_harness import NS_PER_S, Graph
from range_bags import FRAMES, LEFT, LEFT_LIDAR, sweep
from stereo_bags import sequence
from stereo_msgs.msg import DisparityImage
from test_range_monitor import write_pose

from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, Frame, StereoPair
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.disparity import published_disparity
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.point_cloud import valued_cloud_message
from stereo_depth_ros.nodes.message_types import RclpyTypes
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.ranging.projection import project, rectified_from_left
from stereo_depth_ros.ranging.sensor_points import DEFAULT_SIGMA_M

pytestmark = pytest.mark.graph

TYPES = RclpyTypes()
PARAMETERS: dict[str, Any] = {"disparity_range": 48, "prior_topic": "/lidar/points"}
STAMP_NS = 10 * NS_PER_S


def cloud(stamp_ns: int) -> dict[str, Any]:
    points = sweep(0).astype(np.float64)
    return {"/lidar/points": valued_cloud_message(TYPES, points, {}, stamp_ns=stamp_ns, frame_id="lidar")}


def pair(stamp_ns: int) -> dict[str, Any]:
    rig, frames = sequence(FRAMES).rig, sequence(FRAMES)[0].pair
    found: dict[str, Any] = {}
    for side, camera, frame in (("left", rig.left, frames.left), ("right", rig.right, frames.right)):
        found[f"{side}/camera_info"] = camera_info_message(TYPES, camera, stamp_ns)
        moved = Frame(frame.pixels, stamp_ns, frame.frame_id, frame.encoding)
        found[f"{side}/image_raw"] = image_message(TYPES, moved.pixels, moved.encoding, stamp_ns, moved.frame_id)
    return found


def expected(guided: bool) -> F32:
    """Published disparities of the pipeline, with the same points as a prior or without."""
    made = sequence(FRAMES)
    rig = made.rig
    pose = rectified_from_left(rig) @ LEFT_LIDAR
    in_camera = pose.apply(sweep(0).astype(np.float64)).astype(np.float32)
    size = (rig.width, rig.height)
    seen = project(in_camera, DEFAULT_SIGMA_M, Pose.identity(), Triangulation.from_rig(rig), size)
    prior = DisparityPrior(seen.disparity_px, seen.sigma_px) if guided else None
    pipeline = StereoPipeline(PipelineConfig(matching=MatchingConfig(num_disparities=48)), rig)
    result = pipeline.process(StereoPair(made[0].pair.left, made[0].pair.right), prior)
    return result.disparity.disparity_px - np.float32(rig.doffs_px)


def test_pairs_are_matched_with_the_newest_sweep_in_time(tmp_path: Path) -> None:
    file = write_pose(tmp_path / "lidar.yaml", LEFT_LIDAR)
    with Graph(StereoDepthNode, parameters=PARAMETERS | {"prior_extrinsics": file}) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.send(pair(STAMP_NS))
        graph.wait(lambda: len(received) == 1, "a disparity")
        graph.wait(lambda: graph.counter("pairs without a sweep in time") == 1, "the count")
        np.testing.assert_allclose(published_disparity(received[0], ""), expected(guided=False), atol=1e-4)
        graph.send(cloud(STAMP_NS + NS_PER_S))
        graph.wait(lambda: len(graph.nodes[0]._prior._sweeps) == 1, "a sweep")
        graph.send(pair(STAMP_NS + NS_PER_S))
        graph.wait(lambda: len(received) == 2, "a second disparity")
        found = published_disparity(received[1], "")
        np.testing.assert_allclose(found, expected(guided=True), atol=1e-4)
        assert not np.array_equal(found, published_disparity(received[0], ""), equal_nan=True)
        graph.wait(lambda: graph.counter("pairs with a prior") == 1, "the count")
        graph.send(pair(STAMP_NS + 3 * NS_PER_S))
        graph.wait(lambda: graph.counter("pairs without a sweep in time") == 2, "a pair long after the sweep")
        refused = graph.set_parameter("stereo_algorithm", 0)
        assert not refused.successful and "prior_topic has no effect with bm" in refused.reason


def test_a_missing_transform_is_said_and_pairs_are_matched_without() -> None:
    with Graph(StereoDepthNode, parameters=PARAMETERS) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.send(cloud(STAMP_NS))
        graph.wait(lambda: len(graph.nodes[0]._prior._sweeps) == 1, "a sweep")
        graph.send(pair(STAMP_NS))
        graph.wait(lambda: len(received) == 1, "a disparity")
        graph.wait(lambda: graph.counter("pairs without a transform of the range sensor") == 1, "the count")
        status = graph.status()
        assert status.level == DiagnosticStatus.WARN
        assert "no prior of /lidar/points: " in status.message
        assert f"no transform from 'lidar' to '{LEFT}'" in status.message
        np.testing.assert_allclose(published_disparity(received[0], ""), expected(guided=False), atol=1e-4)


def test_a_matcher_that_takes_no_prior_is_refused_at_start() -> None:
    with (
        pytest.raises(ConfigError, match="prior_topic has no effect with bm, which takes no prior"),
        Graph(StereoDepthNode, parameters=PARAMETERS | {"stereo_algorithm": 0}),
    ):
        pass
