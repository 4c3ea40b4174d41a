# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera files: a file as written by camera_calibration, every digit, and every error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_yaml import camera_from_yaml, camera_to_yaml
from stereo_depth_ros.core.errors import CalibrationError, OutputError
from stereo_depth_ros.core.rig import StereoRig

RIGHT_YAML = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo/right
camera_matrix:
  rows: 3
  cols: 3
  data: [537.5, 0.     , 326.2,
           0.     , 536.1, 249.7,
           0.     , 0.     ,   1.     ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.28, 0.07, 1e-05, -2.5e-04, 0.]
rectification_matrix:
  rows: 3
  cols: 3
  data: [ 1, 0, 0,
          0, 1, 0,
          0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [ 500., 0., 320.,  -41.6,
          0., 500., 240.,   0.  ,
          0., 0., 1.,   0.  ]
"""


@pytest.fixture
def camera() -> CameraModel:
    values = np.random.default_rng(5).normal(size=(30,)) * 10.0 ** np.arange(-15, 15)
    return CameraModel(752, 480, "equidistant", values[:9], values[:4] / 3, values[9:18], values[18:])


def test_file_of_camera_calibration() -> None:
    camera = camera_from_yaml(RIGHT_YAML)
    assert (camera.width, camera.height, camera.distortion_model, camera.frame_id) == (640, 480, "plumb_bob", "")
    np.testing.assert_array_equal(camera.K, [[537.5, 0, 326.2], [0, 536.1, 249.7], [0, 0, 1]])
    np.testing.assert_array_equal(camera.D, [-0.28, 0.07, 1e-5, -2.5e-4, 0])
    np.testing.assert_array_equal(camera.R, np.identity(3))
    np.testing.assert_array_equal(camera.P, [[500, 0, 320, -41.6], [0, 500, 240, 0], [0, 0, 1, 0]])


def test_written_is_read_to_the_last_bit(camera: CameraModel) -> None:
    copy = camera_from_yaml(camera_to_yaml(camera, "left"))
    assert (copy.width, copy.height, copy.distortion_model) == (752, 480, "equidistant")
    for name in ("K", "D", "R", "P"):
        np.testing.assert_array_equal(getattr(copy, name), getattr(camera, name))


def test_other_readers_see_numbers(camera: CameraModel) -> None:
    """ROS reads with YAML 1.1, where 1e-05 without a point would be a text."""
    yaml = pytest.importorskip("yaml")
    entries = yaml.safe_load(camera_to_yaml(camera, "narrow/left"))
    assert list(entries) == list(yaml.safe_load(RIGHT_YAML))
    assert entries["camera_name"] == "narrow/left"
    assert entries["projection_matrix"] == {"rows": 3, "cols": 4, "data": camera.P.ravel().tolist()}


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("image_height: 480\n", "", "right.yaml: lacks the key 'image_height'"),
        ("projection_matrix", "projection", "right.yaml: lacks the key 'projection_matrix'"),
        ("537.5,", "", "right.yaml: K has 8 values, it takes 3 x 3"),
        ("537.5", "wide", "right.yaml: a value is not a number.*wide"),
        ("image_width: 640", "image_width: [640]", "right.yaml: a value is not a number"),
        ("camera_matrix:", "camera_matrix: *K", r"right.yaml: is not plain YAML \(alias \*K"),
        (RIGHT_YAML, "", "right.yaml: is not a camera file, it has no keys"),
    ],
)
def test_refused_files(tmp_path: Path, old: str, new: str, match: str) -> None:
    text = RIGHT_YAML.replace(old, new)
    with pytest.raises(CalibrationError, match=f"^{match}") as caught:
        camera_from_yaml(text, "right.yaml")
    assert caught.value.subject == "right.yaml"
    assert caught.value.remedy
    (tmp_path / "left.yaml").write_text(RIGHT_YAML)
    (tmp_path / "right.yaml").write_text(text)
    with pytest.raises(CalibrationError, match=match):
        StereoRig.from_yaml(tmp_path / "left.yaml", str(tmp_path / "right.yaml"))


def test_files_that_cannot_be_opened(camera: CameraModel, tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"none\.yaml: does not exist"):
        StereoRig.from_yaml(tmp_path / "none.yaml", tmp_path / "none.yaml")
    (tmp_path / "image.yaml").write_bytes(b"\xff\xd8\xff\xe0")
    with pytest.raises(CalibrationError, match=r"image\.yaml: byte 0xff in line 1 is not UTF-8"):
        StereoRig.from_yaml(tmp_path / "image.yaml", tmp_path / "image.yaml")
    with pytest.raises(OutputError, match=r"left\.yaml: cannot be written: its folder does not exist"):
        write_camera(tmp_path / "none" / "left.yaml", camera, "left")
