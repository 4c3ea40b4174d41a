# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PLY files: header, binary and text, refusal to overwrite."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.files.ply import write_ply

POINTS = np.array([[0.1, -2.0, 3.5], [4.0, 5.25, 1e-3]])
HEADER = "ply\nformat {} 1.0\ncomment meters\nelement vertex 2\n{}end_header\n"
NAMES = "property float x\nproperty float y\nproperty float z\n"


def test_binary(tmp_path: Path) -> None:
    write_ply(tmp_path / "a" / "p.ply", POINTS, {"intensity": np.array([7, 9])})
    header = HEADER.format("binary_little_endian", f"{NAMES}property float intensity\n").encode()
    data = (tmp_path / "a" / "p.ply").read_bytes()
    assert data.startswith(header)
    table = np.frombuffer(data[len(header) :], "<f4").reshape(2, 4)
    np.testing.assert_array_equal(table, np.column_stack((POINTS, [7, 9])).astype("<f4"))
    with pytest.raises(OutputError, match="already exists"):
        write_ply(tmp_path / "a" / "p.ply", POINTS)


def test_text_and_no_points(tmp_path: Path) -> None:
    write_ply(tmp_path / "p.ply", POINTS, text=True)
    header = HEADER.format("ascii", NAMES)
    assert (tmp_path / "p.ply").read_text() == f"{header}0.100000001 -2 3.5\n4 5.25 0.00100000005\n"
    write_ply(tmp_path / "p.ply", np.empty((0, 3)), overwrite=True)
    assert b"element vertex 0\n" in (tmp_path / "p.ply").read_bytes()
