# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From an image of color stripes to the projector column of each pixel.

Zhang, Curless and Seitz 2002: color edges, and their labels by multi-pass dynamic programming. In addition, the scale
of the edges and the mixing of the colors are found from the image, rows are made consistent, and columns between edges
are interpolated.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.one_shot.consistency import vote
from stereo_depth_ros.active.one_shot.edges import I32, ColorEdges, contrast_limit, find_edges, smooth_columns
from stereo_depth_ros.active.one_shot.labels import LARGEST_RATIO, label_rows
from stereo_depth_ros.active.one_shot.mixing import color_mixing, separate_colors
from stereo_depth_ros.active.one_shot.positions import remove_displacements
from stereo_depth_ros.active.one_shot.stripes import StripePattern
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8, Reason

__all__ = ["StripeEdges", "decode_edges", "one_shot"]

_SCALES_PX = tuple(0.7 * 2 ** (k / 2) for k in range(12))  # stripes of 3 to 130 px
_PROBED_ROWS = 24
_ROWS_OF_MIXING = 64
_MOST_BETWEEN = 1  # changes without an edge, or edges without a label, between two that are interpolated
_LARGEST_RATIO_ALONE = 2.5  # to the typical one
_LEAST_LONG = 0.2  # of the edges in unique runs, in runs of twice the length; of a pattern that is not there below 0.01
_LEAST_UNIQUE = 0.5  # of all edges, in unique runs, where none are long; of a pattern that is not there below 0.4
_FLAT_SIGMAS = 12.0  # pixels farther from every edge are on no stripe
_DARK = 0.2  # of the bright parts of the image
_NO_MATCH, _UNIQUENESS, _TEXTURE, _SHADOW = (
    int(reason) for reason in (Reason.NO_MATCH, Reason.UNIQUENESS, Reason.TEXTURE, Reason.SHADOW)
)


@dataclass(frozen=True, eq=False)
class StripeEdges:
    """The decoded edges of an image.

    Attributes:
        pattern: the pattern in the order in which it is seen, which is turned where its columns decrease along a row.
        turned: whether it is.
        found: all edges.
        x_px: float32 (H, K), their positions without the displacements of their colors, px.
        labels: int32 (H, K), number of the change of the pattern, -1 where the identity is doubtful.
        sigma_x_px: standard deviation of a position, px; the scale where too few edges are decoded to estimate it.
        sigma_px: scale of the edges, px, see :func:`~stereo_depth_ros.active.one_shot.edges.find_edges`.
        contrast: float32 (H, W), gray levels, of the strongest channel around each pixel.
        limit: least contrast of stripes, gray levels.
    """

    pattern: StripePattern
    turned: bool
    found: ColorEdges
    x_px: F32
    labels: I32
    sigma_x_px: float
    sigma_px: float
    contrast: F32
    limit: float

    @property
    def columns_px(self) -> F64:
        """Of each change of the pattern, float64 (N,), projector px."""
        columns = self.pattern.edges_px
        return self.pattern.length_px - 1 - columns if self.turned else columns

    def points(self) -> F64:
        """float64 (N, 3): x, y and projector column of each decoded edge, px."""
        row, k = np.nonzero(self.labels >= 0)
        return np.stack([self.x_px[row, k], row, self.columns_px[self.labels[row, k]]], axis=1)


