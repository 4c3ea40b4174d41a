# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding of patterns against the projector pixels that rendered cameras see, and against published captures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from projected_views import ProjectedView, slanted_view

from stereo_depth_ros.active.structured_light.decoding import decode
from stereo_depth_ros.active.structured_light.noise import Noise
from stereo_depth_ros.active.structured_light.patterns import KINDS, Pattern, PatternSequence
from stereo_depth_ros.active.structured_light.phase import Wave, harmonics, wave_of_images
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import Reason
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.projection import SyntheticScanner

SIZE = (200, 150)


def gray(axis: str, bits: range, *inverses: bool, **settings: int) -> list[Pattern]:
    return [Pattern("gray", axis, bit, inverse, **settings) for bit in bits for inverse in inverses]


def phases(axis: str, period_px: float, *shifts_deg: float) -> list[Pattern]:
    return [Pattern("phase", axis, period_px=period_px, shift_deg=shift) for shift in shifts_deg]


def errors_px(found: ProjectorMap, view: ProjectedView) -> npt.NDArray[np.float64]:
    """Largest error of both coordinates of the decoded pixels; the map is checked to be consistent."""
    valid = found.reasons == 0
    errors = np.zeros(view.column.shape)
    for coordinate, true in ((found.column_px, view.column), (found.row_px, view.row)):
        if coordinate is not None:
            assert np.array_equal(np.isfinite(coordinate), valid)
            errors = np.maximum(errors, np.abs(coordinate - true))
    assert np.array_equal(np.isfinite(found.sigma_px), valid)
    return np.asarray(errors[valid])


