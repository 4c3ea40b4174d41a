# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Evaluates a matcher on a scene: search range, run time, errors, quality of the confidence."""

from __future__ import annotations

import dataclasses
import math
import statistics
import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from stereo_depth_ros.config import MatchingConfig, parameter_infos
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, F64, MatchResult
from stereo_depth_ros.evaluation.hard_regions import hard_regions
from stereo_depth_ros.evaluation.metrics import DisparityErrors, disparity_errors
from stereo_depth_ros.evaluation.scenes import Scene
from stereo_depth_ros.evaluation.sparsification import SparsificationCurve, sparsification
from stereo_depth_ros.matching import Matcher, create_matcher

__all__ = ["Confidence", "Evaluation", "evaluate", "search_range"]

_STEP = 16  # search ranges are multiples of it
_LEAST = 32
_RUNS, _ENOUGH_S = 5, 2.0  # number of timed runs, and the total seconds after which no further one starts
_IN_HARD_REGIONS = ("density", "bad_1", "bad_2", "bad_2_all", "avg")
_CURVE = tuple(step / 20 for step in range(1, 21))  # shares of pixels kept at which a curve is sampled


@dataclass(frozen=True)
class Confidence:
    """Sparsification curves of the confidence of a method, over the matched pixels with truth.

    Attributes:
        bad_1: percentage wrong by more than 1 px.
        avg_px: mean absolute error, pixels.
    """

    bad_1: SparsificationCurve
    avg_px: SparsificationCurve


@dataclass(frozen=True)
class Evaluation:
    """Result of one method on one scene.

    Attributes:
        scene, matcher: names.
        config: parameters in use, with the search range.
        result: result of the method.
        errors: errors over all pixels with truth.
        nonocc: errors over the pixels with truth that both cameras see.
        edges, thin: errors over the pixels with truth near depth edges, and over those of thin structures, see
            :func:`~stereo_depth_ros.evaluation.hard_regions.hard_regions`.
        edges_share, thin_share: their shares of the pixels with truth, 0..1.
        foreground, background: errors over the two parts of the KITTI object map; None without one.
        confidence: None where the method has no confidence, or matched nothing.
        occlusion: source of the pixels that both cameras see: "mask" of the dataset, or "truth".
        ms: median milliseconds of ``runs`` calls after a first one.
        runs: number of timed calls.
    """

    scene: str
    matcher: str
    config: MatchingConfig
    result: MatchResult
    errors: DisparityErrors
    nonocc: DisparityErrors
    edges: DisparityErrors
    thin: DisparityErrors
    edges_share: float
    thin_share: float
    foreground: DisparityErrors | None
    background: DisparityErrors | None
    confidence: Confidence | None
    occlusion: str
    ms: float
    runs: int

    @property
    def ms_per_megapixel(self) -> float:
        """Milliseconds per million pixels of the left image."""
        return self.ms / (self.result.disparity_px.size / 1e6)

    @property
    def ms_per_million_disparities(self) -> float:
        """Milliseconds per million searched disparities, which are pixels times ``disparity_range``."""
        return self.ms_per_megapixel / self.config.num_disparities

    def figures(self) -> dict[str, Any]:
        """One flat row of names and numbers: percent, pixels, milliseconds, density 0..1; None for no pixels."""
        errors = _figures(self.errors)
        first = ("density", "bad_0_5", "bad_1", "bad_2", "bad_2_all", "avg")
        row: dict[str, Any] = {"scene": self.scene, "matcher": self.matcher} | {name: errors[name] for name in first}
        row |= {"ms": self.ms} | errors  # existing names keep their place
        row |= {f"nonocc_{name}": value for name, value in _figures(self.nonocc).items()}
        for part, within, share in (("edges", self.edges, self.edges_share), ("thin", self.thin, self.thin_share)):
            row |= {f"{part}_share": share} | {f"{part}_{name}": _figures(within)[name] for name in _IN_HARD_REGIONS}
        for part, measured in (("bg", self.background), ("fg", self.foreground)):
            row |= {f"d1_{part}": getattr(measured, "d1", None), f"d1_{part}_all": getattr(measured, "d1_all", None)}
        row |= {"constant_bias": self.errors.constant_bias_px} | _areas(self.confidence)
        height, width = self.result.disparity_px.shape
        row |= {"occlusion": self.occlusion, "width": width, "height": height}
        row |= {"min_disparity": self.config.min_disparity, "disparity_range": self.config.num_disparities}
        row |= {"ms_per_megapixel": self.ms_per_megapixel, "runs": self.runs}
        row |= {"ms_per_million_disparities": self.ms_per_million_disparities}
        return {name: _plain(value) for name, value in row.items()}

    def to_json(self) -> dict[str, Any]:
        """:meth:`figures`, the parameters that are not at their defaults, and the curves of the confidence."""
        changed = {
            info.name: value
            for info in parameter_infos(self.config)
            if (value := getattr(self.config, info.field)) != info.default and info.name != "stereo_algorithm"
        }
        curve = None
        if self.confidence is not None:
            density = self.errors.density
            curve = {"kept": list(_CURVE), "coverage": [kept * density for kept in _CURVE]}
            curve["bad_1"] = [self.confidence.bad_1.at(kept) for kept in _CURVE]
            curve["avg"] = [self.confidence.avg_px.at(kept) for kept in _CURVE]
        return self.figures() | {"parameters": changed, "curve": curve}


