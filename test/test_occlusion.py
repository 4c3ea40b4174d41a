# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Occlusion from the left truth: by hand, against exact geometry, against a published mask."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stereo_depth_ros.evaluation.occlusion import visible_pixels
from stereo_depth_ros.evaluation.scenes import find_scenes
from stereo_depth_ros.synthetic.sequence import SyntheticSequence


def visible(*rows: list[float]) -> list[list[int]]:
    return visible_pixels(np.array(rows, np.float32)).astype(int).tolist()


def test_nearer_surface_occludes_what_maps_to_its_right_pixels() -> None:
    # Columns 4 and 5 at 3 px map to 1 and 2, as columns 2 and 3 at 1 px do; column 0 maps outside of the image. The row
    # below has no near surface and no occlusion.
    assert visible([1, 1, 1, 1, 3, 3, 1, 1], [1] * 8) == [[0, 1, 0, 0, 1, 1, 1, 1], [0, 1, 1, 1, 1, 1, 1, 1]]


def test_surface_between_the_mapped_pixels_is_visible() -> None:
    # A thin cylinder, column 6 at 5 px, maps to 1: column 2 is occluded, columns 3 to 5 map right of it and are not.
    assert visible([1, 1, 1, 1, 1, 1, 5, 1]) == [[0, 1, 0, 1, 1, 1, 1, 1]]


def test_step_of_one_pixel_occludes_and_a_slanted_surface_does_not() -> None:
    assert visible([1, 1, 1, 2, 2, 2]) == [[0, 1, 0, 1, 1, 1]]
    slanted = [0.45 * x for x in range(7)]  # maps to 0, 0.55, 1.1, 1.65, ...: two neighbors share a right pixel
    assert visible(slanted) == [[1] * 7]


def test_unknown_truth_is_not_visible_and_occludes_nothing() -> None:
    assert visible([1, 1, 1, 1, np.nan, np.inf, 1, 1]) == [[0, 1, 1, 1, 0, 0, 1, 1]]


def test_negative_disparities_map_outside_at_the_right_edge() -> None:
    assert visible([-2, -2, -2, -2, -2]) == [[1, 1, 1, 0, 0]]


def test_agrees_with_exact_visibility_of_a_rendered_room() -> None:
    frame = SyntheticSequence(frames=1, width=200, height=130)[0]
    known = np.isfinite(frame.truth_disparity_px)
    # They differ at edges of surfaces by half a pixel, and where the raw right image ends before the rectified one.
    computed = visible_pixels(frame.truth_disparity_px)
    assert np.mean(computed[known] == ~frame.occluded[known]) > 0.96
    assert np.mean(~frame.occluded[known]) < 0.93  # so that "all visible" would not pass


@pytest.mark.real_data
def test_agrees_with_the_mask_of_cones(stereo_data: Path) -> None:
    (source,) = find_scenes(stereo_data / "middlebury2003" / "cones")
    scene = source.load()
    assert scene.occlusion == "mask"
    known = np.isfinite(scene.truth_px)
    computed = visible_pixels(scene.truth_px)[known]
    assert np.mean(computed == scene.visible[known]) > 0.985  # the mask is from the truth of both cameras
    assert 0.85 < np.mean(scene.visible[known]) < 0.91
