# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robust estimation of the fundamental matrix from matches with outliers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.eight_point import (
    check_matches,
    eight_point,
    enforce_rank_2,
    epipolar_equations,
    unit_scale,
)
from stereo_depth_ros.geometry.epipolar import homogeneous, sampson_distance
from stereo_depth_ros.geometry.sampson_refinement import common_scale, refine_fundamental, robust_scale

__all__ = ["FundamentalEstimate", "estimate_fundamental"]

SAMPLE = 8
SAMPLES_AT_ONCE = 64
MAX_SAMPLES = 8192
CONFIDENCE = 0.999
ROUNDS = 10  # of refinement and reselection of inliers; two or three are usual
OFF_PLANE = 8  # inliers off the dominant plane
PLANE_THRESHOLDS = 3.0  # an error of a homography has two components, each with the noise of both images


@dataclass(frozen=True, eq=False)
class FundamentalEstimate:
    """Fundamental matrix estimated from matches.

    Attributes:
        F: float64 (3, 3), x_right^T F x_left = 0, rank 2, Frobenius norm 1, the entry of largest size positive.
        inliers: bool (N,), the matches whose Sampson distance is below the threshold.
        sampson_rms_px: root mean square of the Sampson distances of the inliers, px.
    """

    F: F64
    inliers: npt.NDArray[np.bool_]
    sampson_rms_px: float


def estimate_fundamental(
    left_px: F64, right_px: F64, threshold_px: float = 1.0, method: str = "magsac"
) -> FundamentalEstimate:
    """Estimate the fundamental matrix of least Sampson distance from the inliers of matches.

    Args:
        left_px, right_px: float64 (N, 2), N >= 8, pixels without distortion.
        threshold_px: matches with a larger Sampson distance are outliers.
        method: "magsac", MAGSAC++ of OpenCV (Barath et al. 2020), or "ransac", samples of eight points (Fischler and
            Bolles 1981) scored by truncated squares (Torr and Zisserman 2000). Both are deterministic.

    Raises:
        ConfigError: an unknown method, or a threshold that is not above 0.
        CalibrationError: too few matches or inliers, points that are coincident, collinear or coplanar, or a camera
            that only rotated.
    """
    if method not in _METHODS:
        raise ConfigError(
            f"method {method!r} is not one of {', '.join(_METHODS)}",
            value=method,
            limit=tuple(_METHODS),
            remedy="use one of them",
            settings=("method",),
        )
    if not 0 < threshold_px < math.inf:
        raise ConfigError(
            f"threshold_px = {threshold_px:g} is not above 0 and finite",
            value=threshold_px,
            limit=0.0,
            remedy="use 1 px for good matches",
            settings=("threshold_px",),
        )
    check_matches(left_px, right_px)
    F, inliers = _refined(_METHODS[method](left_px, right_px, threshold_px), left_px, right_px, threshold_px)
    distances = sampson_distance(F, left_px[inliers], right_px[inliers])
    return FundamentalEstimate(F, inliers, float(np.sqrt(np.mean(distances**2))))


def _refined(F: F64, left_px: F64, right_px: F64, threshold_px: float) -> tuple[F64, npt.NDArray[np.bool_]]:
    """Alternate refinement and reselection of inliers until the inliers do not change."""
    distances = sampson_distance(F, left_px, right_px)
    inliers = distances < threshold_px
    for _ in range(ROUNDS):
        if inliers.sum() < SAMPLE:
            break
        F = refine_fundamental(F, left_px[inliers], right_px[inliers], robust_scale(distances[inliers]))
        distances = sampson_distance(F, left_px, right_px)
        before, inliers = inliers, distances < threshold_px
        if np.array_equal(inliers, before):
            break
    _check_inlier_count(left_px, right_px, inliers, threshold_px)
    _check_depths(left_px[inliers], right_px[inliers], threshold_px)
    eight_point(left_px[inliers], right_px[inliers])  # raises where the inliers do not determine the matrix
    return unit_scale(F), inliers


def _check_inlier_count(left_px: F64, right_px: F64, inliers: npt.NDArray[np.bool_], threshold_px: float) -> None:
    """The number of inliers must be above that of random matches (Moisan and Stival 2004, eq. 11).

    Seven matches always agree; another one agrees by chance where its point is in the band around its epipolar line.
    """
    total, agree = len(inliers), int(inliers.sum())
    extents = [np.ptp(points, axis=0) for points in (left_px, right_px)]
    chance = min(1.0, max(2 * threshold_px * math.hypot(*extent) / extent.prod() for extent in extents))
    choices = _log_binomial(total, agree) + _log_binomial(agree, 7) if agree > 7 else 0.0
    false_alarms = math.log(max(total - 7, 1)) + choices + (agree - 7) * math.log(chance)
    if agree < SAMPLE or false_alarms > 0:
        raise CalibrationError(
            f"{agree} of {total} matches agree on a fundamental matrix within {threshold_px:g} px, no more than random "
            "matches",
            value=agree,
            remedy="match images of the same scene, undistort the points, or raise threshold_px",
            settings=("threshold_px",),
        )


