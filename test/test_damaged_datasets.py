# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of datasets that are damaged, of another encoding, or made to harm: refused with the cause and a remedy."""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fuzz_targets import FILES, READERS, SENSOR_YAML

from stereo_depth_ros.core.errors import BagError, StereoDepthError
from stereo_depth_ros.datasets import npz
from stereo_depth_ros.datasets.image_files import read_disparity_image, read_image
from stereo_depth_ros.datasets.npz import read_npz

SENSOR = SENSOR_YAML.format(0.0)


def write(kind: str, folder: Path) -> None:
    for name, data in FILES[kind]().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


@pytest.mark.parametrize("kind", list(FILES))
def test_the_files_are_read_as_they_are(kind: str, tmp_path: Path) -> None:
    write(kind, tmp_path)
    assert next(iter(READERS[kind](tmp_path))).left.pixels.shape[:2] == (48, 64)


@pytest.mark.parametrize(
    ("kind", "name", "old", "new", "says"),
    [
        ("kitti", "calib.txt", "P0:", "P0: é", r"calib\.txt: byte 0xe9 in line 1 is not UTF-8"),
        ("kitti", "calib.txt", "P0:", "P0: \0", r"calib\.txt: is a binary file, not text"),
        (
            "kitti",
            "calib.txt",
            "P0:",
            "P0: one",
            r"calib\.txt: is not a KITTI .* has a word that is not a number",
        ),
        (
            "kitti",
            "calib.txt",
            "P1:",
            "P7:",
            r"calib\.txt: the KITTI .* no P_rect_01, it has 'P0, P7, P2'",
        ),
        ("kitti", "calib.txt", "7.188560000000e+02", "1e400", r"calib\.txt: .*K has a value that is not finite"),
        ("kitti", "calib.txt", "P0: 7.1", "P0: nan 7.1", r"P0 of the KITTI calibration has 13 numbers, not 12"),
        ("kitti", "times.txt", "1.0e-01", "1e400", r"times\.txt: is not a list of time stamps"),
        (
            "kitti",
            "times.txt",
            "1.0e-01",
            "9e99",
            r"times\.txt: the time of .* is outside 0\.\.2147483648",
        ),
        ("kitti raw", "calib_cam_to_cam.txt", "D_00:", "E_00:", "the KITTI calibration has no D_00"),
        ("kitti raw", "image_00/timestamps.txt", "2011-", "9999-", "the time of .* is not one"),
        (
            "middlebury 2014",
            "calib.txt",
            "baseline=",
            "base=",
            r"calib\.txt: is not a .* \(it has no baseline\)",
        ),
        ("middlebury 2014", "calib.txt", "193.001", "1e400", r"calib\.txt: .*P has a value that is not finite"),
        ("middlebury 2014", "calib.txt", "width=64", f"width={'9' * 400}", "is more than 67108864 px"),
        ("middlebury 2005", "dmin.txt", "10", "nan", r"dmin\.txt: does not hold one number but 'nan"),
        (
            "euroc",
            "mav0/cam0/data.csv",
            "1403636579763555584,",
            "1e400,",
            r"data\.csv: its rows are not a stamp",
        ),
        (
            "euroc",
            "mav0/cam0/data.csv",
            "1403636579763555584,",
            f"{'9' * 20},",
            r"data\.csv: has stamps outside 0",
        ),
        (
            "euroc",
            "mav0/cam1/sensor.yaml",
            "resolution: [64, 48]",
            "resolution: [.inf, 48]",
            r"sensor\.yaml: .*resolution: inf",
        ),
        ("euroc", "mav0/cam1/sensor.yaml", "[50.0,", "[fx,", r"sensor\.yaml: .*a value is not a number"),
        (
            "euroc",
            "mav0/cam1/sensor.yaml",
            "intrinsics",
            "intrinsic",
            r"sensor\.yaml: is not the sensor.yaml of",
        ),
        (
            "euroc",
            "mav0/cam1/sensor.yaml",
            "[1.0, 0.0, 0.0, 0.1",
            "[0.0, 0.0, 0.0, 0.1",
            "T_BS = .* is not a rotation",
        ),
        (
            "euroc",
            "mav0/cam1/sensor.yaml",
            SENSOR,
            "[" * 10_000,
            r"sensor\.yaml: is not .* \(more than 32 levels deep\)",
        ),
    ],
)
def test_text_files(kind: str, name: str, old: str, new: str, says: str, tmp_path: Path) -> None:
    write(kind, tmp_path)
    text = (tmp_path / name).read_text("utf-8")
    changed = new if old == SENSOR else text.replace(old, new)
    assert changed != text
    (tmp_path / name).write_bytes(changed.encode("latin-1"))
    with warnings.catch_warnings(), pytest.raises(StereoDepthError, match=says) as caught:
        warnings.simplefilter("error")
        list(READERS[kind](tmp_path))
    assert caught.value.remedy


