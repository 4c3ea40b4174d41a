# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matching by diffusion of the disparity space."""

from __future__ import annotations

import math

import numba
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.matching.filters.speckle_filter import I16
from stereo_depth_ros.matching.photometric import match_photometric
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair, check_search
from stereo_depth_ros.matching.selection.float_costs import finish, select_row
from stereo_depth_ros.matching.serial import SerialMatcher

__all__ = ["DiffusionMatcher"]

ITERATIONS = 80

# Contaminated Gaussian of the gray-level difference of a match: a share of outliers is uniform.
NOISE_SIGMA = 8.0
NOISE_OUTLIERS = 0.1
# The same for the difference of neighboring disparities, px; sigma on the grid of whole disparities.
STEP_SIGMA_PX = 0.4
STEP_OUTLIERS = 0.01
# Weight of each of the four neighbors: 1 is the mean field, less compensates evidence that returns to its pixel.
NEIGHBOR_WEIGHT = 0.5
# Membrane: rate of diffusion (stable up to 1/4), and coupling of each pixel to its initial cost.
DIFFUSION_RATE = 0.15
HOLD_RATE = 0.02


class DiffusionMatcher(SerialMatcher):
    """Diffusion of the disparity space (Scharstein and Szeliski 1998), ``iterations`` times; 0 is 80.

    The cost of a pixel at a disparity is E0 = -log of a contaminated Gaussian of the gray-level difference, after the
    photometric correction of the left image. It is diffused by ``diffusion_model``:

    - "bayesian": each pixel has a distribution p = exp(-E) / sum exp(-E) over its disparities. It is smoothed along the
      disparities by the prior of neighbors (also a contaminated Gaussian), and its -log, Es, is passed to the
      neighbors: E = E0 + w sum over 4 neighbors of Es. Support spreads along surfaces and stops at their edges.
    - "membrane": E changes by a (sum over 4 neighbors of their E - E) + b (E0 - E); linear smoothing with bell-shaped
      support, without a window.

    Winner, uniqueness and left-right check (``disp12_max_diff`` above 0) and a parabola fit follow. Bayesian energies
    have sharp minima, so most disparities are near whole pixels. Three copies of the disparity space are in memory: 12
    bytes per pixel and disparity. ``speckle_range`` is in px.

    ``support_px`` is the window of the initial match for the photometric correction; the costs are pixel-wise.
    """

    name = "diffusion"
    step_px = 1 / X16_STEPS

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if the search range does not fit in 16-bit disparities."""
        check_search(config)
        super().__init__(config)
        self._iterations = config.iterations or ITERATIONS

    def _match(self, left: U8, right: U8) -> MatchResult:
        config = self.config
        check_pair(left, right, self)
        rows = left.shape[0]
        data = np.empty((*left.shape, config.num_disparities), np.float32)
        images = (match_photometric(left, right, config), right)
        run_bands(_cost_rows, rows, *images, config.max_disparity, _noise_energies(), data)
        bayesian = config.diffusion_model == "bayesian"
        energies = self._bayesian_energies(data) if bayesian else self._membrane_energies(data)
        disparity_x16 = np.zeros(left.shape, np.int16)
        reasons = np.empty(left.shape, np.uint8)
        checks = (config.uniqueness_ratio, config.disp12_max_diff)
        run_bands(_select_rows, rows, energies, config.max_disparity, *checks, disparity_x16, reasons)
        return finish(disparity_x16, reasons, config, self.step_px)

    def _bayesian_energies(self, data: F32) -> F32:
        beside = math.exp(-1 / (2 * STEP_SIGMA_PX**2))
        kernel = (np.float32(1 / (1 + 2 * beside)), np.float32(beside / (1 + 2 * beside)))
        received, energies = np.zeros_like(data), np.empty_like(data)
        for _ in range(self._iterations):
            run_bands(_bayesian_rows, data.shape[0], data, received, *kernel, energies)
            received, energies = energies, received
        run_bands(_energy_rows, data.shape[0], data, received, energies)
        return energies

    def _membrane_energies(self, data: F32) -> F32:
        energies, moved = data.copy(), np.empty_like(data)
        for _ in range(self._iterations):
            run_bands(_membrane_rows, data.shape[0], data, energies, moved)
            energies, moved = moved, energies
        return energies


def _noise_energies() -> F32:
    """-log of the contaminated Gaussian for each absolute gray-level difference 0..255."""
    gaussian = np.exp(-(np.arange(256.0) ** 2) / (2 * NOISE_SIGMA**2))
    energies: F32 = -np.log((1 - NOISE_OUTLIERS) * gaussian + NOISE_OUTLIERS).astype(np.float32)
    return energies


@compiled(
    numba.void(
        *(numba.int64, numba.int64, READ_ONLY_U8, READ_ONLY_U8, numba.int64),
        *(numba.float32[::1], numba.float32[:, :, ::1]),
    )
)
def _cost_rows(first: int, last: int, left: U8, right: U8, max_disparity: int, energies: F32, data: F32) -> None:
    """Pixel-wise costs (H, W, D); index k is disparity ``max_disparity`` - k, inf outside the right image."""
    _, width, count = data.shape
    for y in range(first, last):
        for x in range(width):
            value = np.int64(left[y, x])
            for k in range(count):
                at = x - max_disparity + k
                data[y, x, k] = energies[abs(value - right[y, at])] if 0 <= at < width else np.inf


@compiled()
def _energy(data: F32, received: F32, y: int, x: int, k: int) -> np.float32:
    """E0 and the messages of the four neighbors; outside the image, the message of the pixel itself."""
    height, width = data.shape[0], data.shape[1]
    vertical = received[max(y - 1, 0), x, k] + received[min(y + 1, height - 1), x, k]
    horizontal = received[y, max(x - 1, 0), k] + received[y, min(x + 1, width - 1), k]
    return np.float32(data[y, x, k] + np.float32(NEIGHBOR_WEIGHT) * (vertical + horizontal))


@compiled("void(int64, int64, float32[:, :, ::1], float32[:, :, ::1], float32, float32, float32[:, :, ::1])")
def _bayesian_rows(first: int, last: int, data: F32, received: F32, center: float, beside: float, sent: F32) -> None:
    """Messages of each pixel, from the messages it received."""
    count = data.shape[2]
    p = np.zeros(count + 2, np.float32)  # p[k + 1] is index k; both ends remain 0
    outliers = np.float32(STEP_OUTLIERS)
    for y in range(first, last):
        for x in range(data.shape[1]):
            least = np.float32(np.inf)
            for k in range(count):
                p[k + 1] = _energy(data, received, y, x, k)
                least = min(least, p[k + 1])
            if least == np.inf:  # no disparity is in the right image: no preference
                for k in range(count):
                    sent[y, x, k] = 0
                continue
            total = np.float32(0)
            for k in range(1, count + 1):
                p[k] = np.exp(least - p[k])
                total += p[k]
            scale = np.float32((1 - outliers) / total)
            for k in range(count):
                smooth = center * p[k + 1] + beside * (p[k] + p[k + 2])
                sent[y, x, k] = -np.log(scale * smooth + outliers)


@compiled("void(int64, int64, float32[:, :, ::1], float32[:, :, ::1], float32[:, :, ::1])")
def _energy_rows(first: int, last: int, data: F32, received: F32, energies: F32) -> None:
    for y in range(first, last):
        for x in range(data.shape[1]):
            for k in range(data.shape[2]):
                energies[y, x, k] = _energy(data, received, y, x, k)


@compiled("void(int64, int64, float32[:, :, ::1], float32[:, :, ::1], float32[:, :, ::1])")
def _membrane_rows(first: int, last: int, data: F32, energies: F32, moved: F32) -> None:
    height, width, count = data.shape
    rate, hold = np.float32(DIFFUSION_RATE), np.float32(HOLD_RATE)
    for y in range(first, last):
        for x in range(width):
            for k in range(count):
                here = energies[y, x, k]
                flow = hold * (data[y, x, k] - here)
                # No flow from outside of either image.
                for row, column in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
                    if 0 <= row < height and 0 <= column < width and energies[row, column, k] < np.inf:
                        flow += rate * (energies[row, column, k] - here)
                moved[y, x, k] = here + flow if here < np.inf else here


@compiled("void(int64, int64, float32[:, :, ::1], int64, float64, int64, int16[:, ::1], uint8[:, ::1])")
def _select_rows(
    first: int,
    last: int,
    energies: F32,
    max_disparity: int,
    uniqueness: float,
    tolerance: int,
    disparity_x16: I16,
    reasons: U8,
) -> None:
    for y in range(first, last):
        select_row(y, energies[y], max_disparity, True, uniqueness, tolerance, disparity_x16, reasons)
