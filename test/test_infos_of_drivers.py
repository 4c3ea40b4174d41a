# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera infos as drivers write them give the same answer in every command, or one error with a remedy that helps."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from doctor_setups import Change, both, entries, put, with_infos

from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.cli.rig import _Survey
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.errors import CalibrationError, StereoDepthError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import Frame, StereoPair
from stereo_depth_ros.datasets.rig_files import read_rig
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.diagnosis.doctor import diagnose
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.diagnosis.root_causes import settled
from stereo_depth_ros.diagnosis.survey import CameraRecord, StereoSetup
from stereo_depth_ros.geometry.depth_range import Precision, default_nearest_m, recommended_search
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message

TYPES = RosbagsTypes()
F, BASELINE_M, SIZE = 430.0, 0.12, (64, 48)
RIG = StereoRig.from_rectified(F, F, 32.5, 31.5, 24.0, BASELINE_M, SIZE, "left_frame")
INFOS = tuple(camera_info_message(TYPES, camera, 0) for camera in (RIG.left, RIG.right))
PIXELS = [np.random.default_rng(seed).integers(0, 255, SIZE[::-1], np.uint8) for seed in (2, 3)]
RECORDS = [
    CameraRecord(f"/{side}/image_raw", f"/{side}/camera_info", [10**9, 2 * 10**9, 3 * 10**9], [info])
    for side, info in zip(("left", "right"), INFOS, strict=True)
]
BARE = StereoSetup("test", *RECORDS)
PAIR = StereoPair(*(Frame(pixels, 10**9, "") for pixels in PIXELS))


def only_P(info: Any) -> Any:  # noqa: N802
    return replace(info, distortion_model="", d=np.zeros(0), k=np.zeros(9), r=np.zeros(9))


def uncalibrated(width: int, height: int) -> Change:
    zeros = both(*(entries(name, np.zeros_like) for name in "krpd"))
    return lambda info: replace(zeros(info), width=width, height=height, distortion_model="plumb_bob")


def write_bag(path: Path, change: Callable[[Any], Any], image: str = "image_raw") -> Path:
    """Two pairs of noise."""
    with BagWriter(path) as bag:
        for stamp_ns in (10**9, 2 * 10**9):
            for side, info, pixels in zip(("left", "right"), INFOS, PIXELS, strict=True):
                bag.write(f"/{side}/camera_info", change(info), stamp_ns)
                message = image_message(TYPES, pixels, "mono8", stamp_ns, info.header.frame_id)
                bag.write(f"/{side}/{image}", message, stamp_ns)
    return path


def errors_of(diagnosis: Any) -> list[str]:
    return [finding.check for finding in diagnosis.findings if finding.level is Level.ERROR]


@pytest.mark.parametrize("image", ["image_raw", "image_rect"])
def test_infos_with_only_p_are_of_rectified_images_for_every_command(tmp_path: Path, image: str) -> None:
    path = write_bag(tmp_path / "bag.mcap", only_P, image)
    info = inspect_bag(path)
    assert info.usable and info.rig is not None
    with BagPairs(BagSelection(path), PairingConfig()) as pairs:
        processed = next(iter(pairs.pairs())).rig(TYPES)
    live = StereoRig.from_infos(*map(only_P, INFOS))
    for rig in (info.rig, processed, live, read_rig([path])):
        np.testing.assert_array_equal(rig.left.K, RIG.left.P[:, :3])
        np.testing.assert_array_equal(rig.left.R, np.identity(3))
        assert rig.baseline_m == pytest.approx(BASELINE_M)
    checks = errors_of(diagnose(survey_bag(BagSelection(path))))
    assert not [check for check in checks if check.split()[-1] in ("K", "R", "P", "distortion", "size")]


def test_only_p_counts_where_the_images_are_rectified(tmp_path: Path) -> None:
    def unknown_lens(info: Any) -> Any:
        return replace(info, distortion_model="ftheta", d=np.ones(5), k=np.full(9, np.nan))

    path = write_bag(tmp_path / "bag.mcap", unknown_lens, "image_rect")
    assert inspect_bag(path).usable and read_rig([path]).baseline_m == pytest.approx(BASELINE_M)
    checks = errors_of(diagnose(survey_bag(BagSelection(path))))
    assert not [check for check in checks if check.split()[-1] in ("K", "R", "P", "distortion", "size")]
    assert StereoRig.from_infos(*map(unknown_lens, INFOS), rectified=True).baseline_m == pytest.approx(BASELINE_M)
    with pytest.raises(CalibrationError):
        StereoRig.from_infos(*map(unknown_lens, INFOS))