def test_a_text_file_of_a_gigabyte_is_not_read(tmp_path: Path) -> None:
    write("kitti", tmp_path)
    with (tmp_path / "calib.txt").open("r+b") as file:
        file.truncate(2**30)
    with pytest.raises(BagError, match=r"calib\.txt: is larger than 1048576 bytes"):
        READERS["kitti"](tmp_path)


def test_images_named_by_an_index_are_those_of_its_folder(tmp_path: Path) -> None:
    write("euroc", tmp_path)
    index = tmp_path / "mav0" / "cam0" / "data.csv"
    index.write_text(index.read_text().replace(",1403636579763555584.png", ",../../cam1/data/1403636579763555584.png"))
    dataset = READERS["euroc"](tmp_path)
    assert {path.parent.parent.name for path in dataset.files if path.suffix == ".png"} == {"cam0", "cam1"}


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"Pf\n60000 60000\n-1\n", "its header declares 60000x60000 px and 67108864 px are the limit"),
        (b"P5 99999 99999 255\n", "its header declares 99999x99999 px"),
        (b"Pf\n-4 3\n-1\n", "which is png"),
        (b"Pf\n4 3\nnan\n" + bytes(48), "its pfm is damaged"),
        (b"Pf\n4 3\n-1\n" + bytes(47), "its pfm is damaged"),
        (b"P5 4 3 255\n" + bytes(11), "its pnm is damaged"),
        (b"P5 4 3 0\n" + bytes(12), "its pnm is damaged"),
        (b"\x76\x2f\x31\x01" + bytes(100), "which is png, jpeg"),
    ],
)
def test_image_files(data: bytes, says: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.pfm").write_bytes(data)
    for read in (read_image, read_disparity_image):
        with pytest.raises(BagError, match=rf"a\.pfm: is not a readable image, {says}"):
            read(tmp_path / "a.pfm")
    assert capfd.readouterr().err == ""  # none of OpenCV's own lines


def npz_file(header: str, payload: bytes) -> bytes:
    file = io.BytesIO()
    padded = header.encode().ljust(117) + b"\n"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", b"\x93NUMPY\x01\0" + struct.pack("<H", len(padded)) + padded + payload)
    return file.getvalue()


def header(descr: str, shape: str) -> str:
    return f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "it is damaged, or not an .npz file"),
        (b"PK\3\4 no zip", "it is damaged, or not an .npz file"),
        (
            npz_file(header("<f4", "(1099511627776, 8)"), bytes(64)),
            "it has 64 bytes, its header declares 1099511627776x8",
        ),
        (
            npz_file(header("|O", "(2, 2)"), b"cos\nsystem\n(S'true'\ntR."),
            "its first array has 2x2 values of type object",
        ),
        (npz_file(header("<f4", "(16,)"), bytes(64)), "its first array has 16 values of type float32"),
        (npz_file("__import__('os')", b""), "it is damaged, or not an .npz file"),
    ],
)
def test_arrays(data: bytes, says: str, tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(BagError, match=f"a.npz: is not a readable array of disparities, {says}"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize("declared", ["as it is", "as little"])
def test_an_array_that_inflates_beyond_the_limit(
    declared: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether the directory of the zip file says so or not."""
    monkeypatch.setattr(npz, "MAX_ARRAY_BYTES", 10_000)
    data = bytearray(npz_file(header("<f4", "(100, 100)"), bytes(40_000)))
    if declared == "as little":
        size = struct.pack("<I", 40_128)
        for at in (data.index(size), data.rindex(size)):
            data[at : at + 4] = struct.pack("<I", 500)
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(BagError, match=r"a\.npz: is not a readable array of disparities, it"):
        read_npz(tmp_path / "a.npz")


def test_arrays_of_other_numbers(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", np.array([[1, 2, 3], [4, 5, 60000]], ">u2"))
    np.testing.assert_array_equal(read_npz(tmp_path / "a.npz"), np.array([[1, 2, 3], [4, 5, 60000]], np.float32))


def test_truth_of_another_size_than_the_images(tmp_path: Path) -> None:
    write("npz", tmp_path)
    np.savez(tmp_path / "a_disp.npz", np.ones((47, 64), np.float32))
    with pytest.raises(BagError, match=r"a_disp\.npz: its disparities are 64x47, the images are 64x48"):
        list(READERS["npz"](tmp_path))
