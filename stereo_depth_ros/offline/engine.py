# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes a bag without a ROS graph, with the pairs, pipeline and message bytes of the live nodes.

A thread reads and decodes pairs, the calling one matches them with all cores, and another one makes, serializes,
compresses and writes their messages: each works on a pair of its own, and the order of the pairs stays.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import MappingProxyType

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration, SerializedPair
from stereo_depth_ros.bags.projected_sweeps import ProjectedSweeps, SensorTopic
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.bags.writer import BagWriter, check_bag_output
from stereo_depth_ros.config import PipelineConfig, ViewConfig
from stereo_depth_ros.config.output_topics import OUTPUT_TOPICS, output_topics
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import CameraOrderError, OutputError, StereoDepthError
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.side_threads import ReadAhead, WriteBehind
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.diagnosis.opening import no_pair_error, open_selection, skipped_text
from stereo_depth_ros.evaluation.bag_score import TRUTH_TOPIC, score_disparity
from stereo_depth_ros.offline.examined_pipelines import ExaminedPipelines
from stereo_depth_ros.offline.provenance import provenance
from stereo_depth_ros.offline.report import RunReport, percentile
from stereo_depth_ros.offline.result_writer import ResultWriter
from stereo_depth_ros.outputs import LIVE_OUTPUTS
from stereo_depth_ros.pipeline import StereoResult

__all__ = ["process_bag"]

_WAITING = 2  # pairs that wait between two steps: memory does not grow with the bag


def process_bag(
    selection: BagSelection,
    output: Path,
    config: PipelineConfig,
    progress: Callable[[int, int], None] = lambda done, total: None,
    views: Mapping[str, ViewConfig] = MappingProxyType({}),
    *,
    overwrite: bool = False,
    strict: bool = False,
    each: Callable[[StereoResult], None] = lambda result: None,
    prior: SensorTopic | None = None,
    also: Sequence[str] = (),
    outputs: Sequence[str] = OUTPUT_TOPICS,
    compression: str = "lz4",
    every: int = 1,
) -> RunReport:
    """Compute the pairs of a bag and write the outputs and camera infos into an MCAP bag.

    A pair that cannot be processed is skipped; the first one of each kind of error is reported in the warnings.

    Args:
        selection: bag, topics and part of it.
        output: the bag to write.
        config: parameters of all stages.
        progress: called with the pairs done and about how many there are at most.
        views: parameters of the views that are written too, by topic.
        overwrite: replace an existing output.
        strict: raise what is a warning otherwise: the first pairs do not fit the calibration, see :class:`FirstPairs`.
        each: called with every result, after its outputs are written.
        prior: range sensor of the bag whose points the matcher takes as a prior. Pairs without a sweep in time are
            matched without; the warnings say how many.
        also: topics of ``LIVE_OUTPUTS`` that are written too.
        outputs: topics of ``LIVE_OUTPUTS`` that are written.
        compression: of the chunks, "none", "lz4" or "zstd".
        every: only the first one of so many pairs is computed.

    Raises:
        BagError, TopicError: no readable stereo bag, stamps that are not set, or no pair that can be processed.
        CalibrationError, ImageError: the first pairs do not fit the calibration, with ``strict``; nothing is written.
        CameraOrderError: left and right are swapped, which a pair shows at last; nothing is written.
        OutputError: an existing output without ``overwrite``, an output that is read, or it cannot be written.
        ConfigError: parameters that contradict each other, or an unknown output.
    """
    check_bag_output(output, bag_files(selection.path), overwrite=overwrite)
    wanted = output_topics([*outputs, *also])
    rows = [row for row in LIVE_OUTPUTS if row.topic in wanted]
    with BagReader(selection.path) as reader:
        selection, choice = open_selection(selection, config.pairing, reader)
        pairs = BagPairs(selection, config.pairing, reader)
        sweeps = None if prior is None else ProjectedSweeps(reader, prior, pairs.rectified_info)
        with BagWriter(output, compression=compression, overwrite=overwrite) as writer:
            results = ResultWriter(writer, rows, views, each)
            run = _Run(config, pairs, sweeps, results, every)
            wall_s, warm_up_s = run.compute_all(progress, strict)
            if run.rig is None or not writer.message_count:
                raise no_pair_error(pairs, selection.path, run.refused)
            writer.write_metadata("stereo_depth_ros", run.provenance())
        score = results.score
        if score is not None and TRUTH_TOPIC in reader.topics:
            score = score_disparity(output, selection.path)
        return RunReport(
            bag=selection.path,
            output=output,
            pairs=run.sent,
            unpaired_left=pairs.unpaired_left,
            unpaired_right=pairs.unpaired_right,
            outputs={},
            skipped=run.skipped,
            wall_s=wall_s,
            warm_up_s=warm_up_s,
            stages_ms={name: (percentile(ms, 50), percentile(ms, 95)) for name, ms in results.stages_ms.items()},
            score=score,
            warnings=(
                *(text for text in (choice, pairs.warning) if text),
                *pairs.losses,
                *run.refused,
                *([str(run.fault)] if run.fault else []),
                *(f"without a prior: {text}" for text in ([] if sweeps is None else sweeps.left_out)),
            ),
        )


