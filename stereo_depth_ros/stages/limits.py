# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of confidence and depth error: pixels beyond them have no disparity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.rig import Rig, StereoRig
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.matching.disparity_sigma import sigma_of

__all__ = ["Limits"]

_UNIQUENESS, _RANGE, _NAN = np.uint8(Reason.UNIQUENESS), np.uint8(Reason.RANGE), np.float32(np.nan)


class Limits:
    """Rejects disparities of too little confidence (UNIQUENESS) and depths of too large an error (RANGE).

    The error is one standard deviation, sigma_Z = f B sigma_d / (d - doffs)^2 and sigma_Z / Z = sigma_d / (d - doffs),
    with sigma_d of :func:`~stereo_depth_ros.matching.disparity_sigma.sigma_of`.

    Args:
        config: min_confidence, max_depth_error and max_relative_depth_error.
        rig: the cameras.

    Raises:
        ConfigError: a limit of the depth error, and the rig is not calibrated.
    """

    def __init__(self, config: MatchingConfig, rig: Rig) -> None:
        self._config = config
        self._least_confidence = np.float32(config.min_confidence)
        self._of_error = config.max_depth_error > 0 or config.max_relative_depth_error > 0
        self._doffs_px, f_baseline = np.float32(rig.doffs_px), 1.0
        if self._of_error:
            f_baseline = _f_baseline(rig)
        self._largest = (
            np.float32(config.max_depth_error / f_baseline or np.inf),
            np.float32(config.max_relative_depth_error / 100 or np.inf),
        )

    def __call__(self, found: MatchResult) -> MatchResult:
        """Reject pixels of a result in place; returns it with their confidence, which is 0."""
        if self._least_confidence == 0 and not self._of_error:
            return found
        confidence = found.confidence
        if confidence is None:  # of a method that has none
            confidence = (found.reasons == 0).astype(np.float32)
        # Before any is rejected: a neighbor that is rejected makes none less certain
        sigma_px = sigma_of(found, self._config) if self._of_error else confidence
        given = (found.disparity_px, found.reasons, confidence, sigma_px, self._least_confidence, self._doffs_px)
        counts = np.zeros((len(confidence), 2), np.int64)
        run_bands(_reject, len(confidence), *given, *self._largest, counts)
        source = None if found.confidence is None else confidence
        by_confidence, by_error = counts.sum(axis=0).tolist()
        return replace(found, confidence_source=source, beyond_limits=(by_confidence, by_error))


def _f_baseline(rig: Rig) -> float:
    if not isinstance(rig, StereoRig):
        raise ConfigError(
            "max_depth_error and max_relative_depth_error need a calibrated rig, this one gives no depth",
            value=type(rig).__name__,
            limit="StereoRig",
            remedy="set them to 0, or calibrate the cameras",
            settings=("max_depth_error", "max_relative_depth_error"),
        )
    return rig.f_px * rig.baseline_m


_IMAGE = "float32[:, ::1]"


@compiled(
    f"void(int64, int64, {_IMAGE}, uint8[:, ::1], {_IMAGE}, {_IMAGE}, "
    "float32, float32, float32, float32, int64[:, ::1])"
)
def _reject(
    first: int,
    last: int,
    disparity_px: F32,
    reasons: U8,
    confidence: F32,
    sigma_px: F32,
    least_confidence: np.float32,
    doffs_px: np.float32,
    largest: np.float32,
    largest_relative: np.float32,
    counts: npt.NDArray[np.int64],
) -> None:
    """``largest`` is the error of the depth divided by f B; ``counts`` of each row: by confidence, and by an error."""
    for y in range(first, last):
        for x in range(disparity_px.shape[1]):
            if reasons[y, x]:
                continue
            ahead = disparity_px[y, x] - doffs_px
            reason = np.uint8(0)
            if confidence[y, x] < least_confidence:
                reason = _UNIQUENESS
                counts[y, 0] += 1
            if sigma_px[y, x] > largest * ahead * ahead or sigma_px[y, x] > largest_relative * ahead:
                reason |= _RANGE
                counts[y, 1] += 1
            if reason:
                reasons[y, x] = reason
                disparity_px[y, x] = _NAN
                confidence[y, x] = 0
