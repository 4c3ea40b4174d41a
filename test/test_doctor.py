# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Each fault of a stereo setup is found, named, and has its remedy; a healthy setup has none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from doctor_setups import Change, all_of, as_is, both, entries, faults, put, scaled, times, with_infos

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.diagnosis.doctor import diagnose
from stereo_depth_ros.diagnosis.finding import Level
from stereo_depth_ros.diagnosis.survey import StereoSetup
from stereo_depth_ros.stages.rectification import Rectifier

SAMPLE = Path(__file__).resolve().parents[1] / "bags" / "synthetic_room.mcap"


@pytest.fixture(scope="module")
def room() -> StereoSetup:
    """The sample bag, one pair of it."""
    found = survey_bag(BagSelection(SAMPLE))
    return replace(found, pairs=found.pairs[:1])


@pytest.fixture(scope="module")
def bare(room: StereoSetup) -> StereoSetup:
    """The sample bag without images."""
    return replace(room, pairs=())


def fisheye_with_K_R(info: Any) -> Any:  # noqa: N802
    P = np.column_stack([np.reshape(info.k, (3, 3)) @ np.reshape(info.r, (3, 3)), np.zeros(3)])
    return replace(info, distortion_model="equidistant", d=np.array([0.1, 0.01, 0.0, 0.0]), p=P.ravel())


# left change, right change, the check that finds it, part of the value, part of the remedy
CALIBRATION_FAULTS = {
    "K not set": (entries("k", np.zeros_like), as_is, "left K", "all zero", "calibrate the camera"),
    "R not set": (as_is, entries("r", np.zeros_like), "right R", "all zero", "calibrate the camera"),
    "P not set": (as_is, entries("p", np.zeros_like), "right P", "all zero", "calibrate the camera"),
    "R no rotation": (entries("r", lambda r: 1.1 * r), as_is, "left R", "not a rotation", "calibrate, or set the id"),
    "NaN in D": (put("d", 1, np.nan), as_is, "left distortion", "not finite", "calibrate again"),
    "NaN in P": (as_is, put("p", 2, np.nan), "right P", "not finite", "calibrate again"),
    "unknown model": (
        lambda info: replace(info, distortion_model="fov"),
        as_is,
        "left distortion",
        "'fov' is not one of plumb_bob",
        "calibrate with one of them",
    ),
    "coefficients": (as_is, entries("d", lambda d: d[:3]), "right distortion", "D has 3 coefficients", "set as many"),
    "no size": (lambda info: replace(info, width=0), as_is, "left size", "0x480 is empty", "set width and height"),
    "sizes": (as_is, lambda info: replace(info, height=482), "sizes", "640x480, right camera is 640x482", "same size"),
    "fx": (as_is, times("p", 0, 1.02), "fx of P", "430 px in left camera and 438.6", "calibrate both cameras together"),
    "fy": (times("p", 5, 1.02), as_is, "fy of P", "425.442 px in left camera", "calibrate both cameras together"),
    "cy": (as_is, times("p", 6, 1.02), "cy of P", "243.27 px in right camera", "calibrate both cameras together"),
    "vertical": (as_is, put("p", 7, 41.7), "right P[1,3]", "vertical baseline of 0.0999", "rotate the images"),
    "sign": (as_is, times("p", 3, -1), "right P[0,3]", "51.6233 is positive", "the sign is wrong"),
    "no baseline": (as_is, put("p", 3, 0.0), "right P[0,3]", "is not a baseline", "calibrate both cameras together"),
    "millimeters": (
        as_is,
        times("p", 3, 1000),
        "baseline",
        "120.054 m is outside",
        "right camera by 0.001",
    ),
    "centimeters": (
        as_is,
        times("p", 3, 100),
        "baseline",
        "12.0054 m is outside",
        "by 0.01, the baseline is then",
    ),
    "not times fx": (as_is, put("p", 3, -0.12), "baseline", "0.00027907 m is outside", "multiply it by fx = 430"),
    "skew in P": (
        entries("p", lambda p: np.array([430.0, 3.0, 320.0, 0.0, -2.0, 430.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0])),
        as_is,
        "left P",
        "is not of the form",
        "write it row by row",
    ),
    "P is K R": (as_is, fisheye_with_K_R, "right P", "P is K R", "calibrate again with the lens model equidistant"),
    "swapped infos": (put("p", 3, -51.6), put("p", 3, 0.0), "left P[:, 3]", "the reference", "probably swapped"),
}


