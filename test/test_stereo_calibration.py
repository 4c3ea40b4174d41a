# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of both cameras and the rig: from exact corners of known cameras, and from real boards."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from rendered_boards import FISHEYE, RIGS, SIZE, exact_views

from stereo_depth_ros.calibration.board_options import create_board
from stereo_depth_ros.calibration.board_views import BoardView
from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.bundle_adjustment import BundleParameters
from stereo_depth_ros.calibration.calibration_files import save_calibration
from stereo_depth_ros.calibration.calibration_result import StereoCalibration
from stereo_depth_ros.calibration.distortion_range import check_distortion_range
from stereo_depth_ros.calibration.row_error import match_rows
from stereo_depth_ros.calibration.stereo_calibration import calibrate
from stereo_depth_ros.calibration.view_finder import FoundViews, find_views
from stereo_depth_ros.core.camera_yaml import camera_from_yaml
from stereo_depth_ros.core.errors import CalibrationError, ConfigError, OutputError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.datasets.stereo_images import open_stereo_images
from stereo_depth_ros.plots.coverage import coverage_plot

MODELS = list(RIGS)


@pytest.mark.parametrize("model", MODELS)
def test_exact_corners_give_the_cameras(model: str) -> None:
    rig = RIGS[model]
    found = calibrate(exact_views(rig, 14, noise_px=0), model)
    # Several sets of rational coefficients describe the same lens
    count = 4 if model == "rational_polynomial" else rig.left.size
    for camera, true in ((found.left, rig.left), (found.right, rig.right)):
        values = np.array([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], *camera.D])
        np.testing.assert_allclose(values[:count], true[:count], rtol=1e-4, atol=1e-4)
        assert camera.rms_px < 1e-4
    np.testing.assert_allclose(found.R, cv2.Rodrigues(rig.rig[:3])[0], atol=1e-6)
    np.testing.assert_allclose(found.T, rig.rig[3:], atol=1e-6)
    assert found.epipolar_rms_px < 1e-3
    assert not found.dropped


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_standard_deviations_are_those_of_many_draws(model: str) -> None:
    """The larger of the estimates from the Jacobian and from the views, which is slightly conservative."""
    draws = [calibrate(exact_views(RIGS[model], 10, 0.2, seed), model) for seed in range(12)]
    true = RIGS[model]
    errors = np.array(
        [[d.left.K[0, 0] - true.left[0], d.right.K[0, 2] - true.right[2], *(d.T - true.rig[3:])] for d in draws]
    )
    sigmas = np.array([[d.left.sigmas[0], d.right.sigmas[2], *d.T_sigma_m] for d in draws])
    share = np.sqrt(np.mean((errors / sigmas) ** 2, axis=0))
    # Of 12 draws the root mean square is known to 20 %
    assert (share > 0.3).all()
    assert (share < 1.5).all()
    assert np.mean([d.left.rms_px for d in draws]) == pytest.approx(0.2 * np.sqrt(2), rel=0.1)


def test_errors_fall_as_the_root_of_the_number() -> None:
    """The same poses, each recorded once or four times, which is four times the information."""
    exact, true = exact_views(RIGS["plumb_bob"], 6, 0.0), RIGS["plumb_bob"]

    def noisy(corners: Corners, random: np.random.Generator) -> Corners:
        return replace(corners, image_px=corners.image_px + 0.05 * random.normal(size=corners.image_px.shape))

    def errors(times: int) -> F64:
        found = []
        for seed in range(10, 16):
            random = np.random.default_rng(seed)
            views = [
                replace(
                    view, name=f"{view.name}_{again}", left=noisy(view.left, random), right=noisy(view.right, random)
                )
                for again in range(times)
                for view in exact
            ]
            result = calibrate(views)
            left, right = result.left.K[[0, 0], [0, 2]], result.right.K[[1, 1], [1, 2]]
            found.append([*(left - true.left[[0, 2]]), *(right - true.right[[1, 3]]), *(result.T - true.rig[3:])])
        rms: F64 = np.sqrt(np.mean(np.square(found), axis=0))
        return rms

    # The mean ratio of seven parameters over six draws is known to 14 %; 1 would be no decrease, 4 a decrease by 1 / n
    assert np.exp(np.log(errors(1) / errors(4)).mean()) == pytest.approx(2, rel=0.35)


