# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images of errors and of confidences: colors, places, sizes, errors."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import ImageError, OutputError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.plots.curve import curve_plot
from stereo_depth_ros.plots.drawing import enlarged, round_ticks, save_png
from stereo_depth_ros.plots.error import error_colors, error_plot

NAN = np.nan


def test_each_class_of_errors_has_its_color() -> None:
    truth = np.full((1, 12), 20, np.float32)
    truth[0, 11] = NAN
    found = truth + np.array([[0, 0.5, -0.6, 1, 1.1, -2, 2.5, 4, 4.5, -9, NAN, 0]], np.float32)
    colors = error_colors(truth, found)[0]
    same = [(0, 1), (2, 3), (4, 5), (6, 7), (8, 9)]
    for first, second in same:
        np.testing.assert_array_equal(colors[first], colors[second])
    assert len({tuple(color) for color in colors.tolist()}) == 7  # five classes, no disparity, no truth
    assert colors[0, 0] > colors[0, 2] and colors[8, 2] > colors[8, 0]  # BGR: right is blue, wrong is red
    assert not colors[10].any()


def test_panels_lie_two_by_two_and_share_the_colors_of_the_truth() -> None:
    left = np.full((60, 300), 77, np.uint8)  # enlarged twice
    truth = np.tile(np.linspace(5, 45, 300, dtype=np.float32), (60, 1))
    found = truth.copy()
    found[:, :100] = NAN
    found[:, 200:] = 90  # beyond the scale: its upper end
    image = error_plot(left, truth, found, "scene: method", "error")
    turbo = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0]
    x, y, dx, dy = 16, 44, 600 + 16, 120 + 30
    assert image[y + 60, x + 300].tolist() == [77, 77, 77]
    np.testing.assert_array_equal(image[y + 60, x + dx], turbo[0])
    np.testing.assert_array_equal(image[y + 60, x + dx + 599], turbo[255])
    assert not image[y + dy + 60, x + 100].any()
    np.testing.assert_array_equal(image[y + dy + 60, x + 300], image[y + 60, x + dx + 300])
    np.testing.assert_array_equal(image[y + dy + 60, x + 500], turbo[255])
    np.testing.assert_array_equal(
        image[y + dy : y + dy + 120, x + dx : x + dx + 600], enlarged(error_colors(truth, found), 600)
    )


def test_truth_of_one_value_and_none_can_be_drawn() -> None:
    left = np.zeros((40, 60, 3), np.uint8)
    for value in (7.0, NAN):
        truth = np.full((40, 60), value, np.float32)
        assert error_plot(left, truth, truth, "", "").shape[2] == 3


def test_sizes_must_agree() -> None:
    left, truth = np.zeros((4, 6), np.uint8), np.zeros((4, 6), np.float32)
    with pytest.raises(ImageError, match=r"left image \(4, 6\), truth \(4, 6\) and disparity \(4, 5\) differ"):
        error_plot(left, truth, truth[:, 1:], "", "")
    with pytest.raises(ImageError, match=r"left image \(4, 5\)"):
        error_plot(left[:, 1:], truth, truth, "", "")


@pytest.mark.parametrize(
    ("low", "high", "most", "ticks"),
    [(0, 100, 10, [*range(0, 101, 10)]), (7.5, 17.5, 5, [8, 10, 12, 14, 16]), (0, 0.7, 3, [0, 0.5]), (-3, 3, 2, [0])],
)
def test_ticks_are_round(low: float, high: float, most: int, ticks: list[float]) -> None:
    assert round_ticks(low, high, most) == pytest.approx(ticks)


def columns_of(image: U8, color: tuple[int, int, int]) -> tuple[int, int]:
    found = np.flatnonzero((image[66:] == color).all(axis=2).any(axis=0))  # below title and legend
    return int(found.min()), int(found.max())


def test_curve_ends_at_the_density_and_at_the_error_of_all() -> None:
    error = np.linspace(2, 8, 1000)
    image = curve_plot(error, np.linspace(0, 8, 1000), 0.5, "title", "percent")
    ours = (72, 150, 253)
    first, last = columns_of(image, ours)
    assert first == pytest.approx(70 + 0.01 * 0.5 * 626, abs=3) and last == pytest.approx(70 + 0.5 * 626, abs=3)
    assert columns_of(image, (180, 160, 49))[1] < last  # the best order is met from below
    rows = np.flatnonzero((image[66:, 70 + 156] == ours).all(axis=1)) + 66
    # a quarter of the axis is half of the pixels, where the error is 5 of an axis of 1.15 x 8
    assert rows.mean() == pytest.approx(368 - 5 / 9.2 * (420 - 62 - 52), abs=2)


def test_image_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    image = np.zeros((3, 4, 3), np.uint8)
    save_png(tmp_path / "new" / "a.png", image)
    assert cv2.imread(str(tmp_path / "new" / "a.png")).shape == (3, 4, 3)
    with pytest.raises(OutputError, match=r"a\.png/b\.png: cannot be written: .* choose a writable folder"):
        save_png(tmp_path / "new" / "a.png" / "b.png", image)
