# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Datasets: layouts, calibrations, scales of the truth, conversion to bags."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_file_texts import SIZE, camchain, truth

from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.camera_files.kitti import rig_from_calibration
from stereo_depth_ros.core.errors import BagError, CalibrationError, ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, StereoPair
from stereo_depth_ros.datasets.dataset import StereoDataset
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.image_files import read_disparity_image, read_image
from stereo_depth_ros.datasets.images import ImagesDataset
from stereo_depth_ros.datasets.kitti import KittiDataset, read_calibration
from stereo_depth_ros.datasets.middlebury import MiddleburyDataset
from stereo_depth_ros.datasets.to_bag import convert_dataset
from stereo_depth_ros.messages.disparity import published_disparity
from stereo_depth_ros.messages.image import decode
from stereo_depth_ros.stages.rectification import Rectifier

WIDTH, HEIGHT = 44, 30


def image(path: Path, size: tuple[int, int] = (WIDTH, HEIGHT), value: int = 7) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    shape = (size[1], size[0], 3) if path.suffix == ".ppm" else (size[1], size[0])  # .ppm is always color
    assert cv2.imwrite(str(path), np.full(shape, value, np.uint8))


def truth_of(dataset: StereoDataset) -> F32:
    truth = next(iter(dataset)).truth_disparity_px
    assert truth is not None and truth.dtype == np.float32
    return truth


def make_2014(folder: Path, truth: F32 | None = None) -> Path:
    image(folder / "im0.png", value=1)
    image(folder / "im1.png", value=2)
    if truth is not None:
        cv2.imwrite(str(folder / "disp0.pfm"), truth)
    (folder / "calib.txt").write_text(
        "cam0=[50.5 0 20.25; 0 51.5 14; 0 0 1]\ncam1=[50.5 0 23.5; 0 51.5 14; 0 0 1]\n"
        f"doffs=3.25\nbaseline=193.001\nwidth={WIDTH}\nheight={HEIGHT}\nndisp=64\n"
    )
    return folder


def test_middlebury_2014(tmp_path: Path) -> None:
    stored = np.arange(WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH) / 8
    stored[3, 5] = np.inf
    dataset = MiddleburyDataset(make_2014(tmp_path, stored))
    rig = dataset.rig
    assert (rig.f_px, rig.fy_px, rig.cx_left, rig.cy) == (50.5, 51.5, 20.25, 14)
    # Middlebury: Z = f B / (d + doffs); ours: Z = f B / (d - doffs_px)
    assert (rig.baseline_m, rig.doffs_px) == pytest.approx((0.193001, -3.25))
    (frame,) = dataset
    assert len(dataset) == 1 and not dataset.has_stamps
    assert (frame.left.pixels[0, 0], frame.right.pixels[0, 0], frame.left.encoding) == (1, 2, "mono8")
    truth = truth_of(dataset)
    assert np.isnan(truth[3, 5])
    stored[3, 5] = np.nan
    np.testing.assert_array_equal(truth, stored)


@pytest.mark.parametrize(
    ("left", "right", "truth", "width", "level", "disparity_px"),
    [
        ("view1.png", "view5.png", "disp1.png", 463, 90, 30.0),  # 2005 and 2006: third size
        ("view1.png", "view5.png", "disp1.png", 695, 90, 45.0),
        ("view1.png", "view5.png", "disp1.png", 1390, 90, 90.0),
        ("im2.png", "im6.png", "disp2.png", 450, 90, 22.5),  # 2003: quarter size
        ("im2.png", "im6.png", "disp2.png", 900, 90, 45.0),
        ("im2.ppm", "im6.ppm", "disp2.pgm", 434, 90, 11.25),  # 2001
        ("scene1.row3.col3.ppm", "scene1.row3.col4.ppm", "truedisp.row3.col3.pgm", 384, 96, 6.0),
        ("scene1.row3.col3.ppm", "scene1.row3.col5.ppm", "truedisp.row3.col3.pgm", 384, 96, 12.0),
    ],
)
def test_middlebury_truth_is_scaled_by_year_and_size(
    tmp_path: Path, left: str, right: str, truth: str, width: int, level: int, disparity_px: float
) -> None:
    for name, value in ((left, 1), (right, 2), (truth, level)):
        image(tmp_path / name, (width, 8), value)
    unknown = read_disparity_image(tmp_path / truth)
    unknown[2, 3] = 0
    cv2.imwrite(str(tmp_path / truth), unknown)
    found = truth_of(MiddleburyDataset(tmp_path, focal_px=300.0, baseline_m=0.1))
    assert found[5, 7] == disparity_px and np.isnan(found[2, 3])
    assert np.isnan(found).sum() == 1