def moved(view: BoardView, right_px: F64) -> BoardView:
    right = Corners(view.right.ids, view.right.board_m, view.right.image_px + right_px)
    return replace(view, right=right)


def test_a_view_with_wrong_corners_is_dropped_and_named() -> None:
    views = exact_views(FISHEYE, 12, 0.1)
    wrong = np.random.default_rng(4).normal(0, 3, views[5].right.image_px.shape)
    views[5] = moved(views[5], wrong)
    found = calibrate(views, "equidistant")
    assert [view.name for view in found.dropped] == ["view05"]
    assert "right: reprojection rms" in found.dropped[0].reason
    assert len(found.views) == 11
    assert found.baseline_m == pytest.approx(np.linalg.norm(FISHEYE.rig[3:]), abs=5e-4)


def test_a_view_whose_cameras_were_not_exposed_together_is_dropped_and_named() -> None:
    """Each camera fits alone: the board moved between the two images."""
    views, later = exact_views(FISHEYE, 12, 0.1), exact_views(FISHEYE, 12, 0.1, seed=9)
    views[3] = replace(views[3], right=later[3].right)
    found = calibrate(views, "equidistant")
    assert [view.name for view in found.dropped] == ["view03"]
    assert "moved between the two" in found.dropped[0].reason


def test_good_views_are_all_kept() -> None:
    for seed in range(6):
        assert not calibrate(exact_views(FISHEYE, 12, 0.3, seed + 20), "equidistant").dropped


def test_insufficient_views() -> None:
    views = exact_views(FISHEYE, 6, 0.1)
    with pytest.raises(CalibrationError, match=r"4 views of the board, at least 5 are required, 20 recommended"):
        calibrate(views[:4], "equidistant")
    with pytest.raises(ConfigError, match="'fisheye' is not one of"):
        calibrate(views, "fisheye")
    with pytest.raises(CalibrationError, match=r"view02: image size 320x240, view00 is 400x300"):
        calibrate([*views[:2], replace(views[2], size=(320, 240)), *views[3:]], "equidistant")


def test_repeated_views() -> None:
    """Repetitions of one pose do not determine the cameras."""
    view = exact_views(RIGS["plumb_bob"], 1, 0.0)[0]
    views = [replace(view, name=f"v{k}") for k in range(8)]
    with pytest.raises(CalibrationError, match=r"1 of 8 views differ, at least 3 are needed: tilt the board"):
        calibrate(views)


def test_a_fisheye_with_views_in_the_center_only_is_rectified() -> None:
    """With k4 free the distortion of these lenses decreases within the image, which cannot be rectified."""
    for seed in (0, 1, 5):
        found = calibrate(exact_views(FISHEYE, 6, 0.2, seed + 100), "equidistant")
        assert any("do not determine" in text and "k4" in text for text in found.warnings)
        assert (found.left.D[3], found.right.D[3], found.left.sigmas[7]) == (0, 0, 0)
        assert found.left.K[0, 0] == pytest.approx(FISHEYE.left[0], abs=4 * found.left.sigmas[0])
        assert found.rig.f_px == pytest.approx(125.6, rel=0.03)  # of the exact cameras
        # Corners of 0.2 px noise in each camera, shown by 125.6 / 174 of their size
        assert found.epipolar_rms_px == pytest.approx(0.2 * np.sqrt(2) * 125.6 / 174, rel=0.25)