@pytest.mark.parametrize("name", CALIBRATION_FAULTS)
def test_a_fault_of_the_camera_infos(bare: StereoSetup, name: str) -> None:
    left, right, check, value, remedy = CALIBRATION_FAULTS[name]
    faulty = with_infos(bare, left, right)
    diagnosis = diagnose(faulty)
    found = faults(diagnosis)
    allowed = {check, "right P[0,3]"} if name == "swapped infos" else {check}
    assert found.keys() == allowed
    assert found[check].level is Level.ERROR
    assert value in found[check].value
    assert remedy in found[check].remedy
    assert check in diagnosis.verdict and diagnosis.verdict.startswith("not usable; ")
    with pytest.raises(CalibrationError):  # the nodes refuse it too
        StereoRig.from_infos(faulty.left.infos[0], faulty.right.infos[0])


def test_the_nodes_accept_what_the_doctor_accepts(bare: StereoSetup) -> None:
    StereoRig.from_infos(bare.left.infos[0], bare.right.infos[0])
    assert not faults(diagnose(bare))


def test_no_fault_hides_another(bare: StereoSetup) -> None:
    left = both(entries("k", np.zeros_like), put("d", 0, np.nan), entries("p", np.zeros_like))  # 0 is not K R
    found = faults(diagnose(with_infos(bare, left, put("r", 0, np.nan))))
    assert found.keys() == {"left K", "left distortion", "left P", "right R"}
    right = both(times("p", 3, -1000), times("p", 5, 1.1), times("p", 6, 1.1))
    found = faults(diagnose(with_infos(bare, as_is, right)))
    assert found.keys() == {"fy of P", "cy of P", "right P[0,3]", "baseline"}


def test_a_region_outside_the_sensor(bare: StereoSetup) -> None:
    def cropped(info: Any) -> Any:
        return replace(info, roi=replace(info.roi, x_offset=600, width=100, height=100))

    found = faults(diagnose(with_infos(bare, cropped)))
    assert "roi 100x100 at (600, 0) is not inside" in found["left roi"].value


def test_a_baseline_that_is_allowed_and_unlikely_is_a_warning(bare: StereoSetup) -> None:
    found = faults(diagnose(with_infos(bare, as_is, times("p", 3, 50))))
    assert found.keys() == {"baseline"} and found["baseline"].level is Level.WARNING
    assert "centimeters" in found["baseline"].remedy


def test_cameras_without_a_calibration(bare: StereoSetup) -> None:
    none = both(*(entries(name, np.zeros_like) for name in "krp"))
    found = faults(diagnose(with_infos(bare, none, none)))
    assert found.keys() == {f"{side} {name}" for side in ("left", "right") for name in "KRP"}
    assert {finding.remedy for finding in found.values()} == {"calibrate the camera, or fill it in"}


def test_a_missing_camera_info(bare: StereoSetup) -> None:
    missing = replace(bare, left=replace(bare.left, infos=()), right=replace(bare.right, infos=(), info_topic=None))
    found = faults(diagnose(missing))
    assert found["left camera info"].value == "nothing on /left/camera_info"
    assert found["right camera info"].value == "none belongs to /right/image_raw"


def test_two_different_camera_infos(bare: StereoSetup) -> None:
    infos = [bare.left.infos[0], times("k", 0, 1.01)(bare.left.infos[0])]
    found = faults(diagnose(replace(bare, left=replace(bare.left, infos=infos))))
    assert found.keys() == {"left camera info"}
    assert found["left camera info"].value == "2 different ones"


def test_frame_ids_of_the_other_camera(bare: StereoSetup) -> None:
    def named(frame_id: str) -> Change:
        return lambda info: replace(info, header=replace(info.header, frame_id=frame_id))

    found = faults(diagnose(with_infos(bare, named("cam_right"), named("cam_left"))))
    assert found.keys() == {"frame names"}


@pytest.mark.parametrize(("factor", "size"), [(2.0, "1280x960"), (0.5, "320x240"), (1.5, "960x720")])
def test_a_calibration_of_another_resolution_names_it(bare: StereoSetup, factor: float, size: str) -> None:
    found = faults(diagnose(with_infos(bare, scaled(factor), scaled(factor))))
    assert found.keys() == {"left center", "right center"}
    assert found["left center"].level is Level.ERROR
    assert f"an image of about {size}: calibrate at 640x480" in found["left center"].remedy
    assert f"by {1 / factor:.4g}" in found["left center"].remedy


