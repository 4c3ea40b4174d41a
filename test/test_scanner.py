# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Synthetic captures of patterns: their geometry against cv2 and the images themselves, and each effect of light."""

from __future__ import annotations

import functools

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import U8, Frame, StereoPair
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.projection import Gloss, Optics, SyntheticScanner
from stereo_depth_ros.synthetic.scene import Rectangle, Scene, Texture

SIZE, PROJECTOR = (160, 120), (200, 150)
PLAIN = Optics(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # light and nothing else
WHITE: U8 = np.full(PROJECTOR[::-1], 255, np.uint8)
BLACK: U8 = np.zeros(PROJECTOR[::-1], np.uint8)
CORNER = Scene(
    (
        Rectangle((-1.2, -1.0, 1.4), (1.4, 0.0, 0.0), (0.0, 2.0, 0.0), Texture(200.0, 0.0)),
        Rectangle((0.2, -1.0, 1.4), (0.9, 0.0, -0.9), (0.0, 2.0, 0.0), Texture(200.0, 0.0)),
    ),
    1,
)


def scanner(optics: Optics = PLAIN, scene: Scene | None = None, seed: int = 7) -> SyntheticScanner:
    return SyntheticScanner(*SIZE, PROJECTOR, scene=scene, optics=optics, seed=seed)


@functools.cache
def plain() -> SyntheticScanner:
    return scanner()


def rectified(scanned: SyntheticScanner, pattern: U8) -> tuple[U8, U8]:
    left, right = (Frame(image, 0, "") for image in scanned.capture(pattern))
    pair = Rectifier(scanned.rig).rectify(StereoPair(left, right))
    return pair.left, pair.right


def test_truth_is_what_opencv_projects() -> None:
    own = plain()
    truth, rig, camera = own.truth(), own.rig, own.projector
    y, x = np.nonzero(truth.lit)
    z = truth.depth_m[y, x].astype(float)
    points = np.column_stack(((x - rig.cx_left) / rig.f_px * z, (y - rig.cy) / rig.fy_px * z, z)) @ rig.left.R
    rotation = cv2.Rodrigues(own.R_projector_left)[0]
    expected = cv2.projectPoints(points, rotation, own.T_projector_left, camera.K, camera.D)[0][:, 0]
    np.testing.assert_allclose(np.column_stack((truth.column_px[y, x], truth.row_px[y, x])), expected, atol=1e-3)
    assert 0.6 < truth.lit.mean() < 0.95
    assert np.isnan(truth.column_px[~truth.lit]).all()
    np.testing.assert_allclose(truth.disparity_px[y, x], rig.f_px * rig.baseline_m / z + rig.doffs_px, rtol=1e-6)


@pytest.mark.parametrize("axis", ["column", "row"])
def test_a_ramp_shows_the_projector_pixel(axis: str) -> None:
    """The level relative to white is the coordinate: images and truth have the same geometry."""
    length = PROJECTOR[0] if axis == "column" else PROJECTOR[1]
    ramp = np.arange(length, dtype=np.uint8)
    pattern = np.broadcast_to(ramp if axis == "column" else ramp[:, None], PROJECTOR[::-1])
    white, coded = (rectified(plain(), p)[0].astype(float) for p in (WHITE, np.ascontiguousarray(pattern)))
    truth = plain().truth()
    bright = (white > 90) & (white < 250) & truth.lit
    inside = cv2.erode((bright & (truth.surface == 0)).astype(np.uint8), np.ones((5, 5))) > 0
    coordinate = (truth.column_px if axis == "column" else truth.row_px)[inside]
    error = coded[inside] / white[inside] * 255 - coordinate
    assert inside.sum() > 500
    assert abs(np.median(error)) < 0.15  # a quantized level of 200 is worth .6 px
    assert np.percentile(np.abs(error), 95) < 255 / 90 / 2  # half a level of the darkest pixel


def test_both_cameras_see_the_same_points() -> None:
    left, right = rectified(plain(), WHITE)
    truth = plain().truth()
    y, x = np.indices(left.shape, np.float32)
    moved = cv2.remap(right, x - truth.disparity_px, y, cv2.INTER_LINEAR).astype(float)
    matte = truth.lit & ~truth.occluded & np.isin(truth.surface, (0, 1, 3))
    inside = cv2.erode(matte.astype(np.uint8), np.ones((5, 5))) > 0
    assert inside.sum() > 2000
    assert np.median(np.abs(moved - left)[inside]) <= 1.0


def test_where_the_projector_does_not_light_only_ambient_light_is() -> None:
    own = scanner(Optics(ambient=0.1, noise=0.0, shot=0.0, vignetting=0.0, interreflection=0.0, black=0.0))
    black, white = rectified(own, BLACK)[0].astype(int), rectified(own, WHITE)[0].astype(int)
    truth = own.truth()
    dark = cv2.erode((~truth.lit & (truth.surface >= 0)).astype(np.uint8), np.ones((5, 5))) > 0
    lit = cv2.erode((truth.lit & (truth.surface == 0)).astype(np.uint8), np.ones((5, 5))) > 0
    assert dark.sum() > 100
    np.testing.assert_array_equal(white[dark], black[dark])
    assert (white[lit] > 2 * black[lit]).all() and black[lit].min() > 3


def test_noise_differs_from_call_to_call_and_repeats_with_the_seed() -> None:
    noisy = Optics(noise=2.0)
    first, again, other = scanner(noisy, seed=3), scanner(noisy, seed=3), scanner(noisy, seed=4)
    one, two = first.capture(WHITE)[0], first.capture(WHITE)[0]
    np.testing.assert_array_equal(one, again.capture(WHITE)[0])
    assert (one != other.capture(WHITE)[0]).any()
    difference = one[60].astype(float) - two[60]
    assert 2.0 < difference.std() < 6.0


def test_walls_that_meet_light_each_other() -> None:
    """The right half of the pattern lights the side wall only; some of it comes from the back wall to the camera."""
    half: U8 = WHITE.copy()
    with_bounce, without = scanner(Optics(noise=0, shot=0, ambient=0), CORNER), scanner(PLAIN, CORNER)
    truth = without.truth()
    edge = int(np.nanmin(truth.column_px[truth.surface == 1])) + 2
    half[:, :edge] = 0
    back = cv2.erode((truth.surface == 0).astype(np.uint8), np.ones((9, 9))) > 0
    bounced, direct = rectified(with_bounce, half)[0][back], rectified(without, half)[0][back]
    assert direct.max() == 0
    near, far = np.nonzero(back)[1] > np.percentile(np.nonzero(back)[1], 80), np.nonzero(back)[1] < 40
    assert bounced[near].mean() > 4 * max(bounced[far].mean(), 1.0)


def test_a_glossy_surface_saturates_where_it_mirrors_the_light() -> None:
    matte = SyntheticScanner(*SIZE, PROJECTOR, optics=PLAIN, gloss={}).capture(WHITE)[0]
    glossy = SyntheticScanner(*SIZE, PROJECTOR, optics=PLAIN, gloss={4: Gloss(4.0, 60.0)}).capture(WHITE)[0]
    changed = glossy.astype(int) - matte
    assert changed.min() >= -1  # the exposure changes a little
    assert 0 < np.count_nonzero(changed > 1) < 0.02 * changed.size
    assert glossy[changed > 1].max() == 255 > matte[changed > 1].max()


def test_colors_mix() -> None:
    red: U8 = np.zeros((*PROJECTOR[::-1], 3), np.uint8)
    red[..., 0] = 255
    image = scanner(Optics(crosstalk=0.1, ambient=0.0, noise=0.0, shot=0.0, black=0.0)).capture(red)[0]
    bright = image[..., 0] > 100
    ratio = image[bright][:, 1] / image[bright][:, 0]
    assert 0.08 < np.median(ratio) < 0.13  # the mixing, times the tint of the surface


def test_an_image_lies_on_its_rectangle() -> None:
    board: U8 = np.zeros((4, 8), np.uint8)
    board[:, 4:] = 255
    own = SyntheticScanner(*SIZE, PROJECTOR, scene=CORNER, prints={0: board}, optics=PLAIN)
    image = own.capture(WHITE)[0]
    truth = own.truth()
    columns = np.nonzero(truth.surface[60] == 0)[0]
    assert image[60, columns[3] + 2] == 0 < 100 < image[60, columns[-1] - 8]


def test_a_pattern_of_another_size_is_refused() -> None:
    with pytest.raises(ConfigError, match="the pattern is 150x200, the projector 200x150"):
        plain().capture(np.ascontiguousarray(WHITE.T))
    with pytest.raises(ConfigError, match="160x0 and 200x150 are not above 0"):
        SyntheticScanner(160, 0, PROJECTOR)
