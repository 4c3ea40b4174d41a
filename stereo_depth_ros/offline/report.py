# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Report of an offline or live run of a bag: counts, latencies, stage timings, and their JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stereo_depth_ros.evaluation.bag_score import BagScore

__all__ = ["OutputStats", "RunReport", "percentile", "stage_timings"]


@dataclass(frozen=True)
class OutputStats:
    """Counts and latencies of one output topic.

    Attributes:
        received: messages of pairs that were sent, each pair counted once.
        lost: pairs whose message was not received.
        latencies_ms: milliseconds from publishing the last message of a pair to receiving this one.
    """

    received: int
    lost: int
    latencies_ms: tuple[float, ...] = ()

    @property
    def p50_ms(self) -> float:
        """Median latency, milliseconds; NaN where nothing was received."""
        return percentile(self.latencies_ms, 50)

    @property
    def p95_ms(self) -> float:
        """95th percentile of the latency, milliseconds; NaN where nothing was received."""
        return percentile(self.latencies_ms, 95)


@dataclass(frozen=True)
class RunReport:
    """Result of one run of a bag through the pipeline, live or offline.

    Attributes:
        bag, output: the bag that was read and the one that was written; None where none was written.
        pairs: pairs sent.
        unpaired_left, unpaired_right: images of the bag without a partner in the other camera.
        outputs: counts per topic; empty offline.
        skipped: pairs that could not be processed, offline; live they are lost outputs.
        wall_s: seconds from the first pair sent to the last output received.
        warm_up_s: of these, until the first pair was computed, offline: what is compiled and prepared belongs to it.
        stages_ms: stage name to (p50, p95) in milliseconds, measured by the nodes or the pipeline.
        score: valid fraction and errors of the recorded disparities; None where nothing was recorded.
        realtime: whether pairs were sent in real time, so that losses are expected.
        warnings: a sentence each, such as for a cut bag or for skipped pairs.
    """

    bag: Path
    output: Path | None
    pairs: int
    unpaired_left: int
    unpaired_right: int
    outputs: Mapping[str, OutputStats]
    wall_s: float
    warm_up_s: float = 0.0
    skipped: int = 0
    stages_ms: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    score: BagScore | None = None
    realtime: bool = False
    warnings: tuple[str, ...] = ()

    @property
    def lost(self) -> int:
        """Expected messages that were not received, over all outputs."""
        return sum(stats.lost for stats in self.outputs.values())

    @property
    def frames_per_second(self) -> float:
        """Pairs per second from the first pair sent to the last output received; NaN for no time.

        Offline, of the pairs after the first one, so that compilation and preparation do not count.
        """
        if self.warm_up_s and self.pairs > 1 and self.wall_s > self.warm_up_s:
            return (self.pairs - 1) / (self.wall_s - self.warm_up_s)
        return self.pairs / self.wall_s if self.wall_s > 0 else math.nan

    def to_json(self) -> dict[str, Any]:
        """The report in JSON types: latencies as percentiles, NaN as None, paths as text."""
        outputs = {
            topic: {"received": s.received, "lost": s.lost, "p50_ms": s.p50_ms, "p95_ms": s.p95_ms}
            for topic, s in self.outputs.items()
        }
        stages = {stage: {"p50_ms": p50, "p95_ms": p95} for stage, (p50, p95) in self.stages_ms.items()}
        values = asdict(self) | {"outputs": outputs, "frames_per_second": self.frames_per_second, "lost": self.lost}
        values |= {"stages_ms": stages}
        return {key: _plain(value) for key, value in values.items()}


def percentile(values: Sequence[float], percent: float) -> float:
    """Percentile with linear interpolation; NaN for no values."""
    return float(np.percentile(np.asarray(values, np.float64), percent)) if len(values) else math.nan


def stage_timings(values: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    """Stage to (p50, p95) in milliseconds, of the values "<stage> p50 ms" and "<stage> p95 ms" of a diagnostic."""
    stages = [key.removesuffix(" p50 ms") for key in values if key.endswith(" p50 ms")]
    return {
        stage: (float(values[f"{stage} p50 ms"]), float(values[f"{stage} p95 ms"]))
        for stage in stages
        if f"{stage} p95 ms" in values
    }


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
