# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding of color stripes: parts against definitions, rendered scenes with exact truth, photographs of a plane."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.active.one_shot.consistency import vote
from stereo_depth_ros.active.one_shot.decoding import decode_edges, one_shot
from stereo_depth_ros.active.one_shot.edges import ColorEdges, find_edges
from stereo_depth_ros.active.one_shot.labels import label_rows
from stereo_depth_ros.active.one_shot.mixing import color_mixing, separate_colors
from stereo_depth_ros.active.one_shot.positions import remove_displacements
from stereo_depth_ros.active.one_shot.stripes import StripePattern, read_stripes, stripe_pattern
from stereo_depth_ros.active.projector.disparity import disparity_from_projector
from stereo_depth_ros.active.projector.rectification import rectify_camera_and_projector
from stereo_depth_ros.active.structured_light.correspondence import disparity_from_maps
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, F64, U8, Reason
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.synthetic.projection import Optics, ScannerTruth, SyntheticScanner
from stereo_depth_ros.synthetic.scene import Cylinder, Rectangle, Scene, Sphere, Texture

PROJECTOR = (512, 384)
PATTERN = stripe_pattern(PROJECTOR, 8)
STRIPES = read_stripes(PATTERN)
GOOD = Optics()
POOR = Optics(crosstalk=0.2, defocus_px=1.5, noise=3.0, ambient=0.3)
MIXED = Optics(crosstalk=0.3, defocus_px=2.0)
WALL, BALL, POLE, BLACK = range(4)
SCENE = Scene(
    (
        Rectangle((-1.5, -1.2, 1.38), (3.0, 0.0, -0.1), (0.0, 2.2, 0.1), Texture(180.0, 30.0)),
        Sphere((-0.3, 0.05, 1.15), 0.2, Texture(170.0, 35.0)),
        Cylinder((0.2, -0.9, 0.95), (0.03, 1.5, 0.0), 0.042, Texture(180.0, 25.0)),
        Rectangle((-0.25, 0.3, 1.2), (0.3, 0.0, 0.02), (0.0, 0.15, 0.0), Texture(3.0, 2.0)),
    ),
    5,
)


def rectified(rig: StereoRig, left: U8, right: U8) -> tuple[U8, U8]:
    images = []
    for camera, image in ((rig.left, left), (rig.right, right)):
        size = (rig.width, rig.height)
        maps = cv2.initUndistortRectifyMap(camera.K, camera.D, camera.R, camera.P[:, :3], size, cv2.CV_32FC1)
        images.append(np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), np.uint8))
    return images[0], images[1]


@functools.cache
def captured(optics: Optics = GOOD, turned: bool = False) -> tuple[U8, U8, ScannerTruth]:
    """Rectified images of the scene, and the truth of the left one."""
    scanner = SyntheticScanner(320, 240, PROJECTOR, scene=SCENE, optics=optics)
    pattern = np.ascontiguousarray(PATTERN[::-1, ::-1]) if turned else PATTERN
    return *rectified(scanner.rig, *scanner.capture(pattern)), scanner.truth()


def errors_px(found: ProjectorMap, truth: ScannerTruth, surface: int) -> F32:
    """Of the decoded columns of a surface, without the pixels beside other surfaces."""
    inside = cv2.erode((truth.lit & (truth.surface == surface)).astype(np.uint8), np.ones((3, 3))) > 0
    assert found.column_px is not None
    return (found.column_px - truth.column_px)[inside & (found.reasons == 0)]


def edges_of(x_px: npt.ArrayLike, changes: npt.ArrayLike) -> ColorEdges:
    """The same edges in each row, (H, K) and (K, 3)."""
    x = np.asarray(x_px, np.float32)
    each = np.asarray(changes, np.float32)
    return ColorEdges(x, np.tile(each, (len(x), 1, 1)), np.full(len(x), x.shape[1], np.int32))


# Parts


