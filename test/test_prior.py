# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A prior of disparities: its costs by the definition, and what it does to sgm."""

from __future__ import annotations

import dataclasses

import cv2
import numba
import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import F32, U8, Frame, StereoPair
from stereo_depth_ros.core.uncalibrated_rig import UncalibratedRig
from stereo_depth_ros.evaluation.evaluator import evaluate
from stereo_depth_ros.evaluation.scenes import make_scene
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.costs.prior import PRIOR_COSTS, PriorCosts, add_prior_costs, prior_costs
from stereo_depth_ros.pipeline import StereoPipeline

HEIGHT, WIDTH, COUNT = 70, 130, 32
WALL_PX = 9.0


def points(share: float, truth_px: F32, seed: int = 3, sigma_px: float = 0.2) -> DisparityPrior:
    rng = np.random.default_rng(seed)
    chosen = rng.random(truth_px.shape) < share
    noisy = truth_px + rng.normal(0, sigma_px, truth_px.shape).astype(np.float32)
    return DisparityPrior(np.where(chosen, noisy, np.float32(np.nan)), np.full(truth_px.shape, sigma_px, np.float32))


def wall_without_texture() -> tuple[U8, U8, F32]:
    """A flat gray wall with a little noise that differs between the cameras, and texture around it."""
    rng = np.random.default_rng(5)
    texture = cv2.GaussianBlur(rng.integers(0, 256, (HEIGHT, WIDTH + COUNT)).astype(np.float32), (3, 3), 0)
    texture[12:-12, 45:-50] = 128
    left, right = texture[:, :WIDTH].copy(), texture[:, int(WALL_PX) : WIDTH + int(WALL_PX)].copy()
    left, right = (np.clip(np.rint(side + rng.normal(0, 1.5, side.shape)), 0, 255) for side in (left, right))
    return left.astype(np.uint8), right.astype(np.uint8), np.full((HEIGHT, WIDTH), WALL_PX, np.float32)


@compiled(numba.void(PRIOR_COSTS, numba.int64, numba.int64, numba.uint8[:, :, ::1]))
def _add(prior: PriorCosts, max_disparity: int, count: int, cost: U8) -> None:
    for y in range(len(cost)):
        add_prior_costs(prior, y, max_disparity, count, cost[y])


def spread_by_definition(prior: DisparityPrior, image: U8) -> list[list[tuple[float, float, float] | None]]:
    """Expected disparity, width and bound of each pixel."""
    rows = np.argwhere(prior.known)
    share = len(rows) / image.size
    reach = min(12, int(np.ceil(2 / np.sqrt(share))))
    found: list[list[tuple[float, float, float] | None]] = [[None] * image.shape[1] for _ in range(len(image))]
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            best = np.inf
            for y, x in rows:
                if max(abs(y - v), abs(x - u)) <= reach:
                    r = float(np.hypot(y - v, x - u))
                    exponent = r / 20 + abs(int(image[v, u]) - int(image[y, x])) / 30
                    if exponent < best - 1e-6:
                        best = exponent
                        width = float(np.sqrt(prior.sigma_px[y, x] ** 2 + 1 + 0.04 * r**2))
                        found[v][u] = (float(prior.disparity_px[y, x]), width, 20 * float(np.exp(-exponent)))
    return found


def test_costs_are_those_of_the_definition() -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 200, (19, 33), np.uint8)
    disparity_px = np.full(image.shape, np.nan, np.float32)
    sigma_px = np.full(image.shape, np.nan, np.float32)  # of no meaning without a point
    for y, x, d, sigma in (
        (3, 5, 12.3, 0.2),
        (4, 25, 20.0, 1.5),
        (16, 8, 7.75, 0),
        (9, 17, 31.4, 0.4),
        (15, 30, 70, 1),
    ):
        disparity_px[y, x], sigma_px[y, x] = d, sigma
    prior = DisparityPrior(disparity_px, sigma_px)
    cost = rng.integers(0, 63, (*image.shape, 48), np.uint8)  # 40 are searched
    expected = cost.astype(np.float64)
    for y, row in enumerate(spread_by_definition(prior, image)):
        for x, point in enumerate(row):
            if point is not None and point[0] < 45.5:  # 6..45 are searched
                d, width, most = point
                away = np.maximum(np.abs(45 - np.arange(40) - d) - 0.5, 0)
                expected[y, x, :40] = np.minimum(
                    expected[y, x, :40] + most * (1 - np.exp(-(away**2) / (2 * width**2))), 62
                )
    before = cost.copy()
    _add(prior_costs(prior, image), 45, 40, cost)
    assert np.abs(cost - expected).max() <= 0.51
    assert np.mean(cost != before) > 0.3
    _add(prior_costs(None, image), 45, 40, before)
    assert before.max() <= 62


def test_a_prior_finds_the_wall_that_the_images_do_not_show() -> None:
    left, right, truth_px = wall_without_texture()
    sgm = create_matcher("sgm", num_disparities=COUNT)
    wall = np.zeros(left.shape, np.bool_)
    wall[16:-16, 50:-55] = True
    without = sgm.match(left, right).disparity_px
    guided = sgm.match(left, right, prior=points(0.03, truth_px)).disparity_px
    right_without, right_guided = (np.mean(np.abs(d[wall] - WALL_PX) < 1) for d in (without, guided))
    assert right_without < 0.5 and right_guided > 0.95
    assert (np.abs(guided[wall & np.isfinite(guided)] - WALL_PX) < 1).all()
    np.testing.assert_array_equal(sgm.match(left, right).disparity_px, without)  # nothing is left of it


