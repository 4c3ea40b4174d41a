# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the row errors of rectified images, by matched features."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from stereo_depth_ros.calibration.row_error import RowMatches, match_rows
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.geometry.correspondences import match_features
from stereo_depth_ros.geometry.robust import robust_sigma

__all__ = [
    "GOOD_ROWS_PX",
    "ImageArrayPairs",
    "RowMatching",
    "check_raw_rows",
    "check_rows",
    "match_image_pairs",
    "too_few",
]

ImageArrayPairs: TypeAlias = Sequence[tuple[U8, U8]]

MAX_FEATURES = 2000  # largest number of features of an image
MIN_MATCHES = 50  # least number of matches of all pairs together; too few otherwise for the whole image
# The right images of three scenes (a room, EuRoC, KITTI) shifted by 0.5, 1, 1.5 and 2 px cost sgm up to 2, 22, 43 and
# 66 % of its disparities, and gave 4 to 7, 9 to 27, 20 to 40 and 25 to 61 % that are wrong by more than 1 px.
GOOD_ROWS_PX, USABLE_ROWS_PX = 0.5, 1.0
GOOD_RMS_PX, USABLE_RMS_PX = 1.0, 2.0  # twice that, for parts of the image
MAX_RESIDUAL = 0.7  # residual of a plane as a fraction of the rms; 0.7: the plane explains half of the squares
NEAR_ROWS_PX = 3.0  # up to here features are matched along the rows


@dataclass(frozen=True, eq=False)
class RowMatching(RowMatches):
    """Matched features of several rectified pairs, without outliers of the row error; ``pairs`` of them."""

    pairs: int

    @property
    def disparity_px(self) -> F64:
        """float64 (N,), x_left - x_right."""
        disparity: F64 = self.left_px[:, 0] - self.right_px[:, 0]
        return disparity

    @property
    def fits(self) -> bool:
        """Enough features, most of them with a small row error."""
        return len(self) >= MIN_MATCHES and self.median_px <= NEAR_ROWS_PX


def match_image_pairs(images: ImageArrayPairs, done: Callable[[], object] = lambda: None) -> RowMatching:
    """Features of rectified pairs, matched along the rows; where these are few, matched anywhere.

    Args:
        images: uint8 (H, W), gray, rectified.
        done: called after each pair.
    """
    found = []
    for left, right in images:
        found.append(_match_pair(left, right))
        done()
    return _without_outliers(found)


def _match_pair(left: U8, right: U8) -> tuple[F64, F64]:
    in_row = match_rows(left, right)
    if len(in_row) >= MIN_MATCHES and in_row.median_px <= NEAR_ROWS_PX:
        return in_row.left_px, in_row.right_px
    anywhere = match_features(left, right, MAX_FEATURES)
    errors = anywhere.left_px[:, 1] - anywhere.right_px[:, 1]
    near = len(errors) and np.median(np.abs(errors)) <= NEAR_ROWS_PX
    return (in_row.left_px, in_row.right_px) if near else (anywhere.left_px, anywhere.right_px)


def _without_outliers(found: Sequence[tuple[F64, F64]]) -> RowMatching:
    left_px, right_px = (np.concatenate([np.empty((0, 2)), *points]) for points in zip(*found, strict=True))
    errors = left_px[:, 1] - right_px[:, 1]
    middle = np.median(errors) if errors.size else 0.0
    deviation = robust_sigma(errors - middle) if errors.size else 0.0
    kept = np.abs(errors - middle) <= max(1.0, 4 * deviation)
    return RowMatching(left_px[kept], right_px[kept], len(found))


def check_raw_rows(images: ImageArrayPairs) -> Finding | None:
    """Row errors before rectification; never a fault by itself, None where features are too few."""
    matching = _without_outliers(
        [(m.left_px, m.right_px) for m in (match_features(*pair, MAX_FEATURES) for pair in images)]
    )
    if len(matching) < MIN_MATCHES:
        return None
    value = f"median {matching.median_px:.2f} px, rms {matching.rms_px:.2f} px"
    return Finding("rows before rectification", Level.OK, value, "", "", _figures(matching))


