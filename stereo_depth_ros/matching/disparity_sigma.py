# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Standard deviation of a disparity by its confidence, from tables fitted to scenes with ground truth."""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.core.types import F32, MatchResult

__all__ = ["CONFIDENCES", "DEFAULT_SIGMA_PX", "SIGMAS_PX", "disparity_sigma", "sigma_kind", "sigma_of"]

DEFAULT_SIGMA_PX = 0.25  # of methods without a table
CONFIDENCES = (0.0, 0.005, 0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0)
_STEPS = 2048  # of the confidence, in a table to look up

# At each confidence the error that 68 % of the disparities keep; where the largest 5 % are beyond twice as much, up to
# what 76 % keep. By benchmarks/uncertainty.py --write, on Venus, Cones, Art, Aloe, Bowling1 and Motorcycle of the
# Middlebury sets, each with equal weight, and never larger at a larger confidence.
# fmt: off
SIGMAS_PX: Mapping[str, tuple[float, ...]] = {
    "sgm fast": (3.88, 3.88, 3.88, 3.56, 2.46, 1.78, 1.32, 1.25, 0.81, 0.58, 0.36, 0.28, 0.25, 0.2, 0.17, 0.15),
    "sgm default": (4.58, 4.58, 4.58, 4.27, 3.08, 1.98, 1.45, 1.19, 0.81, 0.58, 0.35, 0.25, 0.23, 0.18, 0.16, 0.15),
    "sgm best": (2.83, 2.83, 2.83, 2.4, 1.7, 1.33, 1.09, 1.01, 0.7, 0.51, 0.34, 0.26, 0.22, 0.18, 0.16, 0.15),
    "sgbm": (16.67, 16.67, 16.67, 16.67, 16.67, 16.67, 16.67, 16.67, 16.67, 12.25, 5.1, 4.08, 4.08, 0.67, 0.36, 0.21),
    "bm": (4.85, 4.85, 4.85, 4.85, 4.85, 4.85, 4.85, 4.85, 4.84, 4.81, 3.0, 1.62, 1.62, 0.44, 0.29, 0.17),
}
# fmt: on


def sigma_kind(config: MatchingConfig) -> str | None:
    """The table for a matcher with its parameters, the key in ``SIGMAS_PX``; None where there is none."""
    name = list(MATCHERS)[config.stereo_algorithm]
    if name == "sgm":
        name = f"sgm {config.quality}" if config.sgm_cost == "census" and config.temporal_window <= 1 else ""
    return name if name in SIGMAS_PX else None


def sigma_of(found: MatchResult, config: MatchingConfig, constant_px: float = 0.0) -> F32:
    """Standard deviation of each disparity of a result, float32 (H, W), px, NaN where invalid.

    The estimate of the method where it has one; else ``constant_px``; where that is 0, by the confidence, or
    ``DEFAULT_SIGMA_PX`` if there is no table for the matcher.
    """
    if found.sigma_px is not None:
        return found.sigma_px
    kind = sigma_kind(config)
    if constant_px == 0 and kind is not None and found.confidence is not None:
        sigma_px = disparity_sigma(found.confidence, kind)
    else:
        sigma_px = np.full(found.reasons.shape, constant_px or DEFAULT_SIGMA_PX, np.float32)
    sigma_px[found.reasons != 0] = np.nan
    return sigma_px


def disparity_sigma(confidence: F32, kind: str) -> F32:
    """Standard deviation of disparities, px.

    Args:
        confidence: float32 (H, W), 0..1, of a matcher.
        kind: see :func:`sigma_kind`.

    Returns:
        float32 (H, W), linear in the confidence between the entries of the table.
    """
    steps = np.multiply(confidence, np.float32(_STEPS), dtype=np.float32).astype(np.int16)
    return _looked_up(kind)[np.clip(steps, 0, _STEPS, out=steps)]


@functools.cache
def _looked_up(kind: str) -> F32:
    middles = (np.arange(_STEPS + 1) + 0.5) / _STEPS
    return np.interp(middles, CONFIDENCES, SIGMAS_PX[kind]).astype(np.float32)
