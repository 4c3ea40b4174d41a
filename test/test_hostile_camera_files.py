# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile and damaged calibration files: one line with a remedy, whatever they hold."""

from __future__ import annotations

import gzip
import io
import json
import os
import tarfile
from collections.abc import Callable
from pathlib import Path

import camera_file_texts as texts
import numpy as np
import pytest
from camera_file_texts import truth
from mutations import mutated

from stereo_depth_ros.camera_files import documents
from stereo_depth_ros.camera_files.reading import read_rig_files
from stereo_depth_ros.core.camera_yaml import camera_to_yaml
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig

TRUE = truth("plumb_bob 5")
RIG = StereoRig.from_calibration(TRUE.K_left, TRUE.D_left, TRUE.K_right, TRUE.D_right, TRUE.R, TRUE.T, texts.SIZE)
LEFT, RIGHT = camera_to_yaml(RIG.left, "left"), camera_to_yaml(RIG.right, "right")
CHAIN = texts.camchain(TRUE, "radtan")
STEREO = texts.opencv_yaml({**texts.opencv_intrinsics(TRUE), **texts.opencv_extrinsics(TRUE, rectified=False)})
DEPTHAI = texts.depthai(TRUE)
LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]\n" for level in range(1, 12)
)
DIGITS = "9" * 400


