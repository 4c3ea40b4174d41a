# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes of a bag: the pairs with true disparities, or with a sweep of a range sensor, rectified."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration, SerializedPair
from stereo_depth_ros.bags.projected_sweeps import ProjectedSweep, ProjectedSweeps, SensorTopic
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import CalibrationError, MessageError, StereoDepthError
from stereo_depth_ros.core.pair_memory import PairMemory
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import RectifiedPair
from stereo_depth_ros.evaluation.scenes import Scene, SceneSource, make_scene
from stereo_depth_ros.evaluation.truth import DisparityTruth, Truth, TruthOption, TruthSource, open_truth
from stereo_depth_ros.matching.protocol import Images
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["BagScenes"]


class _Rectified(NamedTuple):
    """A rectified pair with its rig, and those before it that are matched together with it."""

    rig: StereoRig
    rectifier: Rectifier
    pair: RectifiedPair
    earlier: tuple[Images, ...]


class BagScenes:
    """The pairs of a bag whose left image has the stamp of true disparities, or a sweep of a range sensor.

    Where the rectified left image has no source pixel in the raw one, the truth is unknown.

    Args:
        selection: the bag and its topics; it is read to the end.
        pair_count: number of pairs that the matchers match together, see :class:`Scene`.
        gap_ns: longest time between these, see :class:`PairMemory`.
        truth: the topic of the truth, see :func:`open_truth`.
        prior: the range sensor that gives the scenes a prior; None for none.

    Attributes:
        path: of the bag.
        names: every name that one of the scenes may have.
        files: all files that are read.

    Raises:
        BagError: not a readable bag.
        TopicError: no truth in it, or no stereo pair.
        CalibrationError: a file of extrinsics that cannot be read.
    """

    def __init__(
        self,
        selection: BagSelection,
        pair_count: int = 1,
        gap_ns: int | None = None,
        truth: TruthOption | None = None,
        prior: SensorTopic | None = None,
    ) -> None:
        self._pair_count, self._gap_ns = pair_count, gap_ns
        self._selection, self.path = selection, selection.path
        self._types = RosbagsTypes()
        self._rectifiers = PerCalibration(self._types, lambda rig: (rig, Rectifier(rig)))
        self._depth, self._rectified_depth = BitDepth(), BitDepth()
        self._option = truth or TruthOption()
        self._truth: TruthSource | None = None
        self._prior = prior
        self._sweeps: ProjectedSweeps | None = None
        with BagReader(self.path) as reader:
            is_range = not isinstance(open_truth(reader, self._option), DisparityTruth)
            if prior is not None:  # refused before anything runs
                ProjectedSweeps(reader, prior)
            count = 0 if is_range else reader.topics[self._option.topic].count
        with BagPairs(selection, PairingConfig()) as pairs:  # refuses a bag without pairs before anything runs
            self.names = [self._name(number) for number in range(pairs.count)]
        self._count = len(self.names) if is_range else count
        self.files = bag_files(self.path) + ([] if self._option.extrinsics is None else [self._option.extrinsics])
        self.files += [] if prior is None or prior.extrinsics is None else [prior.extrinsics]

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[SceneSource]:
        with BagReader(self.path) as reader, BagPairs(self._selection, PairingConfig()) as pairs:
            self._truth = truth = open_truth(reader, self._option, pairs.rectified_info)
            self._sweeps = None if self._prior is None else ProjectedSweeps(reader, self._prior, pairs.rectified_info)
            memory: PairMemory[Images] = PairMemory(self._pair_count, self._gap_ns)
            for number, pair in enumerate(pairs.pairs()):
                rectified = cache(partial(self._rectified, pair, pairs.topics.image_type, memory))
                rig_of = partial(self._rig, pair, pairs.topics.image_type)
                try:
                    read = truth.of(pair.stamp_ns, rig_of)
                    project_sweep = None if self._sweeps is None else self._sweeps.of(pair.stamp_ns, rig_of)
                except (CalibrationError, MessageError):  # of this pair: loading it raises the same
                    yield SceneSource(
                        self._name(number), partial(self._load, rectified, lambda: Truth(np.zeros((0, 0), np.float32)))
                    )
                    continue
                if read is not None:
                    yield SceneSource(self._name(number), partial(self._load, rectified, read, project_sweep))
                if self._pair_count > 1:
                    with contextlib.suppress(StereoDepthError):  # a pair that cannot be read is in no memory
                        rectified()

    @property
    def facts(self) -> str:
        """Where truth and prior of the scenes that were read come from; empty for disparities without a prior."""
        parts = [] if self._truth is None else [self._truth.facts]
        parts += [] if self._sweeps is None else [f"prior of {self._sweeps.facts}"]
        return "; ".join(part for part in parts if part)

    def _name(self, number: int) -> str:
        return f"{self.path.resolve().stem}/{number:04d}"

    def _rig(self, pair: SerializedPair, image_type: str) -> StereoRig:
        return self._rectifiers.of(pair, image_type)[0]

    def _rectified(self, pair: SerializedPair, image_type: str, memory: PairMemory[Images]) -> _Rectified:
        rig, rectifier = self._rectifiers.of(pair, image_type)
        rectified = rectifier.rectify(pair.images(self._types, image_type, rig, self._depth), self._rectified_depth)
        earlier = memory.add((rectified.left, rectified.right), pair.stamp_ns, rig)
        return _Rectified(rig, rectifier, rectified, earlier)

    def _load(
        self,
        source: Callable[[], _Rectified],
        read: Callable[[], Truth],
        project_sweep: Callable[[], ProjectedSweep] | None = None,
    ) -> Scene:
        rig, rectifier, rectified, earlier = source()
        truth = read()
        truth_px = truth.disparity_px
        if truth_px.shape == rectified.left.shape:  # make_scene refuses other sizes
            truth_px[~rectifier.left_source] = np.nan
        parts = (rectified.left, rectified.right, truth_px, truth.visible)
        scene = make_scene(*parts, doffs_px=rig.doffs_px, earlier=earlier)
        prior = None if project_sweep is None else project_sweep().prior
        return dataclasses.replace(scene, occlusion="truth", prior=prior)
