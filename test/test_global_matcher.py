# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Common properties of scanline, graph_cut and belief_propagation, on known surfaces and on real pairs."""

from __future__ import annotations

from pathlib import Path

import middlebury2001
import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F32, U8, Reason
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.global_methods.energy import I32, StereoModel, energy, stereo_model
from stereo_depth_ros.matching.global_methods.global_matcher import margin

# Percent of all pixels wrong by more than 1 px, but for occluded ones and a border of 18 px.
LIMITS = {
    "scanline": {"tsukuba": 5.5, "venus": 11.0},
    "graph_cut": {"tsukuba": 2.5, "venus": 3.5},
    "belief_propagation": {"tsukuba": 2.5, "venus": 2.5},
}
SHAPE = (90, 140)
NEAR = (slice(30, 65), slice(46, 82))  # rows and columns of the nearer square, in the left image


@pytest.fixture(params=LIMITS)
def method(request: pytest.FixtureRequest) -> str:
    if request.param == "graph_cut":
        pytest.importorskip("maxflow")
    return str(request.param)


def two_surfaces(far: int, near: int) -> tuple[U8, U8, F32]:
    """A noise square in front of a noise wall, with other noise where one camera alone looks; and the disparities."""
    rng = np.random.default_rng(11)
    height, width = SHAPE
    wall = rng.integers(0, 256, (height, width + 200)).astype(np.float64)
    square = rng.integers(0, 256, (NEAR[0].stop - NEAR[0].start, NEAR[1].stop - NEAR[1].start))
    disparity = np.full(SHAPE, far, np.float32)
    disparity[NEAR] = near
    left, right = wall[:, 100 : 100 + width].copy(), wall[:, 100 + far : 100 + far + width].copy()
    left[NEAR] = square
    right[NEAR[0], NEAR[1].start - near : NEAR[1].stop - near] = square
    left, right = (np.clip(image + rng.normal(0, 2, SHAPE), 0, 255).astype(np.uint8) for image in (left, right))
    return left, right, disparity


def occluded_strip(far: int, near: int) -> tuple[slice, slice]:
    """The wall that the square hides from the right camera: what lies left of it, as wide as the difference."""
    return NEAR[0], slice(NEAR[1].start - (near - far), NEAR[1].start)


@pytest.mark.parametrize(("far", "near", "min_disparity"), [(4, 13, 0), (-14, -6, -16), (-33, -25, -40), (9, 17, 6)])
def test_disparities_of_two_surfaces(method: str, far: int, near: int, min_disparity: int) -> None:
    left, right, disparity = two_surfaces(far, near)
    # White noise often fits by chance: twice the usual smoothness keeps the paths of scanline from hopping through it.
    fields = {"min_disparity": min_disparity, "num_disparities": 32, "speckle_size": 0, "smoothness": 3.0}
    matcher = create_matcher(method, **fields)
    result = matcher.match(left, right)
    assert matcher.name == method and result.step_px == 1.0
    assert result.disparity_px.dtype == np.float32 and result.reasons.dtype == np.uint8
    np.testing.assert_array_equal(result.reasons == 0, np.isfinite(result.disparity_px))
    assert result.confidence is not None and result.confidence.dtype == np.float32
    assert result.confidence.min() >= 0 and result.confidence.max() <= 1
    assert not result.confidence[result.reasons != 0].any()

    columns = np.arange(SHAPE[1])
    border = (columns < min_disparity) | (columns >= SHAPE[1] + min(0, min_disparity + 31))
    np.testing.assert_array_equal(result.reasons == Reason.BORDER, np.broadcast_to(border, SHAPE))
    seen = np.broadcast_to((columns >= max(0, far)) & (columns < SHAPE[1] + min(0, far)), SHAPE).copy()
    seen[occluded_strip(far, near)] = False
    wrong = ~(result.disparity_px[seen] == disparity[seen])
    # Pixels of noise at the edges of the square may fit the other surface by chance.
    assert np.mean(wrong) < 0.005


