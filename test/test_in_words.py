# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Causes are words: no errno, no texts of the system or of Python, whatever stands in the place of a file."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from stereo_depth_ros.cli.errors import error_text
from stereo_depth_ros.config.ros_yaml import node_parameters
from stereo_depth_ros.core.errors import BagError, StereoDepthError
from stereo_depth_ros.core.in_words import in_words, kind_in_words
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.datasets.image_files import read_image
from stereo_depth_ros.files.output import OutputFile, check_outputs, write_file

FORBIDDEN = (
    "Errno",
    "No such file",
    "Is a directory",
    "Not a directory",
    "Permission denied",
    "No space left",
    "codec",
)


def refused(act: object, *arguments: object, **options: object) -> str:
    with pytest.raises((StereoDepthError, OSError)) as caught:
        act(*arguments, **options)  # type: ignore[operator]
    text = error_text(caught.value)  # type: ignore[arg-type]
    assert not [word for word in FORBIDDEN if word in text], text
    return text


READERS = [read_image, node_parameters, lambda path: StereoRig.from_yaml(path, path), Path.read_text]


@pytest.mark.parametrize("read", READERS, ids=["image", "parameters", "calibration", "any"])
def test_what_stands_in_the_place_of_a_file(read: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("a")
    assert "does not exist" in refused(read, tmp_path / "none")
    assert "is a folder" in refused(read, tmp_path)
    assert "what its path names as a folder is a file" in refused(read, tmp_path / "file" / "below")
    assert "its name is too long" in refused(read, tmp_path / ("n" * 300))
    (tmp_path / "circle").symlink_to("circle")
    assert "its links form a circle" in refused(read, tmp_path / "circle")

    def forbidden(*_: object, **__: object) -> None:  # the permissions of files do not count for root
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), "file")

    monkeypatch.setattr("pathlib.Path.open", forbidden)
    monkeypatch.setattr("io.open", forbidden)
    assert "the permission is missing" in refused(read, tmp_path / "file")


def test_outputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("a")
    assert "its folder does not exist: choose" in refused(write_file, tmp_path / "none" / "a.png", b"")
    below = tmp_path / "file" / "below.png"
    assert "what its path names as a folder is a file" in refused(write_file, below, b"")
    assert "what its path names as a folder is a file" in refused(check_outputs, [below])
    assert "it is a folder: name a file" in refused(check_outputs, [tmp_path])
    assert "its name is too long: choose a shorter name" in refused(check_outputs, [tmp_path / ("n" * 300)])
    assert "the disk is full: free space on the disk" in refused(write_file, Path("/dev/full"), b"a")

    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(tmp_path))

    monkeypatch.setattr("tempfile.TemporaryFile", read_only)
    assert "the disk is read-only: choose a writable folder" in refused(check_outputs, [tmp_path / "new.png"])
    monkeypatch.setattr("pathlib.Path.open", read_only)
    assert "the disk is read-only: choose a writable folder" in refused(OutputFile, tmp_path / "new.png")


def test_other_causes() -> None:
    assert in_words(BagError("is cut")) == "is cut"
    assert in_words(OSError("odd")) == "odd"
    assert in_words(OSError(errno.ECONNRESET, "Connection reset by peer")) == "the system says connection reset by peer"


def test_kinds() -> None:
    kinds = (True, 1, 1.5, "a", None, [1], np.zeros(2), {})
    assert [kind_in_words(type(kind)) for kind in kinds] == [
        "true or false",
        "a whole number",
        "a number",
        "text",
        "empty",
        "a list",
        "a list",
        "a mapping",
    ]
