# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Depth from one camera and a projector: planes that both see, with exact codes, noise and wrong codes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_projector import ABOVE, BESIDE, PLACES, KnownProjector

from stereo_depth_ros.active.projector.disparity import disparity_from_projector
from stereo_depth_ros.active.projector.rectification import rectify_camera_and_projector
from stereo_depth_ros.active.structured_light.decoding import decode
from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import CalibrationError, ImageError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64, Reason
from stereo_depth_ros.diagnosis.checks.rig import check_pair, check_shown
from stereo_depth_ros.diagnosis.finding import Level
from stereo_depth_ros.geometry.calibrated_rectification import common_area
from stereo_depth_ros.geometry.rays import camera_rays, rectify_points
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.projection import SyntheticScanner
from stereo_depth_ros.synthetic.rays import trace

SIGMA_PX = 0.2


def rig_of(known: KnownProjector) -> StereoRig:
    return rectify_camera_and_projector(*known.models, known.pose)


def slanted(rig: StereoRig) -> F64:
    """Depth of a slanted plane, float64 (H, W), at 0.7 to 1 m."""
    y, x = np.indices((rig.height, rig.width))
    depth_m: F64 = 0.8 / (1 + 0.3 * (x / rig.width - 0.5) - 0.2 * (y / rig.height - 0.5))
    return depth_m


def seen(known: KnownProjector, rig: StereoRig, depth_m: F64, noise_px: float = 0.0, seed: int = 0) -> ProjectorMap:
    """The projector pixels of the points at a depth of each rectified left pixel."""
    y, x = np.indices(depth_m.shape)
    rays = np.stack(((x - rig.cx_left) / rig.f_px, (y - rig.cy) / rig.fy_px, np.ones_like(depth_m)), axis=-1)
    points = (rays * depth_m[..., None]).reshape(-1, 3) @ rig.left.R
    pixels = known.in_projector(points) + noise_px * np.random.default_rng(seed).normal(size=(len(points), 2))
    pixels = pixels.reshape(*depth_m.shape, 2)
    lit = ((pixels > -0.5) & (pixels < np.array(known.projector_size) - 0.5)).all(axis=2)
    lit &= Rectifier(rig).left_source
    column, row = (np.where(lit, pixels[..., n], np.nan).astype(np.float32) for n in (0, 1))
    sigma = np.where(lit, SIGMA_PX, np.nan).astype(np.float32)
    reasons = np.where(lit, 0, int(Reason.SHADOW)).astype(np.uint8)
    return ProjectorMap(known.projector_size, column, row, sigma, reasons)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("coded", ["both", "columns", "rows"])
def test_exact_codes_give_the_depth(place: str, coded: str) -> None:
    known = PLACES[place]
    rig, depth_m = rig_of(known), slanted(rig_of(known))
    found = seen(known, rig, depth_m)
    if coded != "both":
        found = replace(found, **{"row_px" if coded == "columns" else "column_px": None})
    if coded == ("columns" if place == "above" else "rows"):
        with pytest.raises(CalibrationError, match=f"the {coded} of the projector run along the rows .* give no depth"):
            disparity_from_projector(rig, found)
        return
    match = disparity_from_projector(rig, found)
    np.testing.assert_array_equal(match.reasons, found.reasons)
    valid = match.reasons == 0
    assert valid.mean() > 0.3
    expected = rig.f_px * rig.baseline_m / depth_m + rig.doffs_px
    np.testing.assert_allclose(match.disparity_px[valid], expected[valid], atol=3e-3)
    assert np.isnan(match.disparity_px[~valid]).all()
    triangulation = Triangulation.from_rig(rig)
    y, x = (each.astype(np.float64) for each in np.nonzero(valid))
    points = triangulation.points(np.column_stack((x, y)), np.column_stack((x - match.disparity_px[valid], y)))
    np.testing.assert_allclose(points[:, 2], depth_m[valid], rtol=1e-4)


@pytest.mark.parametrize("coded", ["both", "columns"])
def test_sigma_is_that_of_the_errors(coded: str) -> None:
    """The codes of projector pixels become errors of disparities by the geometry of both."""
    rig, depth_m = rig_of(BESIDE), slanted(rig_of(BESIDE))
    found = seen(BESIDE, rig, depth_m, noise_px=SIGMA_PX)
    match = disparity_from_projector(rig, found if coded == "both" else replace(found, row_px=None))
    valid = match.reasons == 0
    assert match.sigma_px is not None
    expected = rig.f_px * rig.baseline_m / depth_m + rig.doffs_px
    share = (match.disparity_px - expected)[valid] / match.sigma_px[valid]
    assert np.std(share) == pytest.approx(1, abs=0.05)
    assert np.isnan(match.sigma_px[~valid]).all()


def test_codes_whose_row_differs_are_rejected() -> None:
    rig, depth_m = rig_of(BESIDE), slanted(rig_of(BESIDE))
    found = seen(BESIDE, rig, depth_m)
    assert found.row_px is not None and found.column_px is not None
    row_px = found.row_px.copy()
    row_px[80:120, 100:180] += 5.0
    match = disparity_from_projector(rig, replace(found, row_px=row_px))
    changed = np.zeros(row_px.shape, bool)
    changed[80:120, 100:180] = found.reasons[80:120, 100:180] == 0
    assert changed.sum() > 1000
    np.testing.assert_array_equal(match.reasons == Reason.UNIQUENESS, changed)