def test_a_center_off_in_one_axis_is_a_warning(bare: StereoSetup) -> None:
    found = faults(diagnose(with_infos(bare, put("k", 2, 80.0))))
    assert found.keys() == {"left center"} and found["left center"].level is Level.WARNING


def test_focal_lengths_that_no_lens_has(bare: StereoSetup) -> None:
    found = faults(diagnose(with_infos(bare, times("k", 0, 0.1), times("k", 4, 2))))
    assert found.keys() == {"left field of view", "right field of view"}
    assert "165.2 deg" in found["left field of view"].value
    assert "scaled differently" in found["right field of view"].remedy


def test_the_sample_bag_is_healthy(room: StereoSetup) -> None:
    progress: list[tuple[int, int]] = []
    diagnosis = diagnose(room, lambda done, total: progress.append((done, total)))
    assert progress == [(0, 1), (1, 1)]
    assert diagnosis.level is Level.OK and not diagnosis.skipped
    found = all_of(diagnosis)
    assert found["rows before rectification"].figures["median_px"] > 2
    assert found["rows"].figures["median_px"] < 0.1
    assert found["order of the cameras"].figures["share_behind"] < 0.05
    # Truth of the first frame: disparities 16.4 to 38.6 px (1.77 to 7.5 m), infinity at 9.5 px.
    assert diagnosis.search == {"min_disparity": 0, "disparity_range": 48}
    assert found["depths of the features"].figures["near_m"] == pytest.approx(1.9, rel=0.15)
    assert diagnosis.verdict.startswith("healthy; baseline 0.1201 m, rows agree to 0.0")


def test_wrong_width_and_height_where_K_is_right(room: StereoSetup) -> None:  # noqa: N802
    def doubled(info: Any) -> Any:
        return replace(info, width=1280, height=960)

    diagnosis = diagnose(with_infos(room, doubled, doubled))
    found = faults(diagnosis)
    assert found.keys() == {"left image size", "right image size"}
    assert "set width and height of the camera info to that" in found["left image size"].remedy
    assert all_of(diagnosis)["rows"].level is Level.SKIPPED


def test_images_of_half_the_calibrated_size(room: StereoSetup) -> None:
    def doubled(info: Any) -> Any:
        return replace(scaled(2.0)(info), width=1280, height=960)

    found = faults(diagnose(with_infos(room, doubled, doubled)))
    assert found.keys() == {"left image size", "right image size"}
    assert "0.5 times the size that was calibrated" in found["left image size"].remedy
    assert "set binning to 2" in found["left image size"].remedy


def binned(info: Any) -> Any:
    return replace(info, binning_x=2, binning_y=2)


def cropped(info: Any) -> Any:
    return replace(info, roi=replace(info.roi, x_offset=150, y_offset=100, width=320, height=240))


@pytest.mark.parametrize("change", [binned, cropped])
def test_images_of_the_whole_sensor(room: StereoSetup, change: Change) -> None:
    found = faults(diagnose(with_infos(room, change, change)))
    assert found.keys() == {"left image size", "right image size"}
    assert "whole sensor: set binning and roi of the camera info to 0" in found["left image size"].remedy
    one_side = faults(diagnose(with_infos(room, as_is, change)))
    assert one_side.keys() == {"sizes", "right image size"}
    assert one_side["sizes"].remedy == one_side["right image size"].remedy


@pytest.mark.parametrize(
    ("width", "height", "remedy"),
    [
        (320, 240, "0.5 times the size that was calibrated: set binning to 2, or roi where they are a crop"),
        (384, 288, "0.6 times the size that was calibrated: scale K and P by that"),
        (400, 150, "a crop of what was calibrated: set the roi"),
    ],
)
def test_images_of_another_size(room: StereoSetup, width: int, height: int, remedy: str) -> None:
    pair = room.pairs[0]
    frames = [replace(frame, pixels=cv2.resize(frame.pixels, (width, height))) for frame in (pair.left, pair.right)]
    found = faults(diagnose(replace(room, pairs=[StereoPair(*frames)])))
    assert found.keys() == {"left image size", "right image size"}
    assert remedy in found["right image size"].remedy


def test_one_camera_info_for_both_cameras(room: StereoSetup) -> None:
    found = faults(diagnose(replace(room, right=replace(room.right, infos=room.left.infos))))
    assert "both camera infos are equal" in found["right P[0,3]"].remedy
    assert found.keys() - {"right frame_id"} == {"right P[0,3]", "rows"}


