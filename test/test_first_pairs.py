# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first pairs of a rig: plausible wrong calibrations are found, right ones and scenes without texture are not."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from stereo_bags import PARAMETERS

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, CameraOrderError, ImageError, StereoDepthError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, U8, Frame, MatchResult, StereoPair
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.diagnosis import first_pairs
from stereo_depth_ros.diagnosis.first_pairs import LOOKS, FirstPairs
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

SIZE = WIDTH, HEIGHT = 320, 240
CONFIG = pipeline_config(PARAMETERS)
ROWS = r"^rows of left and right differ by \d+\.\d px \(limit 1 px\), 25 % of the pixels have a disparity: the images"


@pytest.fixture(scope="module")
def made() -> SyntheticSequence:
    return SyntheticSequence(3, *SIZE)


@pytest.fixture(scope="module")
def raw(made: SyntheticSequence) -> list[StereoPair]:
    return [frame.pair for frame in made]


def a_quarter_valid(shape: tuple[int, ...]) -> MatchResult:
    reasons = np.ones(shape, np.uint8)
    reasons[: shape[0] // 2, : shape[1] // 2] = 0
    return MatchResult(np.where(reasons == 0, np.float32(5), np.float32(np.nan)), reasons, 1.0)


def look(first: FirstPairs, left: U8, right: U8, pair: StereoPair | None = None) -> StereoDepthError | None:
    pair = pair or StereoPair(Frame(left, 0, "left"), Frame(right, 0, "right"))
    return first.look(pair, left, right, a_quarter_valid(left.shape))


def faults(rig: StereoRig, pairs: Iterable[StereoPair]) -> Iterator[StereoDepthError | None]:
    """What the pairs show, rectified for the rig."""
    rectifier = Rectifier(rig)
    first = FirstPairs(rig, rectifier.shown)
    for pair in pairs:
        rectified = rectifier.rectify(pair)
        yield look(first, rectified.left, rectified.right, pair)


def first_fault(rig: StereoRig, pairs: Iterable[StereoPair]) -> StereoDepthError:
    return next(fault for fault in faults(rig, pairs) if fault is not None)


def turned(rig: StereoRig, *degrees: float) -> StereoRig:
    """The rig whose right camera was turned about x, y and z after its calibration."""
    R: F64 = cv2.Rodrigues(np.radians(degrees))[0]
    return StereoRig(rig.left, replace(rig.right, R=rig.right.R @ R))


def test_right_calibration_has_no_fault_and_costs_nothing_after_two_pairs(
    made: SyntheticSequence, raw: list[StereoPair], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []
    match_rows = first_pairs.match_rows
    monkeypatch.setattr(first_pairs, "match_rows", lambda *a: calls.append(1) or match_rows(*a))
    assert list(faults(made.rig, raw * 3)) == [None] * 9
    assert len(calls) == 2


def test_unrectified_images_are_reported_once(made: SyntheticSequence, raw: list[StereoPair]) -> None:
    first = FirstPairs(made.rig, 1.0)
    found = [look(first, pair.left.pixels, pair.right.pixels) for pair in raw]
    assert found[0] is None and found[2] is None and isinstance(found[1], CalibrationError)
    assert str(found[1]).endswith("or the calibration does not belong to them: run stereo-depth doctor")
    assert says(found[1], CalibrationError, ROWS)
    assert first.finish() is None


def says(fault: StereoDepthError | None, kind: type[StereoDepthError], pattern: str) -> bool:
    return isinstance(fault, kind) and re.search(pattern, str(fault)) is not None


def test_a_single_pair_is_reported_at_the_end(made: SyntheticSequence, raw: list[StereoPair]) -> None:
    first = FirstPairs(made.rig, 1.0)
    assert look(first, raw[0].left.pixels, raw[0].right.pixels) is None
    assert "rows of left and right differ" in str(first.finish())


def test_one_bad_pair_of_three_is_not_a_bad_calibration(made: SyntheticSequence, raw: list[StereoPair]) -> None:
    first, rectifier = FirstPairs(made.rig, 1.0), Rectifier(made.rig)
    assert look(first, raw[0].left.pixels, raw[0].right.pixels) is None
    for pair in raw[1:]:
        rectified = rectifier.rectify(pair)
        assert look(first, rectified.left, rectified.right) is None
    assert first.finish() is None


@pytest.mark.parametrize("degrees", [(0.5, 0.0, 0.0), (-10.0, 0.0, 0.0), (0.0, 0.0, 3.0), (0.0, 10.0, 0.0)])
def test_the_rotation_of_another_rig(
    made: SyntheticSequence, raw: list[StereoPair], degrees: tuple[float, float, float]
) -> None:
    fault = first_fault(turned(made.rig, *degrees), raw)
    assert says(fault, CalibrationError, ROWS)
    assert isinstance(fault.value, float)
    if degrees[1:] == (0.0, 0.0):  # about f times the angle
        assert fault.value == pytest.approx(made.rig.f_px * np.radians(abs(degrees[0])), rel=0.15)


def test_the_translation_of_another_rig(made: SyntheticSequence, raw: list[StereoPair]) -> None:
    """Another direction of the baseline turns the rectification of both cameras."""
    left, right = made.rig.left, made.rig.right
    other = StereoRig.from_calibration(
        left.K, left.D, right.K, right.D, right.R.T @ left.R, [-0.12, 0.02, 0.0], SIZE, left.distortion_model
    )
    assert says(first_fault(other, raw), CalibrationError, "rows of left and right differ")


def test_other_cameras_of_the_same_resolution(made: SyntheticSequence, raw: list[StereoPair]) -> None:
    def camera(own: CameraModel) -> CameraModel:
        K = own.K.copy()
        K[:2, 2] += (9.0, -14.0)
        return replace(own, K=K)

    fault = first_fault(StereoRig(made.rig.left, camera(made.rig.right)), raw)
    assert isinstance(fault.value, float) and fault.value == pytest.approx(14, rel=0.15)


def test_camera_infos_of_another_resolution(made: SyntheticSequence, raw: list[StereoPair]) -> None:
    scale = np.diag([2.0, 2.0, 1.0])
    one, other = (replace(c, K=scale @ c.K, P=scale @ c.P) for c in (made.rig.left, made.rig.right))
    fault = first_fault(StereoRig(one, other), raw[:1])
    assert isinstance(fault, CalibrationError)
    assert "left: the center of K is at 2.0" in str(fault) and "K is that of an image of about 640x480" in str(fault)


def test_rectification_that_shows_nothing(made: SyntheticSequence, raw: list[StereoPair]) -> None:
    fault = first_fault(turned(made.rig, 40.0, 0.0, 0.0), raw[:1])
    assert "left and right: 38 % of the rectified image has a source, limit 40 %: R and P do not fit K" in str(fault)


def test_one_camera_on_both_topics(made: SyntheticSequence, raw: list[StereoPair]) -> None:
    fault = first_fault(made.rig, [StereoPair(pair.left, pair.left) for pair in raw])
    assert says(fault, ImageError, "^left and right image are identical: both topics show one camera")
    dark = Frame(np.zeros((HEIGHT, WIDTH), np.uint8), 0, "left")
    assert list(faults(made.rig, [StereoPair(dark, dark)] * 3)) == [None] * 3  # two covered cameras are identical too


def test_features_behind_infinity_are_refused_from_then_on(made: SyntheticSequence, raw: list[StereoPair]) -> None:
    rectifier = Rectifier(made.rig)
    first = FirstPairs(made.rig, 1.0)
    pairs = [rectifier.rectify(pair) for pair in raw]
    assert look(first, pairs[0].right, pairs[0].left) is None
    for one, other in ((pairs[1].right, pairs[1].left), (np.zeros_like(pairs[0].left), pairs[0].left)):
        with pytest.raises(CameraOrderError, match=r"cameras look swapped: \d+ % of the features behind infinity"):
            look(first, one, other)


def noise(rng: np.random.Generator, sigma: float) -> U8:
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    gray = 50 + 100 * x / WIDTH + 40 * y / HEIGHT + sigma * rng.standard_normal((HEIGHT, WIDTH))
    return np.clip(gray, 0, 255).astype(np.uint8)


def board(rng: np.random.Generator, square: float) -> U8:
    x, y = np.meshgrid(np.arange(WIDTH) + rng.integers(99), np.arange(HEIGHT))
    return ((x // square + y // square) % 2 * 200 + 20).astype(np.uint8)


@pytest.mark.parametrize(("scene", "strength"), [(noise, 1.0), (noise, 20.0), (board, 20), (board, 7)])
def test_scenes_without_distinct_texture_say_nothing(
    made: SyntheticSequence, scene: Callable[[np.random.Generator, float], U8], strength: float
) -> None:
    rng, first = np.random.default_rng(3), FirstPairs(made.rig, 1.0)
    assert [look(first, scene(rng, strength), scene(rng, strength)) for _ in range(6)] == [None] * 6
    assert first.finish() is None


def test_pairs_that_show_nothing_are_followed_by_later_ones_up_to_a_limit(
    made: SyntheticSequence, raw: list[StereoPair], monkeypatch: pytest.MonkeyPatch
) -> None:
    dark, raw_pair = np.zeros((HEIGHT, WIDTH), np.uint8), (raw[0].left.pixels, raw[0].right.pixels)
    first = FirstPairs(made.rig, 1.0)
    assert [look(first, dark, dark + 1) for _ in range(35)] == [None] * 35
    found = [look(first, *raw_pair) for _ in range(25)]
    assert [index for index, fault in enumerate(found, start=36) if fault is not None] == [50]  # after 40
    examined = []
    monkeypatch.setattr(FirstPairs, "_examine", lambda *_: examined.append(1) or (None, False))
    first = FirstPairs(made.rig, 1.0)
    for _ in range(1000):
        look(first, dark, dark)
    assert len(examined) == LOOKS == 40


def write_bag(path: Path, pairs: Iterable[StereoPair], *rigs: StereoRig) -> Path:
    """The pairs once for each rig, one after the other."""
    types, pairs = RosbagsTypes(), list(pairs)
    with BagWriter(path) as bag:
        for index, (rig, pair) in enumerate((rig, pair) for rig in rigs for pair in pairs):
            stamp_ns = 10**18 + index * 10**8
            for side, camera, frame in (("left", rig.left, pair.left), ("right", rig.right, pair.right)):
                bag.write(f"/{side}/camera_info", camera_info_message(types, camera, stamp_ns), stamp_ns)
                image = image_message(types, frame.pixels, "mono8", stamp_ns, frame.frame_id)
                bag.write(f"/{side}/image_raw", image, stamp_ns)
    return path


def test_process_warns_once_and_is_strict_on_request(
    made: SyntheticSequence, raw: list[StereoPair], tmp_path: Path
) -> None:
    wrong, output = turned(made.rig, 1.0, 0.0, 0.0), tmp_path / "out.mcap"
    bag = write_bag(tmp_path / "in.mcap", raw, wrong)
    (warning,) = process_bag(BagSelection(bag), output, CONFIG).warnings
    assert "rows of left and right differ by " in warning and "run stereo-depth doctor" in warning
    output.unlink()
    with pytest.raises(CalibrationError, match=r"in\.mcap: rows of left and right differ by .* px"):
        process_bag(BagSelection(bag), output, CONFIG, strict=True)
    with pytest.raises(CalibrationError, match="rows of left and right differ"):
        process_bag(BagSelection(bag, duration_seconds=0.05), output, CONFIG, strict=True)  # one pair
    assert not output.exists()
    right = write_bag(tmp_path / "right.mcap", raw, made.rig)
    assert process_bag(BagSelection(right), output, CONFIG, strict=True).warnings == ()


def test_process_looks_again_after_the_camera_infos_have_changed(
    made: SyntheticSequence, raw: list[StereoPair], tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / "in.mcap", raw, made.rig, turned(made.rig, 1.0, 0.0, 0.0))
    (warning,) = process_bag(BagSelection(bag), tmp_path / "out.mcap", CONFIG).warnings
    assert "rows of left and right differ by " in warning


def kitti(data: Path) -> tuple[StereoRig, Iterator[StereoPair]]:
    dataset = KittiDataset(data / "kitti_odometry" / "seqA_1226x370")
    return dataset.rig, (StereoPair(frame.left, frame.right) for frame in dataset)


def euroc(data: Path) -> tuple[StereoRig, Iterator[StereoPair]]:
    dataset = EurocDataset(data / "euroc" / "V1_01_micro")
    return dataset.rig, (StereoPair(frame.left, frame.right) for frame in dataset)


@pytest.mark.real_data
@pytest.mark.parametrize("sequence", [kitti, euroc])
def test_every_pair_of_real_sequences_fits(
    stereo_data: Path, sequence: Callable[[Path], tuple[StereoRig, Iterator[StereoPair]]]
) -> None:
    rig, pairs = sequence(stereo_data)
    for pair in islice(pairs, 0, None, 4):
        assert list(faults(rig, [pair] * 2)) == [None, None]


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("middlebury2003/cones/im2.png", "im6.png"),
        ("middlebury2006/Bowling1/view1.png", "view5.png"),
        ("middlebury2006/Plastic/view1.png", "view5.png"),
        ("oakd/stereodemo/donkey_toy_left.png", "donkey_toy_right.png"),
        ("oakd/stereodemo/stairs_left.png", "stairs_right.png"),
        ("eth3d/terrace/im0.png", "im1.png"),
        ("active/e_active_speckle_d415/image0.png", "image1.png"),
    ],
)
def test_real_rectified_pairs_fit(stereo_data: Path, left: str, right: str) -> None:
    path = stereo_data / left
    one, other = (np.asarray(cv2.imread(str(p), cv2.IMREAD_GRAYSCALE), np.uint8) for p in (path, path.with_name(right)))
    rig = StereoRig.from_rectified(500, 500, 0.5 * one.shape[1], 0.5 * one.shape[1], 100, 0.1, one.shape[::-1])
    first = FirstPairs(rig, 1.0)
    assert [look(first, one, other) for _ in range(3)] == [None] * 3
    assert first.finish() is None


@pytest.mark.real_data
def test_raw_images_of_a_real_rig_do_not_fit(stereo_data: Path) -> None:
    rig, pairs = euroc(stereo_data)
    first = FirstPairs(rig, 1.0)
    found = [look(first, to_gray(pair.left), to_gray(pair.right)) for pair in islice(pairs, 2)]
    assert says(found[1], CalibrationError, "differ by 1[0-9]\\.[0-9] px")
