# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes of a bag: the pairs with true disparities on /truth/disparity, rectified."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration, SerializedPair
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.evaluation.bag_score import TRUTH_TOPIC
from stereo_depth_ros.evaluation.scenes import Scene, SceneSource, make_scene
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["BagScenes"]


class BagScenes:
    """The pairs of a bag whose left image has the stamp of a message on ``/truth/disparity``.

    Where the rectified left image has no source pixel in the raw one, the truth is unknown.

    Args:
        selection: the bag and its topics; it is read to the end.

    Attributes:
        names: every name that one of the scenes may have.
        files: all files that are read.

    Raises:
        BagError: not a readable bag.
        TopicError: no true disparities in it, or no stereo pair.
    """

    def __init__(self, selection: BagSelection) -> None:
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
            for number, pair in enumerate(pairs.pairs()):
                while known is not None and known[0] < pair.stamp_ns:
                    known = next(truths, None)
                if known is not None and known[0] == pair.stamp_ns:
                    yield SceneSource(
                        self._name(number), partial(self._load, pair, pairs.topics.image_type, known[1].data)
                    )

    def _name(self, number: int) -> str:
        return f"{self._path.resolve().stem}/{number:04d}"

    def _load(self, pair: SerializedPair, image_type: str, truth: bytes) -> Scene:
        rig, rectifier = self._rectifiers.of(pair, image_type)
        rectified = rectifier.rectify(pair.images(self._types, image_type, rig, self._depth), self._rectified_depth)
        truth_px = matched_disparity(self._types.deserialize(truth, self._truth_type), rig, TRUTH_TOPIC)
        if truth_px.shape == rectified.left.shape:  # make_scene refuses other sizes
            truth_px[~rectifier.left_source] = np.nan
        return make_scene(rectified.left, rectified.right, truth_px, doffs_px=rig.doffs_px)