@pytest.mark.parametrize(("kind", "seed"), [*zip(KINDS, (5, 6, 7), strict=True)])
def test_scanner_with_all_that_disturbs(kind: str, seed: int) -> None:
    """Noise, gamma, ambient light, vignetting, defocus, a corner that reflects onto itself, gloss and black."""
    size = (384, 288)
    scanner = SyntheticScanner(240, 180, size, seed=seed)
    rectifier = Rectifier(scanner.rig)
    sequence = PatternSequence.of_kind(kind, size)
    images = [rectifier.rectify_left(scanner.capture(pattern)[0]) for pattern in sequence.render()]
    found, truth = decode(sequence, images), scanner.truth()
    valid = found.reasons == 0
    assert found.column_px is not None
    errors = np.abs(found.column_px - truth.column_px)[valid & truth.lit]
    assert np.mean(errors < 1) >= 0.99
    assert np.median(errors) <= 0.1
    assert np.count_nonzero(valid & truth.lit) > 0.8 * np.count_nonzero(truth.lit)
    # 2 px around what is lit, some of the light falls onto the pixel
    shadow = cv2.erode((~truth.lit).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert np.count_nonzero(shadow) > 1000 and not (valid & shadow).any()
    assert np.mean((found.reasons[shadow] & Reason.SHADOW) != 0) > 0.95


FOREIGN = {
    "without inverses, ambient first, rows before columns": [
        Pattern("ambient"),
        Pattern("black"),
        *gray("rows", range(8), False),
        Pattern("unused"),
        *gray("columns", range(8), False),
        Pattern("white"),
    ],
    "inverses only, offset and cells": [
        Pattern("white"),
        Pattern("black"),
        *gray("columns", range(6, -1, -1), True, offset_px=28, cell_px=2),
    ],
    "ambient in place of black": [Pattern("white"), Pattern("ambient"), *gray("columns", range(7, -1, -1), False)],
    "inverse pairs without white and black": gray("columns", range(7, -1, -1), True, False),
    "coarse bits only": [Pattern("white"), Pattern("black"), *gray("columns", range(7, 2, -1), False)],
    "heterodyne, falling phase": [p for period in (24, 27, 30) for p in phases("columns", period, 0, -120, -240)],
    "whole axis and a fine period": [*phases("columns", 200, 0, 90, 180, 270), *phases("columns", 20, 30, 150, 270)],
    "unequal steps": [
        Pattern("white"),
        Pattern("black"),
        *gray("rows", range(7, 2, -1), False, True),
        *phases("rows", 16, 10, 80, 190, 300, 340),
    ],
}


@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_sequences(name: str) -> None:
    view = slanted_view()
    sequence = PatternSequence(SIZE, tuple(FOREIGN[name]))
    found = decode(sequence, view.images(sequence))
    errors = errors_px(found, view)
    assert len(errors) > 0.98 * view.column.size
    assert np.median(errors) < (0.4 if "coarse" in name else 0.12)
    assert np.mean(errors < (2.0 if "coarse" in name else 0.6)) > 0.99


@pytest.mark.parametrize("kind", KINDS)
def test_a_camera_on_its_side_sees_the_same(kind: str) -> None:
    """Columns of the projector along the rows of the image, or along its columns: edges are sought across them."""
    view = slanted_view()
    sequence = PatternSequence.of_kind(kind, SIZE)
    images = view.images(sequence)
    upright = decode(sequence, images)
    turned = decode(sequence, [np.ascontiguousarray(image.T) for image in images])
    assert upright.column_px is not None and turned.column_px is not None
    both = np.isfinite(upright.column_px) & np.isfinite(turned.column_px.T)
    assert both.mean() > 0.98 and np.abs(upright.column_px - turned.column_px.T)[both].max() < 1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_standard_deviations_are_those_of_the_errors(kind: str) -> None:
    view = slanted_view(noise=5.0, albedo=120.0)
    sequence = PatternSequence.of_kind(kind, SIZE)
    found = decode(sequence, view.images(sequence))
    assert found.column_px is not None
    ratio = np.abs(found.column_px - view.column) / found.sigma_px
    assert 0.4 < 1.4826 * np.nanmedian(ratio) < 1.5
    assert np.nanpercentile(ratio, 99) < 6


def test_bits_that_the_camera_does_not_resolve_are_not_reported() -> None:
    """A pixel sees 5 projector px: the stripes of bit 0 (2 px) and bit 1 (4 px) are gray."""
    view = slanted_view(blur_px=2.5)
    view.column, view.row = 4 * view.column, 4 * view.row
    size = (4 * SIZE[0], 4 * SIZE[1])
    sequence = PatternSequence.of_kind("gray", size, rows=True)
    found = decode(sequence, view.images(sequence))
    errors = errors_px(found, view)
    assert len(errors) > 0.97 * view.column.size
    assert np.median(errors) < 0.8 and np.mean(errors < 4) > 0.999
    # the same images with random fine bits: what is not resolved has no influence
    images = view.images(sequence)
    for number, pattern in enumerate(sequence.patterns):
        if pattern.role == "gray" and pattern.bit == 0:
            images[number] = np.random.default_rng(1).normal(87, 2, images[0].shape).astype(np.uint8)
    again = errors_px(decode(sequence, images), view)
    assert len(again) > 0.97 * view.column.size and np.mean(again < 4) > 0.999


@pytest.mark.parametrize("kind", KINDS)
def test_shadow_in_light_from_other_surfaces_is_not_decoded(kind: str) -> None:
    view = slanted_view(reflected=70.0)
    view.column[30:80, 40:90] = np.nan
    sequence = PatternSequence.of_kind(kind, SIZE)
    found = decode(sequence, view.images(sequence))
    assert not (found.reasons[30:80, 40:90] == 0).any()
    assert np.mean((found.reasons[30:80, 40:90] & Reason.SHADOW) != 0) > 0.95
    assert (found.reasons[:25] == 0).mean() > 0.98


@pytest.mark.parametrize("kind", KINDS)
def test_dark_and_saturated_pixels_are_not_decoded(kind: str) -> None:
    albedo = np.full((120, 160), 150.0)
    albedo[20:50, 30:70] = 1.0
    albedo[70:100, 30:70] = 2000.0
    view = slanted_view(albedo=albedo, ambient=40.0)
    sequence = PatternSequence.of_kind(kind, SIZE)
    found = decode(sequence, view.images(sequence))
    assert (found.reasons[20:50, 30:70] & (Reason.SHADOW | Reason.TEXTURE)).all()
    errors = errors_px(found, view)
    assert np.mean(errors < 1) > 0.995
    if kind != "gray":  # bits are read as long as a stripe and its inverse differ
        assert np.mean((found.reasons[70:100, 30:70] & Reason.TEXTURE) != 0) > 0.95


def test_gamma_of_three_steps_is_compensated() -> None:
    """A gamma of 2.2 adds a second harmonic of 0.19 of the first: an error of the phase of sin 3 p that amounts."""
    view = slanted_view(gamma=2.2, noise=0.5)
    numbers, shifts = [0, 1, 2], [0.0, 120.0, 240.0]
    patterns = phases("columns", 18, *shifts)
    stack = np.stack([view.image(pattern, SIZE) for pattern in patterns])
    wave = wave_of_images(stack, numbers, 18, shifts, Noise(0.25), np.zeros(view.column.shape, np.uint8))
    raw = 2 * np.pi * ((wave.turn - view.column / 18 + 0.5) % 1 - 0.5)
    sequence = PatternSequence(SIZE, (*patterns, *phases("columns", 21, *shifts), *phases("columns", 25, *shifts)))
    found = decode(sequence, view.images(sequence))
    assert found.column_px is not None
    compensated = 2 * np.pi * (found.column_px - view.column) / 18
    assert np.sqrt(np.mean(raw**2)) > 0.1
    assert np.sqrt(np.nanmean(compensated**2)) < 0.015
    amplitude = harmonics(wave)[0, 0] * 2 * np.pi
    bins = np.histogram(2 * np.pi * view.column.ravel() / 18 % (2 * np.pi), 72)[0]
    assert bins.min() > 0.7 * bins.mean()  # the phases are spread, as the estimate presumes
    assert amplitude == pytest.approx(np.sqrt(2) * np.sqrt(np.mean(raw**2)), rel=0.1)


def test_a_plane_that_shows_few_phases_is_not_compensated() -> None:
    """Parallel to the camera with 6 px a period: two phases for each of three steps, again and again."""
    turn = np.tile(np.arange(60, dtype=np.float32) / 6 % 1, (80, 1)) + np.float32(0.02)
    assert not harmonics(Wave(12.0, 3, turn, np.full_like(turn, 0.001))).any()


def test_noise_rises_with_the_light() -> None:
    y, x = np.mgrid[:300, :400]
    random = np.random.default_rng(2)
    scene = 120 + 0.1 * x + 20 * (y > 120) * np.sin(x / 40)
    for read, shot in ((1.0, 0.0), (3.0, 0.0), (0.9, 0.05)):
        images = []
        for light in (0.1, 1.0):
            sigma = np.sqrt(read**2 + shot * light * scene)
            noisy = light * scene + sigma * random.standard_normal(scene.shape)
            images.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
        found = Noise.of_images(images)
        for level in (20.0, 150.0):
            assert found.sigma(level) == pytest.approx(np.sqrt(read**2 + shot * level + 1 / 12), rel=0.1)
    assert Noise.of_images([np.zeros((40, 50), np.uint8)]) == Noise(0.25)
    assert Noise.of_images([np.full((3, 3), 7, np.uint8)]) == Noise(0.25)


def test_a_dark_surface_beside_a_bright_one_is_decoded() -> None:
    """Its light is below the noise of the bright surface, and clear in its own."""
    albedo = np.full((120, 160), 200.0)
    albedo[:, 80:] = 14.0
    view = slanted_view(albedo=albedo, ambient=4.0, shot=0.06, noise=0.6)
    sequence = PatternSequence(SIZE, (Pattern("white"), Pattern("black"), *gray("columns", range(7, 0, -1), False)))
    found = decode(sequence, view.images(sequence))
    assert found.column_px is not None
    dark = np.abs(found.column_px - view.column)[:, 85:]
    assert np.mean(np.isfinite(dark)) > 0.9 and np.nanmedian(dark) < 0.5 and np.mean(dark[np.isfinite(dark)] < 2) > 0.99


@pytest.mark.parametrize(
    ("patterns", "words"),
    [
        ([Pattern("white"), Pattern("black")], ["gray or phase"]),
        (gray("columns", range(7), False, True), ["bit 7", "columns", "missing"]),
        (gray("rows", range(5), False, True) + gray("rows", range(6, 8), False, True), ["bit 5", "rows"]),
        (gray("columns", range(8), False), ["bit 7", "no inverse", "white or black"]),
        (
            gray("columns", range(7), False, True) + gray("columns", range(7, 8), False, True, cell_px=2),
            ["cell_px"],
        ),
        (phases("columns", 16, 0, 120, 240), ["16 px", "200 px", "Gray code"]),
        (phases("columns", 200, 0, 180), ["0, 180 deg", "200 px"]),
        (phases("columns", 200, 0, 2, 5), ["0, 2, 5 deg"]),
    ],
)
def test_sequences_that_cannot_be_decoded(patterns: list[Pattern], words: list[str]) -> None:
    sequence = PatternSequence(SIZE, tuple(patterns))
    with pytest.raises(ConfigError) as error:
        decode(sequence, list(slanted_view(32, 24).images(sequence)))
    assert all(word in str(error.value) for word in words), error.value
    assert error.value.remedy


def test_images_that_do_not_fit_the_sequence() -> None:
    sequence = PatternSequence.of_kind("gray", (64, 48))
    images = [np.zeros((24, 32), np.uint8)] * len(sequence)
    for wrong in (
        [],
        images[:-1],
        [*images[:-1], images[0][1:]],
        [*images[:-1], images[0] * 1.0],
        [i[None] for i in images],
    ):
        with pytest.raises(ImageError) as error:
            decode(sequence, wrong)
        assert error.value.remedy
    assert not (decode(sequence, images).reasons == 0).any()  # black images are no error: nothing is lit


def read(folder: Path, names: list[str], step: int = 1) -> list[npt.NDArray[np.uint8]]:
    """Gray images, of which every ``step``-th row and column is kept."""
    images = [cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE) for name in names]
    return [np.ascontiguousarray(image[::step, ::step]) for image in images]