@pytest.mark.parametrize("size", [(0, 0), SIZE])
@pytest.mark.parametrize("image", ["image_raw", "image_rect"])
def test_an_uncalibrated_camera_is_named_with_its_topic_by_every_command(
    tmp_path: Path, size: tuple[int, int], image: str
) -> None:
    path = write_bag(tmp_path / "bag.mcap", uncalibrated(*size), image)
    says = re.compile(r"/left/camera_info\)?: not calibrated, the size is .*: calibrate both cameras together")
    assert says.search(str(inspect_bag(path).problems[0]))
    with pytest.raises(CalibrationError, match=says):
        read_rig([path])
    with BagPairs(BagSelection(path), PairingConfig()) as pairs, pytest.raises(CalibrationError, match=says):
        next(iter(pairs.pairs())).rig(TYPES)
    diagnosis = diagnose(survey_bag(BagSelection(path)))
    assert {"left calibration", "right calibration"} <= set(errors_of(diagnosis))
    found = {finding.check: finding for finding in diagnosis.findings}
    assert says.search(f"{found['left calibration'].value}: {found['left calibration'].remedy}")
    assert not {"left K", "left center", "left field of view", "left image size", "baseline"} & found.keys()
    assert "calibrate both cameras together" in diagnosis.verdict


def test_a_small_vertical_baseline_is_taken_and_a_large_one_has_value_limit_and_remedy() -> None:
    left, right = INFOS
    third_of_a_millimeter = put("p", 7, F * 0.33e-3)(right)
    StereoRig.from_infos(left, third_of_a_millimeter)
    assert "right P[1,3]" not in errors_of(diagnose(with_infos(BARE, right=put("p", 7, F * 0.33e-3))))
    for ratio, taken in ((0.0099, True), (0.0101, False), (-0.0099, True), (-0.0101, False)):
        slanted = put("p", 7, ratio * F * BASELINE_M)
        diagnosis = diagnose(with_infos(BARE, right=slanted))
        assert ("right P[1,3]" not in errors_of(diagnosis)) == taken
        if taken:
            StereoRig.from_infos(left, slanted(right))
        else:
            says = r"limit 0\.516: 0\.01 of P\[0,3\], 1 px between the rows at a disparity of 100 px: calibrate"
            with pytest.raises(CalibrationError, match=says):
                StereoRig.from_infos(left, slanted(right))


@pytest.mark.parametrize(
    ("left", "right"),
    [(-1.0, -1.0), (1.0, 1.0), (-0.5, -1.5), (1.0, 0.0), (0.4, -0.6)],
)
def test_the_remedy_of_a_left_camera_that_is_not_the_reference_makes_a_rig(left: float, right: float) -> None:
    """Equal P as simulators write them, and P of a third camera as reference; factors of the baseline term."""
    term = F * BASELINE_M
    changes = put("p", 3, left * term), put("p", 3, right * term)
    with pytest.raises(CalibrationError) as caught:
        StereoRig.from_infos(changes[0](INFOS[0]), changes[1](INFOS[1]))
    found = {f.check: f for f in diagnose(with_infos(BARE, *changes)).findings}["left P[:, 3]"]
    assert found.remedy == caught.value.remedy
    assert "set P[0,3] of the left camera to 0" in found.remedy
    number = re.search(r"(?:right camera|of the right one) to (-[\d.]+)$", found.remedy)
    followed = put("p", 3, float(number[1]))(INFOS[1]) if number else changes[1](INFOS[1])
    assert StereoRig.from_infos(INFOS[0], followed).baseline_m == pytest.approx(BASELINE_M, rel=1e-4)