def test_left_right_check_rejects_occlusions(method: str) -> None:
    left, right, disparity = two_surfaces(4, 13)
    fields = {"num_disparities": 32, "speckle_size": 0}
    result = create_matcher(method, disp12_max_diff=1, **fields).match(left, right)
    without = create_matcher(method, **fields).match(left, right)
    strip = occluded_strip(4, 13)
    kept = result.reasons == 0
    assert np.mean(kept[strip]) < 0.05
    np.testing.assert_array_equal(result.disparity_px[kept], without.disparity_px[kept])
    checked = result.reasons[without.reasons == 0]
    assert set(np.unique(checked)) <= {0, int(Reason.LEFT_RIGHT)}
    seen = np.isfinite(disparity)
    seen[:, :13] = False
    seen[strip] = False
    assert np.mean(kept[seen]) > 0.99


def test_energies_are_of_the_left_image() -> None:
    left, right, _ = two_surfaces(4, 13)
    plain = create_matcher("belief_propagation", num_disparities=32)
    checked = create_matcher("belief_propagation", num_disparities=32, disp12_max_diff=1)
    plain.match(left, right)
    checked.match(left, right)
    assert plain.energies == checked.energies  # type: ignore[attr-defined]


def test_same_bytes_on_any_number_of_cores_and_again(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    left, right, _ = two_surfaces(3, 9)
    matcher = create_matcher(method, num_disparities=32, disp12_max_diff=2)
    out = np.full(SHAPE, 7, np.float32)
    first = matcher.match(left, right, out)
    assert first.disparity_px is out
    monkeypatch.setattr(parallel, "core_count", lambda: 1)
    again = matcher.match(left, right)
    assert again.disparity_px.tobytes() == out.tobytes()
    assert again.reasons.tobytes() == first.reasons.tobytes()
    assert again.confidence is not None and first.confidence is not None
    assert again.confidence.tobytes() == first.confidence.tobytes()


def test_speckles_are_removed(method: str) -> None:
    left, right, disparity = two_surfaces(4, 13)
    square = disparity[NEAR].size
    fields = {"num_disparities": 32, "speckle_range": 1}
    kept = create_matcher(method, speckle_size=square // 4, **fields).match(left, right)
    wall_alone = create_matcher(method, speckle_size=1000, **fields).match(left[20:42], right[20:42])
    assert np.mean(kept.disparity_px[NEAR] == 13) > 0.98
    # 12 rows of the square and of what it hides are 540 px: a component that is small enough.
    assert np.mean(wall_alone.reasons[13:22, 52:76] == Reason.SPECKLE) > 0.9


def test_smoothness_removes_small_structures(method: str) -> None:
    left, right, _ = two_surfaces(4, 13)
    weak, strong = (
        create_matcher(method, num_disparities=32, speckle_size=0, smoothness=value).match(left, right)
        for value in (0.5, 900.0)
    )
    assert np.mean(weak.disparity_px[NEAR] == 13) > 0.98
    assert not (strong.disparity_px == 13).any()


def test_smoothness_below_the_unit_of_costs_is_refused(method: str) -> None:
    with pytest.raises(ConfigError, match=r"smoothness = 0.25 is below 0.5 .* use 0.5 or more"):
        create_matcher(method, smoothness=0.25)


def test_disparities_beyond_16_bit_are_refused(method: str) -> None:
    with pytest.raises(ConfigError, match=r"disparities -2048\.\.-1985 .* use a smaller search range"):
        create_matcher(method, min_disparity=-2048)


def test_images_are_checked(method: str) -> None:
    matcher = create_matcher(method, num_disparities=32)
    image = np.zeros((40, 60), np.uint8)
    with pytest.raises(ImageError, match="convert it to gray"):
        matcher.match(np.zeros((40, 60, 3), np.uint8), image)
    with pytest.raises(ImageError, match="both must have one size"):
        matcher.match(image, image[:, 1:])
    with pytest.raises(ImageError, match="pass such an array or None"):
        matcher.match(image, image, np.empty((40, 60)))  # type: ignore[arg-type]


def test_margin_compares_the_label_with_the_best_that_is_not_adjacent() -> None:
    data = np.empty((4, 5, 6), np.int32)
    data[:] = [8, 3, 1, 0, 24, 90]
    model = StereoModel(data, np.zeros((2, 4, 5), np.int32), 2, 24)
    # Own 1: others at least two away are 8, 24 and 90 (24 at most). Own 0: the best other is 3. Own 24: it is 1.
    for label, expected in ((2, 8 / 9), (3, 1.0), (4, 1 / 25), (5, 0.0)):
        labels = np.full((4, 5), label, np.int32)
        np.testing.assert_allclose(margin(model, labels, 3), expected, rtol=1e-6)
    nothing = StereoModel(np.zeros_like(data), model.weights, 2, 24)
    np.testing.assert_array_equal(margin(nothing, np.zeros((4, 5), np.int32), 3), np.float32(0.5))


def sparsification(wrong: np.ndarray, confidence: np.ndarray) -> float:
    """Area under the error rate as the least confident pixels go, against that of a random order (which is flat)."""
    order = np.random.default_rng(0).permutation(wrong.size)  # equal confidences in random order
    order = order[np.argsort(-confidence[order], kind="stable")]
    return float(np.mean(np.cumsum(wrong[order]) / np.arange(1, wrong.size + 1)) / wrong.mean())


@pytest.mark.real_data
@pytest.mark.parametrize("name", ["tsukuba", "venus"])
def test_real_pairs(method: str, name: str, stereo_data: Path) -> None:
    of = middlebury2001.scene(name, stereo_data)
    result, energies, seconds = middlebury2001.matched(method, name, stereo_data, fill_holes=True)
    assert seconds < 60
    assert result.valid_fraction == 1
    assert middlebury2001.bad(result.disparity_px, of) <= LIMITS[method][name]

    falls = np.diff(energies) < 0
    assert falls.all() if method == "graph_cut" else energies[-1:] <= energies[:1]
    assert (len(energies) > 0) == (method != "scanline")

    assert result.confidence is not None
    wrong = np.abs(result.disparity_px - of.truth_px)[of.mask] > 1
    assert sparsification(wrong, result.confidence[of.mask]) < 0.5


def labels_inside(disparity_px: F32) -> I32:
    """Whole disparities from 0, moved into the right image where filling holes left it."""
    whole = np.rint(disparity_px).astype(np.int32)
    return np.clip(whole, 0, np.minimum(np.arange(whole.shape[1]), 31)).astype(np.int32)


@pytest.mark.real_data
def test_final_energy_is_below_that_of_local_and_scanline_methods(stereo_data: Path) -> None:
    pytest.importorskip("maxflow")
    of = middlebury2001.scene("tsukuba", stereo_data)
    model = stereo_model(of.left, of.right, MatchingConfig(num_disparities=32))
    fields = {"window": {"correlation_window_size": 9}}
    reached = {}
    for method in ("graph_cut", "belief_propagation", "scanline", "window"):
        given = fields.get(method, {"fill_holes": True})
        result, energies, _ = middlebury2001.matched(method, "tsukuba", stereo_data, **given)
        labels = labels_inside(result.disparity_px)
        assert (np.take_along_axis(model.data, labels[..., np.newaxis], 2) <= model.largest_cost).all()
        reached[method] = energy(model, labels)
        assert energies[-1:] in ([], [reached[method]])
    assert max(reached["graph_cut"], reached["belief_propagation"]) < min(reached["scanline"], reached["window"])


@pytest.mark.real_data
@pytest.mark.parametrize(("method", "limit"), [("scanline", 4.0), ("belief_propagation", 5.0)])
def test_constants_hold_with_photometric_differences(method: str, limit: float, stereo_data: Path) -> None:
    # With gray values as they are, 8.2 and 8.6 % are wrong.
    of = middlebury2001.part(middlebury2001.scene("Baby1", stereo_data), slice(100, 200))
    fields = {"num_disparities": of.num_disparities, "speckle_size": 0, "fill_holes": True}
    result = create_matcher(method, **fields).match(of.left, of.right)
    assert middlebury2001.bad(result.disparity_px, of) <= limit
