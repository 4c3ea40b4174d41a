# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scores the disparities of a bag: valid fraction, and errors where the true disparities are known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.evaluation.metrics import DisparityErrors, disparity_errors
from stereo_depth_ros.messages.disparity import published_disparity
from stereo_depth_ros.messages.types import stamp_ns

__all__ = ["TRUTH_TOPIC", "BagScore", "score_disparity", "untrue_score"]

TRUTH_TOPIC = "/truth/disparity"


@dataclass(frozen=True)
class BagScore:
    """Means over the frames of a bag; NaN over no frames.

    Attributes:
        frames: number of disparity images.
        valid_fraction: share of pixels with a disparity, 0..1.
        truth_frames: number of them with true disparities of the same stamp.
        density: share of the pixels with truth that have a disparity, 0..1.
        median_px, avg_px: median and mean absolute error of the matched pixels with truth, pixels.
        bad_2: percentage of the matched pixels with truth that are wrong by more than 2 px.
    """

    frames: int
    valid_fraction: float
    truth_frames: int
    density: float
    median_px: float
    avg_px: float
    bad_2: float


def score_disparity(path: Path, truth: Path, topic: str = "/disparity") -> BagScore:
    """Score the DisparityImages of a bag against ``/truth/disparity`` of another one.

    Args:
        path: bag with the disparities.
        truth: bag that may have true disparities, with equal stamps.
        topic: topic of the disparities.

    Raises:
        BagError: a bag that cannot be read.
        ImageError: true disparities of another size.
    """
    valid: list[float] = []
    errors: list[DisparityErrors] = []
    truths = _disparities(truth, TRUTH_TOPIC)
    known = next(truths, None)
    for stamp, disparity_px in _disparities(path, topic):
        valid.append(np.count_nonzero(np.isfinite(disparity_px)) / disparity_px.size)
        while known is not None and known[0] < stamp:
            known = next(truths, None)
        if known is not None and known[0] == stamp:
            errors.append(disparity_errors(disparity_px, known[1]))
    return _score(valid, errors)


def untrue_score(valid_fractions: Sequence[float]) -> BagScore:
    """The score without true disparities, from the valid fraction of each frame."""
    return _score(valid_fractions, ())


def _score(valid: Sequence[float], errors: Sequence[DisparityErrors]) -> BagScore:
    return BagScore(
        frames=len(valid),
        valid_fraction=_mean(valid),
        truth_frames=len(errors),
        density=_mean([error.density for error in errors]),
        median_px=_mean([error.median_px for error in errors]),
        avg_px=_mean([error.avg_px for error in errors]),
        bad_2=_mean([error.bad_2 for error in errors]),
    )


def _disparities(path: Path, topic: str) -> Iterator[tuple[int, F32]]:
    """Stamp and published disparities in the order of the bag; none without the topic."""
    with BagReader(path) as reader:
        if topic in reader.topics:
            for message in reader.messages([topic]):
                image = reader.deserialize(message)
                yield stamp_ns(image.header), published_disparity(image, topic)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
