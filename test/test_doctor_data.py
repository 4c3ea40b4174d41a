# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor on real recordings: healthy as they are, and each fault that is put in is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from doctor_setups import all_of, as_is, faults, times, with_infos

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.diagnosis.checks.disparities import check_camera_order
from stereo_depth_ros.diagnosis.checks.rows import check_raw_rows, check_rows, match_image_pairs
from stereo_depth_ros.diagnosis.doctor import diagnose
from stereo_depth_ros.diagnosis.finding import Level
from stereo_depth_ros.diagnosis.survey import CameraRecord, StereoSetup
from stereo_depth_ros.messages.camera_info import camera_info_message


def of_dataset(dataset: EurocDataset | KittiDataset, pairs: int) -> StereoSetup:
    types = RosbagsTypes()
    frames = list(dataset)
    chosen = [StereoPair(frame.left, frame.right) for frame in frames[:: len(frames) // pairs]]
    records = [
        CameraRecord(f"/{side}/image_raw", f"/{side}/camera_info", stamps_, [camera_info_message(types, camera, 0)])
        for side, camera, stamps_ in (
            ("left", dataset.rig.left, [frame.left.stamp_ns for frame in frames]),
            ("right", dataset.rig.right, [frame.right.stamp_ns for frame in frames]),
        )
    ]
    return StereoSetup("dataset", records[0], records[1], chosen)


@pytest.fixture(scope="module")
def euroc(stereo_data: Path) -> StereoSetup:
    return of_dataset(EurocDataset(stereo_data / "euroc" / "V1_01_micro"), 1)


@pytest.mark.real_data
def test_euroc_is_healthy(euroc: StereoSetup) -> None:
    diagnosis = diagnose(euroc)
    assert diagnosis.level is Level.OK, diagnosis.verdict
    found = all_of(diagnosis)
    assert found["rows before rectification"].figures["median_px"] == pytest.approx(12.8, abs=0.5)
    assert found["rows"].figures["median_px"] <= 0.15
    assert found["rates"].figures["left_hz"] == pytest.approx(20.0, rel=1e-4)


@pytest.mark.real_data
def test_kitti_is_healthy(stereo_data: Path) -> None:
    diagnosis = diagnose(of_dataset(KittiDataset(stereo_data / "kitti_odometry" / "seqA_1226x370"), 1))
    assert diagnosis.level is Level.OK, diagnosis.verdict
    assert all_of(diagnosis)["baseline"].figures["baseline_m"] == pytest.approx(0.5372, abs=1e-4)


@pytest.mark.real_data
def test_euroc_with_swapped_cameras(euroc: StereoSetup) -> None:
    diagnosis = diagnose(replace(euroc, pairs=[StereoPair(pair.right, pair.left) for pair in euroc.pairs]))
    assert diagnosis.verdict == "not usable; order of the cameras: exchange the image topics of left and right"


@pytest.mark.real_data
def test_euroc_in_millimetres(euroc: StereoSetup) -> None:
    diagnosis = diagnose(with_infos(euroc, as_is, times("p", 3, 1000)))
    assert faults(diagnosis).keys() == {"baseline"}
    assert "multiply P[0,3] of the right camera by 0.001, the baseline is then 0.1101 m" in diagnosis.verdict


@pytest.mark.real_data
def test_euroc_rolled_by_half_a_degree(euroc: StereoSetup) -> None:
    def rolled(pair: StereoPair) -> StereoPair:
        turn = cv2.getRotationMatrix2D((376, 240), 0.5, 1.0)
        pixels = cv2.warpAffine(pair.right.pixels, turn, (752, 480), flags=cv2.INTER_CUBIC)
        return StereoPair(pair.left, replace(pair.right, pixels=pixels))

    found = faults(diagnose(replace(euroc, pairs=[rolled(pair) for pair in euroc.pairs])))
    assert found["rows"].level is Level.ERROR
    assert "the cameras are rolled" in found["rows"].remedy
    across_px = 752 * np.tan(np.radians(0.5))
    assert found["rows"].figures["across_px"] == pytest.approx(across_px, rel=0.05)


@pytest.mark.real_data
def test_infinity_far_below_disparity_0(stereo_data: Path) -> None:
    """Cropped images: exchanged, all points would have a depth too, and no order is refused."""
    folder = stereo_data / "middlebury2005" / "Art"
    left, right = (cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_GRAYSCALE) for name in ("view1", "view5"))
    doffs_px = -200 / 3
    rig = StereoRig.from_rectified(1246.7, 1246.7, 230 + doffs_px, 230, 185, 0.16, left.shape[::-1])
    given = [(left, right)]
    order = check_camera_order(given, match_image_pairs(given), lambda: [(right, left)], rig.doffs_px, True)
    assert order.level is Level.OK, order.value


@pytest.mark.real_data
def test_few_features_are_enough_where_they_fit(stereo_data: Path) -> None:
    """43 features before rectification, more than 50 in their own row after it."""
    folder = stereo_data / "middlebury2006" / "Plastic"
    left, right = (cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_GRAYSCALE) for name in ("view1", "view5"))
    assert check_raw_rows([(left, right)]) is None
    height, width = left.shape
    assert check_rows(match_image_pairs([(left, right)]), None, width, height, 1246.7).level is Level.OK
