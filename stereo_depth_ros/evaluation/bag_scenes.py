# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pairs of a bag that have a truth on /truth/disparity, rectified, as scenes to evaluate on."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, SerializedPair
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.evaluation.bag_score import TRUTH_TOPIC
from stereo_depth_ros.evaluation.scenes import Scene, SceneSource, make_scene
from stereo_depth_ros.messages.cdr import cdr_stamp_ns
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.messages.image import decode
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["BagScenes"]

_INFO_TYPE = "sensor_msgs/msg/CameraInfo"


class BagScenes:
    """The pairs of a bag whose left stamp a message of ``/truth/disparity`` has.

    Where the rectified left image has no source in the raw one, the truth counts as unknown: no method sees anything.

    Args:
        path: the bag.

    Attributes:
        names: every name that one of the scenes may have.
        files: all that is read.

    Raises:
        BagError: no bag.
        TopicError: no truth in it, or no stereo pair.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._types = RosbagsTypes()
        with BagReader(path) as reader:
            if TRUTH_TOPIC not in reader.topics:
                raise TopicError(
                    f"{path} has no {TRUTH_TOPIC}, it has {', '.join(reader.topics)}: make a bag with truth, with "
                    "`stereo-depth convert` or `stereo-depth synthesize`"
                )
            self._truth_type, self._count = reader.topics[TRUTH_TOPIC].msgtype, reader.topics[TRUTH_TOPIC].count
        with BagPairs(BagSelection(path), PairingConfig()) as pairs:  # a bag without is refused before anything runs
            self.names = [self._name(number) for number in range(pairs.count)]
        self.files = bag_files(path)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[SceneSource]:
        with BagReader(self._path) as reader, BagPairs(BagSelection(self._path), PairingConfig()) as pairs:
            image_type = f"sensor_msgs/msg/{'CompressedImage' if pairs.topics.compressed else 'Image'}"
            truths = ((cdr_stamp_ns(message.data), message.data) for message in reader.messages([TRUTH_TOPIC]))
            known = next(truths, None)
            for number, pair in enumerate(pairs.pairs()):
                while known is not None and known[0] < pair.stamp_ns:
                    known = next(truths, None)
                if known is not None and known[0] == pair.stamp_ns:
                    yield SceneSource(self._name(number), partial(self._load, pair, known[1], image_type))

    def _name(self, number: int) -> str:
        return f"{self._path.resolve().stem}/{number:04d}"

    def _load(self, pair: SerializedPair, truth: bytes, image_type: str) -> Scene:
        types = self._types
        rig = StereoRig.from_infos(*(types.deserialize(info, _INFO_TYPE) for info in (pair.left_info, pair.right_info)))
        left, right = (decode(types.deserialize(image, image_type)) for image in (pair.left, pair.right))
        rectifier = Rectifier(rig)
        rectified = rectifier.rectify(StereoPair(left, right))
        truth_px = matched_disparity(types.deserialize(truth, self._truth_type), rig, TRUTH_TOPIC)
        if truth_px.shape == rectified.left.shape:  # other sizes are refused below
            truth_px[~rectifier.left_source] = np.nan
        return make_scene(rectified.left, rectified.right, truth_px, doffs_px=rig.doffs_px)