@pytest.mark.real_data
def test_published_fringes_of_three_close_periods(stereo_data: Path) -> None:
    """A plaster head before a wall, 3 steps at 42, 45 and 48 px; 12 steps have shown 0.118 rad of error in the phase.

    The wall is nearly flat: along a row, the coordinate of its pixels is a smooth function.
    """
    folder = stereo_data / "active" / "b_fringe_3freq_cfpe_david"
    images = read(folder, [f"06{number:02d}h.bmp" for number in range(0, 36, 4)])
    patterns = [p for period in (42, 45, 48) for p in phases("columns", period, 0, -120, -240)]
    sequence = PatternSequence((1920, 1080), tuple(patterns))
    found = decode(sequence, images)
    assert found.column_px is not None
    assert np.mean(found.reasons == 0) > 0.88
    face = found.column_px[170:300, 400:440]
    jumps = np.abs(np.diff(face, axis=1))
    assert np.mean(np.isfinite(face)) > 0.9 and np.nanmax(jumps) < 15

    def ripple_rad(turn: npt.NDArray[np.float32]) -> float:
        """Error of the phase on the wall that repeats three times a period, from a smooth fit to each row."""
        x = np.arange(20, 300)
        smooth = [np.polynomial.Polynomial.fit(x, row, 4)(x) for row in wall]
        rest = turn[100:300:10, 20:300] - np.array(smooth) / 42
        return float(2 * np.pi * np.std(rest - np.round(rest)))

    wall = found.column_px[100:300:10, 20:300]
    assert np.isfinite(wall).all()
    raw = wave_of_images(
        np.stack(images[:3]), [0, 1, 2], 42, [0, -120, -240], Noise(0.25), np.zeros(images[0].shape, np.uint8)
    )
    assert ripple_rad(raw.turn) > 0.1
    assert ripple_rad((found.column_px / 42).astype(np.float32)) < 0.03


