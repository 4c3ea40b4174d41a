# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes a bag without a ROS graph, with the pairs, pipeline and message bytes of the live nodes."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration, SerializedPair
from stereo_depth_ros.bags.projected_sweeps import ProjectedSweeps, SensorTopic
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.bags.topics import INFO_TYPE
from stereo_depth_ros.bags.writer import BagWriter, check_bag_output
from stereo_depth_ros.config import PipelineConfig, ViewConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import CameraOrderError, OutputError, StereoDepthError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.diagnosis.opening import no_pair_error, open_selection, skipped_text
from stereo_depth_ros.evaluation.bag_score import score_disparity
from stereo_depth_ros.offline.examined_pipelines import ExaminedPipelines
from stereo_depth_ros.offline.provenance import provenance
from stereo_depth_ros.offline.report import RunReport, percentile
from stereo_depth_ros.outputs import MORE_OUTPUTS, OUTPUTS, ResultMessages
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.views.result_frames import ResultFrames
from stereo_depth_ros.views.topics import ViewMessages

__all__ = ["process_bag"]


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
) -> RunReport:
    """Compute every pair of a bag and write the outputs and camera infos into an MCAP bag.

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
        also: topics of ``MORE_OUTPUTS`` that are written too.

    Raises:
        BagError, TopicError: no readable stereo bag, stamps that are not set, or no pair that can be processed.
        CalibrationError, ImageError: the first pairs do not fit the calibration, with ``strict``; nothing is written.
        CameraOrderError: left and right are swapped, which a pair shows at last; nothing is written.
        OutputError: an existing output without ``overwrite``, an output that is read, or it cannot be written.
        ConfigError: parameters that contradict each other.
    """
    check_bag_output(output, bag_files(selection.path), overwrite=overwrite)
    refused: dict[str, str] = {}
    stages_ms: dict[str, list[float]] = defaultdict(list)
    engine = _Engine(config, views, each, also)
    selection, choice = open_selection(selection, config.pairing)
    with BagPairs(selection, config.pairing) as pairs, BagReader(selection.path) as reader:
        sweeps = None if prior is None else ProjectedSweeps(reader, prior, pairs.rectified_info)
        with BagWriter(output, compression="lz4", overwrite=overwrite) as writer:
            start, warm_up_s, sent, skipped = time.perf_counter(), 0.0, 0, 0
            for sent, pair in enumerate(pairs.pairs(), start=1):
                try:
                    timings_ms = engine.process(pair, pairs.topics.image_type, writer, sweeps)
                except CameraOrderError as error:  # of the pairs before it too, which showed too little
                    raise error.about(selection.path) from error
                except OutputError:
                    raise
                except StereoDepthError as error:
                    skipped += 1
                    refused.setdefault(type(error).__name__, skipped_text(pair.stamp_ns, error))
                else:
                    for stage, ms in timings_ms.items():
                        stages_ms[stage].append(ms)
                _refuse(engine.fault, selection.path, strict)
                warm_up_s = warm_up_s or time.perf_counter() - start
                progress(sent, max(sent, pairs.count))
            wall_s = time.perf_counter() - start
            engine.finish()
            _refuse(engine.fault, selection.path, strict)
            if engine.rig is None or not writer.message_count:
                raise no_pair_error(pairs, selection.path, refused.values())
            writer.write_metadata("stereo_depth_ros", provenance(config, engine.rig, bag=selection.path))
        return RunReport(
            bag=selection.path,
            output=output,
            pairs=sent,
            unpaired_left=pairs.unpaired_left,
            unpaired_right=pairs.unpaired_right,
            outputs={},
            skipped=skipped,
            wall_s=wall_s,
            warm_up_s=warm_up_s,
            stages_ms={stage: (percentile(times, 50), percentile(times, 95)) for stage, times in stages_ms.items()},
            score=score_disparity(output, selection.path),
            warnings=(
                *(text for text in (choice, pairs.warning) if text),
                *pairs.losses,
                *refused.values(),
                *([str(engine.fault)] if engine.fault else []),
                *(f"without a prior: {text}" for text in ([] if sweeps is None else sweeps.left_out)),
            ),
        )


def _refuse(fault: StereoDepthError | None, bag: Path, strict: bool) -> None:
    if fault is not None and (strict or isinstance(fault, CameraOrderError)):
        raise fault.about(bag)


class _Engine:
    """Computes serialized pairs and writes their messages.

    Attributes:
        rig: of the last pair.
    """

    def __init__(
        self,
        config: PipelineConfig,
        views: Mapping[str, ViewConfig],
        each: Callable[[StereoResult], None],
        also: Sequence[str],
    ) -> None:
        self._types = RosbagsTypes()
        self._rows = (*OUTPUTS, *(row for row in MORE_OUTPUTS if row.topic in also))
        self._each = each
        self._views = views
        self._frames, self._view_messages = ResultFrames(), ViewMessages(self._types)
        self._messages = ResultMessages(self._types)
        self._rigs = PerCalibration(self._types, lambda rig: rig)
        self._pipelines = ExaminedPipelines(config)
        self._depth = BitDepth()
        self.rig: StereoRig | None = None

    @property
    def fault(self) -> StereoDepthError | None:
        """What the first pairs show."""
        return self._pipelines.fault

    def process(
        self, pair: SerializedPair, image_type: str, writer: BagWriter, sweeps: ProjectedSweeps | None
    ) -> dict[str, float]:
        """Compute a pair and write its messages; returns milliseconds per stage."""
        rig = self._rigs.of(pair, image_type)
        prior, prior_ms = None, 0.0
        if sweeps is not None:
            start = time.perf_counter()
            project_sweep = sweeps.of(pair.stamp_ns, lambda: rig)
            prior = None if project_sweep is None else project_sweep().prior
            prior_ms = 1e3 * (time.perf_counter() - start)
        result = self._pipelines.compute(pair.images(self._types, image_type, rig, self._depth), rig, prior)
        if sweeps is not None:
            result.timings_ms["prior"] = prior_ms
        self.rig = result.calibrated_rig
        writer.write_raw("/left/camera_info", INFO_TYPE, pair.left_info, pair.stamp_ns)
        writer.write_raw("/right/camera_info", INFO_TYPE, pair.right_info, pair.right_stamp_ns)
        for topic, message in self._outputs(result):
            writer.write(topic, message, result.stamp_ns)
        self._each(result)
        return result.timings_ms

    def finish(self) -> None:
        """No more pair comes."""
        self._pipelines.finish()

    def _outputs(self, result: StereoResult) -> Iterator[tuple[str, Any]]:
        for topic, _, build in self._rows:
            start = time.perf_counter()
            message = build(self._messages, result)
            result.timings_ms[f"make {topic}"] = 1e3 * (time.perf_counter() - start)
            yield f"/{topic}", message
        frame = self._frames.of(result) if self._views else None
        for topic, config in self._views.items():
            assert frame is not None  # there are views
            start = time.perf_counter()
            message = self._view_messages.build(topic, frame, config)
            result.timings_ms[f"make {topic}"] = 1e3 * (time.perf_counter() - start)
            yield f"/{topic}", message