def refused(paths: list[Path], match: str = ".") -> None:
    with pytest.raises(CalibrationError, match=match) as caught:
        read_rig_files(paths, texts.SIZE)
    line = str(caught.value)
    assert caught.value.subject and caught.value.remedy
    assert line.isprintable() and len(line) < 1000, line


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (LAUGHS + LEFT.replace("plumb_bob", "*a11"), "more than 50000 values, those that aliases repeat included"),
        (LEFT.replace("image_width: 640", "image_width: .inf"), r"a value is not a number \(image_width: inf\)"),
        (LEFT.replace("image_width: 640", f"image_width: {DIGITS}"), r"not a number \(image_width: inf\)"),
        (LEFT.replace("image_width: 640", "image_width: 123456789012345678"), "not a whole number of 0 to 65535"),
        (LEFT.replace("image_width: 640", "image_width: [640]"), r"not a number \(image_width: a list\)"),
        (LEFT.replace("image_width: 640", "image_width:"), r"not a number \(image_width: nothing\)"),
        (LEFT.replace("image_width: 640", "image_width: '640'"), r"not a number \(image_width: '640'\)"),
        (LEFT.replace("image_width: 640", "image_width: true"), r"not a number \(image_width: True\)"),
        (LEFT.replace("image_width: 640", "image_width: -640"), "not a whole number"),
        (LEFT.replace("image_width: 640", "image_width: 640.5"), "not a whole number"),
        (LEFT.replace("data: [", "data: [.nan, ", 1), r"not a number \(camera_matrix: nan\)"),
        (LEFT.replace("data: [", "data: [wide, ", 1), r"not a number \(camera_matrix: 'wide'\)"),
        (LEFT.replace("data: [", "data: [\"\\e[31m\", ", 1), r"camera_matrix: '\\x1b\[31m'"),
        (LEFT.replace("data: [", "data: [{a: 1}, ", 1), r"not a number \(camera_matrix: a mapping\)"),
        (LEFT.replace("data: [", "data: [1, ", 1), "K has 10 values, it takes 3 x 3"),
        (LEFT.replace("data: [", f"data: [{DIGITS}, ", 1), r"not a number \(camera_matrix: inf\)"),
        (LEFT.replace("camera_matrix:", "camera_matrix: 3 #", 1).replace("  rows: 3\n  cols: 3\n  data", "x", 1), "."),
        (LEFT.replace("distortion_model: plumb_bob", f"distortion_model: {'b' * 5000}"), "distortion_model 'b+'"),
        (LEFT.replace("distortion_model: plumb_bob", "distortion_model: [a, b]"), "distortion_model"),
        ("[" * 100_000, "more than 32 levels deep"),
        (LEFT + "D: " + "[" * 100_000, "more than 32 levels deep"),
        ("{" * 100_000, "is not JSON"),
        ('{"cameraData": ' + "[" * 100_000, "is not plain JSON"),
        (f'{{"cameraData": {"9" * 5000}}}', "is not plain JSON"),
        ("<a>" * 1000, "is not XML"),
        ("<opencv_storage>" + "<a>" * 100 + "</a>" * 100 + "</opencv_storage>", "is XML of more than 32 levels"),
        ('<!DOCTYPE a [<!ENTITY b "x">]><opencv_storage>&b;</opencv_storage>', "is XML with a document type"),
        ("<svg/>", "is XML, but not of OpenCV's FileStorage"),
        ("<opencv_storage/>", "has no keys"),
        ("- 1\n- 2\n", "has no keys"),
        ("", "has no keys"),
        ("a" * 2_000_000, "is larger than 1048576 bytes"),
        (CHAIN.replace("resolution: [640, 400]", "resolution: [640, .inf]"), r"not a number \(cam0\.resolution: inf\)"),
        (CHAIN.replace("resolution: [640, 400]", "resolution: 640"), "."),
        (CHAIN.replace("intrinsics: [", "intrinsics: [null, "), r"not a number \(cam0\.intrinsics: nothing\)"),
        (CHAIN.replace("  distortion_coeffs: [", "  distortion_coeffs: {a: 1} #"), "cam0.distortion_coeffs"),
        (CHAIN.replace("cam1:\n", "cam1: 3\nother:\n"), "but cam1 holds no keys"),
        (CHAIN.replace("cam1:\n", "cam1: [T_cn_cnm1]\nother:\n"), "but cam1 holds no keys"),
        (CHAIN.replace("camera_model: pinhole", "camera_model: [pinhole]"), "of a camera of model"),
        (CHAIN.replace("[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 1.0, 1.0]"), "the last row of T_cn_cnm1"),
        (STEREO.replace("data: [ ", "data: [ x, ", 1), "."),
        (STEREO.replace("data: [ ", "data: [ [[[1]]], ", 1), "."),
        (DEPTHAI.replace('"x": ', '"x": 1e999, "y2": '), "."),
        (DEPTHAI.replace('"toCameraSocket": 2', '"toCameraSocket": 1'), "without extrinsics"),
        (DEPTHAI.replace('"toCameraSocket": 2', '"toCameraSocket": [2]'), "without extrinsics"),
        (json.dumps({"cameraData": [[1, 2, 3]]}), "cameraData is not a list"),
        (json.dumps({"cameraData": {"a": {}}}), "a socket that is not a number"),
        (json.dumps({"cameraData": [[1, None], [2, None]], "stereoRectificationData": []}), "."),
        ("[image]\nwidth\n640\n\nheight\n4e9\n[c]\ncamera matrix\n1 2\n", "height = 4e9 is not possible"),
        ("[image]\nwidth\n640\n[c]\n", "height has 0 numbers"),
        ("[image]\nwidth\nx\n", "width has 0 numbers"),
        ("P0: 1 2 3 4 5 6 7 8 9 10 11 x\nP1: 1 2 3 4 5 6 7 8 9 10 11 12\n", "."),
        ("P0: 1 2 3 4 5 6 7 8 9 10 11 12\n", "has no P_rect_01"),
        ("cam0=[1 2; 3]\n", "is not a Middlebury calibration"),
        ("cam0_calib: ../../../../etc/passwd\ncam1_calib: x\nbody_T_cam0: 1\nbody_T_cam1: 2\n", "body_T_cam0"),
    ],
)  # fmt: skip
def test_one_line_for_each(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "left.yaml").write_text(text)
    (tmp_path / "right.yaml").write_text(RIGHT)
    refused(
        [tmp_path / "left.yaml", tmp_path / "right.yaml"] if "image_width" in text else [tmp_path / "left.yaml"], match
    )


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (LEFT.encode("utf-16"), "is UTF-16 text: save it as UTF-8"),
        (LEFT.encode("utf-16-le"), "is a binary file"),
        (LEFT.replace("left", "lünks").encode("latin-1"), "byte 0xfc in line 3 is not UTF-8"),
        (LEFT.replace("left", "le\0ft").encode(), "is a binary file"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "is a binary file"),
        (b"BZh91AY", "is a packed file"),
        (b"\x1f\x8b" + bytes(100), "is not the gzip archive of a calibration"),
        (gzip.compress(LEFT.encode()), "is not the gzip archive of a calibration"),
    ],
)
def test_other_encodings_and_binary_files(tmp_path: Path, data: bytes, match: str) -> None:
    (tmp_path / "left.yaml").write_bytes(data)
    (tmp_path / "right.yaml").write_text(RIGHT)
    refused([tmp_path / "left.yaml", tmp_path / "right.yaml"], match)


