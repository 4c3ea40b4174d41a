# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth evaluate`: tables, files, plots, skipped scenes, exit codes."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from evaluation_scenes import pair, write, write_kitti, write_scene
from rosbags.rosbag2 import StoragePlugin
from stereo_bags import compressed_folder, write_truth_bag

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.rig import Rig
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.evaluation import bag_scenes, evaluator
from stereo_depth_ros.matching import Matcher, create_matcher
from stereo_depth_ros.stages.rectification import Rectifier

KEYS = {"scene", "matcher", "density", "bad_0_5", "bad_1", "bad_2", "bad_2_all", "avg", "ms"}
SMALL = ("--param", "correlation_window_size:=9")


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("evaluate", columns=80)


def rows_of(path: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = json.loads(path.read_text())
    return rows


def test_scenes_times_methods_as_table_json_csv_and_plots(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "dumb")  # of 80 columns
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    write_scene(tmp_path / "data" / "one")
    write_scene(tmp_path / "data" / "set" / "two", seed=2)
    report, sheet, plots = tmp_path / "r.json", tmp_path / "r.csv", tmp_path / "plots"
    files = ("--json", report, "--csv", sheet, "--plots", plots)
    code, out, err = run(tmp_path / "data", "--matcher", "bm", "--matcher", "sgbm", *SMALL, *files)
    assert (code, err) == (0, "")
    rows = rows_of(report)
    assert [(row["scene"], row["matcher"]) for row in rows] == [
        ("one", "bm"),
        ("one", "sgbm"),
        ("two", "bm"),
        ("two", "sgbm"),
    ]
    for row in rows:
        assert row.keys() >= KEYS
        assert row["disparity_range"] == 32 and row["bad_1"] < 6 and row["bad_2_all"] > 10 and row["ms"] > 0
        assert row["parameters"] == {"correlation_window_size": 9, "disparity_range": 32}
        assert any(
            line.split()[:3] == [row["scene"], row["matcher"], f"{100 * row['density']:.1f}"]
            for line in out.splitlines()
        )
    assert out.count("near depth edges and on thin structures") == 2  # of each scene, and the means
    # A frame of 5 px on both sides of the edges of 70 x 50 px, without its outer corners; three pixels in each corner.
    for row in rows:
        assert row["edges_share"] == pytest.approx((80 * 60 - 4 - 60 * 40) / (170 * 96))
        assert row["thin_share"] == pytest.approx(12 / (170 * 96))
    assert "smallest multiple of 16 above" in " ".join(out.split())
    assert max(map(len, out.splitlines())) <= 80
    with sheet.open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [float(line["bad_2_all"]) for line in lines] == [row["bad_2_all"] for row in rows]
    assert 0 < float(lines[0]["auc_bad_1_ratio"]) < 1 and "curve" not in lines[0]
    assert sorted(path.name for path in plots.iterdir()) == sorted(
        f"{s}_{m}{kind}.png" for s in ("one", "two") for m in ("bm", "sgbm") for kind in ("", "_confidence", "_reasons")
    )
    assert cv2.imread(str(plots / "one_bm.png")).shape[1] > 1000


def test_range_that_is_set_is_used_and_reported(run: Run, tmp_path: Path) -> None:
    write_scene(tmp_path / "one")
    code, out, _ = run(tmp_path / "one", "--matcher", "bm", *SMALL, "--param", "disparity_range:=48")
    assert code == 0 and "48 to 48, as set" in out
    code, out, _ = run(tmp_path / "one", "--matcher", "bm", *SMALL, "-p", "disparity_range:=48", "--json", "-")
    assert [row["disparity_range"] for row in json.loads(out)] == [48]


def test_confidence_is_measured_and_plotted(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Confident:
        """Block matching with low confidence where it is wrong."""

        def __init__(self, inner: Matcher) -> None:
            self.config, self._inner = inner.config, inner

        def match(self, left: U8, right: U8, out: F32 | None = None, earlier: Any = ()) -> MatchResult:
            found = self._inner.match(left, right)
            wrong = np.abs(found.disparity_px - pair()[2]) > 1
            confidence = np.where(np.isnan(found.disparity_px), 0, np.where(wrong, 0.25, 0.75)).astype(np.float32)
            return MatchResult(found.disparity_px, found.reasons, found.step_px, confidence)

    monkeypatch.setattr(evaluator, "create_matcher", lambda *how: Confident(create_matcher(*how)))
    write_scene(tmp_path / "one")
    files = ("--json", tmp_path / "r.json", "--plots", tmp_path / "p")
    code, out, _ = run(tmp_path / "one", "--matcher", "bm", *SMALL, *files)
    assert code == 0
    (row,) = rows_of(tmp_path / "r.json")
    assert row["auc_bad_1"] == pytest.approx(row["auc_bad_1_oracle"]) and row["auc_bad_1_ratio"] < 0.3
    assert len(row["curve"]["bad_1"]) == len(row["curve"]["coverage"]) == 20
    assert f"{row['auc_bad_1_ratio']:.2f}" in out
    assert {path.name for path in (tmp_path / "p").iterdir()} == {
        f"one_bm{kind}.png" for kind in ("", "_confidence", "_reasons")
    }


def test_bags_and_folders_together_and_equal_names_are_numbered(run: Run, tmp_path: Path) -> None:
    write_truth_bag(tmp_path / "room.mcap", 2)
    write_scene(tmp_path / "a" / "one")
    write_scene(tmp_path / "b" / "one", seed=2)
    write_kitti(tmp_path / "training")
    places = (tmp_path / "room.mcap", tmp_path / "a", tmp_path / "b", tmp_path / "training")
    code, _, err = run(*places, "--matcher", "bm", *SMALL, "--json", tmp_path / "r.json")
    assert code == 0, err
    rows = rows_of(tmp_path / "r.json")
    names = ["room/0000", "room/0001", "one", "one#2", "training/000000_10"]
    assert [row["scene"] for row in rows] == names
    assert all(row["bad_2"] < 8 for row in rows)
    assert [row["d1_fg"] is not None for row in rows] == [False] * 4 + [True]
    assert rows[-1]["occlusion"] == "mask"


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_folder_of_a_compressed_bag(run: Run, tmp_path: Path, plugin: StoragePlugin) -> None:
    write_truth_bag(tmp_path / "room.mcap", 1)
    folder = compressed_folder(tmp_path / "room.mcap", tmp_path / "bag", plugin)
    assert [path.suffix for path in folder.iterdir() if path.suffix != ".yaml"] == [".zstd"]
    code, _, err = run(folder, "--matcher", "bm", *SMALL, "--json", tmp_path / "r.json")
    assert code == 0, err
    assert [row["scene"] for row in rows_of(tmp_path / "r.json")] == ["bag/0000"]


def test_invalid_scenes_are_skipped_with_a_warning(run: Run, tmp_path: Path) -> None:
    write_scene(tmp_path / "good")
    left, right, truth_px = pair()
    write(write_scene(tmp_path / "scaled") / "disp0.pfm", 4 * truth_px)
    write(write_scene(tmp_path / "small") / "disp0.pfm", truth_px[:, :-2].copy())
    write(write_scene(tmp_path / "swapped") / "im0.png", right)
    write(tmp_path / "swapped" / "im1.png", left)
    code, out, err = run(tmp_path, "--matcher", "bm", *SMALL, "--json", tmp_path / "r.json")
    assert code == 3
    assert [row["scene"] for row in rows_of(tmp_path / "r.json")] == ["good"]
    assert "good" in out
    lines = err.splitlines()
    assert len(lines) == 4 and lines[-1].startswith("error: 3 skipped")
    assert lines[0].startswith("warning: scaled skipped: the scale of the truth looks wrong, it is about 4 times")
    truth = tmp_path / "small" / "disp0.pfm"
    assert lines[1].startswith(f"warning: small skipped: {truth}: its disparities are 168x96, the images are 170x96: ")
    assert lines[2].startswith("warning: swapped skipped: cameras look swapped")
    code, out, err = run(tmp_path / "swapped", "--matcher", "bm", *SMALL)
    assert (code, out) == (1, "")
    assert err.startswith("error: nothing could be evaluated: swapped skipped: cameras look swapped")
    assert err.count("\n") == 1


def test_matcher_that_rejects_a_scene_is_skipped_there(run: Run, tmp_path: Path) -> None:
    write_scene(tmp_path / "one")
    window = ("--param", "correlation_window_size:=95", "--param", "prefilter_cap:=5")
    code, out, err = run(tmp_path / "one", "--matcher", "bm", *window, "--param", "disparity_range:=160")
    assert (code, out) == (1, "")
    assert "one, bm skipped: images of 170 x 96 px" in err and "use a smaller search range or window" in err


def test_errors_before_anything_runs_are_one_line(run: Run, tmp_path: Path) -> None:
    write_scene(tmp_path / "one")

    def error(*arguments: object, usage: bool = False) -> str:
        code, out, err = run(*arguments)
        assert (code, out) == (2 if usage else 1, "") and err.startswith("error: ") and err.count("\n") == 1
        return err

    assert "unknown matcher 'best': known are bm (0)" in error(tmp_path / "one", "--matcher", "best", usage=True)
    assert "did you mean 'speckle_size'" in error(
        tmp_path / "one", "--matcher", "bm", "-p", "speckle_siz:=3", usage=True
    )
    assert "P2 = 100 is not above P1" in error(
        tmp_path / "one", "--matcher", "sgbm", "-p", "P1:=200.0", "-p", "P2:=100.0", usage=True
    )
    assert "none: does not exist" in error(tmp_path / "none", "--matcher", "bm")
    (tmp_path / "empty").mkdir()
    assert "empty: has no scene with truth" in error(tmp_path / "empty", "--matcher", "bm")
    for option in ("--json", "--csv"):
        assert f"folder {tmp_path / 'no'} does not exist" in error(
            tmp_path / "one", "--matcher", "bm", option, tmp_path / "no" / "r"
        )
    assert "cannot be written" in error(tmp_path / "one", "--matcher", "bm", *SMALL, "--csv", tmp_path)
    (tmp_path / "file").write_text("")
    assert "cannot be written" in error(tmp_path / "one", "--matcher", "bm", *SMALL, "--plots", tmp_path / "file")


def test_usage(run: Run, tmp_path: Path) -> None:
    assert run(tmp_path)[0] == 2  # no method
    assert run("--matcher", "bm")[0] == 2  # no folder or bag
    code, out, _ = run("--help")
    assert code == 0 and "stereo-depth evaluate Motorcycle-perfect --matcher sgbm" in out
    assert "smallest multiple of 16" in " ".join(out.split())


def test_a_constant_bias_is_named(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def shifted(name: str, config: MatchingConfig) -> Matcher:
        method = create_matcher(name, config)
        match = method.match
        if name == "bm":
            monkeypatch.setattr(method, "match", lambda *images, **more: plus(match(*images, **more), 1.8))
        return method

    def plus(result: MatchResult, bias_px: float) -> MatchResult:
        return replace(result, disparity_px=result.disparity_px + np.float32(bias_px))

    monkeypatch.setattr(evaluator, "create_matcher", shifted)
    write_scene(tmp_path / "data" / "one")
    write_scene(tmp_path / "data" / "two", seed=2)
    options = ("--matcher", "bm", "--matcher", "sgbm", *SMALL, "--json", tmp_path / "r.json")
    code, out, err = run(tmp_path / "data", *options)
    assert code == 0 and "median of disparity minus truth" in out
    (warning,) = err.splitlines()
    assert "bm: disparities are 1.80 px too large everywhere on 2 of 2 scenes" in warning and "sgbm" not in warning
    for row in rows_of(tmp_path / "r.json"):
        expected = 1.8 if row["matcher"] == "bm" else 0.0
        assert row["signed_median"] == pytest.approx(expected, abs=0.07)
        assert row["constant_bias"] == (row["signed_median"] if expected else None)


@pytest.mark.real_data
def test_no_method_is_biased_on_real_scenes(run: Run, stereo_data: Path, tmp_path: Path) -> None:
    places = (stereo_data / name for name in ("middlebury2001", "middlebury2005/Reindeer"))  # the largest of all
    code, _, err = run(*places, "--matcher", "bm", "--matcher", "sgm", "--json", tmp_path / "r.json")
    assert (code, err) == (0, "")
    rows = rows_of(tmp_path / "r.json")
    assert len(rows) == 6 and all(abs(row["signed_median"]) < 0.25 for row in rows)


@pytest.mark.real_data
def test_tsukuba_and_cones_against_independent_figures(run: Run, stereo_data: Path, tmp_path: Path) -> None:
    tsukuba = stereo_data / "middlebury2001" / "tsukuba"
    places = (tsukuba, stereo_data / "middlebury2003")
    code, out, err = run(*places, "--matcher", "sgbm", "--json", tmp_path / "r.json")
    assert code == 0, err
    first, second = rows_of(tmp_path / "r.json")
    colors = (cv2.imread(str(tsukuba / f"scene1.row3.{name}.ppm")) for name in ("col3", "col4"))
    left, right = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in colors)
    levels = cv2.imread(str(tsukuba / "truedisp.row3.col3.pgm"), cv2.IMREAD_UNCHANGED)
    found = create_matcher("sgbm", num_disparities=32).match(left, right).disparity_px
    known, matched = levels > 0, (levels > 0) & np.isfinite(found)
    wrong = np.abs(found - levels / 16.0) > 2
    assert first["density"] == pytest.approx(matched.sum() / known.sum())
    assert first["bad_2"] == pytest.approx(100 * (wrong & matched).sum() / matched.sum())
    assert first["bad_2_all"] == pytest.approx(100 * ((wrong & matched).sum() + (known & ~matched).sum()) / known.sum())
    assert (second["scene"], second["occlusion"], second["disparity_range"]) == ("cones", "mask", 64)
    assert second["nonocc_bad_2_all"] < second["bad_2_all"] < 40
    assert "cones: mask of the dataset" in " ".join(out.split())


def test_maps_of_a_bag_are_built_once(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_truth_bag(tmp_path / "room.mcap", 3)
    rigs = []

    class Counted(Rectifier):
        def __init__(self, rig: Rig) -> None:
            rigs.append(rig)
            super().__init__(rig)

    monkeypatch.setattr(bag_scenes, "Rectifier", Counted)
    code, _, err = run(tmp_path / "room.mcap", "--matcher", "bm", *SMALL, "--json", tmp_path / "r.json")
    assert code == 0, err
    assert (len(rows_of(tmp_path / "r.json")), len(rigs)) == (3, 1)