def one_shot(image: npt.NDArray[Any], pattern: StripePattern) -> ProjectorMap:
    """The projector column that lights each pixel, from one image of color stripes.

    Columns between two edges that follow each other in the image and in the pattern are interpolated where the stripe
    is about as wide as those beside it, so not across a step in depth. Without a column are pixels where

    - the projector gives no light (SHADOW): no stripes, and dark,
    - no stripes are seen in light (TEXTURE): saturated, or their contrast is below the noise,
    - edges are seen, but which ones is doubtful (UNIQUENESS),
    - edges are known, but a step in depth is between them (NO_MATCH).

    Args:
        image: uint8 (H, W, 3), RGB; vertical stripes of the pattern cross its rows, horizontal ones its columns.
        pattern: the projected pattern, see :func:`~stereo_depth_ros.active.one_shot.stripes.read_stripes`. The
            projector may be upside down.

    Returns:
        Columns, or rows of a pattern of horizontal stripes, and their standard deviation, which is that of the edges.

    Raises:
        ImageError: another shape or dtype, or an image without color.
    """
    if pattern.axis == "rows":
        found = one_shot(_checked(image).transpose(1, 0, 2), _transposed(pattern))
        return ProjectorMap(
            pattern.size,
            None,
            None if found.column_px is None else np.ascontiguousarray(found.column_px.T),
            np.ascontiguousarray(found.sigma_px.T),
            np.ascontiguousarray(found.reasons.T),
        )
    edges = decode_edges(image, pattern)
    height, width = image.shape[:2]
    column_px = np.full((height, width), np.nan, np.float32)
    sigma_px = np.full((height, width), np.nan, np.float32)
    reasons = np.empty((height, width), np.uint8)
    level = np.ascontiguousarray(image.max(axis=2))
    dark = _DARK * float(np.percentile(level, 98))
    typical = _stripe_steps(edges)
    run_bands(
        _interpolate,
        height,
        edges.found.x_px,
        edges.x_px,
        edges.found.counts,
        edges.labels,
        edges.pattern.edges_px,
        edges.contrast,
        level,
        (edges.limit, dark, _FLAT_SIGMAS * edges.sigma_px, typical, edges.sigma_x_px),
        column_px,
        sigma_px,
        reasons,
        min_rows=8,
    )
    if edges.turned:
        column_px = np.float32(pattern.length_px - 1) - column_px
    return ProjectorMap(pattern.size, column_px, None, sigma_px, reasons)