def test_of_all_images_of_a_middlebury_scene_the_pair_with_truth_is_read(tmp_path: Path) -> None:
    """As published in 2001 and 2003: im0 to im8, of which im2 and im6 have disparities; of map im0 and im1."""
    for number in range(9):
        image(tmp_path / "venus" / f"im{number}.ppm", (434, 8), number)
    for number, level in ((2, 90), (6, 30)):
        image(tmp_path / "venus" / f"disp{number}.pgm", (434, 8), level)
    dataset = MiddleburyDataset(tmp_path / "venus", focal_px=300.0, baseline_m=0.1)
    (frame,) = dataset
    assert (frame.left.pixels[0, 0, 0], frame.right.pixels[0, 0, 0]) == (2, 6)
    assert truth_of(dataset)[5, 7] == 11.25
    for name, level in (("im0", 1), ("im1", 2), ("disp0", 80), ("disp1", 40)):
        image(tmp_path / "map" / f"{name}.pgm", (284, 8), level)
    dataset = MiddleburyDataset(tmp_path / "map", focal_px=300.0, baseline_m=0.1)
    (frame,) = dataset
    assert (frame.left.pixels[0, 0], frame.right.pixels[0, 0], truth_of(dataset)[5, 7]) == (1, 2, 10.0)


def test_middlebury_2005_has_published_calibration(tmp_path: Path) -> None:
    for name in ("view1.png", "view5.png", "disp1.png"):
        image(tmp_path / name, (463, 8))
    with pytest.raises(BagError, match=r"neither calib\.txt nor dmin\.txt.*give focal length and baseline"):
        MiddleburyDataset(tmp_path)
    assert MiddleburyDataset(tmp_path, doffs=12.5).rig.doffs_px == pytest.approx(-12.5)
    (tmp_path / "dmin.txt").write_text("200\n")
    rig = MiddleburyDataset(tmp_path).rig
    assert (rig.f_px, rig.baseline_m, rig.doffs_px) == pytest.approx((3740 / 3, 0.160, -200 / 3))
    assert (rig.cx_left, rig.cy) == (231.0, 3.5)
    (tmp_path / "dmin.txt").write_text("many")
    with pytest.raises(BagError, match=r"dmin\.txt: does not hold one number"):
        MiddleburyDataset(tmp_path)


def test_middlebury_without_a_calibration(tmp_path: Path) -> None:
    for name in ("im2.png", "im6.png"):
        image(tmp_path / name)
    with pytest.raises(BagError, match="is not a Middlebury scene"):
        MiddleburyDataset(tmp_path)
    image(tmp_path / "disp2.png")
    with pytest.raises(BagError, match=r"no calib\.txt: .*give focal length and baseline \(and doffs"):
        MiddleburyDataset(tmp_path)
    elsewhere = make_2014(tmp_path / "other") / "calib.txt"
    assert MiddleburyDataset(tmp_path, calibration_file=elsewhere).rig.cx_left == 20.25


def test_middlebury_files_that_are_broken(tmp_path: Path) -> None:
    make_2014(tmp_path)
    (tmp_path / "calib.txt").write_text("cam0=[1 2 3]\n")
    with pytest.raises(BagError, match=r"calib\.txt: is not a Middlebury calibration"):
        MiddleburyDataset(tmp_path)
    make_2014(tmp_path)
    image(tmp_path / "im1.png", (WIDTH - 1, HEIGHT))
    with pytest.raises(CalibrationError, match=rf"im1\.png: the image is {WIDTH - 1}x{HEIGHT}"):
        MiddleburyDataset(tmp_path)
    (tmp_path / "im1.png").write_bytes(b"no image")
    with pytest.raises(BagError, match=r"im1\.png: is not a readable image"):
        MiddleburyDataset(tmp_path)


def test_images_that_are_missing_or_in_color(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"gone\.png: does not exist: check the path"):
        read_image(tmp_path / "gone.png")
    cv2.imwrite(str(tmp_path / "color.png"), np.zeros((4, 5, 3), np.uint8))
    with pytest.raises(BagError, match=r"color\.png: has 3 channels"):
        read_disparity_image(tmp_path / "color.png")


P0 = "50.5 0 20.25 0 0 51.5 14 0 0 0 1 0"
P1 = "50.5 0 20.25 -27.27 0 51.5 14 0 0 0 1 0"


def make_kitti(folder: Path, left: str = "image_0", right: str = "image_1", names: int = 3) -> Path:
    for index in range(names):
        image(folder / left / f"{index:06d}.png", value=10 + index)
        image(folder / right / f"{index:06d}.png", value=20 + index)
    (folder / "calib.txt").write_text(f"P0: {P0}\nP1: {P1}\n")
    return folder


def test_kitti_odometry(tmp_path: Path) -> None:
    folder = make_kitti(tmp_path)
    (folder / "image_0" / "000009.png").write_bytes(b"")  # has no right image
    dataset = KittiDataset(folder)
    assert (dataset.rig.f_px, dataset.rig.fy_px) == (50.5, 51.5)
    assert dataset.rig.baseline_m == pytest.approx(27.27 / 50.5)
    frames = list(dataset)
    assert len(dataset) == len(frames) == 3 and dataset.skipped == 0
    assert [f.left.stamp_ns for f in frames] == [1_000_000_000, 1_100_000_000, 1_200_000_000]
    assert [(f.left.pixels[0, 0], f.right.pixels[0, 0]) for f in frames] == [(10, 20), (11, 21), (12, 22)]
    assert frames[0].truth_disparity_px is None