@pytest.mark.parametrize("sigma_px", [1.0, 2.0])
def test_edges_are_where_the_steps_are_on_surfaces_of_any_color(sigma_px: float) -> None:
    """Steps blurred by a Gaussian, at known places, seen on a surface that reflects little blue."""
    at = np.array([20.3, 41.8, 60.0, 83.6])
    signs = np.array([[1, 0, -1], [-1, 1, 0], [1, 0, 1], [0, -1, -1]])
    x = np.arange(110.0)
    steps = (1 + np.vectorize(lambda t: float(np.tanh(t)))((x[:, None] - at) / 1.2)) / 2
    row = np.array([0.2, 0.2, 0.9]) + steps @ (signs * [0.7, 0.7, 0.7])
    image = np.repeat((row * [200.0, 150.0, 60.0] + 10)[None], 5, axis=0).astype(np.float32)
    edges, contrast = find_edges(np.ascontiguousarray(image), sigma_px, 8.0)
    assert edges.counts.tolist() == [4] * 5
    np.testing.assert_allclose(edges.x_px[:, :4], np.tile(at, (5, 1)), atol=0.06)
    np.testing.assert_allclose(edges.changes[2, :4], signs, atol=0.15)
    assert contrast[2, 50] == pytest.approx(140.0, rel=0.05)
    assert find_edges(np.ascontiguousarray(image), sigma_px, 200.0)[0].counts.sum() == 0


def test_labels_are_the_best_sequence_in_order() -> None:
    """Against all sequences: the sum of the scores, less 1.5 for each pair that follows no other."""
    random = np.random.default_rng(3)
    six = dataclasses.replace(STRIPES, changes=STRIPES.changes[9:15], edges_px=STRIPES.edges_px[9:15])

    def score(edge: F64, change: F64) -> float:
        on = (edge * change - 0.3) / 0.4
        off = 1 - (np.abs(edge) - 0.3) / 0.4
        return float(np.clip(np.where(change != 0, on, off), -1, 1).min())

    def total(pairs: list[tuple[int, int]], scores: F64) -> float:
        new = sum(k == 0 or (i - 1, j - 1) != pairs[k - 1] for k, (i, j) in enumerate(pairs))
        return sum(float(scores[pair]) for pair in pairs) - 1.5 * new

    for _ in range(12):
        changes = six.changes[np.sort(random.choice(6, 5, replace=False))] * 0.9 + random.normal(0, 0.15, (5, 3))
        changes /= np.abs(changes).max(axis=1, keepdims=True)
        scores = np.array([[score(edge, change) for change in six.changes] for edge in changes])
        best = max(
            total(list(zip(some, others, strict=True)), scores)
            for number in range(6)
            for some in itertools.combinations(range(5), number)
            for others in itertools.combinations(range(6), number)
        )
        labels, _ = label_rows(edges_of([np.arange(5) * 9.0], changes), six)
        found = [(i, int(label)) for i, label in enumerate(labels[0]) if label >= 0]
        assert total(found, scores) == pytest.approx(best, abs=1e-5)


def test_later_passes_label_what_breaks_the_order() -> None:
    """A pole in front of the wall: its edges come too early, and hide those that the wall has there."""
    seen = [*range(20), 33, 34, 35, 36, *range(25, 33), *range(37, 60)]
    labels, runs = label_rows(edges_of([np.arange(len(seen)) * 7.0], STRIPES.changes[seen]), STRIPES)
    np.testing.assert_array_equal(labels[0], seen)
    assert runs[0, 20:24].tolist() == [4] * 4


def test_an_edge_that_two_runs_could_continue_has_no_label() -> None:
    """The change after a is the one at b: the first edge behind the step may be either of them."""
    changes = STRIPES.changes

    def same(i: int, j: int) -> bool:
        return bool((changes[i] == changes[j]).all())

    found = 0
    for a, b in itertools.product(range(6, 20), range(28, 50)):
        if same(a + 1, b) and not same(a + 2, b + 1) and not same(a, b - 1):
            seen = [*range(a - 6, a + 1), *range(b, b + 7)]
            labels, runs = label_rows(edges_of([np.arange(14) * 7.0], changes[seen]), STRIPES)
            np.testing.assert_array_equal(labels[0], [*seen[:7], -1, *seen[8:]])
            assert runs[0].tolist() == [7] * 14
            found += 1
    assert found > 3
    missing = [*range(20), *range(22, 40)]  # on a smooth surface nothing is doubtful
    labels, _ = label_rows(edges_of([np.array(missing) * 7.0], changes[missing]), STRIPES)
    np.testing.assert_array_equal(labels[0], missing)


