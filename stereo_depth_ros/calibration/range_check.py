# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks a stereo rig against a range sensor: scale of the depth, offset of the disparities, rotation of the sensor.

A point X of the sensor in the left rectified frame, turned by a small rotation R, has the disparity

    m = (1 + s) f B / Z + doffs + o,   (X, Y, Z) = R X,

and the matcher has found D(u, v) in its pixel u = f X / Z + cx, v = fy Y / Z + cy. The scale s of the baseline, the
offset o and the three angles of R minimize the differences D - m by Gauss-Newton, weighted robustly (Beaton and Tukey
1974). What the angles do to D follows from its gradient: slanted surfaces tell them, one plane parallel to the images
tells next to nothing.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.geometry.robust import robust_sigma

__all__ = ["FIGURES", "Figure", "RangeCheck", "RangeChecker"]

Mask: TypeAlias = npt.NDArray[np.bool_]

FIGURES = ("scale", "offset", "pitch", "yaw", "roll")

_PAIRS = 10  # that are kept
_POINTS = 1000  # of a pair
_FEWEST_POINTS, _FEWEST_TILES = 200, 12
_TILES = (8, 6)  # across and down: errors of matching are alike within one of them
_WINDOW = 5  # px, within which disparities are averaged, and which holds no depth step
_STEP_PX = 2.0  # of disparity in a window: above it, it is a depth step, where matchers widen what is near
_ITERATIONS, _WIDE = 12, 4  # of Gauss-Newton; the first ones tolerate three times larger differences
_NANS = (math.nan, math.nan, math.nan, math.nan)
_TUKEY = 4.685  # 95 % efficient for normal errors
_LEAST_PX = 0.02  # of the standard deviation of a difference
# What the matchers of this package err by in common, which scatter does not show: of disparities, and of the place in
# the image, which is that of all errors of a slanted surface. In the rendered room at focal lengths of 134 and 215 px,
# bm, sgbm and sgm erred by up to 0.18 px in the offset and 0.16 degrees: by about two of these.
_COMMON_PX, _COMMON_PLACE_PX = 0.08, 0.25
_CONVERGED = 1e-2  # of a standard deviation
# What is known without data: standard deviations of scale, px, radians. They decide only what data do not tell.
_PRIOR = np.array([0.2, 5.0, *[math.radians(5.0)] * 3])
# What is worth a warning: share, px, radians.
_LIMITS = np.array([0.01, 0.25, *[math.radians(0.2)] * 3])


@dataclass(frozen=True)
class Figure:
    """One figure of the check.

    Attributes:
        value: the estimate.
        sigma: its standard deviation.
        limit: deviation from 0 that is worth a warning; with a standard deviation above twice of it, it is not
            observable.
    """

    value: float
    sigma: float
    limit: float

    @property
    def observable(self) -> bool:
        """Whether the data tell it."""
        return self.sigma <= 2 * self.limit

    @property
    def deviates(self) -> bool:
        """Whether it is above its limit, and not by chance."""
        return self.observable and abs(self.value) > max(self.limit, 3 * self.sigma)


@dataclass(frozen=True)
class RangeCheck:
    """How stereo and sensor differ.

    Attributes:
        scale: true baseline relative to the calibrated one, minus 1; the depth of the stereo camera is wrong by the
            inverse of it.
        offset: what matched disparities are too large by, px.
        pitch, yaw, roll: rotation of the sensor's points about x, y, z of the left rectified camera that corrects its
            transform, degrees.
        residual_px: robust standard deviation of what remains.
        points: that were compared.
        matched: of them, those that agree, the weight of which is not 0.
        pairs: of images.
    """

    scale: Figure
    offset: Figure
    pitch: Figure
    yaw: Figure
    roll: Figure
    residual_px: float
    points: int
    matched: int
    pairs: int

    @property
    def figures(self) -> dict[str, Figure]:
        """All of them by name."""
        return {name: getattr(self, name) for name in FIGURES}


@dataclass(frozen=True)
class _Pair:
    """One pair: averaged disparities and their gradients, NaN where unknown or at a depth step; points before turning.

    ``maps`` is float32 (H, W, 3): disparity, and its derivatives along x and y; ``noise`` has the standard deviations
    of the derivatives.
    """

    maps: F32
    noise: tuple[float, float]
    points_m: F64