def test_kitti_times(tmp_path: Path) -> None:
    folder = make_kitti(tmp_path / "a")
    (folder / "times.txt").write_text("0.000000e+00\n1.036224e-01\n2.072e-01\n")
    assert [f.left.stamp_ns for f in KittiDataset(folder)] == [1_000_000_000, 1_103_622_400, 1_207_200_000]
    (folder / "times.txt").write_text("0\n")
    with pytest.raises(BagError, match=r"times\.txt: has 1 times for 3 pairs"):
        KittiDataset(folder)
    (folder / "times.txt").write_text("now\n")
    with pytest.raises(BagError, match=r"times\.txt: is not a list of time stamps"):
        KittiDataset(folder)
    raw = make_kitti(tmp_path / "b", "image_00/data", "image_01/data", names=1)
    (raw / "image_00" / "timestamps.txt").write_text("2011-09-26 13:02:25.964389445\n")
    assert [f.left.stamp_ns for f in KittiDataset(raw)] == [1_317_042_145_964_389_445]


def make_excerpt(folder: Path, numbers: tuple[int, ...], pattern: str = "{:06d}.png") -> Path:
    """Frames of a sequence, whose gray levels are their numbers."""
    for number in numbers:
        image(folder / "image_0" / pattern.format(number), value=number)
        image(folder / "image_1" / pattern.format(number), value=number)
    (folder / "calib.txt").write_text(f"P0: {P0}\nP1: {P1}\n")
    return folder


def stamps(dataset: StereoDataset) -> dict[int, int]:
    """Nanoseconds by gray level, in the order of the frames."""
    frames = list(dataset)
    assert all(frame.left.stamp_ns == frame.right.stamp_ns for frame in frames)
    return {int(frame.left.pixels[0, 0]): frame.left.stamp_ns for frame in frames}


def test_kitti_excerpt_keeps_the_times_of_its_frames(tmp_path: Path) -> None:
    folder = make_excerpt(tmp_path, (100, 101, 103))
    assert stamps(KittiDataset(folder)) == {100: 11_000_000_000, 101: 11_100_000_000, 103: 11_300_000_000}
    times = np.cumsum(np.arange(110) % 7 + 1) / 64  # gaps that differ from row to row
    (folder / "times.txt").write_text("".join(f"{time:.6f}\n" for time in times))
    assert stamps(KittiDataset(folder)) == {n: 10**9 + round(times[n] * 1e9) for n in (100, 101, 103)}
    (folder / "times.txt").write_text("0.5\n0.75\n2.0\n")  # that of the excerpt
    assert stamps(KittiDataset(folder)) == {100: 1_500_000_000, 101: 1_750_000_000, 103: 3_000_000_000}
    (folder / "times.txt").write_text("0\n" * 103)  # one too few
    with pytest.raises(BagError, match=r"times\.txt: has 103 times for 3 pairs, the last of which is frame 103: "):
        KittiDataset(folder)


def test_kitti_image_without_a_partner_has_its_row_of_times(tmp_path: Path) -> None:
    folder = make_excerpt(tmp_path, (0, 1, 2, 3))
    (folder / "image_1" / "000001.png").unlink()
    (folder / "times.txt").write_text("0.5\n0.75\n2.0\n2.25\n")
    expected = {0: 1_500_000_000, 2: 3_000_000_000, 3: 3_250_000_000}
    assert stamps(KittiDataset(folder)) == expected
    for side in ("image_0", "image_1"):  # now frames 4, 5, 6, 7 with the times of the excerpt
        for path in sorted((folder / side).iterdir()):
            path.rename(path.with_name(f"{int(path.stem) + 4:06d}.png"))
    assert stamps(KittiDataset(folder)) == expected


def test_kitti_raw_excerpt_keeps_the_times_of_its_frames(tmp_path: Path) -> None:
    folder = make_kitti(tmp_path, "image_00/data", "image_01/data", names=3)
    for side in ("image_00", "image_01"):
        (folder / side / "data" / "000001.png").unlink()
    rows = [f"2011-09-26 13:02:{second}" for second in ("25.964389445", "26.1", "27.500000001")]
    (folder / "image_00" / "timestamps.txt").write_text("\n".join(rows) + "\n")
    assert stamps(KittiDataset(folder)) == {10: 1_317_042_145_964_389_445, 12: 1_317_042_147_500_000_001}


def test_kitti_pairs_of_another_calibration_do_not_shift_the_times(tmp_path: Path) -> None:
    folder = make_excerpt(tmp_path, (3, 4, 6, 9))
    (folder / "calib.txt").unlink()
    (folder / "calib").mkdir()
    for number in (3, 4, 6, 9):
        focal = "60.5" if number == 4 else "50.5"
        (folder / "calib" / f"{number:06d}.txt").write_text(f"P0: {P0}\nP1: {P1}\n".replace("50.5", focal))
    dataset = KittiDataset(folder)
    assert dataset.skipped == 1
    assert stamps(dataset) == {3: 1_300_000_000, 6: 1_600_000_000, 9: 1_900_000_000}
    (folder / "times.txt").write_text("0.5\n0.75\n2.0\n2.25\n")
    assert stamps(KittiDataset(folder)) == {3: 1_500_000_000, 6: 3_000_000_000, 9: 3_250_000_000}