def test_colors_that_mix_are_separated() -> None:
    M = np.array([[1.0, 0.1, 0.0], [0.35, 0.9, 0.3], [0.05, 0.45, 1.0]])
    number = len(STRIPES.changes)
    seen = STRIPES.changes @ M.T
    edges = edges_of(np.arange(number) * 7.0 + np.zeros((3, 1)), seen)
    labels = np.tile(np.arange(number, dtype=np.int32), (3, 1))
    doubtful = labels.copy()
    doubtful[:, 3:40:2] = -1
    found = color_mixing(edges, doubtful, np.full(labels.shape, 9, np.uint8), STRIPES)
    np.testing.assert_allclose(found, M, atol=1e-6)
    np.testing.assert_allclose(separate_colors(edges, M).changes[1], STRIPES.changes, atol=1e-5)
    for runs in (5, 9):  # not sure enough; too few
        rows = slice(0, 3 if runs == 5 else 1)
        some = ColorEdges(edges.x_px[rows], edges.changes[rows], edges.counts[rows])
        unknown = color_mixing(some, labels[rows], np.full(labels[rows].shape, runs, np.uint8), STRIPES)
        np.testing.assert_array_equal(unknown, np.identity(3))
    left, _, truth = captured(MIXED)
    assert np.mean(one_shot(left, STRIPES).reasons[truth.lit] == 0) > 0.8


def test_neighboring_rows_reject_and_complete_labels() -> None:
    """Slanted edges; one row has a wrong label, one has none, and one edge has another label in each row."""
    x = np.arange(6) * 10.0 + 0.7 * np.arange(12)[:, None] + 5
    labels = np.tile(np.arange(6, dtype=np.int32), (12, 1))
    labels[4, 2], labels[6, 3], labels[:, 5] = 40, -1, np.arange(12) * 3 + 7
    runs = np.full(labels.shape, 5, np.uint8)
    agreed = vote(edges_of(x, STRIPES.changes[:6]), labels, runs, 3, 1.0)
    np.testing.assert_array_equal(agreed, np.tile([0, 1, 2, 3, 4, -1], (12, 1)))
    assert (vote(edges_of(x[:2], STRIPES.changes[:6]), labels[:2], runs[:2], 3, 1.0) == -1).all()


def test_displacements_of_colors_are_estimated_and_removed() -> None:
    random = np.random.default_rng(2)
    labels = np.tile(np.arange(len(STRIPES.edges_px), dtype=np.int32), (40, 1))
    smooth = 0.9 * STRIPES.edges_px + 4e-4 * STRIPES.edges_px**2 + np.arange(40)[:, None]
    stripe_px = 8 * (0.9 + 8e-4 * STRIPES.edges_px)
    bias = stripe_px * (STRIPES.changes @ [0.04, 0.0, -0.1])
    x_px = (smooth + bias + random.normal(0, 0.1, smooth.shape)).astype(np.float32)
    corrected, sigma_px = remove_displacements(x_px, labels, STRIPES)
    assert np.std(corrected - smooth) < 0.13 < 0.5 < np.std(x_px - smooth)
    assert sigma_px == pytest.approx(0.1, rel=0.2)
    some, _ = remove_displacements(x_px[:, :7], np.ascontiguousarray(labels[:, :7]), STRIPES)
    np.testing.assert_array_equal(some, x_px[:, :7])  # five different triples do not determine them
    few = remove_displacements(x_px[:1, :20], np.tile(labels[0, :20], (1, 1)), STRIPES)
    assert np.isnan(few[1])


# Scenes


@pytest.mark.parametrize("optics", [GOOD, POOR], ids=["good", "poor"])
def test_a_rendered_scene(optics: Optics) -> None:
    """Noise, gamma, ambient light, mixed colors and defocus; a wall, a ball, and a pole that breaks the order."""
    left, _, truth = captured(optics)
    found = one_shot(left, STRIPES)
    assert found.size == PROJECTOR and found.row_px is None and found.column_px is not None
    np.testing.assert_array_equal(found.reasons == 0, np.isfinite(found.column_px))
    np.testing.assert_array_equal(found.reasons == 0, np.isfinite(found.sigma_px))
    for surface, density, limit_px in ((WALL, 0.8, 1.0), (BALL, 0.7, 1.0), (POLE, 0.5, 4.0)):
        off = np.abs(errors_px(found, truth, surface))
        assert off.size >= density * np.count_nonzero(truth.lit & (truth.surface == surface)), surface
        assert np.mean(off < limit_px) >= 0.98, surface  # half a stripe where the outline of the pole is an edge
    off = errors_px(found, truth, WALL)
    assert 0.5 < np.median(np.abs(off)) * 1.4826 / np.nanmedian(found.sigma_px) < 1.5


