# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Video files are complete or absent, of one size, gray or in color."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.views.video import VideoFile


def test_frames_are_read_back(tmp_path: Path) -> None:
    levels = (40, 120, 200)
    with VideoFile(tmp_path / "new" / "v.mp4", 12.5) as video:
        for level in levels:
            video.add(np.full((61, 83), level, np.uint8))
    found = cv2.VideoCapture(str(tmp_path / "new" / "v.mp4"))
    assert found.get(cv2.CAP_PROP_FPS) == pytest.approx(12.5)
    for level in levels:
        image = found.read()[1]
        assert image.shape == (60, 82, 3)
        assert abs(float(image.mean()) - level) < 4
    assert not found.read()[0]


def test_nothing_is_left_after_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    changed = pytest.raises(OutputError, match=r"v\.mp4: the size changes to 40x20: write an image")
    with changed, VideoFile(tmp_path / "v.mp4", 10) as video:
        video.add(np.zeros((20, 30, 3), np.uint8))
        video.add(np.zeros((20, 40, 3), np.uint8))
    with VideoFile(tmp_path / "empty.mp4", 10):
        pass
    assert [*tmp_path.iterdir()] == [tmp_path / "temporary"]
    assert not [*(tmp_path / "temporary").iterdir()]


def test_existing_file_is_kept(tmp_path: Path) -> None:
    (tmp_path / "v.mp4").write_bytes(b"old")
    with pytest.raises(OutputError, match="already exists"):
        VideoFile(tmp_path / "v.mp4", 10)
    with pytest.raises(ZeroDivisionError), VideoFile(tmp_path / "v.mp4", 10, overwrite=True) as video:
        video.add(np.zeros((20, 30), np.uint8))
        raise ZeroDivisionError
    assert (tmp_path / "v.mp4").read_bytes() == b"old"
    with VideoFile(tmp_path / "v.mp4", 10, overwrite=True) as video:
        video.add(np.zeros((20, 30), np.uint8))
    assert (tmp_path / "v.mp4").stat().st_size > 100