def test_kitti_pairs_of_stereo_benchmarks_are_counted(tmp_path: Path) -> None:
    """Frame 10 of every scene has a truth; successive frames are 100 ms apart."""
    folder = make_excerpt(tmp_path / "a", (0, 2, 5), "{:06d}_10.png")
    assert stamps(KittiDataset(folder)) == {0: 1_000_000_000, 2: 1_200_000_000, 5: 1_500_000_000}
    folder = make_excerpt(tmp_path / "b", (10, 11, 13), "000001_{:02d}.png")
    make_excerpt(folder, (210, 211), "000{:03d}.png")
    for side in ("image_0", "image_1"):
        for number in (210, 211):
            (folder / side / f"000{number}.png").rename(folder / side / f"000002_{number - 200}.png")
    assert stamps(KittiDataset(folder)) == {
        10: 1_400_000_000,
        11: 1_500_000_000,
        13: 1_700_000_000,
        210: 1_800_000_000,
        211: 1_900_000_000,
    }


def test_kitti_frames_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    folder = make_excerpt(tmp_path, (2, 10, 9), "{}.png")
    assert list(stamps(KittiDataset(folder)).items()) == [(2, 1_200_000_000), (9, 1_900_000_000), (10, 2_000_000_000)]


def test_kitti_names_that_do_not_number_the_frames(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"first_7\.png: has no frame number, images of KITTI are named 000000\.png"):
        KittiDataset(make_excerpt(tmp_path / "a", (7,), "first_{}.png"))
    folder = make_excerpt(make_excerpt(tmp_path / "b", (7,)), (7,), "{}.png")
    with pytest.raises(BagError, match=r"000007\.png and .*7\.png have the same frame number: remove one"):
        KittiDataset(folder)


def test_kitti_stereo_benchmark_has_truth_and_one_calibration_per_pair(tmp_path: Path) -> None:
    for name in ("000000_10.png", "000001_10.png", "000002_10.png"):
        image(tmp_path / "image_2" / name)
        image(tmp_path / "image_3" / name)
    rows = "P_rect_02: 50.5 0 20 2.02 0 51.5 14 0.2 0 0 1 0.002\nP_rect_03: 50.5 0 20 -18.18 0 51.5 14 2 0 0 1 0.003\n"
    (tmp_path / "calib_cam_to_cam").mkdir()
    for index, text in enumerate((rows, rows.replace("50.5", "60.5"), rows)):
        (tmp_path / "calib_cam_to_cam" / f"{index:06d}.txt").write_text(text)
    (tmp_path / "disp_occ_0").mkdir()
    levels = np.full((HEIGHT, WIDTH), 1000, np.uint16)
    levels[4, 6] = 0
    cv2.imwrite(str(tmp_path / "disp_occ_0" / "000000_10.png"), levels)
    dataset = KittiDataset(tmp_path)
    assert (len(dataset), dataset.skipped) == (2, 1)
    assert dataset.rig.baseline_m == pytest.approx((18.18 + 2.02) / 50.5)
    truth = truth_of(dataset)
    assert truth[5, 6] == 1000 / 256 and np.isnan(truth[4, 6])
    cv2.imwrite(str(tmp_path / "disp_occ_0" / "000000_10.png"), levels.astype(np.uint8))
    with pytest.raises(BagError, match=r"000000_10\.png: is uint8, the disparities of KITTI are uint16"):
        next(iter(dataset))


def test_kitti_folders_that_lack_something(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="is not a KITTI folder"):
        KittiDataset(tmp_path)
    folder = make_kitti(tmp_path / "a")
    (folder / "calib.txt").write_text("P0: one two\n")
    with pytest.raises(BagError, match=r"calib\.txt: is not a KITTI calibration, row 'P0: one two'"):
        KittiDataset(folder)
    (folder / "calib.txt").write_text(f"P0: {P0}\n")
    with pytest.raises(BagError, match="the KITTI calibration has no P_rect_01, it has 'P0'"):
        KittiDataset(folder)
    (folder / "calib.txt").unlink()
    with pytest.raises(BagError, match="a: has no calibration: add calib"):
        KittiDataset(folder)


SENSOR = """%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, {x}, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
resolution: [44, 30]
intrinsics: [50.5, 51.5, 20.25, 14.0]
distortion_model: {model}
distortion_coefficients: [-0.02, 0.01, 0.0, 0.0]
"""


def make_euroc(folder: Path, model: str = "radial-tangential") -> Path:
    for camera, x, stamps in (("cam0", 0.01, (20, 10, 30, 50)), ("cam1", 0.21, (10, 30, 40, 50))):
        root = folder / "mav0" / camera
        for stamp in stamps[:3]:  # the last row has no image
            image(root / "data" / f"{stamp}.png", value=stamp)
        rows = "".join(f"{stamp},{stamp}.png\r\n" for stamp in stamps)
        (root / "data.csv").write_text("#timestamp [ns],filename\r\n" + rows)
        (root / "sensor.yaml").write_text(SENSOR.format(x=x, model=model))
    return folder


def test_euroc(tmp_path: Path) -> None:
    folder = make_euroc(tmp_path)
    for place in (folder, folder / "mav0"):
        dataset = EurocDataset(place)
        assert [(f.left.stamp_ns, f.right.stamp_ns) for f in dataset] == [(10, 10), (30, 30)]
        assert (len(dataset), dataset.skipped) == (2, 2)
    # T_body_right is 0.2 m to the right of T_body_left along the common x axis
    assert dataset.rig.baseline_m == pytest.approx(0.2)
    np.testing.assert_allclose(dataset.rig.left.D, [-0.02, 0.01, 0, 0])
    assert dataset.rig.left.K[0, 2] == 20.25


