# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rigs of calibration files, folders and bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stereo_bags import sequence, write_odd_bag, write_truth_bag

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.datasets.rig_files import read_rig
from stereo_depth_ros.messages.image import image_message

RIG = sequence(1).rig


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_camera(tmp_path / "left.yaml", RIG.left, "left")
    write_camera(tmp_path / "right.yaml", RIG.right, "right")
    return tmp_path


@pytest.mark.parametrize("names", [["left.yaml", "right.yaml"], ["left.yaml"], ["right.yaml"], ["."]])
def test_files(folder: Path, names: list[str]) -> None:
    rig = read_rig([folder / name for name in names])
    np.testing.assert_array_equal(rig.left.P, RIG.left.P)
    np.testing.assert_array_equal(rig.right.K, RIG.right.K)


@pytest.mark.parametrize("odd", [True, False])
def test_bags(tmp_path: Path, odd: bool) -> None:
    (write_odd_bag if odd else write_truth_bag)(tmp_path / "b.mcap", 1)
    rig = read_rig([tmp_path / "b.mcap"])
    np.testing.assert_array_equal(rig.right.P, RIG.right.P)
    np.testing.assert_array_equal(rig.left.D, RIG.left.D)


def test_a_bag_without_camera_infos(tmp_path: Path) -> None:
    types, frame = RosbagsTypes(), next(iter(sequence(1)))
    with BagWriter(tmp_path / "b.mcap") as bag:
        for side, image in (("left", frame.pair.left), ("right", frame.pair.right)):
            message = image_message(types, image.pixels, "mono8", image.stamp_ns, image.frame_id)
            bag.write(f"/{side}/image_raw", message, image.stamp_ns)
    with pytest.raises(BagError, match="no CameraInfo belongs to /left/image_raw: record the camera infos"):
        read_rig([tmp_path / "b.mcap"])


def test_paths_without_a_rig(folder: Path) -> None:
    with pytest.raises(CalibrationError, match="3 paths, not 1 or 2: give the files of the left"):
        read_rig([folder] * 3)
    with pytest.raises(CalibrationError, match=r"none\.yaml: does not exist"):
        read_rig([folder / "none.yaml"])
    (folder / "right.yaml").unlink()
    with pytest.raises(
        CalibrationError, match=r"left\.yaml: .* YAML, one camera, and there is no right\.yaml in its folder"
    ):
        read_rig([folder / "left.yaml"])
    write_camera(folder / "head.yaml", RIG.left, "head")
    with pytest.raises(
        CalibrationError, match=r"head\.yaml: .* YAML, one camera, and its name has neither left nor right"
    ):
        read_rig([folder / "head.yaml"])