def test_a_fisheye_that_cannot_be_rectified() -> None:
    """r = theta (1 - 0.4 theta^2) is largest at theta = 0.913, 104 px from the center of an image of 400 x 300."""
    lens = np.array([171.0, 171, 199.5, 149.5, -0.4, 0, 0, 0])
    with pytest.raises(CalibrationError, match=r"left camera: .* beyond 104 px .* up to 200 px away: it cannot be"):
        check_distortion_range(BundleParameters("equidistant", (lens, lens), FISHEYE.rig, np.zeros((0, 6))), SIZE)


def part(corners: Corners, keep: npt.NDArray[np.bool_]) -> Corners:
    return Corners(corners.ids[keep], corners.board_m[keep], corners.image_px[keep])


def test_views_of_different_parts_of_a_board() -> None:
    """As from boards with markers."""
    views = exact_views(RIGS["plumb_bob"], 10, 0.1)
    halves = [
        replace(view, left=part(view.left, view.left.ids % 7 < 4), right=part(view.right, view.right.ids % 7 >= 4))
        for view in views
    ]
    found = calibrate([*views[:9], halves[9]])
    assert len(found.views) == 10
    assert found.epipolar_rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.25)
    values = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert [view["rms_rows"] is None for view in values["views"]] == [False] * 9 + [True]
    with pytest.raises(CalibrationError, match="no corner of the board in common in any view"):
        calibrate(halves)


def test_images_that_do_not_belong_together() -> None:
    """Each right image is that of the next pair."""
    views = exact_views(RIGS["plumb_bob"], 10, 0.1)
    views = [replace(view, right=views[(k + 1) % len(views)].right) for k, view in enumerate(views)]
    with pytest.raises(CalibrationError, match=r"do not belong together|moved between the two"):
        calibrate(views)


def test_swapped_cameras() -> None:
    views = [replace(view, left=view.right, right=view.left) for view in exact_views(FISHEYE, 10, 0.1)]
    with pytest.raises(
        CalibrationError, match=r"-?[\d.]+ m to the left of the left camera: exchange the left and right images"
    ):
        calibrate(views, "equidistant")


def test_square_in_millimeters() -> None:
    views = exact_views(FISHEYE, 10, 0.0)
    views[0].left.board_m[:] *= 1000  # all views have this array
    with pytest.raises(CalibrationError, match=r"baseline is 11\d\.\d+ m, outside .*square in meters: 25 mm is 0\.025"):
        calibrate(views, "equidistant")


def test_files_are_read_back_as_they_are(tmp_path: Path) -> None:
    found = calibrate(exact_views(FISHEYE, 10, 0.2), "equidistant")
    save_calibration(found, tmp_path / "out")
    for name, camera in (("left", found.rig.left), ("right", found.rig.right)):
        read = camera_from_yaml((tmp_path / "out" / f"{name}.yaml").read_text())
        for field in ("K", "D", "R", "P"):
            np.testing.assert_array_equal(getattr(read, field), getattr(camera, field))
        assert (read.width, read.height, read.distortion_model) == (*SIZE, "equidistant")
    assert found.rig.f_px > 100  # of a usable image
    rig = StereoRig.from_yaml(tmp_path / "out" / "left.yaml", tmp_path / "out" / "right.yaml")
    assert rig.baseline_m == pytest.approx(found.baseline_m, rel=1e-9)
    # P of a fisheye contains the baseline
    assert rig.right.P[0, 3] == pytest.approx(-rig.f_px * found.baseline_m, rel=1e-9)
    report = (tmp_path / "out" / "calibration.txt").read_text()
    assert "baseline" in report and "+-" in report


def test_files_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    found = calibrate(exact_views(FISHEYE, 8, 0.2), "equidistant")
    with pytest.raises(OutputError, match=r"file/.*: cannot be written: .*choose a writable folder"):
        save_calibration(found, tmp_path / "file")


