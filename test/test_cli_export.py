# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The option --export of process and scan: which results are written, and what is refused before anything is."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from scanned import SEQUENCE, scanner, write_bag, write_manifest

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.synthetic.bag import write_synthetic_bag
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

FRAMES = 3
STAMPS = [SyntheticSequence(FRAMES, 160, 120).stamp_ns(n) for n in range(FRAMES)]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "room.mcap"
    write_synthetic_bag(path, SyntheticSequence(FRAMES, 160, 120))
    return path


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line()


def refused(result: tuple[int, str, str], text: str) -> None:
    code, out, err = result
    assert code == 1 and out == "" and text in err.splitlines()[-1], err


def test_the_first_pair(run: Run, bag: Path, tmp_path: Path) -> None:
    depth = tmp_path / "new" / "d.png"
    code, out, err = run("process", bag, "-o", tmp_path / "o.mcap", "--export", depth)
    assert code == 0, err
    assert [path.name for path in depth.parent.iterdir()] == ["d.png"]
    found = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED)
    with BagReader(tmp_path / "o.mcap") as reader:
        message = reader.deserialize(next(iter(reader.messages(["/depth/image_rect"]))))
    expected = np.frombuffer(message.data, np.float32).reshape(120, 160)
    known = np.isfinite(expected)
    assert np.abs(found[known] - 1000 * expected[known]).max() <= 0.51 and (found[~known] == 0).all()
    assert "surface written" in out and f"{depth}: {known.sum()} points" in out


def test_each_pair_by_its_stamp(run: Run, bag: Path, tmp_path: Path) -> None:
    name, output = tmp_path / "m" / "{stamp}.glb", tmp_path / "o.mcap"
    code, out, err = run("process", bag, "-o", output, "--export", name, "--json", "-")
    assert code == 0, err
    files = json.loads(out)["surfaces"]
    assert [Path(file["path"]).name for file in files] == [f"{stamp}.glb" for stamp in STAMPS]
    assert all(Path(file["path"]).stat().st_size > 1000 and file["triangles"] > 1000 for file in files)
    more = ("process", bag, "-o", output, "--overwrite", "--export")
    refused(run(*more[:3], tmp_path / "p.mcap", *more[5:], name), f"{STAMPS[0]}.glb: already exists")
    assert not (tmp_path / "p.mcap").exists()
    code, out, _ = run(*more, name)
    assert code == 0 and "3 files" in out and "pixels left out, they are in no triangle" in out


def test_a_smaller_standard_deviation_cuts_more(run: Run, bag: Path, tmp_path: Path) -> None:
    triangles = []
    for sigma in ("0.02", "1.0"):
        options = ("--export", tmp_path / f"{sigma}.ply", "--param", f"disparity_sigma_px:={sigma}")
        code, out, err = run("process", bag, "-o", tmp_path / f"{sigma}.mcap", *options, "--json", "-")
        assert code == 0, err
        triangles.append(json.loads(out)["surfaces"][0]["triangles"])
    assert triangles[0] < triangles[1] - 500


def test_names_are_checked_before_anything_is_read(run: Run, bag: Path, tmp_path: Path) -> None:
    output = tmp_path / "o.mcap"
    for name, text in (
        ("s.obj", "its name does not end in"),
        ("{stamp}/s.ply", "{stamp} is in the name of a folder"),
        (bag, "its name does not end in"),
    ):
        refused(run("process", bag, "-o", output, "--export", tmp_path / name), text)
    (tmp_path / "s.ply").write_text("mine")
    refused(run("process", bag, "-o", output, "--export", tmp_path / "s.ply"), "already exists")
    assert (tmp_path / "s.ply").read_text() == "mine"
    assert not output.exists()


def test_nothing_is_left_of_a_run_that_fails(run: Run, bag: Path, tmp_path: Path) -> None:
    """The second file cannot be written, because a folder has its name."""
    (tmp_path / f"{STAMPS[1]}.ply").mkdir()
    result = run("process", bag, "-o", tmp_path / "o.mcap", "--overwrite", "--export", tmp_path / "{stamp}.ply")
    refused(result, "it is a folder")
    assert [path.name for path in tmp_path.iterdir()] == [f"{STAMPS[1]}.ply"]


def test_scans(run: Run, tmp_path: Path) -> None:
    manifest = write_manifest(tmp_path)
    captures = write_bag(tmp_path / "in.mcap", [*range(len(SEQUENCE))])
    options = ("--patterns", manifest, "--export", tmp_path / "s.cloud.ply", "--json", "-")
    code, out, err = run("scan", captures, "-o", tmp_path / "o.mcap", *options)
    assert code == 0, err
    (file,) = json.loads(out)["surfaces"]
    kinds = [*((name, "<f4") for name in ("x", "y", "z", "sigma")), *((name, "u1") for name in "rgb")]
    rows = np.frombuffer((tmp_path / "s.cloud.ply").read_bytes().partition(b"end_header\n")[2], kinds)
    assert len(rows) == file["points"] > 0.3 * 160 * 120
    rig = scanner().rig
    u = np.rint(rows["x"] / rows["z"] * rig.f_px + rig.cx_left).astype(int)
    v = np.rint(rows["y"] / rows["z"] * rig.fy_px + rig.cy).astype(int)
    off = np.abs(rows["z"] - scanner().truth().depth_m[v, u])
    assert np.median(off / rows["sigma"]) < 2
    name = tmp_path / "{stamp}.glb"
    refused(
        run("scan", captures, "-o", tmp_path / "p.mcap", "--kind", "stripe", "--laser", "x", "--export", name), "glb"
    )