def test_black_saturated_and_shaded_areas_have_no_codes() -> None:
    left, _, truth = captured()
    image = left.copy()
    image[150:190, 20:70] = 255
    found = one_shot(image, STRIPES)
    assert not np.any(found.reasons[153:187, 23:67] == 0)
    assert np.mean(found.reasons[155:185, 36:54] == Reason.TEXTURE) > 0.9
    for dark in (truth.surface == BLACK, ~truth.lit & (truth.surface == WALL)):
        inside = cv2.erode(dark.astype(np.uint8), np.ones((5, 5))) > 0
        assert inside.sum() > 300
        assert np.mean(found.reasons[inside] == 0) < 0.01
    assert np.any(found.reasons[(truth.surface == BLACK)] == Reason.SHADOW)


def test_two_cameras_and_a_projector() -> None:
    left, right, truth = captured()
    found = disparity_from_maps(one_shot(left, STRIPES), one_shot(right, STRIPES))
    seen = (found.reasons == 0) & ~truth.occluded & truth.lit
    off = np.abs(found.disparity_px - truth.disparity_px)[seen]
    assert seen.mean() > 0.5
    assert np.mean(off < 1.0) > 0.95 and np.median(off) < 0.15


def test_one_camera_and_a_projector() -> None:
    """Depth, compared with the truth of the same point in the frame of the two cameras."""
    scanner = SyntheticScanner(320, 240, PROJECTOR, scene=SCENE)
    truth, own = scanner.truth(), scanner.rig.left
    pose = RelativePose(scanner.R_projector_left, scanner.T_projector_left)
    rig = rectify_camera_and_projector(own, scanner.projector, pose)
    match = disparity_from_projector(rig, one_shot(rectified(rig, *scanner.capture(PATTERN))[0], STRIPES))
    y, x = np.nonzero(match.reasons == 0)
    assert len(y) > 0.35 * match.reasons.size
    depth_m = rig.f_px * rig.baseline_m / (match.disparity_px[y, x] - rig.doffs_px)
    P = rig.left.P
    points = depth_m[:, None] * np.column_stack(((x - P[0, 2]) / P[0, 0], (y - P[1, 2]) / P[1, 1], np.ones(len(y))))
    points = points @ rig.left.R @ own.R.T
    column = np.rint(own.P[0, 0] * points[:, 0] / points[:, 2] + own.P[0, 2]).astype(int)
    row = np.rint(own.P[1, 1] * points[:, 1] / points[:, 2] + own.P[1, 2]).astype(int)
    inside = (row >= 0) & (row < 240) & (column >= 0) & (column < 320)
    off = np.abs(points[inside, 2] / truth.depth_m[row[inside], column[inside]] - 1.0)
    assert np.median(off) < 0.004 and np.mean(off < 0.01) > 0.9


def test_a_projector_upside_down_and_horizontal_stripes() -> None:
    upright = one_shot(captured()[0], STRIPES)
    turned = one_shot(captured(turned=True)[0], STRIPES)
    both = (upright.reasons == 0) & (turned.reasons == 0)
    assert both.mean() > 0.55 and upright.column_px is not None and turned.column_px is not None
    total = upright.column_px[both] + turned.column_px[both]
    assert np.median(np.abs(total - (PROJECTOR[0] - 1))) < 0.2

    lying = read_stripes(np.ascontiguousarray(PATTERN.transpose(1, 0, 2)))
    found = one_shot(np.ascontiguousarray(captured()[0].transpose(1, 0, 2)), lying)
    assert found.column_px is None and found.row_px is not None and found.size == PROJECTOR[::-1]
    np.testing.assert_array_equal(found.row_px.T, upright.column_px)
    np.testing.assert_array_equal(found.reasons.T, upright.reasons)


def test_an_image_without_the_pattern_has_no_codes() -> None:
    """Another pattern, noise, and darkness."""
    other = stripe_pattern((640, 64), 5, window=4)[:, ::-1]
    noise = np.random.default_rng(0).integers(0, 256, (48, 200, 3), np.uint8)
    dark = np.full((48, 200, 3), 3, np.uint8)
    dark[..., 1] = 4
    for image in (noise, dark):
        assert np.count_nonzero(one_shot(image, STRIPES).reasons == 0) == 0
    assert np.mean(one_shot(np.ascontiguousarray(other), STRIPES).reasons == 0) == 0


