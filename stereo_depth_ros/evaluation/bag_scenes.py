# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes of a bag: the pairs with true disparities on /truth/disparity, rectified."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration, SerializedPair
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import StereoDepthError, TopicError
from stereo_depth_ros.core.pair_memory import PairMemory
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import RectifiedPair
from stereo_depth_ros.evaluation.bag_score import TRUTH_TOPIC
from stereo_depth_ros.evaluation.scenes import Scene, SceneSource, make_scene
from stereo_depth_ros.matching.protocol import Images
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["BagScenes"]


class _Rectified(NamedTuple):
    """A rectified pair with its rig, and those before it that are matched together with it."""

    rig: StereoRig
    rectifier: Rectifier
    pair: RectifiedPair
    earlier: tuple[Images, ...]


class BagScenes:
    """The pairs of a bag whose left image has the stamp of a message on ``/truth/disparity``.

    Where the rectified left image has no source pixel in the raw one, the truth is unknown.

    Args:
        selection: the bag and its topics; it is read to the end.
        pair_count: number of pairs that the matchers match together, see :class:`Scene`.
        gap_ns: longest time between these, see :class:`PairMemory`.

    Attributes:
        names: every name that one of the scenes may have.
        files: all files that are read.

    Raises:
        BagError: not a readable bag.
        TopicError: no true disparities in it, or no stereo pair.
    """

    def __init__(self, selection: BagSelection, pair_count: int = 1, gap_ns: int | None = None) -> None:
        self._pair_count, self._gap_ns = pair_count, gap_ns
        self._selection, self._path = selection, selection.path
        self._types = RosbagsTypes()
        self._rectifiers = PerCalibration(self._types, lambda rig: (rig, Rectifier(rig)))
        self._depth, self._rectified_depth = BitDepth(), BitDepth()
        with BagReader(self._path) as reader:
            if TRUTH_TOPIC not in reader.topics:
                raise TopicError(
                    f"has no {TRUTH_TOPIC}, it has {', '.join(reader.topics)}",
                    subject=str(self._path),
                    value=list(reader.topics),
                    limit=TRUTH_TOPIC,
                    remedy="convert a dataset with true disparities, or synthesize a bag",
                )
            self._truth_type, self._count = reader.topics[TRUTH_TOPIC].msgtype, reader.topics[TRUTH_TOPIC].count
        with BagPairs(selection, PairingConfig()) as pairs:  # refuses a bag without pairs before anything runs
            self.names = [self._name(number) for number in range(pairs.count)]
        self.files = bag_files(self._path)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[SceneSource]:
        with BagReader(self._path) as reader, BagPairs(self._selection, PairingConfig()) as pairs:
            truths = StampedMessages().read(reader.messages([TRUTH_TOPIC]))
            known = next(truths, None)
            memory: PairMemory[Images] = PairMemory(self._pair_count, self._gap_ns)
            for number, pair in enumerate(pairs.pairs()):
                while known is not None and known[0] < pair.stamp_ns:
                    known = next(truths, None)
                rectified = cache(partial(self._rectified, pair, pairs.topics.image_type, memory))
                if known is not None and known[0] == pair.stamp_ns:
                    yield SceneSource(self._name(number), partial(self._load, rectified, known[1].data))
                if self._pair_count > 1:
                    with contextlib.suppress(StereoDepthError):  # a pair that cannot be read is in no memory
                        rectified()

    def _name(self, number: int) -> str:
        return f"{self._path.resolve().stem}/{number:04d}"

    def _rectified(self, pair: SerializedPair, image_type: str, memory: PairMemory[Images]) -> _Rectified:
        rig, rectifier = self._rectifiers.of(pair, image_type)
        rectified = rectifier.rectify(pair.images(self._types, image_type, rig, self._depth), self._rectified_depth)
        earlier = memory.add((rectified.left, rectified.right), pair.stamp_ns, rig)
        return _Rectified(rig, rectifier, rectified, earlier)

    def _load(self, source: Callable[[], _Rectified], truth: bytes) -> Scene:
        rig, rectifier, rectified, earlier = source()
        truth_px = matched_disparity(self._types.deserialize(truth, self._truth_type), rig, TRUTH_TOPIC)
        if truth_px.shape == rectified.left.shape:  # make_scene refuses other sizes
            truth_px[~rectifier.left_source] = np.nan
        return make_scene(rectified.left, rectified.right, truth_px, doffs_px=rig.doffs_px, earlier=earlier)