@pytest.mark.parametrize("place", ["dso/camchain.yaml", "mav0/dso/camchain.yaml", "camchain-imucam.yaml"])
def test_tum_vi(place: str, tmp_path: Path) -> None:
    folder, rig = make_euroc(tmp_path), truth("equidistant")
    for camera in ("cam0", "cam1"):
        (folder / "mav0" / camera / "sensor.yaml").unlink()
        for path in (folder / "mav0" / camera / "data").glob("*.png"):
            cv2.imwrite(str(path), np.full(SIZE[::-1], 257 * int(path.stem), np.uint16))  # 16 bits
    (folder / place).parent.mkdir(exist_ok=True)
    (folder / place).write_text(camchain(rig, "equidistant", pose="T_cam_imu"))
    dataset = EurocDataset(folder)
    assert folder / place in dataset.files
    np.testing.assert_allclose(dataset.rig.left.D, rig.D_left[:4])
    assert dataset.rig.left.distortion_model == "equidistant"
    assert dataset.rig.baseline_m == pytest.approx(np.linalg.norm(rig.T))
    assert [(f.left.stamp_ns, int(f.left.pixels[0, 0])) for f in dataset] == [(10, 10), (30, 30)]
    (folder / place).write_text("cam0: 1\n")
    with pytest.raises(BagError, match=r"camchain.*is not a camchain of Kalibr"):
        EurocDataset(folder)
    (folder / "mav0" / "camchain_2.yaml").write_text("cam0: 1\n")
    with pytest.raises(BagError, match=r"mav0: has several calibrations: .*camchain.*camchain"):
        EurocDataset(folder)


def test_euroc_folders_that_lack_something(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"is not an EuRoC sequence, it has no mav0/cam0/data\.csv, mav0/cam1/data\.csv"):
        EurocDataset(tmp_path)
    with pytest.raises(BagError, match="distortion_model = 'fisheye' is not supported, supported is radial-tangential"):
        EurocDataset(make_euroc(tmp_path / "a", "fisheye"))
    folder = make_euroc(tmp_path / "b")
    (folder / "mav0" / "cam1" / "sensor.yaml").write_text("intrinsics: [1, 2]\n")
    with pytest.raises(BagError, match=r"cam1/sensor\.yaml: is not the sensor\.yaml of an EuRoC camera"):
        EurocDataset(folder)
    (folder / "mav0" / "cam1" / "data.csv").write_text("21,40.png\n")
    with pytest.raises(BagError, match="none of 3 left and 1 right images have equal stamps"):
        EurocDataset(folder)
    (folder / "mav0" / "cam1" / "data.csv").write_text("soon,40.png\n")
    with pytest.raises(BagError, match=r"cam1/data\.csv: its rows are not a stamp and a file name"):
        EurocDataset(folder)


@pytest.mark.parametrize("pattern", ["{side}/{index}.png", "{side}{index}.png"])
def test_images(tmp_path: Path, pattern: str) -> None:
    rig = StereoRig.from_rectified(50.5, 51.5, 20.25, 23.5, 14.0, 0.2, (WIDTH, HEIGHT))
    for index in range(2):
        image(tmp_path / pattern.format(side="left", index=index), value=index)
        image(tmp_path / pattern.format(side="right", index=index), value=index + 5)
    with pytest.raises(BagError, match=r"no calibration .*left\.yaml, .*right\.yaml"):
        ImagesDataset(tmp_path)
    write_camera(tmp_path / "left.yaml", rig.left, "left")
    write_camera(tmp_path / "other.yaml", rig.right, "right")
    dataset = ImagesDataset(tmp_path, [tmp_path / "left.yaml", tmp_path / "other.yaml"])
    assert dataset.rig.doffs_px == pytest.approx(-3.25)
    assert [(f.left.pixels[0, 0], f.right.pixels[0, 0]) for f in dataset] == [(0, 5), (1, 6)]
    assert len(dataset) == 2 and dataset.rig.frame_id == "left_optical_frame"
    alone = tmp_path / pattern.format(side="right", index=9)
    image(alone)
    dataset = ImagesDataset(tmp_path, [tmp_path / "left.yaml", tmp_path / "other.yaml"])
    assert (len(dataset), dataset.skipped) == (2, 1)
    assert dataset.warnings == [f"{alone}: skipped, it has no left image"]


def make_images(folder: Path, names: dict[str, int]) -> Path:
    """Images by name and gray level, and a calibration."""
    rig = StereoRig.from_rectified(50.5, 51.5, 20.25, 23.5, 14.0, 0.2, (WIDTH, HEIGHT))
    for name, value in names.items():
        image(folder / name, value=value)
    write_camera(folder / "left.yaml", rig.left, "left")
    write_camera(folder / "right.yaml", rig.right, "right")
    return folder


