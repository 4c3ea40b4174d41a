# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of a matcher without ground truth: its disparities against those of features, refined to sub-pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.calibration.row_error import match_rows
from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.diagnosis.checks.rows import MIN_MATCHES, ImageArrayPairs
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.geometry.robust import robust_sigma
from stereo_depth_ros.matching import Matcher

__all__ = ["check_matcher"]

PAIRS = 2  # that are matched: a network may take a minute for one
MIN_FOUND = 0.3  # share of the features that have a disparity
MAX_ROW_ERROR_PX = 1.0  # of a feature that can be compared
NEAR_PX = 1.0  # from the feature, without a constant offset
MIN_NEAR = 0.5  # share of the disparities that are so near
SMALLEST_PX = 4.0  # of disparities whose ratio shows a scale
SCALE_TOLERANCE, ABOUT_FACTOR = 0.05, 0.5
BIAS_PX = 0.3
SPREADS = 1.0  # a constant offset is above so many spreads of the differences


@dataclass(frozen=True, eq=False)
class _Compared:
    """Disparities at features, float64 (N,), px: of the features, and of the matcher, NaN where it has none."""

    feature_px: F64
    matcher_px: F64

    @property
    def found(self) -> float:
        """Share of the features that have a disparity, 0..1."""
        return float(np.isfinite(self.matcher_px).mean())

    @property
    def known(self) -> tuple[F64, F64]:
        """Both disparities where the matcher has one."""
        known = np.isfinite(self.matcher_px)
        return self.feature_px[known], self.matcher_px[known]


def check_matcher(matcher: Matcher, given: ImageArrayPairs, done: Callable[[], object] = lambda: None) -> list[Finding]:
    """Share, scale and constant offset of the disparities of a matcher, compared with features of the same pairs.

    Features are corners refined by the method of Lucas and Kanade (1981), see :func:`match_rows`. Where a matcher is
    right they have its disparities to some tenths of a pixel; a network whose images or disparities are scaled or
    shifted on their way, as by another interpolation than in its training, has the same error at nearly all of them.

    Args:
        matcher: with its parameters.
        given: rectified pairs, uint8 (H, W); the first and the last are matched.
        done: called after each of them.
    """
    check = f"disparities of {matcher.name}"
    images = [given[0], given[-1]][: min(PAIRS, len(given))]
    try:
        compared = _compare(matcher, images, done)
    except StereoDepthError as error:
        return [Finding.refused(check, error)]
    count = len(compared.feature_px)
    if count < MIN_MATCHES:
        value = f"{count} matched features in {len(images)} pairs"
        remedy = "show the cameras something with texture, at a few meters, sharp"
        return [Finding(check, Level.SKIPPED, value, f"{MIN_MATCHES} features", remedy)]
    if compared.found < MIN_FOUND:
        value = f"at {100 * compared.found:.0f} % of {count} features"
        remedy = _remedy_of_missing(matcher)
        return [Finding(check, Level.WARNING, value, f"{100 * MIN_FOUND:.0f} %", remedy, {"found": compared.found})]
    return [_scale(matcher, check, compared) or _offset(matcher, check, compared)]


def _compare(matcher: Matcher, images: ImageArrayPairs, done: Callable[[], object]) -> _Compared:
    """Features whose disparity the matcher searches."""
    config, feature_px, matcher_px = matcher.config, [], []
    for left, right in images:
        found = matcher.match(left, right).disparity_px
        features = match_rows(left, right)
        disparity = features.left_px[:, 0] - features.right_px[:, 0]
        used = (disparity >= config.min_disparity) & (disparity <= config.max_disparity)
        used &= np.abs(features.errors_px) <= MAX_ROW_ERROR_PX
        x, y = np.rint(features.left_px[used]).astype(int).T
        feature_px.append(disparity[used])
        matcher_px.append(found[y, x].astype(np.float64))
        done()
    return _Compared(np.concatenate(feature_px), np.concatenate(matcher_px))


def _scale(matcher: Matcher, check: str, compared: _Compared) -> Finding | None:
    """A warning where the disparities are those of the features times a factor; None where they are not.

    A factor explains them better than an offset: their spread about it is less than half, in px of the features.
    """
    feature, own = compared.known
    clear = np.abs(feature) >= SMALLEST_PX
    if np.count_nonzero(clear) < MIN_MATCHES / 2:
        return None
    factor = float(np.median(own[clear] / feature[clear]))
    if factor == 0 or abs(factor - 1) <= SCALE_TOLERANCE:
        return None
    about_factor, about_offset = own / factor - feature, own - feature - np.median(own - feature)
    if robust_sigma(about_factor) >= ABOUT_FACTOR * robust_sigma(about_offset):
        return None
    value = f"{factor:.3g} times those of {own.size} features"
    figures: dict[str, float | None] = {"scale": factor, "spread_px": robust_sigma(about_factor)}
    if matcher.name != "onnx":
        remedy = "look for a scale in the parameters of the matcher, or in the images"
        return Finding(check, Level.WARNING, value, "1 times", remedy, figures)
    scale = (matcher.config.onnx_scale or 1.0) / factor
    remedy = f"divide by {factor:.3g}, multiplying onnx_scale, or export the network for pixels"
    return Finding(check, Level.WARNING, value, "1 times", remedy, figures, {"onnx_scale": float(f"{scale:.4g}")})


def _offset(matcher: Matcher, check: str, compared: _Compared) -> Finding:
    """The median signed difference, and the share of the disparities that are near without it."""
    feature, own = compared.known
    error = own - feature
    offset = float(np.median(error))
    spread = robust_sigma(error - offset)
    near = float((np.abs(error - offset) <= NEAR_PX).mean())
    figures: dict[str, float | None] = {
        **{"matches": float(feature.size), "found": compared.found, "near": near},
        **{"offset_px": offset, "spread_px": spread},
    }
    size = "large" if offset > 0 else "small"
    value = f"median {offset:+.2f} px against {error.size} features, spread {spread:.2f} px"
    limit = f"{BIAS_PX:g} px"
    if near < MIN_NEAR:
        value = f"{100 * near:.0f} % within {NEAR_PX:g} px of {error.size} features"
        remedy = _remedy_of_wrong(matcher)
        return Finding(check, Level.WARNING, value, f"{100 * MIN_NEAR:.0f} %", remedy, figures)
    if abs(offset) <= max(BIAS_PX, SPREADS * spread):
        return Finding(check, Level.OK, value, limit, "", figures)
    remedy = f"disparities are {abs(offset):.2f} px too {size} everywhere: "
    if matcher.name != "onnx":
        remedy += "look for a shift in the images or the parameters"
        return Finding(check, Level.WARNING, value, limit, remedy, figures)
    remedy += "add the opposite, or look for a shift in the export of the network, such as align_corners"
    corrected = round(matcher.config.onnx_offset - offset, 2)
    return Finding(check, Level.WARNING, value, limit, remedy, figures, {"onnx_offset": corrected})


def _remedy_of_missing(matcher: Matcher) -> str:
    if matcher.name == "onnx":
        return (
            "its disparities are outside the search range: set onnx_scale to its unit, or disparity_range to cover them"
        )
    return "check the search range and the limits of the checks that reject disparities"


def _remedy_of_wrong(matcher: Matcher) -> str:
    if matcher.name == "onnx":
        return "give the network what it was trained with: onnx_normalization, left and right input, size of the images"
    return "check the parameters of the matcher"