def evaluate(name: str, scene: Scene, matcher: str, config: MatchingConfig, given: Collection[str] = ()) -> Evaluation:
    """Run a matcher on a scene and compare the result with the truth.

    Args:
        name: name of the scene.
        scene: the pair and its truth.
        matcher: name of the matcher.
        config: parameters of the matcher.
        given: parameters that the user set; see :func:`search_range`.

    Raises:
        ConfigError: the matcher refuses the parameters.
        ImageError: the matcher refuses the images, or returns another size or an invalid confidence.
    """
    method = create_matcher(matcher, search_range(config, scene.truth_px, given))
    result, ms, runs = _timed(method, scene)
    if result.disparity_px.shape != scene.truth_px.shape:
        raise ImageError(
            f"{matcher} returns {result.disparity_px.shape}, the image is {scene.truth_px.shape}",
            value=result.disparity_px.shape,
            limit=scene.truth_px.shape,
            remedy="correct the matcher",
        )
    known, hard = np.isfinite(scene.truth_px), hard_regions(scene.truth_px)
    objects = scene.foreground
    return Evaluation(
        scene=name,
        matcher=matcher,
        config=method.config,
        result=result,
        errors=disparity_errors(result.disparity_px, scene.truth_px),
        nonocc=disparity_errors(result.disparity_px, scene.truth_px, scene.visible),
        edges=disparity_errors(result.disparity_px, scene.truth_px, hard.edges),
        thin=disparity_errors(result.disparity_px, scene.truth_px, hard.thin),
        edges_share=np.count_nonzero(hard.edges) / np.count_nonzero(known),
        thin_share=np.count_nonzero(hard.thin) / np.count_nonzero(known),
        foreground=None if objects is None else disparity_errors(result.disparity_px, scene.truth_px, objects),
        background=None if objects is None else disparity_errors(result.disparity_px, scene.truth_px, ~objects),
        confidence=_confidence(result, scene.truth_px),
        occlusion=scene.occlusion,
        ms=ms,
        runs=runs,
    )


def search_range(config: MatchingConfig, truth_px: F32, given: Collection[str] = ()) -> MatchingConfig:
    """The config with a search range that covers the truth; the parameters in ``given`` are kept.

    ``disparity_range`` is the smallest multiple of 16, at least 32, with which the search ends above the largest true
    disparity. ``min_disparity`` is lowered to the smallest true disparity if that is negative.
    """
    known = truth_px[np.isfinite(truth_px)]
    changes: dict[str, int] = {}
    if "min_disparity" not in given:
        changes["min_disparity"] = min(config.min_disparity, math.floor(known.min()))
    if "disparity_range" not in given:
        first = changes.get("min_disparity", config.min_disparity)
        steps = math.floor((float(known.max()) - first) / _STEP) + 1
        changes["num_disparities"] = max(_LEAST, _STEP * steps)
    return dataclasses.replace(config, **changes)  # type: ignore[arg-type]


def _timed(matcher: Matcher, scene: Scene) -> tuple[MatchResult, float, int]:
    """Result, median milliseconds and number of the timed calls after a warm-up call."""
    more: dict[str, Any] = {} if scene.prior is None else {"prior": scene.prior}
    result = matcher.match(scene.left, scene.right, earlier=scene.earlier, **more)
    seconds: list[float] = []
    while len(seconds) < _RUNS and sum(seconds) < _ENOUGH_S:
        begin = time.perf_counter()
        result = matcher.match(scene.left, scene.right, earlier=scene.earlier, **more)
        seconds.append(time.perf_counter() - begin)
    return result, 1e3 * statistics.median(seconds), len(seconds)


def _confidence(result: MatchResult, truth_px: F32) -> Confidence | None:
    if result.confidence is None:
        return None
    both = np.isfinite(result.disparity_px) & np.isfinite(truth_px)
    error = np.abs(result.disparity_px[both].astype(np.float64) - truth_px[both])
    bad: F64 = np.where(error > 1, 100.0, 0.0)
    bad_1 = sparsification(result.confidence[both], bad)
    avg_px = sparsification(result.confidence[both], error)
    return None if bad_1 is None or avg_px is None else Confidence(bad_1, avg_px)


def _figures(errors: DisparityErrors) -> dict[str, float]:
    """The errors by their published names: A50 is the median."""
    fields = (field.name for field in dataclasses.fields(errors))
    names = ((field, "a50" if field == "median_px" else field) for field in fields)
    return {name.removesuffix("_px"): getattr(errors, field) for field, name in names}


def _areas(confidence: Confidence | None) -> dict[str, float | None]:
    """Areas under the sparsification curves: by confidence, in random and in best order, and confidence over random."""
    areas: dict[str, float | None] = {}
    for name in ("bad_1", "avg_px"):
        curve: SparsificationCurve | None = getattr(confidence, name, None)
        key = f"auc_{name.removesuffix('_px')}"
        areas[key] = curve.area if curve else None
        areas[f"{key}_random"] = curve.random_area if curve else None
        areas[f"{key}_oracle"] = curve.oracle_area if curve else None
        areas[f"{key}_ratio"] = curve.area / curve.random_area if curve and curve.random_area else None
    return areas


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