def test_images_side_by_side(tmp_path: Path) -> None:
    rig = StereoRig.from_rectified(50.5, 51.5, 20.25, 23.5, 14.0, 0.2, (WIDTH, HEIGHT))
    for side, camera in (("left", rig.left), ("right", rig.right)):
        write_camera(tmp_path / f"{side}.yaml", camera, side)
    for number in (2, 11):
        both = np.full((HEIGHT, 2 * WIDTH), number, np.uint8)
        both[:, WIDTH:] += 100
        assert cv2.imwrite(str(tmp_path / f"{number}.png"), both)
    dataset = ImagesDataset(tmp_path, side_by_side=True)
    assert levels(dataset) == [(2, 102), (11, 111)]
    (frame, _) = dataset
    assert frame.left.pixels.shape == frame.right.pixels.shape == (HEIGHT, WIDTH)
    image(tmp_path / "2.png")
    with pytest.raises(CalibrationError, match=r"2\.png: the image is \d+x\d+, its camera info is for"):
        ImagesDataset(tmp_path, side_by_side=True)


def make_cropped(folder: Path, width: int = WIDTH - 8) -> Path:
    """Right images narrower and higher than the left ones, each with its calibration."""
    folder.mkdir(exist_ok=True)
    rig = StereoRig.from_rectified(50.5, 51.5, -20.25, 23.5, 14.0, 0.2, (WIDTH, HEIGHT))
    K = rig.right.K - np.array([[0, 0, 0], [0, 0, 2], [0, 0, 0]])  # its rows are 2 px above those of the left camera
    right = replace(rig.right, width=WIDTH - 8, height=HEIGHT + 3, K=K)
    write_camera(folder / "left.yaml", rig.left, "left")
    write_camera(folder / "right.yaml", right, "right")
    for number in (4, 10):
        image(folder / f"L_{number}.png", value=number)
        image(folder / f"R_{number}.png", (width, HEIGHT + 3), value=100 + number)
    return folder


def test_images_of_two_sizes_are_extended_to_one(tmp_path: Path) -> None:
    dataset = ImagesDataset(make_cropped(tmp_path))
    assert levels(dataset) == [(4, 104), (10, 110)]
    assert (dataset.rig.width, dataset.rig.height) == (WIDTH, HEIGHT + 3)
    assert dataset.rig.doffs_px == pytest.approx(-43.75)  # pixels keep their coordinates
    _, frame = dataset
    for pixels, size, value in ((frame.left.pixels, (WIDTH, HEIGHT), 10), (frame.right.pixels, (WIDTH - 8, 33), 110)):
        expected = np.zeros((HEIGHT + 3, WIDTH), np.uint8)
        expected[: size[1], : size[0]] = value
        np.testing.assert_array_equal(pixels, expected)
    rectified = Rectifier(dataset.rig).rectify(StereoPair(frame.left, frame.right))
    np.testing.assert_array_equal(rectified.right[2:], frame.right.pixels[:-2])
    assert convert_dataset(dataset, tmp_path / "out.mcap") == 2


def test_images_of_two_sizes_must_be_those_of_their_calibrations(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"right\.yaml: the image is 35x33, its camera info is for 36x33: use"):
        ImagesDataset(make_cropped(tmp_path / "a", WIDTH - 9))
    folder = make_cropped(tmp_path / "b")
    image(folder / "R_10.png", (WIDTH - 7, HEIGHT + 3))
    with pytest.raises(CalibrationError, match=r"R_10\.png: the image is 37x33, its camera info is for 44x33"):
        list(ImagesDataset(folder))


def levels(dataset: StereoDataset) -> list[tuple[int, int]]:
    """Gray levels of the pairs."""
    return [(int(frame.left.pixels[0, 0]), int(frame.right.pixels[0, 0])) for frame in dataset]


@pytest.mark.parametrize("pattern", ["{side}/{number}.png", "{side}{number}.png", "{side}/{side}{number:02d}.png"])
def test_images_are_paired_by_name_and_not_by_position(tmp_path: Path, pattern: str) -> None:
    """As many left as right images, of other frames."""
    left = {pattern.format(side="left", number=number): number for number in (1, 2, 3, 10)}
    right = {pattern.format(side="right", number=number): 100 + number for number in (2, 3, 10, 11)}
    dataset = ImagesDataset(make_images(tmp_path, left | right))
    assert levels(dataset) == [(2, 102), (3, 103), (10, 110)]
    assert (len(dataset), dataset.skipped, len(dataset.warnings)) == (3, 2, 2)


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("left/cam0_{}.png", "right/cam1_{}.png"),
        ("cam0/data/{}.png", "cam1/data/{}.png"),
        ("image_0/{}.png", "image_1/{}.png"),
        ("L_{}.PNG", "R_{}.PNG"),
        ("{}_left.jpg", "{}_right.jpg"),
    ],
)
def test_images_may_have_all_names_that_calibrate_reads(tmp_path: Path, left: str, right: str) -> None:
    names = {left.format("0004"): 4, left.format("0007"): 7, right.format("0007"): 107, right.format("0009"): 109}
    dataset = ImagesDataset(make_images(tmp_path, names))
    (pair,) = levels(dataset)
    assert pair == pytest.approx((7, 107), abs=1) and dataset.skipped == 2


@pytest.mark.parametrize("pattern", ["{side}/{number}.png", "{side}{number}.png"])
def test_images_of_other_folders_and_masks_are_ignored(tmp_path: Path, pattern: str) -> None:
    names = {pattern.format(side=side, number=5): value for side, value in (("left", 5), ("right", 105))}
    for side in ("left", "right"):
        names |= {
            f"board/{side}5.png": 50,
            f"rectified/{side}/5.png": 60,
            pattern.format(side=side, number="_mask"): 255,
        }
    dataset = ImagesDataset(make_images(tmp_path, names))
    assert levels(dataset) == [(5, 105)] and dataset.skipped == 0