def test_points_behind_the_camera_are_out_of_range() -> None:
    rig, depth_m = rig_of(BESIDE), slanted(rig_of(BESIDE))
    found = seen(BESIDE, rig, depth_m)
    assert found.column_px is not None
    column_px = found.column_px.copy()
    column_px[100:110, 100:150] += 250
    match = disparity_from_projector(rig, replace(found, column_px=column_px, row_px=None))
    assert ((match.reasons[100:110, 100:150] == Reason.RANGE) == (found.reasons[100:110, 100:150] == 0)).all()
    assert (found.reasons[100:110, 100:150] == 0).any()


def test_a_calibration_of_another_setup_is_named() -> None:
    rig, depth_m = rig_of(BESIDE), slanted(rig_of(BESIDE))
    moved = replace(BESIDE, rig=BESIDE.rig + 0.03 * np.identity(6)[0])
    with pytest.raises(CalibrationError, match=r"the rows of 100 % of \d+ decoded pixels differ .* median by 7\.7 px"):
        disparity_from_projector(rig, seen(moved, rig, depth_m))


def test_maps_that_do_not_fit() -> None:
    rig, depth_m = rig_of(BESIDE), slanted(rig_of(BESIDE))
    found = seen(BESIDE, rig, depth_m)
    with pytest.raises(ImageError, match=r"the map is 320x200, the rig is for 320x240"):
        disparity_from_projector(rig, replace(found, reasons=found.reasons[:200]))
    dark = np.full_like(found.reasons, int(Reason.SHADOW))
    with pytest.raises(ImageError, match=r"no pixel of 76800 is decoded: check that the projector lights"):
        disparity_from_projector(rig, replace(found, reasons=dark))


@pytest.mark.parametrize("place", PLACES)
def test_rectification_keeps_what_both_have_in_view(place: str) -> None:
    """Also with a shifted and verged projector, above the camera, or to the left of it."""
    known = PLACES[place]
    rig, (camera, _) = rig_of(known), known.models
    assert rig.baseline_m == pytest.approx(np.linalg.norm(known.rig[3:]))
    findings = [*check_pair(rig.left, rig.right), check_shown(Rectifier(rig).shown)]
    assert {finding.level for finding in findings} == {Level.OK}
    area = common_area(rig)
    assert area.width * area.height > 0.25 * rig.width * rig.height
    # every pixel of the camera that sees a lit point of the plane is in the rectified image
    y, x = np.indices((rig.height, rig.width)).reshape(2, -1).astype(np.float64)
    raw = np.column_stack((x, y))
    rays = camera_rays(raw, camera)
    pixels = known.in_projector(rays / rays[:, 2:] * 0.8)
    lit = ((pixels > 0) & (pixels < np.array(known.projector_size) - 1)).all(axis=1)
    rectified = rectify_points(raw[lit], rig.left)
    assert lit.mean() > 0.3
    inside = ((rectified > -0.5) & (rectified < [rig.width - 0.5, rig.height - 0.5])).all(axis=1)
    assert inside.all()


def test_a_projector_in_front_of_the_camera_cannot_be_rectified() -> None:
    camera, projector = ABOVE.models
    with pytest.raises(
        CalibrationError, match=r"degrees off the direction of view, limit 20: an epipole is in or near"
    ):
        rectify_camera_and_projector(camera, projector, RelativePose(np.identity(3), np.array([0.01, 0.02, -0.3])))
    turned = np.diag([-1.0, 1.0, -1.0])
    with pytest.raises(CalibrationError):
        rectify_camera_and_projector(camera, projector, RelativePose(turned, np.array([0.3, 0.0, 0.0])))


@pytest.mark.parametrize("coded", ["both", "columns"])
def test_a_rendered_scene_has_its_depth(coded: str) -> None:
    """Shadows, gloss, light between surfaces, noise; what is valid in the shadow counts as an error."""
    scanner = SyntheticScanner(160, 120, (256, 192))
    sequence = PatternSequence.of_kind("gray+phase", (256, 192), rows=coded == "both")
    pose = RelativePose(scanner.R_projector_left, scanner.T_projector_left)
    rig = rectify_camera_and_projector(scanner.rig.left, scanner.projector, pose)
    rectifier = Rectifier(rig)
    images = [rectifier.rectify_left(scanner.capture(pattern)[0]) for pattern in sequence.render()]
    match = disparity_from_projector(rig, decode(sequence, images))
    valid = (match.reasons == 0) & rectifier.left_source
    truth_px = rig.f_px * rig.baseline_m / true_depth(scanner, rig) + rig.doffs_px
    error_px = np.abs(match.disparity_px - truth_px)[valid]
    assert valid.mean() > 0.35  # of the scene that both have in view
    assert np.median(error_px) < 0.03
    assert (error_px < 1).mean() >= 0.99


def true_depth(scanner: SyntheticScanner, rig: StereoRig) -> F64:
    """Depth of the scene in the left rectified frame of a rig, float64 (H, W), meters."""
    y, x = np.indices((rig.height, rig.width), np.float64)
    rays = np.stack(((x - rig.cx_left) / rig.f_px, (y - rig.cy) / rig.fy_px, np.ones_like(x)), axis=-1)
    points, normals = np.empty((2, *x.shape, 3))
    levels, surface = np.empty(x.shape), np.empty(x.shape, np.int32)
    geometry = (scanner.scene.packed(), np.zeros(3), np.ascontiguousarray(rig.left.R.T), rays, 1e-3, scanner.scene.seed)
    run_bands(trace, rig.height, *geometry, points, normals, levels, surface)
    depth_m: F64 = (points @ rig.left.R.T)[..., 2]
    return depth_m