def test_a_byte_order_mark_is_taken(tmp_path: Path) -> None:
    for name, text in (("left.yaml", LEFT), ("right.yaml", RIGHT)):
        (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    np.testing.assert_array_equal(read_rig_files([tmp_path]).right.P, RIG.right.P)


def test_paths_that_are_not_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    for path, match in (
        (tmp_path, "is a folder without the files of a calibration"),
        (tmp_path / "none.yaml", "does not exist"),
        (tmp_path / "pipe.yaml", "is a device or a pipe, not a file"),
        (Path("/dev/zero"), "is a device or a pipe, not a file"),
        (tmp_path / "a\0b.yaml", "cannot be read|does not exist"),
    ):
        with pytest.raises(CalibrationError, match=match):
            read_rig_files([path])


def archive(
    path: Path, members: dict[str, bytes], change: Callable[[tarfile.TarInfo], None] = lambda member: None
) -> Path:
    with tarfile.open(path, "w:gz") as file:
        for name, data in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            change(member)
            file.addfile(member, io.BytesIO(data) if member.isreg() else None)
    return path


def test_archives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(documents, "MAX_ARCHIVE_BYTES", 2**24)  # a bomb of the real limit would take a second
    monkeypatch.setattr(documents, "_MAX_MEMBERS", 100)
    both = {"left.yaml": LEFT.encode(), "right.yaml": RIGHT.encode()}
    bomb = archive(tmp_path / "bomb.tar.gz", {"left-0.png": bytes(2**25), **both})
    assert bomb.stat().st_size < 2**17
    refused([bomb], "unpacks to more than 16777216 bytes")
    refused(
        [archive(tmp_path / "large.tar.gz", {**both, "left.yaml": bytes(2**21)})], r"left\.yaml in it is larger than"
    )
    refused(
        [archive(tmp_path / "images.tar.gz", {"left-0.png": b"x"})], r"is an archive without left\.yaml and right\.yaml"
    )

    def link(member: tarfile.TarInfo) -> None:
        member.type, member.linkname, member.size = tarfile.SYMTYPE, "/etc/passwd", 0

    refused([archive(tmp_path / "links.tar.gz", both, link)], "is an archive without")
    refused([archive(tmp_path / "many.tar.gz", {f"{n}": b"" for n in range(101)})], "holds more than 100 files")
    outside = {f"../../{tmp_path.name}_{name}/{name}": data for name, data in both.items()}
    rig = read_rig_files([archive(tmp_path / "paths.tar.gz", outside)])
    np.testing.assert_array_equal(rig.left.K, RIG.left.K)
    assert not list(tmp_path.parent.glob(f"{tmp_path.name}_*"))
    header = io.BytesIO()
    with tarfile.open(fileobj=header, mode="w") as file:
        member = tarfile.TarInfo("left.yaml")
        member.pax_headers = {"comment": "x"}
        file.addfile(member)
    cut = header.getvalue()[:512]
    huge = bytearray(cut)
    huge[124:136] = b"77777777777\0"
    huge[156:157] = b"x"
    huge[148:156] = b" " * 8
    huge[148:156] = b"%06o\0 " % sum(huge)
    (tmp_path / "pax.tar").write_bytes(bytes(huge))
    refused([tmp_path / "pax.tar"], "is not the tar archive of a calibration, or is damaged")


LEFT_MATRICES, RIGHT_MATRICES = ((each.K, each.D, each.R, each.P) for each in (RIG.left, RIG.right))
FILES = {
    "left.yaml": LEFT.encode(),
    "camchain.yaml": CHAIN.encode(),
    "stereo.yml": STEREO.encode(),
    "stereo.xml": texts.opencv_xml({**texts.opencv_intrinsics(TRUE), **texts.opencv_extrinsics(TRUE, True)}).encode(),
    "depthai.json": DEPTHAI.encode(),
    "orb.yaml": texts.orb_slam(TRUE, "PinHole").encode(),
    "ost.txt": texts.videre([("left", *LEFT_MATRICES), ("right", *RIGHT_MATRICES)]).encode(),
    "calib.txt": b"P0: 451.5 0 299 0 0 452 190.25 0 0 0 1 0\nP1: 451.5 0 303.5 -33.8625 0 452 190.25 0 0 0 1 0\n",
}


@pytest.mark.parametrize("name", FILES)
def test_damaged_files(tmp_path: Path, name: str) -> None:
    """Damage of any kind gives a rig or an error of one line."""
    random = np.random.default_rng(sum(name.encode()))
    path = tmp_path / name
    (tmp_path / "right.yaml").write_text(RIGHT)
    for _ in range(25):
        path.write_bytes(mutated(FILES[name], random))
        try:
            read_rig_files([path], texts.SIZE)
        except CalibrationError as error:
            assert str(error).isprintable(), error
