# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth fuse` with color and depth images: on a sheet of dots, and with given poses."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine
from sheet_views import BLOCK, CX, CY, FX, FY, poses_around, view, write_toy, write_views

INTRINSICS = f"{FX},{FY},{CX},{CY}"
POSES = poses_around(5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five views and the image of the sheet."""
    place = tmp_path_factory.mktemp("views") / "toy"
    write_toy(place)
    (place / "camera.yaml").rename(place.parent / "camera.yaml")
    return place


def test_a_block_on_a_sheet(command_line: CommandLine, folder: Path, tmp_path: Path) -> None:
    fuse = command_line("fuse", str(folder), "--marks", str(folder / "sheet.png"))
    out, report = tmp_path / "block.ply", tmp_path / "block.json"
    code, printed, err = fuse("--intrinsics", INTRINSICS, "-o", out, "--voxel", 0.003, "--json", report)
    assert code == 0, err
    assert "5 of 5" in printed and "dots from their plane" in printed
    values = json.loads(report.read_text("utf-8"))
    assert values["fused"] == 5 and values["dots_flatness_m"] < 0.0005 and values["dots_spread_m"] < 0.0015
    for pose, truth in zip(values["poses"], POSES, strict=True):
        assert np.abs(np.array(pose["sheet_from_camera"]) - truth.matrix).max() < 0.004
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.load(out)
    assert mesh.is_watertight
    low = values["cut_height_m"]
    np.testing.assert_allclose(mesh.bounds, [[*BLOCK[0][:2], low], BLOCK[1]], atol=0.002)
    code, _, err = fuse("--intrinsics", INTRINSICS, "-o", out)
    assert code == 1 and "already exists" in err and "--overwrite" in err


def test_a_view_that_does_not_fit_is_skipped_and_told(command_line: CommandLine, folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "views"
    write_views(place, [view(pose, seed) for seed, pose in enumerate(POSES[:2])])
    write_views(place, [view(POSES[0], 7)], first=2)
    cv2.imwrite(str(place / "rgb_2.png"), np.full((230, 300, 3), 200, np.uint8))
    fuse = command_line("fuse", str(place), "--marks", str(folder / "sheet.png"), "--intrinsics", INTRINSICS)
    code, out, err = fuse("-o", tmp_path / "block.glb", "--voxel", 0.004)
    assert code == 3 and "2 of 3" in out
    assert "rgb_2.png: 0 dark dots with a depth" in err and "1 views skipped" in err


def test_given_poses(command_line: CommandLine, folder: Path, tmp_path: Path) -> None:
    rows = [" ".join(f"{value:.9f}" for value in pose.matrix[:3].ravel()) for pose in POSES]
    poses = tmp_path / "poses.txt"
    poses.write_text("\n".join(rows) + "\n", "utf-8")
    fuse = command_line("fuse", str(folder), "--poses", str(poses), "--intrinsics", INTRINSICS)
    code, out, err = fuse("-o", tmp_path / "all.ply", "--voxel", 0.004, "--max-depth", 0.6, "--refine")
    assert code == 0, err
    assert "5 of 5" in out and "poses refined" in out


@pytest.mark.parametrize(
    ("options", "code", "problem"),
    [
        ((), 2, "the camera of the color images is not known"),
        (("--intrinsics", "1,2,3"), 2, "intrinsics '1,2,3' are not four numbers"),
        (("--intrinsics", "-5,400,150,110"), 1, "focal lengths -5 and 400"),
        (("--intrinsics", INTRINSICS, "--matcher", "sgm"), 2, "--matcher has no effect with color and depth images"),
        (("--intrinsics", INTRINSICS, "--poses", "p.txt"), 2, "--poses has no effect with --marks"),
        (("--intrinsics", INTRINSICS, "--depth-unit", "0"), 2, "depth_unit = 0 m is not above 0"),
        (("--intrinsics", INTRINSICS, "--depth-sigma", "nan"), 2, "depth_sigma = nan m is not above 0"),
        (("--intrinsics", INTRINSICS, "--camera-info", "left.yaml"), 2, "contradict each other"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    command_line: CommandLine, folder: Path, tmp_path: Path, options: tuple[str, ...], code: int, problem: str
) -> None:
    fuse = command_line("fuse", str(folder), "--marks", str(folder / "sheet.png"), "-o", str(tmp_path / "a.ply"))
    found, _, err = fuse(*options)
    assert (found, problem in err) == (code, True), err
    assert not (tmp_path / "a.ply").exists()


def test_other_errors_are_one_line(command_line: CommandLine, folder: Path, tmp_path: Path) -> None:
    fuse = command_line("fuse", str(folder), "--intrinsics", INTRINSICS, "-o", str(tmp_path / "a.ply"))
    code, _, err = fuse()
    assert code == 2 and "has no file of poses of its own" in err and "--marks" in err
    code, _, err = fuse("--marks", folder / "rgb_0.png", "--voxel", 0.004)
    assert code == 1 and len(err.strip().splitlines()) >= 1 and "Traceback" not in err
    code, _, err = fuse("--marks", tmp_path / "none.png")
    assert code == 1 and "does not exist" in err
    (tmp_path / "empty").mkdir()
    code, _, err = command_line("fuse", str(tmp_path / "empty"))("-o", tmp_path / "b.ply", "--marks", "x.png")
    assert code == 2 and "--marks has no effect without color and depth images" in err


@pytest.mark.real_data
def test_three_views_of_a_toy(command_line: CommandLine, stereo_data: Path, tmp_path: Path) -> None:
    place = stereo_data / "active" / "g_rgbd_turntable_dog"
    if not place.is_dir():
        pytest.skip("no views of a range camera")
    for number in (0, 2, 4):
        for kind in ("rgb", "depth"):
            (tmp_path / f"{kind}_{number}.png").symlink_to(place / f"{kind}_{number}.png")
    fuse = command_line("fuse", str(tmp_path), "--marks", str(place / "template.png"))
    code, _, err = fuse(
        "--intrinsics", "616.8676,617.0631,319.5701,233.0649", "-o", tmp_path / "toy.ply", "--voxel", 0.004,
        "--json", tmp_path / "toy.json",
    )  # fmt: skip
    assert code == 0, err
    values = json.loads((tmp_path / "toy.json").read_text("utf-8"))
    assert values["fused"] == 3 and values["dots"] >= 15
    assert values["dots_flatness_m"] < 0.001 and values["dots_spread_m"] < 0.002
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.load(tmp_path / "toy.ply")
    assert mesh.is_watertight and 0.08 < mesh.extents[2] < 0.11
