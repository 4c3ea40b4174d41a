# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A network that was trained: PSMNet in the file that the variable PSMNET names, see benchmarks/export_psmnet.py."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from command_line import CommandLine
from stereo_bags import write_truth_bag

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.diagnosis.checks.matcher import check_matcher
from stereo_depth_ros.diagnosis.finding import Level
from stereo_depth_ros.evaluation.metrics import disparity_errors
from stereo_depth_ros.evaluation.scenes import Scene, find_scenes
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.onnx import OnnxMatcher
from stereo_depth_ros.offline.engine import process_bag

PSMNET = os.environ.get("PSMNET", "")
MULTIPLE = 256  # the smallest size of the network; the images of the tests are smaller

pytestmark = [
    pytest.mark.network,
    pytest.mark.skipif(not PSMNET, reason="no network: set PSMNET to the file of benchmarks/export_psmnet.py"),
]


def parameters(**more: object) -> dict[str, object]:
    return {"stereo_algorithm": 10, "onnx_model": PSMNET, "onnx_multiple": MULTIPLE, "disparity_range": 32, **more}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("psmnet") / "in.mcap"
    write_truth_bag(path, 1)
    return path


@pytest.fixture(scope="module")
def venus(stereo_data: Path) -> Scene:
    return next(source.load() for source in find_scenes(stereo_data / "middlebury2001") if source.name == "venus")


def test_metadata_say_how_it_is_run() -> None:
    matcher = create_matcher("onnx", onnx_model=PSMNET, disparity_range=192)
    assert isinstance(matcher, OnnxMatcher)
    assert matcher._pair.left.normalization == "imagenet"
    assert matcher._network.number("max_disparity") == 191


@pytest.mark.real_data
def test_errors_and_bias_on_a_real_scene(venus: Scene) -> None:
    """Its disparities are half a pixel too large, which the check finds without the truth."""
    part = np.s_[60:316, 100:420]
    left, right = venus.left[part], venus.right[part]
    matcher = create_matcher("onnx", onnx_model=PSMNET, disparity_range=32)
    errors = disparity_errors(matcher.match(left, right).disparity_px, venus.truth_px[part])
    assert errors.bad_2 < 5 and errors.density > 0.85
    assert 0.3 < errors.signed_median_px < 0.7
    (finding,) = check_matcher(matcher, [(left, right)])
    assert finding.level is Level.WARNING
    assert finding.settings["onnx_offset"] == pytest.approx(-errors.signed_median_px, abs=0.1)
    corrected = create_matcher("onnx", onnx_model=PSMNET, disparity_range=32, **finding.settings)
    (finding,) = check_matcher(corrected, [(left, right)])
    assert finding.level is Level.OK


def test_evaluate_and_process(command_line: CommandLine, bag: Path, tmp_path: Path) -> None:
    options = [text for name, value in parameters().items() for text in ("--param", f"{name}:={value}")]
    options = options[2:]  # the matcher is that of --matcher
    code, out, _ = command_line("evaluate")(bag, "--matcher", "onnx", *options, "--json", "-")
    (row,) = json.loads(out)
    assert code == 0
    assert row["bad_2"] < 10 and row["density"] > 0.7
    result = process_bag(BagSelection(bag), tmp_path / "out.mcap", pipeline_config(parameters()))
    assert (result.pairs, result.lost) == (1, 0)
    assert result.score is not None and result.score.median_px < 1


@pytest.mark.graph
def test_the_node_gives_the_disparities_of_the_matcher() -> None:
    from graph_harness import Graph, StereoCamera, image_pixels

    from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode

    disparity_type = pytest.importorskip("stereo_msgs.msg").DisparityImage
    camera = StereoCamera(frames=1)
    with Graph(StereoDepthNode, parameters=parameters()) as graph:
        received = graph.listen("disparity", disparity_type)
        graph.send(camera.pair(1_000_000_000))
        graph.wait(lambda: received, "disparity", timeout_s=300)
        assert graph.nodes[0].matcher == "onnx (cpu by ONNX Runtime)"
    message, frame = received[0], camera.frames[0]
    found = image_pixels(message.image)
    seen = (found >= message.min_disparity) & ~frame.occluded
    truth_px = message.f * message.t / frame.truth_depth_m
    assert seen.mean() > 0.5
    assert np.median(np.abs(found - truth_px)[seen]) < 1
