# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth calibrate-laser`: files, figures, wrong input."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from light_stripe_images import BOARD_PLANE, board_camera
from rendered_boards import SQUARE_M
from test_plane_calibration import images

from stereo_depth_ros.active.light_stripe.plane_file import read_plane
from stereo_depth_ros.core.camera_yaml import camera_to_yaml

BOARD = ("--size", "7x5", "--square", SQUARE_M, "--param", "stripe_channel:=green_excess")


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("calibrate-laser", columns=100)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four boards, and one image without."""
    (tmp_path / "boards").mkdir()
    for name, frame in images():
        cv2.imwrite(str(tmp_path / "boards" / name), frame.pixels)
    cv2.imwrite(str(tmp_path / "boards" / "10.png"), np.full((300, 400, 3), 80, np.uint8))
    (tmp_path / "camera.yaml").write_text(camera_to_yaml(board_camera(), "camera"))
    return tmp_path


def test_files_and_figures(run: Run, folder: Path) -> None:
    output = folder / "out" / "laser.yaml"
    more = ("--camera", folder / "camera.yaml", "-o", output, "--json", folder / "r.json")
    code, out, err = run(folder / "boards", *BOARD, *more)
    assert code == 0, err
    plane, camera = read_plane(output)
    assert float(plane.normal @ BOARD_PLANE[:3]) == pytest.approx(1, abs=1e-5)
    np.testing.assert_array_equal(camera.D, board_camera().D)
    values = json.loads((folder / "r.json").read_text())
    assert values["images"] == {"total": 5, "used": 4}
    np.testing.assert_allclose(values["normal"], plane.normal, rtol=1e-12)
    assert "10.png: no board of 7x5 inner corners" in err
    assert out.index("3.png") < out.index("5 examined, 4 used")  # in the order of the numbers
    image = cv2.imread(str(output.with_suffix(".png")))
    assert image is not None
    assert image.shape[1] > 1000
    code, _, err = run(folder / "boards", *BOARD, *more[:4])
    assert (code, "already exists" in err) == (1, True)


def test_wrong_input_is_one_line(run: Run, folder: Path) -> None:
    camera = ("--camera", folder / "camera.yaml", "-o", folder / "laser.yaml")
    for arguments, text in (
        ((folder / "absent", *BOARD, *camera), "absent: does not exist: name a folder of images"),
        ((folder / "boards", *BOARD[:4], *camera[:2], "-o", folder / "laser.txt"), "does not end in .yaml"),
        ((folder / "boards", "--size", "9x6", "--square", "0.03", *camera), "found in 0 of 5 images, at least 3"),
        ((folder / "boards", *BOARD, "--marker", "0.02", *camera), "--marker has no effect with --board chessboard"),
        ((folder / "boards", *BOARD, "--camera", folder / "no.yaml", *camera[2:]), "no.yaml"),
        ((folder / "boards", *BOARD, "--param", "stripe_width:=1", *camera), "stripe_width"),
        ((folder / "boards", *BOARD, "--param", "disparity_range:=64", *camera), "has no effect"),
    ):
        code, _, err = run(*arguments)
        assert code in (1, 2), text
        assert text in err
        assert err.count("\n") == 1, err
    assert not (folder / "laser.yaml").exists()
