# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A range sensor of a bag as a prior: process and evaluate --prior."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import CommandLine, Run
from range_bags import FRAMES, write_range_bag
from stereo_bags import sequence

from stereo_depth_ros.bags.projected_sweeps import ProjectedSweeps, SensorTopic
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.messages.disparity import published_disparity

SEARCH = ("--param", "disparity_range:=48")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("prior") / "room.mcap"
    write_range_bag(path)
    return path


@pytest.fixture
def process(command_line: CommandLine) -> Run:
    return command_line("process")


@pytest.fixture
def evaluate(command_line: CommandLine) -> Run:
    return command_line("evaluate")


def disparities(path: Path) -> list[F32]:
    with BagReader(path) as reader:
        return [published_disparity(reader.deserialize(each), "") for each in reader.messages(["/disparity"])]


def test_points_are_a_prior_at_their_true_disparities(bag: Path) -> None:
    made = sequence(FRAMES)
    with BagReader(bag) as reader:
        sweeps = ProjectedSweeps(reader, SensorTopic("/sensor/points"))
        project_sweep = sweeps.of(made.stamp_ns(1), lambda: made.rig)
        assert project_sweep is not None
        prior = project_sweep().prior
    assert prior.known.sum() > 200
    truth_px = made[1].truth_disparity_px
    error = np.abs(prior.disparity_px - truth_px)[prior.known & np.isfinite(truth_px)]
    assert np.median(error) < 0.2 and np.mean(error > 1) < 0.02


def test_process_with_a_prior(process: Run, bag: Path, tmp_path: Path) -> None:
    outputs = tmp_path / "plain.mcap", tmp_path / "guided.mcap"
    for output, options in zip(outputs, ((), ("--prior", "/sensor/points")), strict=True):
        code, _, err = process(bag, "-o", output, *SEARCH, *options)
        assert code == 0, err
    plain, guided = map(disparities, outputs)
    assert len(plain) == len(guided) == FRAMES
    assert all(
        (np.isfinite(one) & np.isfinite(two) & (one != two)).any() for one, two in zip(plain, guided, strict=True)
    )
    made = sequence(FRAMES)
    truths = [made[index].truth_disparity_px - np.float32(made.rig.doffs_px) for index in range(FRAMES)]
    wrong = [
        sum(float(np.nanmean(~(np.abs(found - truth) <= 2))) for found, truth in zip(each, truths, strict=True))
        for each in (plain, guided)
    ]
    assert wrong[1] < wrong[0]


def test_pairs_without_a_sweep_in_time_are_counted(process: Run, tmp_path: Path) -> None:
    write_range_bag(tmp_path / "late.mcap", late_ns=2 * 10**9)
    options = ("--prior", "/sensor/points", "--json", tmp_path / "r.json")
    code, _, err = process(tmp_path / "late.mcap", "-o", tmp_path / "out.mcap", *SEARCH, *options)
    assert code == 0
    assert f"without a prior: {FRAMES} pairs left out, whose nearest sweep is more than" in err


def test_evaluate_with_a_prior(evaluate: Run, bag: Path, tmp_path: Path) -> None:
    rows = []
    for options in ((), ("--prior", "/sensor/points")):
        code, out, err = evaluate(
            bag, "--matcher", "sgm", *SEARCH, *options, "--json", tmp_path / "r.json", "--overwrite"
        )
        assert code == 0, err
        rows.append(json.loads((tmp_path / "r.json").read_text()))
    assert "prior of /sensor/points, PointCloud2 of frame lidar" in " ".join(out.split())
    assert len(rows[0]) == len(rows[1]) == FRAMES
    without, guided = (np.mean([row["bad_2_all"] for row in each]) for each in rows)
    assert guided < without


def test_what_has_no_effect_is_refused(process: Run, evaluate: Run, bag: Path, tmp_path: Path) -> None:
    def error(command: Run, *arguments: object) -> str:
        code, out, err = command(*arguments)
        assert code in (1, 2) and out == "" and err.startswith("error: ") and err.count("\n") == 1
        return err

    output = ("-o", tmp_path / "out.mcap")
    prior = ("--prior", "/sensor/points")
    assert "--prior has no effect with bm, which takes no prior" in error(
        process, bag, *output, *prior, "--matcher", "bm"
    )
    assert "--extrinsics has no effect without --prior" in error(process, bag, *output, "--extrinsics", bag)
    assert "has no topic /none" in error(process, bag, *output, "--prior", "/none")
    assert "--prior has no effect with bm" in error(evaluate, bag, *prior, "--matcher", "sgm", "--matcher", "bm")
    assert "--prior and --truth are both" in error(
        evaluate, bag, *prior, "--matcher", "sgm", "--truth", "/sensor/points"
    )
    assert "--prior has no effect with a folder" in error(evaluate, tmp_path, *prior, "--matcher", "sgm")
    assert not (tmp_path / "out.mcap").exists()