@dataclass(frozen=True)
class _ReadPair:
    """A pair that has been read.

    Attributes:
        number: of the pair, from 1.
        serialized: its messages.
        images, rig, prior: what is computed from; None where ``error`` says why it cannot be.
        prior_ms: milliseconds that the prior took; None without a range sensor.
    """

    number: int
    serialized: SerializedPair
    images: StereoPair | None = None
    rig: StereoRig | None = None
    prior: DisparityPrior | None = None
    prior_ms: float | None = None
    error: StereoDepthError | None = None


class _Run:
    """The pairs of a bag through the three steps.

    Attributes:
        rig: of the last pair.
        sent: pairs so far.
    """

    def __init__(
        self, config: PipelineConfig, pairs: BagPairs, sweeps: ProjectedSweeps | None, results: ResultWriter, every: int
    ) -> None:
        self._every = every
        self._types = RosbagsTypes()
        self._config = config
        self._pairs, self._sweeps, self._results = pairs, sweeps, results
        self._pipelines = ExaminedPipelines(config)
        self._refused: list[tuple[int, str, str]] = []  # number of the pair, kind of the error, text
        self.rig: StereoRig | None = None
        self.sent = 0

    @property
    def fault(self) -> StereoDepthError | None:
        """What the first pairs show."""
        return self._pipelines.fault

    @property
    def skipped(self) -> int:
        """Pairs so far that could not be processed."""
        return len(self._refused)

    @property
    def refused(self) -> list[str]:
        """The first error of each kind, in the order of the pairs."""
        first: dict[str, str] = {}
        for _, kind, text in sorted(self._refused):
            first.setdefault(kind, text)
        return [*first.values()]

    def provenance(self) -> dict[str, str]:
        """Metadata of the output."""
        counts = {"pairs": self.sent, "skipped_pairs": self.skipped}
        return provenance(self._config, self.rig, bag=self._pairs.path, every=self._every, **counts)

    def compute_all(self, progress: Callable[[int, int], None], strict: bool) -> tuple[float, float]:
        """All pairs; returns the seconds that they took, and of these the seconds until the first one was computed."""
        start, warm_up_s = time.perf_counter(), 0.0
        with (
            ReadAhead(self._read(), _WAITING, "read pairs") as read,
            WriteBehind(self._write, _WAITING, "write results") as written,
        ):
            for pair in read:
                self.sent = pair.number
                result = self._compute(pair)
                if result is not None:
                    written.put((pair, result))
                self._refuse_fault(strict)
                warm_up_s = warm_up_s or time.perf_counter() - start
                progress(self.sent, max(self.sent, math.ceil(self._pairs.count / self._every)))
                del pair, result  # they hold images
        wall_s = time.perf_counter() - start
        self._pipelines.finish()
        self._refuse_fault(strict)
        return wall_s, warm_up_s

    def _refuse_fault(self, strict: bool) -> None:
        if self.fault is not None and (strict or isinstance(self.fault, CameraOrderError)):
            raise self.fault.about(self._pairs.path)

    def _skip(self, pair: _ReadPair, error: StereoDepthError) -> None:
        text = skipped_text(pair.serialized.stamp_ns, error)
        self._refused.append((pair.number, type(error).__name__, text))

    def _read(self) -> Iterator[_ReadPair]:
        """The pairs, decoded; in the thread that reads."""
        rigs, depth = PerCalibration(self._types, lambda rig: rig), BitDepth()
        image_type = self._pairs.topics.image_type
        for number, pair in enumerate(islice(self._pairs.pairs(), 0, None, self._every), start=1):
            try:
                rig = rigs.of(pair, image_type)
                prior, prior_ms = self._prior(pair, rig)
                images = pair.images(self._types, image_type, rig, depth)
            except StereoDepthError as error:
                yield _ReadPair(number, pair, error=error)
            else:
                yield _ReadPair(number, pair, images, rig, prior, prior_ms)

    def _prior(self, pair: SerializedPair, rig: StereoRig) -> tuple[DisparityPrior | None, float | None]:
        if self._sweeps is None:
            return None, None
        start = time.perf_counter()
        project_sweep = self._sweeps.of(pair.stamp_ns, lambda: rig)
        prior = None if project_sweep is None else project_sweep().prior
        return prior, 1e3 * (time.perf_counter() - start)

    def _compute(self, pair: _ReadPair) -> StereoResult | None:
        """The result of a pair; None for one that is skipped."""
        if pair.error is not None:
            self._skip(pair, pair.error)
            return None
        assert pair.images is not None and pair.rig is not None  # there is no error
        try:
            result = self._pipelines.compute(pair.images, pair.rig, pair.prior)
            self.rig = result.calibrated_rig
        except CameraOrderError as error:  # of the pairs before it too, which showed too little
            raise error.about(self._pairs.path) from error
        except StereoDepthError as error:
            self._skip(pair, error)
            return None
        if pair.prior_ms is not None:
            result.timings_ms["prior"] = pair.prior_ms
        return result

    def _write(self, item: tuple[_ReadPair, StereoResult]) -> None:
        """Write the messages of a pair; in the thread that writes."""
        pair, result = item
        try:
            self._results.write(pair.serialized, result)
        except OutputError:
            raise
        except StereoDepthError as error:
            self._skip(pair, error)