@dataclass(frozen=True)
class _Linearized:
    """Differences, float64 (N,), their derivatives, float64 (N, 5), and their tiles, int64 (N,).

    ``noise`` has the standard deviations of the derivatives by those of the gradients along x and y, float64 (N, 2, 5).
    """

    differences: F64
    jacobian: F64
    noise: F64
    tiles: npt.NDArray[np.int64]


class RangeChecker:
    """Compares matched disparities with a range sensor, over the last ten pairs.

    Args:
        triangulation: of the rig.
    """

    def __init__(self, triangulation: Triangulation) -> None:
        self._triangulation = triangulation
        self._pairs: deque[_Pair] = deque(maxlen=_PAIRS)

    def add(self, disparity_px: F32, points_m: F32) -> None:
        """Add a pair.

        Args:
            disparity_px: float32 (H, W), x_left - x_right as matched, NaN where invalid.
            points_m: float32 (N, 3), points of the sensor that the left camera sees, in the left rectified frame.
        """
        step = max(1, -(-len(points_m) // _POINTS))
        maps = _maps(disparity_px)
        self._pairs.append(_Pair(maps, _gradient_noise(maps), points_m[::step].astype(np.float64)))

    def check(self) -> RangeCheck | None:
        """The figures of the last pairs; None while fewer than 200 points in 12 of 8 x 6 tiles can be compared."""
        theta = np.zeros(5)
        for iteration in range(_ITERATIONS):
            at = self._linearized(theta)
            if len(at.differences) < _FEWEST_POINTS or len(np.unique(at.tiles)) < _FEWEST_TILES:
                return None
            first_px = np.median(at.differences) if iteration == 0 else 0.0  # of which the offset is not known yet
            scale_px = max(robust_sigma(at.differences - first_px), _LEAST_PX)
            cut = _TUKEY * scale_px * (3 if iteration < _WIDE else 1)
            weights = np.where(np.abs(at.differences) < cut, (1 - (at.differences / cut) ** 2) ** 2, 0.0) / scale_px**2
            information = (at.jacobian * weights[:, None]).T @ at.jacobian + np.diag(_PRIOR**-2)
            step = np.linalg.solve(information, at.jacobian.T @ (weights * at.differences) + theta / _PRIOR**2)
            theta = theta - step
            if iteration >= _WIDE and step @ information @ step < _CONVERGED**2:
                break
        sigmas = np.sqrt(np.diag(_covariance(at, weights)) + self._common(at.jacobian) ** 2)
        units = np.array([1.0, 1.0, *[180 / math.pi] * 3])
        scale, offset, pitch, yaw, roll = (
            Figure(*map(float, each)) for each in zip(theta * units, sigmas * units, _LIMITS * units, strict=True)
        )
        matched = int(np.count_nonzero(weights))
        return RangeCheck(scale, offset, pitch, yaw, roll, scale_px, len(weights), matched, len(self._pairs))

    def _common(self, jacobian: F64) -> F64:
        """Standard deviations, float64 (5,), of what all differences have in common."""
        angle = _COMMON_PLACE_PX / self._triangulation.f_px
        return np.array([_COMMON_PX / np.median(np.abs(jacobian[:, 0])), _COMMON_PX, angle, angle, angle])

    def _linearized(self, theta: F64) -> _Linearized:
        """At values of the parameters, over all pairs."""
        parts = [self._of_pair(pair, theta) for pair in self._pairs]
        if not parts:
            return _Linearized(np.zeros(0), np.zeros((0, 5)), np.zeros((0, 2, 5)), np.zeros(0, np.int64))
        return _Linearized(*map(np.concatenate, zip(*parts, strict=True)))

    def _of_pair(self, pair: _Pair, theta: F64) -> tuple[F64, F64, F64, npt.NDArray[np.int64]]:
        t, (scale, offset) = self._triangulation, theta[:2]
        turn = np.asarray(cv2.Rodrigues(theta[2:])[0], np.float64)
        X, Y, Z = (pair.points_m @ turn.T).T
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = t.f_px * X / Z + t.cx_px, t.fy_px * Y / Z + t.cy_px
        values = cv2.remap(pair.maps, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderValue=_NANS)
        D, D_x, D_y = values.reshape(-1, 3).T.astype(np.float64)
        known = np.isfinite(D) & np.isfinite(D_x) & np.isfinite(D_y) & (Z > 0)
        X, Y, Z, u, v, D, D_x, D_y = (each[known] for each in (X, Y, Z, u, v, D, D_x, D_y))
        of_depth = t.f_px * t.baseline_m / Z
        differences = D - (1 + scale) * of_depth - t.doffs_px - offset
        # a rotation w moves X by w x X
        zero = np.zeros_like(Z)
        X_w, Y_w, Z_w = np.array([[zero, Z, -Y], [-Z, zero, X], [Y, -X, zero]])
        u_w, v_w = t.f_px * (X_w * Z - X * Z_w) / Z**2, t.fy_px * (Y_w * Z - Y * Z_w) / Z**2
        by_angles = D_x * u_w + D_y * v_w + (1 + scale) * of_depth / Z * Z_w
        height, width = pair.maps.shape[:2]
        column = (u * (_TILES[0] / width)).astype(np.int64).clip(0, _TILES[0] - 1)
        row = (v * (_TILES[1] / height)).astype(np.int64).clip(0, _TILES[1] - 1)
        jacobian = np.stack([-of_depth, zero - 1, *by_angles], axis=1)
        noise = np.zeros((len(Z), 2, 5))
        noise[:, 0, 2:], noise[:, 1, 2:] = pair.noise[0] * u_w.T, pair.noise[1] * v_w.T
        return differences, jacobian, noise, row * _TILES[0] + column


def _covariance(at: _Linearized, weights: F64) -> F64:
    """Of the estimate, float64 (5, 5), by the scatter of whole tiles (Liang and Zeger 1986), and by what is not told.

    Neighbors err alike, so that the scatter of single points would promise too much. The noise of the gradients looks
    like slanted surfaces and is subtracted (Fuller 1987, Measurement Error Models, section 1.2).
    """
    of_tiles = np.zeros((_TILES[0] * _TILES[1], len(_PRIOR)))
    np.add.at(of_tiles, at.tiles, at.jacobian * (weights * at.differences)[:, None])
    count = len(np.unique(at.tiles))
    scatter = of_tiles.T @ of_tiles * (count / (count - len(_PRIOR)))
    told = (at.jacobian * weights[:, None]).T @ at.jacobian - np.einsum("n,nki,nkj->ij", weights, at.noise, at.noise)
    # in units of the prior, whose information is 1
    values, vectors = np.linalg.eigh(told * np.outer(_PRIOR, _PRIOR))
    inverse = (vectors / (1 + np.maximum(values, 0.0))) @ vectors.T
    covariance = inverse @ (scatter * np.outer(_PRIOR, _PRIOR) + np.identity(len(_PRIOR))) @ inverse
    return np.asarray(covariance * np.outer(_PRIOR, _PRIOR), np.float64)


def _gradient_noise(maps: F32) -> tuple[float, float]:
    """Standard deviations of the gradients along x and y, from their differences to those above and below."""
    reach = 2 * _WINDOW
    sigmas = []
    for gradient in (maps[..., 1], maps[..., 2]):
        bend = gradient[reach:-reach] - (gradient[2 * reach :] + gradient[: -2 * reach]) / 2
        known = bend[np.isfinite(bend)]
        sigmas.append(robust_sigma(known.astype(np.float64)) / math.sqrt(1.5) if known.size else 0.0)
    return sigmas[0], sigmas[1]


def _maps(disparity_px: F32) -> F32:
    """Disparities averaged over a window and their derivatives, float32 (H, W, 3); NaN near what is not known."""
    known = np.isfinite(disparity_px)
    filled = np.where(known, disparity_px, np.float32(0))
    window = (_WINDOW, _WINDOW)
    ones = np.ones(window, np.uint8)
    highest = cv2.dilate(np.where(known, disparity_px, np.float32(-1e6)), ones)
    lowest = cv2.erode(np.where(known, disparity_px, np.float32(1e6)), ones)
    share = cv2.boxFilter(known.astype(np.float32), -1, window)
    mean = cv2.boxFilter(filled, -1, window) / np.maximum(share, np.float32(1e-6))
    mean[(share < 1 - 1e-4) | (highest - lowest > _STEP_PX)] = np.nan
    reach = _WINDOW // 2
    maps = np.full((*disparity_px.shape, 3), np.nan, np.float32)
    maps[..., 0] = mean
    maps[:, reach:-reach, 1] = (mean[:, 2 * reach :] - mean[:, : -2 * reach]) / (2 * reach)
    maps[reach:-reach, :, 2] = (mean[2 * reach :] - mean[: -2 * reach]) / (2 * reach)
    return maps