def _log_binomial(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


def _check_depths(left_px: F64, right_px: F64, threshold_px: float) -> None:
    """Inliers off the dominant plane must be more than two, which fit some fundamental matrix wherever they are.

    (H-degeneracy, Chum, Werner and Matas 2005.)
    """
    reach_px = PLANE_THRESHOLDS * threshold_px
    H = cv2.findHomography(left_px, right_px, cv2.USAC_MAGSAC, reach_px)[0]
    if H is None:
        return
    mapped = homogeneous(left_px) @ H.T
    off = int((np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - right_px, axis=1) > reach_px).sum())
    needed = min(OFF_PLANE, (len(left_px) - 4) // 2)
    if off < needed:
        raise CalibrationError(
            f"all but {off} of {len(left_px)} matches are coplanar, or of a camera that only rotated, within "
            f"{reach_px:g} px; at least {needed} others are needed",
            value=off,
            limit=needed,
            remedy="use a scene with more depth, a larger baseline, or a lower threshold_px",
            settings=("threshold_px",),
        )


def _magsac(left_px: F64, right_px: F64, threshold_px: float) -> F64:
    F, _ = cv2.findFundamentalMat(left_px, right_px, cv2.USAC_MAGSAC, threshold_px, CONFIDENCE, MAX_SAMPLES)
    if F is None or F.shape != (3, 3):
        raise CalibrationError(
            f"MAGSAC found no fundamental matrix for {len(left_px)} matches",
            value=len(left_px),
            remedy="match images of the same scene",
        )
    found: F64 = F
    return found


def _ransac(left_px: F64, right_px: F64, threshold_px: float) -> F64:
    """The best of random samples of eight, each improvement locally optimized by its inliers (Chum et al. 2003)."""
    to_left, to_right = common_scale(left_px, right_px)
    x_left, x_right = homogeneous(left_px) @ to_left.T, homogeneous(right_px) @ to_right.T
    threshold = threshold_px * to_left[0, 0]
    rng = np.random.default_rng(0)
    best, best_cost, tried, needed = np.zeros((3, 3)), math.inf, 0, MAX_SAMPLES
    while tried < needed:
        candidates = _from_samples(x_left, x_right, rng)
        costs, counts = _scores(candidates, x_left, x_right, threshold)
        tried += len(candidates)
        first = int(costs.argmin())
        if costs[first] >= best_cost:
            continue
        best, best_cost, agree = candidates[first], costs[first], counts[first]
        local = _refitted(best, x_left, x_right, threshold)
        costs, counts = _scores(local[None], x_left, x_right, threshold)
        if costs[0] < best_cost:
            best, best_cost, agree = local, costs[0], counts[0]
        needed = min(MAX_SAMPLES, _samples_needed(agree / len(x_left)))
    F: F64 = to_right.T @ best @ to_left
    return F


def _from_samples(x_left: F64, x_right: F64, rng: np.random.Generator) -> F64:
    """float64 (S, 3, 3): the fundamental matrices of S random samples."""
    order = rng.random((SAMPLES_AT_ONCE, len(x_left)))
    sample = np.argpartition(order, SAMPLE - 1, axis=1)[:, :SAMPLE]
    equations = epipolar_equations(x_left[sample], x_right[sample])
    return enforce_rank_2(np.linalg.svd(equations, full_matrices=True)[2][:, 8].reshape(-1, 3, 3))


def _scores(F: F64, x_left: F64, x_right: F64, threshold: float) -> tuple[F64, npt.NDArray[np.intp]]:
    """Sums of squared Sampson distances truncated at the threshold, and inlier counts, of matrices (S, 3, 3)."""
    in_right, in_left = x_left @ F.transpose(0, 2, 1), x_right @ F
    slope = (in_right[..., :2] ** 2).sum(axis=2) + (in_left[..., :2] ** 2).sum(axis=2)
    squared = (in_right * x_right).sum(axis=2) ** 2 / np.maximum(slope, np.finfo(np.float64).tiny)
    costs: F64 = np.minimum(squared, threshold**2).sum(axis=1)
    return costs, np.count_nonzero(squared < threshold**2, axis=1)


def _refitted(F: F64, x_left: F64, x_right: F64, threshold: float) -> F64:
    """The eight-point solution of the inliers; F itself where they do not determine it."""
    inliers = sampson_distance(F, x_left[:, :2], x_right[:, :2]) < threshold
    try:
        return eight_point(x_left[inliers, :2], x_right[inliers, :2])
    except CalibrationError:
        return F


def _samples_needed(share: float) -> int:
    """Number of samples after which one consists of inliers only, with the given confidence."""
    good = min(share**SAMPLE, 1 - 1e-12)
    return math.ceil(math.log(1 - CONFIDENCE) / math.log1p(-good)) if good > 0 else MAX_SAMPLES


_METHODS: Mapping[str, Callable[[F64, F64, float], F64]] = {"magsac": _magsac, "ransac": _ransac}