def test_coverage_plot_shows_corners_and_bars() -> None:
    found = calibrate(exact_views(FISHEYE, 8, 0.2), "equidistant")
    image = coverage_plot(found)
    assert image.dtype == np.uint8
    assert image.shape[1] > 1100
    blank = coverage_plot(replace(found, views=found.views[:1]))
    assert np.count_nonzero((image != blank).any(axis=2)) > 2000


def board_views(folder: Path) -> FoundViews:
    board = create_board("chessboard", (9, 6), 0.025)
    return find_views(open_stereo_images(folder), board, lambda size: create_board("chessboard", size, 0.025))


@pytest.fixture(scope="module")
def chessboard(stereo_data: Path) -> StereoCalibration:
    return calibrate(board_views(stereo_data / "opencv_samples" / "chessboard_stereo").views)


@pytest.mark.real_data
def test_the_chessboards_of_opencv(chessboard: StereoCalibration) -> None:
    assert len(chessboard.views) == 13
    assert max(chessboard.left.rms_px, chessboard.right.rms_px) <= 0.25
    assert chessboard.rms_stereo_px <= 0.35
    assert abs(1e3 * chessboard.baseline_m - 83.2) <= 1
    for camera in (chessboard.left, chessboard.right):
        assert np.abs(camera.K[[0, 1], [0, 1]] / 534.8 - 1).max() <= 0.01
    assert chessboard.epipolar_rms_px <= 0.2


@pytest.mark.real_data
def test_the_chessboards_of_opencv_against_opencv(stereo_data: Path, chessboard: StereoCalibration) -> None:
    """The same corners by cv2.stereoCalibrate: the same minimum."""
    views = board_views(stereo_data / "opencv_samples" / "chessboard_stereo").views
    board = [view.left.board_m.astype(np.float32) for view in views]
    left, right = ([getattr(view, side).image_px.astype(np.float32) for view in views] for side in ("left", "right"))
    one, other = (cv2.calibrateCamera(board, side, (640, 480), None, None)[1:3] for side in (left, right))
    flags = cv2.CALIB_USE_INTRINSIC_GUESS
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-12)
    rms, K, _, K_right, _, R, T, *_ = cv2.stereoCalibrate(
        board, left, right, *one, *other, (640, 480), flags=flags, criteria=criteria
    )
    assert chessboard.rms_stereo_px <= rms * 1.001
    np.testing.assert_allclose(chessboard.left.K, K, rtol=2e-3)
    np.testing.assert_allclose(chessboard.right.K, K_right, rtol=2e-3)
    np.testing.assert_allclose(chessboard.T, T.ravel(), atol=2e-4)
    np.testing.assert_allclose(chessboard.R, R, atol=1e-3)


@pytest.mark.real_data
def test_a_fisheye_rig(stereo_data: Path) -> None:
    folder = stereo_data / "stereopi" / "fisheye_v2"
    found = calibrate(board_views(folder / "pairs").views, "equidistant")
    assert max(found.left.rms_px, found.right.rms_px, found.rms_stereo_px) <= 0.35
    assert abs(1e3 * found.baseline_m - 64.6) <= 2
    # The scene is half as large as the boards were
    scene = cv2.imread(str(folder / "scenes" / "photo.png"), cv2.IMREAD_GRAYSCALE)
    assert scene is not None
    large = cv2.resize(scene, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    matches = match_rows(
        *(_rectified(np.asarray(large[:, side * 640 :][:, :640], np.uint8), found.rig, side) for side in (0, 1))
    )
    assert len(matches) > 200
    assert matches.median_px <= 0.4


def _rectified(image: U8, rig: StereoRig, side: int) -> U8:
    c = (rig.left, rig.right)[side]
    maps = cv2.fisheye.initUndistortRectifyMap(c.K, c.D, c.R, c.P[:, :3], (c.width, c.height), cv2.CV_32FC1)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), np.uint8)
