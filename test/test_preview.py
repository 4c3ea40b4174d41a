# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The preview image: colors, legend, size, errors."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import ImageError, OutputError
from stereo_depth_ros.plots.preview import color_depth, legend_ticks, preview, save_preview

SHAPE = (60, 96)


def ramp() -> np.ndarray:
    """Depth 2 m at the left to 8 m at the right, linear in 1 / Z; row 0 invalid."""
    depth_m = np.tile(1 / np.linspace(1 / 2, 1 / 8, SHAPE[1]), (SHAPE[0], 1)).astype(np.float32)
    depth_m[0] = np.nan
    return depth_m


def test_colors_are_turbo_linear_in_inverse_depth_and_black_where_invalid() -> None:
    colors = color_depth(ramp(), 2.0, 8.0)
    turbo = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0]
    assert not colors[0].any()
    np.testing.assert_array_equal(colors[5, 0], turbo[255])
    np.testing.assert_array_equal(colors[5, -1], turbo[0])
    middle = color_depth(np.full((1, 1), 1 / (0.5 * (1 / 2 + 1 / 8)), np.float32), 2.0, 8.0)
    np.testing.assert_array_equal(middle[0, 0], turbo[128])  # 127.5 is rounded up


@pytest.mark.parametrize(("near_m", "far_m"), [(1.7, 7.0), (0.31, 0.35), (4.0, 180.0)])
def test_legend_ticks_are_inside_the_range_and_a_line_apart(near_m: float, far_m: float) -> None:
    bar_px = 480
    ticks = legend_ticks(near_m, far_m, bar_px)
    assert len(ticks) >= 3
    assert all(near_m <= tick <= far_m for tick in ticks)
    places = bar_px * (1 / np.array(ticks) - 1 / far_m) / (1 / near_m - 1 / far_m)
    assert np.diff(places).max() <= -20, "nearer is higher, with a line of text between"


def test_preview_has_the_left_image_and_the_depth_beside_it() -> None:
    left = np.arange(np.prod(SHAPE), dtype=np.uint32).reshape(SHAPE).astype(np.uint8)
    image = preview(left, ramp(), "title")
    scale = 7  # 96 px become 672, next to the 640 of a panel
    assert image.shape[1] > 2 * scale * SHAPE[1]
    panel = np.kron(left, np.ones((scale, scale), np.uint8))
    rows = [y for y in range(image.shape[0] - panel.shape[0]) if (image[y : y + 420, 16, 0] == panel[:, 0]).all()]
    assert len(rows) == 1
    np.testing.assert_array_equal(image[rows[0] : rows[0] + 420, 16 : 16 + 672, 1], panel)
    depth_x = 16 + 672 + 16
    assert not image[rows[0], depth_x : depth_x + 672].any(), "row 0 is invalid"
    assert image[rows[0] + scale, depth_x, 2] > image[rows[0] + scale, depth_x, 0], "near is red"


def test_nothing_valid_gives_a_black_panel_and_no_error() -> None:
    image = preview(np.full(SHAPE, 90, np.uint8), np.full(SHAPE, np.nan, np.float32))
    assert not image[16 : 16 + 420, 16 + 672 + 16 : 16 + 672 + 16 + 672].any()


def test_sizes_that_differ_are_refused() -> None:
    with pytest.raises(ImageError, match=r"\(60, 95\).*\(60, 96\)"):
        preview(np.zeros((60, 95), np.uint8), ramp())


def test_preview_is_written_as_png(tmp_path: Path) -> None:
    path = tmp_path / "new" / "p.png"
    left = np.full((*SHAPE, 3), (10, 20, 30), np.uint8)
    save_preview(path, left, ramp(), "title")
    np.testing.assert_array_equal(cv2.imread(str(path)), preview(left, ramp(), "title"))


def test_folder_that_cannot_be_created_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match=r"file/p\.png: cannot be written"):
        save_preview(tmp_path / "file" / "p.png", np.zeros(SHAPE, np.uint8), ramp())