def test_images_without_any_pair(tmp_path: Path) -> None:
    folder = make_images(tmp_path, {"left/3.png": 3, "left/4.png": 4, "right/5.png": 5, "right/6.png": 6})
    with pytest.raises(BagError, match=r"no left image has the number of a right one, such as 3\.png and 5\.png"):
        ImagesDataset(folder)


def test_middlebury_image_of_another_scene_is_not_a_partner(tmp_path: Path) -> None:
    for name, value in (("a_left.png", 1), ("b_left.png", 2), ("b_right.png", 3), ("c_right.png", 4)):
        image(tmp_path / name, value=value)
    for name in "abc":
        np.savez(tmp_path / f"{name}_disp.npz", np.full((HEIGHT, WIDTH), ord(name), np.float32))
    dataset = MiddleburyDataset(tmp_path, focal_px=300.0, baseline_m=0.1)
    assert levels(dataset) == [(2, 3)]
    assert truth_of(dataset)[0, 0] == ord("b")


def test_a_dataset_becomes_a_bag(tmp_path: Path) -> None:
    truth = np.full((HEIGHT, WIDTH), 4.5, np.float32)
    truth[2, 3], truth[4, 5] = np.inf, 9.25
    dataset = MiddleburyDataset(make_2014(tmp_path / "scene", truth))
    seen: list[tuple[int, int]] = []
    assert convert_dataset(dataset, tmp_path / "out.mcap", progress=lambda *done: seen.append(done)) == 1
    assert seen == [(1, 1)]
    with BagReader(tmp_path / "out.mcap") as reader:
        messages = {m.topic: reader.deserialize(m) for m in reader.messages()}
    assert sorted(messages) == [
        "/left/camera_info",
        "/left/image_raw",
        "/right/camera_info",
        "/right/image_raw",
        "/truth/disparity",
    ]
    assert {m.header.stamp.sec for m in messages.values()} == {1}
    assert decode(messages["/right/image_raw"]).pixels[0, 0] == 2
    rig = StereoRig.from_infos(messages["/left/camera_info"], messages["/right/camera_info"])
    np.testing.assert_allclose(rig.Q, dataset.rig.Q)
    disparity = messages["/truth/disparity"]
    published = published_disparity(disparity)
    assert np.isnan(published[2, 3])
    # published is d + doffs of Middlebury's formula: Z = f T / published
    assert (published[0, 0], published[4, 5]) == (4.5 + 3.25, 9.25 + 3.25)
    assert (disparity.min_disparity, disparity.max_disparity) == (4 + 3.25, 10 + 3.25)


def test_pairs_without_times_are_counted_at_the_rate(tmp_path: Path) -> None:
    rig = StereoRig.from_rectified(50.5, 51.5, 20.25, 23.5, 14.0, 0.2, (WIDTH, HEIGHT))
    for side, camera in (("left", rig.left), ("right", rig.right)):
        write_camera(tmp_path / f"{side}.yaml", camera, side)
        for index in range(3):
            image(tmp_path / side / f"{index}.png")
    dataset = ImagesDataset(tmp_path)
    convert_dataset(dataset, tmp_path / "out.mcap", rate_hz=4.0)
    with BagReader(tmp_path / "out.mcap") as reader:
        stamps = [m.log_time_ns for m in reader.messages(["/right/image_raw"])]
    assert stamps == [1_000_000_000, 1_250_000_000, 1_500_000_000]
    for rate_hz in (0.0, -1.0, float("nan"), float("inf"), 1e-300, 1e-12, 1e10, 1e300):
        with pytest.raises(ConfigError, match=r"rate_hz = .* is outside 0\.001\.\.1e\+06: set pairs per second"):
            convert_dataset(dataset, tmp_path / "other.mcap", rate_hz=rate_hz)
    with pytest.raises(BagError, match=r"out\.mcap: already exists"):
        convert_dataset(dataset, tmp_path / "out.mcap")


# The expected numbers below are published with the datasets.


@pytest.mark.real_data
def test_real_middlebury_and_eth3d(stereo_data: Path) -> None:
    terrace = MiddleburyDataset(stereo_data / "eth3d" / "terrace")
    assert (terrace.rig.f_px, terrace.rig.baseline_m, terrace.rig.doffs_px) == pytest.approx((711.499, 0.0599432, 0))
    assert np.isfinite(truth_of(terrace)).mean() == pytest.approx(
        0.53, abs=0.05
    )  # truth of a laser scan, about half of the pixels
    art = MiddleburyDataset(stereo_data / "middlebury2005" / "Art")
    dmin = float((stereo_data / "middlebury2005" / "Art" / "dmin.txt").read_text())
    assert art.rig.f_px == pytest.approx(1246.67, abs=0.01) and art.rig.doffs_px == pytest.approx(-dmin / 3)
    folder = stereo_data / "middlebury2014" / "Motorcycle_quarter"
    motorcycle = MiddleburyDataset(folder, focal_px=994.978, baseline_m=0.193001, doffs=31.086)
    truth = truth_of(motorcycle)
    assert truth.shape == (500, 741) and not np.isinf(truth).any()
    depth_m = 994.978 * 0.193001 / (truth + 31.086)
    assert 2 < np.nanmin(depth_m) < np.nanmax(depth_m) < 6  # the scene is a garage
    with pytest.raises(BagError, match=r"no calib\.txt"):
        MiddleburyDataset(folder)


