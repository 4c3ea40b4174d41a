# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of bags with the points of a range sensor as truth: kinds, stamps, motion, transforms of bag and file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import CommandLine
from range_bags import FRAMES, LEFT, LEFT_LIDAR, write_range_bag
from stereo_bags import sequence

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.core.errors import TopicError, TransformError
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.evaluation.bag_scenes import BagScenes
from stereo_depth_ros.evaluation.truth import TruthOption

TOPIC = "/sensor/points"
MS = 10**6


def errors_of(path: Path, extrinsics: Path | None = None) -> tuple[list[F32], BagScenes]:
    """Truth of the sensor minus the exact one, and exact depth, of each pair; the scenes."""
    scenes = BagScenes(BagSelection(path), truth=TruthOption(TOPIC, extrinsics))
    found = []
    for source in scenes:
        scene = source.load()
        exact = sequence(FRAMES)[int(source.name[-4:])]
        known = np.isfinite(scene.truth_px)
        found.append(scene.truth_px[known] - exact.truth_disparity_px[known])
        sees = scene.visible[known] == ~exact.occluded[known]
        assert np.mean(sees) > 0.92  # of few points, the edges of what hides others are not known
    return found, scenes


# What hides the points of a single ring from a camera below is not seen by the scanner.
@pytest.mark.parametrize(
    ("kind", "fewest", "wrong"), [("cloud", 3000, 0.03), ("scan", 100, 0.16), ("depth", 6500, 0.03)]
)
def test_truth_of_every_kind_of_sensor(tmp_path: Path, kind: str, fewest: int, wrong: float) -> None:
    write_range_bag(tmp_path / "bag.mcap", kind)
    found, scenes = errors_of(tmp_path / "bag.mcap")
    assert len(found) == len(scenes) == FRAMES
    for errors in found:
        assert errors.size >= fewest
        # noise of the ranges, the place in a pixel, and the pixels at depth steps
        assert np.median(np.abs(errors)) < 0.05
        assert np.mean(np.abs(errors) > 1) < wrong
    name = {
        "cloud": "PointCloud2 of frame lidar",
        "scan": "LaserScan of frame lidar",
        "depth": f"Image of frame {LEFT}",
    }
    assert name[kind] in scenes.facts
    assert f"{sum(errors.size for errors in found)} px of 3 pairs" in scenes.facts or kind == "scan"
    assert "transform of /tf_static" in scenes.facts
    assert "the motion between sweep and pair is not known" in scenes.facts


@pytest.mark.parametrize("moving", ["tf", "odometry"])
def test_points_are_moved_to_the_time_of_the_pair(tmp_path: Path, moving: str) -> None:
    write_range_bag(tmp_path / "bag.mcap", late_ns=40 * MS, later_s=0.04, moving=moving)
    found, scenes = errors_of(tmp_path / "bag.mcap")
    assert "moved to the time of each pair" in scenes.facts
    for errors in found:
        assert np.median(np.abs(errors)) < 0.05
        assert np.mean(np.abs(errors) > 1) < 0.03


def test_without_the_motion_sweeps_of_another_time_are_left_out(tmp_path: Path) -> None:
    write_range_bag(tmp_path / "bag.mcap", late_ns=-60 * MS)  # the next one is nearer, but for the last pair
    found, scenes = errors_of(tmp_path / "bag.mcap")
    assert len(found) == FRAMES - 1
    assert "1 pairs left out, whose nearest sweep is more than 50 ms, half a period, away" in scenes.facts


def test_a_file_has_the_pose_of_the_sensor(tmp_path: Path) -> None:
    write_range_bag(tmp_path / "bag.mcap", static=False)
    x, y, z, w = LEFT_LIDAR.quaternion
    text = f"parent: {LEFT}\nchild: lidar\ntranslation: [0.12, -0.25, -0.1]\nquaternion: [{x}, {y}, {z}, {w}]\n"
    (tmp_path / "lidar.yaml").write_text(text)
    found, scenes = errors_of(tmp_path / "bag.mcap", tmp_path / "lidar.yaml")
    assert np.median(np.abs(np.concatenate(found))) < 0.05
    assert f"transform of {tmp_path / 'lidar.yaml'}" in scenes.facts
    assert tmp_path / "lidar.yaml" in scenes.files


def test_without_a_transform_both_frames_are_named(tmp_path: Path) -> None:
    write_range_bag(tmp_path / "bag.mcap", static=False)
    with pytest.raises(TransformError, match=f"no transform from 'lidar' to '{LEFT}'"):
        errors_of(tmp_path / "bag.mcap")


def test_other_topics_are_refused(tmp_path: Path) -> None:
    write_range_bag(tmp_path / "bag.mcap")
    for topic, text in (
        ("/radar", f"has no topic /radar: choose among {TOPIC}$"),
        ("/left/camera_info", "/left/camera_info is sensor_msgs/msg/CameraInfo, not a range sensor"),
    ):
        with pytest.raises(TopicError, match=text):
            BagScenes(BagSelection(tmp_path / "bag.mcap"), truth=TruthOption(topic))


def test_the_command_agrees_with_the_exact_truth(tmp_path: Path, command_line: CommandLine) -> None:
    write_range_bag(tmp_path / "bag.mcap")
    run, given = command_line("evaluate"), (tmp_path / "bag.mcap", "--matcher", "bm", "--param", "speckle_size:=20")
    rows = {}
    for name, more in (("exact", ()), ("sensor", ("--truth", TOPIC))):
        code, out, err = run(*given, "--json", "-", *more)
        assert code == 0, err
        rows[name] = json.loads(out)
    for exact, found in zip(rows["exact"], rows["sensor"], strict=True):
        assert found["scene"] == exact["scene"]
        assert abs(found["a50"] - exact["a50"]) < 0.05
        assert abs(found["bad_1"] - exact["bad_1"]) < 4
        assert abs(found["signed_median"] - exact["signed_median"]) < 0.05
        assert found["occlusion"] == "truth"
    _, out, _ = run(*given, "--truth", TOPIC)
    assert "PointCloud2 of frame lidar" in " ".join(out.split())


def test_options_without_effect_are_refused(tmp_path: Path, command_line: CommandLine) -> None:
    code, _, err = command_line("evaluate")(tmp_path, "--matcher", "bm", "--truth", TOPIC)
    assert code == 2
    assert "--truth has no effect with a folder" in err