def test_images_in_order_do_not_replace_the_remedy_of_equal_p() -> None:
    equal = diagnose(with_infos(BARE, left=put("p", 3, -F * BASELINE_M))).findings
    for order in (Level.OK, Level.ERROR):
        findings = settled([*equal, Finding("order of the cameras", order, "", "", "exchange the image topics")])
        remedy = next(f.remedy for f in findings if f.check == "left P[:, 3]")
        assert "set P[0,3] of the left camera to 0" in remedy
    swapped = diagnose(with_infos(BARE, left=put("p", 3, -F * BASELINE_M), right=put("p", 3, 0.0))).findings
    findings = settled([*swapped, Finding("order of the cameras", Level.OK, "", "")])
    assert "exchange the camera infos" in next(f.remedy for f in findings if f.check == "left P[:, 3]")


def test_arrays_of_other_lengths_are_an_error_with_the_topic() -> None:
    plain = SimpleNamespace(**{name: getattr(INFOS[1], name) for name in INFOS[1].__dataclass_fields__})
    plain.k = plain.k[:8]
    with pytest.raises(CalibrationError, match=r"^/right/camera_info: K has 8 values, it takes 3 x 3"):
        StereoRig.from_infos(INFOS[0], plain, ("/left/camera_info", "/right/camera_info"))


def test_binning_above_the_size_is_an_error() -> None:
    with pytest.raises(CalibrationError, match=r"^left: binning 100x1 is above the size 64x48: set the binning"):
        StereoRig.from_infos(replace(INFOS[0], binning_x=100), INFOS[1])


def spoiled(info: Any, random: np.random.Generator) -> Any:
    """The camera info with a few random faults."""
    values = {name: np.array(getattr(info, name)) for name in "krpd"}
    values["d"] = random.choice([0.0, 0.1, np.nan], random.integers(0, 15), p=[0.7, 0.28, 0.02])
    for name in random.choice(list("krp"), random.integers(0, 3), replace=False):
        at = slice(None) if random.random() < 0.5 else random.integers(values[name].size)
        values[name][at] = random.choice([0.0, np.nan, np.inf, -np.inf, -1.0, 1e-300, 1e300])
        if random.random() < 0.1:
            values[name] = values[name][: random.integers(values[name].size)]
    models = ["plumb_bob", "plumb_bob", "rational_polynomial", "equidistant", "", "none", "fisheye", "fov"]
    roi = replace(info.roi, width=int(random.choice([0, 0, 0, 32, 99])), height=int(random.choice([0, 0, 0, 32])))
    width, height = random.choice([0, *[SIZE[0]] * 6]), random.choice([0, *[SIZE[1]] * 6])
    model, binning = random.choice(models), random.choice([0, 0, 1, 2, 70])
    other = {"width": int(width), "height": int(height), "distortion_model": str(model), "binning_x": int(binning)}
    return SimpleNamespace(header=info.header, binning_y=0, roi=roi, **values, **other)


def test_spoiled_infos_give_a_rig_or_an_error_of_the_package() -> None:
    random = np.random.default_rng(7)
    rigs = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a warning of numpy is a number computed from what was refused
        for trial in range(160):
            infos = [spoiled(info, random) if random.random() < 0.5 else info for info in INFOS]
            setup = replace(
                BARE,
                left=replace(BARE.left, infos=[infos[0]]),
                right=replace(BARE.right, infos=[infos[1]]),
                pairs=[] if trial % 4 else [PAIR],
                rectified=bool(trial % 2),
            )
            diagnosis = diagnose(setup)
            try:
                rig = StereoRig.from_infos(*infos, rectified=setup.rectified)
            except StereoDepthError as error:
                assert error.remedy
                assert diagnosis.level is Level.ERROR, error
                continue
            rigs += 1
            # center, image size, rectified image: a rig, but not of these images
            assert not {check.split()[-1] for check in errors_of(diagnosis)} - {"center", "size", "image"}
            assert np.isfinite(rig.Q).all() and 1e-3 <= rig.baseline_m <= 10
            search = recommended_search(rig, default_nearest_m(rig))
            values = _Survey(rig, search, Precision(1 / 16, 0.25, 0.05)).to_json()
            assert all(limits["nearest_m"] > 0 for limits in values["limits"])
    assert rigs > 40