@pytest.mark.real_data
def test_real_truth_explains_the_images(stereo_data: Path) -> None:
    for name in ("middlebury2003/cones", "middlebury2001/venus", "middlebury2001/tsukuba"):
        dataset = MiddleburyDataset(stereo_data / name, focal_px=500.0, baseline_m=0.1)
        (frame,) = dataset
        truth = truth_of(dataset)
        errors = [
            warp_error(frame.left.pixels, frame.right.pixels, truth * np.float32(scale)) for scale in (1, 0.8, 1.2)
        ]
        assert errors[0] < 0.7 * min(errors[1:])


def warp_error(left: np.ndarray, right: np.ndarray, disparity_px: F32) -> float:
    """Mean absolute difference between the left image and the right one sampled at x - d."""
    y, x = np.indices(disparity_px.shape, np.float32)
    warped = cv2.remap(right, x - disparity_px, y, cv2.INTER_LINEAR)
    known = np.isfinite(disparity_px) & (x > disparity_px)
    return float(np.mean(cv2.absdiff(left, warped)[known]))


@pytest.mark.real_data
def test_real_kitti(stereo_data: Path, tmp_path: Path) -> None:
    dataset = KittiDataset(stereo_data / "kitti_odometry" / "seqA_1226x370")
    assert (dataset.rig.f_px, dataset.rig.baseline_m) == pytest.approx((707.0912, 0.5372), abs=1e-4)
    assert convert_dataset(dataset, tmp_path / "kitti.mcap") == 21
    info = inspect_bag(tmp_path / "kitti.mcap")
    assert info.usable and info.exact_pairs == 21
    assert info.topics["/left/image_raw"].rate_hz == pytest.approx(10.0)


@pytest.mark.real_data
def test_real_kitti_raw_calibration(stereo_data: Path) -> None:
    path = stereo_data / "kitti_stereo" / "calib_only_kimera" / "calib_cam_to_cam.txt"
    values = read_calibration(path)
    assert "calib_time" not in values and values["corner_dist"] == pytest.approx(0.0995)
    rectified = rig_from_calibration(values, (0, 1), (1242, 375))
    assert (rectified.f_px, rectified.cx_left, rectified.cy) == (721.5377, 609.5593, 172.854)
    assert rectified.baseline_m == pytest.approx(387.5744 / 721.5377)
    assert not rectified.left.D.any()
    color = rig_from_calibration(values, (2, 3), (1242, 375))
    assert color.baseline_m == pytest.approx((339.5242 + 44.85728) / 721.5377)
    raw = rig_from_calibration(values, (0, 1), (1392, 512))
    assert raw.left.K[0, 0] == 984.2439 and raw.right.D[0] == -0.3644661
    assert raw.baseline_m == pytest.approx(rectified.baseline_m)
    # the rotation of the two rectified cameras is that of the extrinsics: R_rect_01 R_01 = R_rect_00
    np.testing.assert_allclose(raw.right.R @ values["R_01"].reshape(3, 3), raw.left.R, atol=1e-5)


@pytest.mark.real_data
def test_real_euroc(stereo_data: Path, tmp_path: Path) -> None:
    dataset = EurocDataset(stereo_data / "euroc" / "V1_01_micro")
    assert dataset.rig.baseline_m == pytest.approx(0.1101, abs=1e-4)
    assert dataset.rig.left.K[0, 0] == 458.654 and dataset.rig.right.D[1] == 0.07451284
    assert convert_dataset(dataset, tmp_path / "euroc.mcap") == 24
    info = inspect_bag(tmp_path / "euroc.mcap")
    assert info.usable and info.exact_pairs == 24
    assert info.duration_s == pytest.approx(23 * 0.05, abs=1e-6)


def test_kitti_matrix_with_missing_numbers(tmp_path: Path) -> None:
    folder = make_kitti(tmp_path)
    (folder / "calib.txt").write_text(f"P0: {P0}\nP1: 50 0 20\n")
    with pytest.raises(BagError, match=r"P1 of the KITTI calibration has 3 numbers, not 12: copy") as caught:
        KittiDataset(folder)
    assert (caught.value.value, caught.value.limit) == (3, 12)


def test_images_of_another_size_after_the_first_pair(tmp_path: Path) -> None:
    names = {f"{side}/{number}.png": number for side in ("left", "right") for number in (1, 2)}
    folder = make_images(tmp_path, names)
    image(folder / "right" / "2.png", (WIDTH, HEIGHT - 2))
    with pytest.raises(CalibrationError, match=rf"right/2\.png.* {WIDTH}x{HEIGHT - 2}"):
        convert_dataset(ImagesDataset(folder), tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_unreadable_images_are_reported_without_the_text_of_opencv(tmp_path: Path) -> None:
    (tmp_path / "empty.png").write_bytes(b"")
    with pytest.raises(BagError, match=r"empty\.png: is not a readable image, it is empty: copy it again$"):
        read_image(tmp_path / "empty.png")
    with pytest.raises(BagError, match=r"gone\.png: does not exist: check the path"):
        read_image(tmp_path / "gone.png")