def decode_edges(image: npt.NDArray[Any], pattern: StripePattern) -> StripeEdges:
    """The edges of an image, and which change of a pattern of vertical stripes each one is; see :func:`one_shot`."""
    checked = _checked(image)
    limit = contrast_limit(checked)
    smooth = smooth_columns(checked)
    sigma_px, turned = _best_scale(smooth, limit, pattern)
    seen = pattern.turned() if turned else pattern
    found, contrast = find_edges(smooth, sigma_px, limit)
    some = found.some_rows(max(1, found.counts.size // _ROWS_OF_MIXING))
    found = separate_colors(found, color_mixing(some, *label_rows(some, seen), seen))
    labels, runs = label_rows(found, seen)
    if not _is_plausible(runs, int(found.counts.sum()), pattern.window):
        labels[:] = -1
    labels = vote(found, labels, runs, pattern.window, sigma_px)
    x_px, sigma_x_px = remove_displacements(found.x_px, labels, seen)
    if not math.isfinite(sigma_x_px):
        sigma_x_px = sigma_px
    return StripeEdges(seen, turned, found, x_px, labels, sigma_x_px, sigma_px, contrast, limit)


def _is_plausible(runs: U8, edges: int, window: int) -> bool:
    """Whether the pattern is the one that is seen: of another one, some short sequences are in this one too."""
    unique, long = np.count_nonzero(runs >= window), np.count_nonzero(runs >= 2 * window)
    return bool(long >= _LEAST_LONG * unique or unique >= _LEAST_UNIQUE * edges)


def _transposed(pattern: StripePattern) -> StripePattern:
    return dataclasses.replace(pattern, size=pattern.size[::-1], axis="columns")


def _checked(image: npt.NDArray[Any]) -> U8:
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise ImageError(
            f"the image is {getattr(image, 'dtype', type(image).__name__)} {getattr(image, 'shape', '')}, "
            "uint8 (H, W, 3) is needed",
            subject="image of color stripes",
            value=getattr(image, "shape", None),
            limit="uint8 (H, W, 3)",
            remedy="read a color image in RGB",
        )
    if not image.size or (image == image[..., :1]).all():
        raise ImageError(
            "the image has no colors" if image.size else "the image has no pixels",
            subject="image of color stripes",
            value=image.shape,
            limit="a color image",
            remedy="use a color camera",
        )
    return np.ascontiguousarray(image)


def _best_scale(smooth: F32, limit: float, pattern: StripePattern) -> tuple[float, bool]:
    """The scale at which most edges of some rows are in runs that are unique, and whether the pattern is turned."""
    height = smooth.shape[0]
    part = np.ascontiguousarray(smooth[np.linspace(0, height - 1, min(_PROBED_ROWS, height)).astype(np.intp)])
    best, most = (_SCALES_PX[0], False), -1
    patterns = (pattern, pattern.turned())
    for sigma_px in _SCALES_PX:
        edges, _ = find_edges(part, sigma_px, limit)
        for turned, seen in enumerate(patterns):
            _, runs = label_rows(edges, seen)
            number = int(np.count_nonzero(runs >= pattern.window))
            if number > most:
                best, most = (sigma_px, bool(turned)), number
    return best


def _stripe_steps(edges: StripeEdges) -> float:
    """Typical distance of edges for each projector column, px; NaN without edges."""
    row, k = np.nonzero(edges.labels >= 0)
    x, u = edges.x_px[row, k], edges.pattern.edges_px[edges.labels[row, k]]
    follows = (np.diff(row) == 0) & (np.diff(u) > 0)
    steps = np.diff(x)[follows] / np.diff(u)[follows]
    return float(np.median(steps)) if steps.size else float("nan")


@compiled(
    "void(int64, int64, float32[:, ::1], float32[:, ::1], int32[::1], int32[:, ::1], float64[::1], float32[:, ::1],"
    " uint8[:, ::1], UniTuple(float64, 5), float32[:, ::1], float32[:, ::1], uint8[:, ::1])"
)
def _interpolate(
    first: int,
    last: int,
    found_px: F32,
    x_px: F32,
    counts: I32,
    labels: I32,
    columns: F64,
    contrast: F32,
    level: U8,
    limits: tuple[float, float, float, float, float],
    column_px: F32,
    sigma_px: F32,
    reasons: U8,
) -> None:
    limit, dark, flat_px, typical, sigma_x_px = limits
    width = column_px.shape[1]
    known = np.empty(labels.shape[1], np.int64)
    steps = np.empty(labels.shape[1], np.float64)
    for y in range(first, last):
        _reasons_of_row(found_px[y], counts[y], labels[y], contrast[y], level[y], limit, dark, flat_px, reasons[y])
        number = 0
        for k in range(counts[y]):
            if labels[y, k] >= 0:
                known[number] = k
                number += 1
        for i in range(number - 1):
            a, b = known[i], known[i + 1]
            u = columns[labels[y, b]] - columns[labels[y, a]]
            skipped, unknown = labels[y, b] - labels[y, a] - 1, b - a - 1
            ok = 0 <= skipped <= _MOST_BETWEEN and unknown <= _MOST_BETWEEN and x_px[y, b] > x_px[y, a]
            steps[i] = (x_px[y, b] - x_px[y, a]) / u if ok else -1.0
        for i in range(number - 1):
            if not _is_smooth(steps, i, number - 1, typical):
                continue
            a, b = known[i], known[i + 1]
            u = columns[labels[y, a]]
            for x in range(max(0, int(np.ceil(x_px[y, a]))), min(width - 1, int(np.floor(x_px[y, b]))) + 1):
                part = (x - x_px[y, a]) / (x_px[y, b] - x_px[y, a])
                column_px[y, x] = u + (x - x_px[y, a]) / steps[i]
                sigma_px[y, x] = sigma_x_px / steps[i] * math.sqrt((1.0 - part) ** 2 + part**2)
                reasons[y, x] = 0


@compiled()
def _is_smooth(steps: F64, i: int, count: int, typical: float) -> bool:
    """Whether a stripe is about as wide as one beside it."""
    if steps[i] <= 0:
        return False
    alone = True
    for k in (i - 1, i + 1):
        if 0 <= k < count and steps[k] > 0:
            alone = False
            if 1.0 / LARGEST_RATIO < steps[i] / steps[k] < LARGEST_RATIO:
                return True
    return alone and 1.0 / _LARGEST_RATIO_ALONE < steps[i] / typical < _LARGEST_RATIO_ALONE


@compiled()
def _reasons_of_row(
    found_px: F32,
    count: int,
    labels: I32,
    contrast: F32,
    level: U8,
    limit: float,
    dark: float,
    flat_px: float,
    reasons: U8,
) -> None:
    """Reasons of a row as if nothing were decoded."""
    after = 0
    for x in range(reasons.size):
        while after < count and found_px[after] < x:
            after += 1
        has_before, has_after = after > 0, after < count
        near = (has_before and x - found_px[after - 1] <= flat_px) or (has_after and found_px[after] - x <= flat_px)
        if contrast[x] < limit or not near:
            reasons[x] = _SHADOW if level[x] < dark else _TEXTURE
        elif has_before and has_after and labels[after - 1] >= 0 and labels[after] >= 0:
            reasons[x] = _NO_MATCH
        else:
            reasons[x] = _UNIQUENESS
