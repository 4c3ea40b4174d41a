# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of poses: each format by its content, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.datasets.pose_files import EUROC, KITTI, TUM, read_poses

POSE = Pose(np.asarray(cv2.Rodrigues(np.array([0.3, -0.9, 0.4]))[0]), np.array([1.5, -0.25, 30.0]))
NS = 1403715273262142976


def file(folder: Path, *rows: str) -> Path:
    path = folder / "poses.txt"
    path.write_text("\n".join(rows) + "\n")
    return path


def words(values: object) -> list[str]:
    return [f"{value:.9g}" for value in np.ravel(values)]  # type: ignore[arg-type]


X, Y, Z, W = POSE.quaternion
T = POSE.translation_m
MATRIX = " ".join(words(POSE.matrix[:3]))
ROWS = {
    "KITTI": ([f"{MATRIX}", f"{MATRIX}"], KITTI, [], []),
    "KITTI, four rows": ([" ".join(words(POSE.matrix))], KITTI, [], []),
    "KITTI-360": ([f"7 {MATRIX}", f"9 {MATRIX}"], KITTI, [], [7, 9]),
    "EuRoC": (
        ["#timestamp, p_x [m], ...", f"{NS}, " + ",".join(words([*T, W, X, Y, Z, 0, 0, 0])), ""],
        EUROC,
        [NS],
        [],
    ),
    "EuRoC, names without #": (
        ["timestamp,x,y,z,...", f"{NS}," + ",".join(words([*T, W, X, Y, Z])) + ","],
        EUROC,
        [NS],
        [],
    ),
    "TUM": (["# t x y z", f"1403715273.25 {' '.join(words([*T, X, Y, Z, W]))} # note"], TUM, [1403715273250000000], []),
    "TUM, nanoseconds": ([f"{NS} {' '.join(words([*T, -X, -Y, -Z, -W]))}"], TUM, [NS], []),
}


@pytest.mark.parametrize("name", ROWS)
def test_formats(tmp_path: Path, name: str) -> None:
    rows, kind, stamps, numbers = ROWS[name]
    found = read_poses(file(tmp_path, *rows))
    assert (found.kind, found.stamps_ns, found.numbers) == (kind, stamps, numbers)
    for pose in found.poses:
        np.testing.assert_allclose(pose.matrix, POSE.matrix, atol=1e-7)


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ([], "holds no poses"),
        ([f"{NS},1.0,2.0,3.0"], "positions without orientations"),
        (["1 2 3 4 5"], "line 1 has 5 values"),
        (["1.5,0,0,0,0,0,0,1"], "line 1 has 8 values with commas"),
        ([MATRIX, "# a", MATRIX + " 4"], "line 3 has 13 numbers, line 1 has 12"),
        ([MATRIX.replace(" 30", " thirty")], "line 1 has a word that is not a number"),
        ([MATRIX.replace(" 30", " nan")], "not finite"),
        ([" ".join(words(2 * POSE.matrix[:3]))], "not a rotation"),
        ([" ".join(words(-POSE.matrix[:3]))], "not a rotation"),
        (["12.5 1 2 3 0.1 0.2 0.3 0.4"], "quaternion of length 0.5477"),
        ([MATRIX.replace(" 30", " -1e200")], "has the number -1e"),
        (["-2 1 2 3 0 0 0 1"], "outside"),
        (["1e300 1 2 3 0 0 0 1"], "outside"),
    ],
)
def test_what_is_refused(tmp_path: Path, rows: list[str], problem: str) -> None:
    with pytest.raises(BagError, match=problem) as caught:
        read_poses(file(tmp_path, *rows))
    assert "KITTI" in caught.value.remedy or "state_groundtruth" in caught.value.remedy
    assert caught.value.settings == ("poses",)


def test_a_file_that_is_not_text(tmp_path: Path) -> None:
    (tmp_path / "poses.txt").write_bytes(bytes(range(256)))
    with pytest.raises(BagError, match="binary"):
        read_poses(tmp_path / "poses.txt")
    with pytest.raises(BagError, match="does not exist"):
        read_poses(tmp_path / "none.txt")