def gray_of_two_views(stereo_data: Path, view: int, step: int) -> ProjectorMap:
    images = read(stereo_data / "active" / "e_graycode_two_views_joep" / f"view{view}", NAMES, step)
    return decode(PatternSequence((960, 540), tuple(TWO_VIEWS)), images)


NAMES = [f"{number:02d}.jpg" for number in range(42)]
TWO_VIEWS = [
    Pattern("white"),
    Pattern("black"),
    *gray("columns", range(9, -1, -1), False, True),
    *gray("rows", range(9, -1, -1), False, True),
]


@pytest.mark.real_data
def test_published_phases_give_the_place_of_the_gray_code(stereo_data: Path) -> None:
    """Three steps at a sixteenth of the axis and at all of it, and a Gray code, of one view."""
    folder = stereo_data / "active" / "b_phase_two_views_joep" / "view1"
    axes = [(axis, period) for axis, length in (("columns", 960), ("rows", 540)) for period in (length / 16, length)]
    patterns = [p for axis, period in axes for p in phases(axis, period, 0, 120, 240)]
    sequence = PatternSequence((960, 540), (Pattern("white"), Pattern("black"), *patterns))
    found, coded = decode(sequence, read(folder, NAMES[:14], 2)), gray_of_two_views(stereo_data, 1, 2)
    for phase, code in ((found.column_px, coded.column_px), (found.row_px, coded.row_px)):
        assert phase is not None and code is not None
        both = np.isfinite(phase) & np.isfinite(code)
        assert both.mean() > 0.4
        assert np.median(np.abs(phase - code)[both]) < 0.5