def test_wrong_points_lose_against_texture() -> None:
    rng = np.random.default_rng(2)
    texture = rng.integers(0, 256, (HEIGHT, WIDTH + COUNT), np.uint8)
    left, right = texture[:, :WIDTH].copy(), texture[:, 9 : WIDTH + 9].copy()
    wrong = points(0.05, np.full((HEIGHT, WIDTH), 21.0, np.float32))
    sgm = create_matcher("sgm", num_disparities=COUNT)
    result = sgm.match(left, right, prior=wrong)
    valid = np.isfinite(result.disparity_px[:, COUNT:])
    assert valid.mean() > 0.95
    assert np.mean(np.abs(result.disparity_px[:, COUNT:][valid] - 9) < 0.5) > 0.99


def test_points_outside_the_search_and_empty_priors_change_nothing() -> None:
    left, right, truth_px = wall_without_texture()
    sgm = create_matcher("sgm", num_disparities=COUNT, sgm_paths=8)
    expected = sgm.match(left, right)
    for prior in (points(0.0, truth_px), points(0.05, truth_px + 60), points(0.05, truth_px - 40)):
        result = sgm.match(left, right, prior=prior)
        np.testing.assert_array_equal(result.disparity_px, expected.disparity_px)
        np.testing.assert_array_equal(result.reasons, expected.reasons)


def test_costs_stay_within_8_bits() -> None:
    """With the largest penalties that are allowed, path costs of 70 half bits are the most that fit."""
    left, right, truth_px = wall_without_texture()
    config = MatchingConfig(num_disparities=COUNT, sgm_P1=92, sgm_P2=93)
    result = create_matcher("sgm", config).match(left, right, prior=points(0.1, truth_px))
    valid = np.isfinite(result.disparity_px[:, COUNT:])
    assert np.mean(np.abs(result.disparity_px[:, COUNT:][valid] - WALL_PX) < 1) > 0.97


@pytest.mark.parametrize("quality", ["fast", "default", "best"])
def test_every_quality_takes_a_prior(quality: str) -> None:
    left, right, truth_px = wall_without_texture()
    config = MatchingConfig(num_disparities=COUNT, quality=quality)
    result = create_matcher("sgm", config).match(left, right, prior=points(0.1, truth_px))
    found = result.disparity_px[:, COUNT:]
    assert np.isfinite(found).mean() > 0.8
    assert np.mean(np.abs(found[np.isfinite(found)] - WALL_PX) < 1) > 0.97


def test_scene_with_a_prior_is_evaluated_with_it() -> None:
    left, right, truth_px = wall_without_texture()
    scene = make_scene(left, right, truth_px)
    config = MatchingConfig(num_disparities=COUNT)
    without = evaluate("wall", scene, "sgm", config)
    guided = evaluate("wall", dataclasses.replace(scene, prior=points(0.03, truth_px)), "sgm", config)
    assert guided.errors.bad_1_all < without.errors.bad_1_all - 5


def test_stage_and_pipeline_match_with_a_prior() -> None:
    left, right, truth_px = wall_without_texture()
    prior = points(0.03, truth_px)
    frames = StereoPair(*(Frame(side, 1, "camera") for side in (left, right)))
    rig = UncalibratedRig.from_homographies(np.identity(3), np.identity(3), (WIDTH, HEIGHT))
    pipeline = StereoPipeline(PipelineConfig(matching=MatchingConfig(num_disparities=COUNT)), rig)
    sides = pipeline.prepare(frames).rectified
    expected = create_matcher("sgm", pipeline.config.matching).match(sides.left, sides.right, prior=prior).disparity_px
    found = pipeline.process(frames, prior).disparity.disparity_px
    seen = np.isfinite(found)  # the stage rejects border pixels too
    np.testing.assert_array_equal(found[seen], expected[seen])
    np.testing.assert_array_equal(pipeline.match(pipeline.prepare(frames), prior).disparity.disparity_px, found)
    assert seen.mean() > 0.5 and seen.sum() > np.isfinite(pipeline.process(frames).disparity.disparity_px).sum()


def test_refusals() -> None:
    gray = np.zeros((40, 80), np.uint8)
    known = np.full((40, 80), 5, np.float32)
    with pytest.raises(ImageError, match=r"disparity_px is float64 of shape \(40, 80\), a prior has float32"):
        DisparityPrior(known.astype(np.float64), known)  # type: ignore[arg-type]
    with pytest.raises(ImageError, match=r"disparities have shape \(40, 80\), standard deviations \(40, 79\)"):
        DisparityPrior(known, known[:, :-1])
    with pytest.raises(ImageError, match="a standard deviation is -1 px, below 0 or not finite"):
        DisparityPrior(known, -known / 5)
    prior = DisparityPrior(known, known)
    with pytest.raises(ConfigError, match="bm takes no prior: use a matcher that does, such as sgm"):
        create_matcher("bm", correlation_window_size=5).match(gray, gray, prior=prior)
    with pytest.raises(ImageError, match=r"the prior is \(40, 80\), the left image is \(30, 80\)"):
        create_matcher("sgm").match(gray[:30], gray[:30], prior=prior)