def check_rows(matching: RowMatching, raw: Finding | None, width: int, height: int, f_px: float | None) -> Finding:
    """Row errors of rectified images, and their pattern.

    Args:
        matching: of the rectified images.
        raw: finding of :func:`check_raw_rows` on the same images.
        width, height: of the images, px.
        f_px: rectified focal length, px; None where it is not known.
    """
    if len(matching) < MIN_MATCHES:
        return too_few("rows", matching)
    value = f"median {matching.median_px:.2f} px, rms {matching.rms_px:.2f} px"
    limit = f"good {GOOD_ROWS_PX:g}, {GOOD_RMS_PX:g}; usable {USABLE_ROWS_PX:g}, {USABLE_RMS_PX:g} px"
    shift, across, down = (float(part) for part in _plane(matching, width, height)[0])
    figures = _figures(matching) | {"shift_px": shift, "across_px": 2 * across, "down_px": 2 * down}
    if matching.median_px <= GOOD_ROWS_PX and matching.rms_px <= GOOD_RMS_PX:
        return Finding("rows", Level.OK, value, limit, "", figures)
    usable = matching.median_px <= USABLE_ROWS_PX and matching.rms_px <= USABLE_RMS_PX
    remedy = f"{_pattern(matching, width, height, f_px)}; {_row_remedy(matching, raw)}"
    return Finding("rows", Level.WARNING if usable else Level.ERROR, value, limit, remedy, figures)


def _figures(matching: RowMatching) -> dict[str, float | None]:
    return {
        "matches": float(len(matching)),
        "median_px": matching.median_px,
        "rms_px": matching.rms_px,
    }


def too_few(check: str, matching: RowMatching) -> Finding:
    """A check that is skipped because there are not enough features."""
    value = f"{len(matching)} matched features in {matching.pairs} pairs"
    remedy = "show the cameras something with texture, at a few meters, sharp"
    figures: dict[str, float | None] = {"matches": float(len(matching))}
    return Finding(check, Level.SKIPPED, value, f"{MIN_MATCHES} features", remedy, figures)


def _row_remedy(matching: RowMatching, raw: Finding | None) -> str:
    before = raw.figures.get("median_px") if raw is not None else None
    if before is not None and before <= GOOD_ROWS_PX:
        return "the rows agreed before: the images are rectified already, or the calibration is of other cameras"
    if before is not None and before < matching.median_px:
        return "the rows agreed better before: the calibration is of other cameras, or of the other camera"
    return "calibrate both cameras together again"


def _plane(matching: RowMatching, width: int, height: int) -> tuple[F64, float]:
    """The least-squares plane through the row errors, and the rms of the residuals, px.

    Returns:
        float64 (3,), px: value at the center, increase to the right edge, increase to the lower edge.
    """
    x, y = matching.left_px.T
    basis = np.stack([np.ones_like(x), 2 * x / width - 1, 2 * y / height - 1], axis=1)
    parts: F64 = np.linalg.lstsq(basis, matching.errors_px, rcond=None)[0]
    return parts, float(np.sqrt(np.mean((matching.errors_px - basis @ parts) ** 2)))


def _pattern(matching: RowMatching, width: int, height: int, f_px: float | None) -> str:
    """One sentence on the pattern of the row errors: the largest part of their plane."""
    parts, residual_px = _plane(matching, width, height)
    if residual_px > MAX_RESIDUAL * matching.rms_px:
        return "the row errors have no simple pattern, as with a lens that is not the calibrated one"
    shift, across, down = (float(part) for part in parts)
    largest = max(abs(part) for part in parts)
    if abs(shift) == largest:
        where = "higher" if shift > 0 else "lower"
        turn = "" if f_px is None else f" by about {math.degrees(math.atan(abs(shift) / f_px)):.2f} deg"
        return (
            f"right rows lie {abs(shift):.2f} px {where} everywhere: the cameras are pitched against each other{turn}"
        )
    if abs(across) == largest:
        turn_deg = math.degrees(math.atan(2 * abs(across) / width))
        return (
            f"the row error changes by {2 * across:+.2f} px across: the cameras are rolled by about {turn_deg:.2f} deg"
        )
    share = 200 * abs(down) / height
    return f"the row error changes by {2 * down:+.2f} px downwards: the focal lengths differ by about {share:.2f} %"