def test_rows_after_a_calibration_of_another_resolution(room: StereoSetup) -> None:
    found = faults(diagnose(with_infos(room, scaled(2.0), scaled(2.0))))
    assert found.keys() == {"left center", "right center", "rows"}
    assert found["rows"].remedy == found["left center"].remedy, "the cameras are not out of line"


@pytest.mark.parametrize("sides", ["images", "infos", "both"])
def test_swapped_cameras_are_found_by_the_images(room: StereoSetup, sides: str) -> None:
    swapped = room
    if sides in ("infos", "both"):
        left, right = replace(room.left, infos=room.right.infos), replace(room.right, infos=room.left.infos)
        swapped = replace(swapped, left=left, right=right)
    if sides in ("images", "both"):
        swapped = replace(swapped, pairs=[StereoPair(pair.right, pair.left) for pair in room.pairs])
    diagnosis = diagnose(swapped)
    order = all_of(diagnosis)["order of the cameras"]
    remedies = {"images": "the image topics of left and right", "infos": "the camera infos of left and right"}
    remedies["both"] = "the image topics of left and right and those of the infos"
    assert order.level is Level.ERROR
    assert order.remedy == f"exchange {remedies[sides]}"
    assert order.remedy in diagnosis.verdict, "the root cause comes first"
    errors = [finding for finding in diagnosis.findings if finding.level is Level.ERROR]
    assert {finding.remedy for finding in errors} == {order.remedy}, "one remedy for all checks that show the fault"
    assert all_of(diagnosis)["rows"].level is Level.SKIPPED


def test_the_images_distinguish_a_wrong_sign_from_swapped_cameras(room: StereoSetup) -> None:
    found = faults(diagnose(with_infos(room, as_is, times("p", 3, -1))))
    assert found.keys() == {"right P[0,3]"}
    assert found["right P[0,3]"].remedy == "the images are in order: change the sign of P[0,3]"


def test_millimeters_do_not_hide_the_rows(room: StereoSetup) -> None:
    found = all_of(diagnose(with_infos(room, as_is, times("p", 3, 1000))))
    assert found["rows"].level is Level.OK
    assert found["disparities"].level is Level.OK
    assert "depths of the features" not in found


def test_the_calibration_of_other_cameras(room: StereoSetup) -> None:
    """Rectified images that are rectified again: the rows agreed before."""
    rig = StereoRig.from_infos(room.left.infos[0], room.right.infos[0])
    rectified = Rectifier(rig).rectify(room.pairs[0])
    pair = room.pairs[0]
    frames = replace(pair.left, pixels=rectified.left), replace(pair.right, pixels=rectified.right)
    again = replace(room, pairs=[StereoPair(*frames)])
    found = faults(diagnose(again))
    assert found["rows"].level is Level.ERROR
    assert "the images are rectified already" in found["rows"].remedy
    named_so = all_of(diagnose(replace(again, rectified=True)))
    assert named_so["rows"].level is Level.OK
    assert "rows before rectification" not in named_so
    no_infos = replace(again, left=replace(room.left, infos=()), right=replace(room.right, infos=()))
    assert "may be rectified already" in all_of(diagnose(no_infos))["rows"].remedy


def test_rows_of_black_images_are_skipped(room: StereoSetup) -> None:
    pair = room.pairs[0]
    black = StereoPair(pair.left, replace(pair.right, pixels=np.zeros_like(pair.right.pixels)))
    diagnosis = diagnose(replace(room, pairs=[black]))
    assert faults(diagnosis).keys() == {"right image"}
    assert all_of(diagnosis)["rows"].level is Level.SKIPPED
    assert diagnosis.skipped


def test_one_camera_on_both_topics(room: StereoSetup) -> None:
    left = room.pairs[0].left
    diagnosis = diagnose(replace(room, pairs=[StereoPair(left, left)]))
    assert "both topics show one camera" in diagnosis.verdict


def test_the_image_of_the_wrong_frame(room: StereoSetup) -> None:
    pair = room.pairs[0]
    right = replace(pair.right, frame_id=pair.left.frame_id)
    unnamed = replace(pair.left, frame_id="")
    found = faults(diagnose(replace(room, pairs=[StereoPair(unnamed, right)])))
    assert found.keys() == {"left frame_id", "right frame_id"}
    assert found["left frame_id"].level is Level.WARNING
    assert found["right frame_id"].remedy == "the images are in order: exchange the frame_ids"