def test_an_object_of_a_few_stripes() -> None:
    left, _, truth = captured()
    image = np.zeros_like(left)
    image[20:90, 60:92] = left[20:90, 60:92]
    found = one_shot(image, STRIPES)
    assert found.column_px is not None
    off = np.abs(found.column_px - truth.column_px)[22:88, 67:85]  # without the borders, which are edges too
    assert np.mean(off < 1.0) > 0.95


@pytest.mark.parametrize(
    ("image", "problem"),
    [
        (np.zeros((4, 5), np.uint8), r"uint8 \(4, 5\)"),
        (np.zeros((4, 5, 3), np.uint16), "uint16"),
        (np.zeros((0, 5, 3), np.uint8), "no pixels"),
        (np.full((4, 5, 3), 7, np.uint8), "no colors"),
        (None, "NoneType"),
    ],
)
def test_images_that_cannot_be_decoded(image: U8, problem: str) -> None:
    with pytest.raises(ImageError, match=problem) as error:
        one_shot(image, STRIPES)
    assert error.value.remedy and error.value.subject


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 9, 3), (9, 2, 3), (2, 400, 3)])
def test_small_images(shape: tuple[int, int, int]) -> None:
    image = np.random.default_rng(1).integers(0, 256, shape, np.uint8)
    assert (one_shot(image, STRIPES).reasons != 0).all()


# Photographs


def photographed(folder: Path, name: str) -> tuple[U8, StripePattern]:
    """At a quarter of the size."""
    image = cv2.imread(str(folder / name), cv2.IMREAD_REDUCED_COLOR_4)
    pattern = cv2.imread(str(folder / "pattern2.bmp"))
    return np.ascontiguousarray(image[..., ::-1]), read_stripes(np.ascontiguousarray(pattern[..., ::-1]))


def plane_errors(points: F64) -> F64:
    """Deviation from the best u = (a x + b y + c) / (d x + e y + 1), projector px."""
    x, y, u = ((points - points.mean(axis=0)) / points.std(axis=0)).T
    weight, inlier = np.ones_like(u), np.ones(len(u), bool)
    for _ in range(10):
        A = np.stack([x, y, np.ones_like(x), -u * x, -u * y], axis=1) / weight[:, None]
        a, b, c, d, e = np.linalg.lstsq(A[inlier], (u / weight)[inlier], rcond=None)[0]
        weight = d * x + e * y + 1
        off = ((a * x + b * y + c) / weight - u) * points[:, 2].std()
        inlier = np.abs(off) < 1.0
    return np.asarray(off)


@pytest.mark.real_data
def test_a_photographed_wall_is_a_plane(stereo_data: Path) -> None:
    """A stripe is two columns wide: within one column, the identity is right."""
    image, pattern = photographed(stereo_data / "active" / "d_color_stripe_tingck", "wall.jpg")
    edges = decode_edges(image, pattern)
    points = edges.points()
    off = plane_errors(points)
    assert len(points) > 40000 and len(np.unique(points[:, 2])) == len(pattern.edges_px) == 124
    assert np.mean(np.abs(off) < 1.0) > 0.97 and np.mean(np.abs(off) < 2.0) > 0.999
    assert np.sqrt(np.mean(off[np.abs(off) < 1.0] ** 2)) < 0.36


@pytest.mark.real_data
def test_a_photographed_hand_is_in_order(stereo_data: Path) -> None:
    """Columns increase along each row; the wall beside and the hand are decoded densely."""
    image, pattern = photographed(stereo_data / "active" / "d_color_stripe_tingck", "hand.jpg")
    found = one_shot(image, pattern)
    assert found.column_px is not None
    decreasing = total = 0
    for row in found.column_px:
        steps = np.diff(row[np.isfinite(row)])
        decreasing, total = decreasing + np.count_nonzero(steps < 0), total + steps.size
    assert decreasing < 0.002 * total
    assert np.isfinite(found.column_px[200:300, 180:500]).mean() > 0.9
    assert np.isfinite(found.column_px[80:260, 570:640]).mean() > 0.9
