# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sample bag is of limited size, usable, and equal to the frames of the generator."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.messages.disparity import published_disparity
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

BAG = Path(__file__).resolve().parents[1] / "bags" / "synthetic_room.mcap"


def test_size_and_contents() -> None:
    assert BAG.stat().st_size <= 16 * 1024**2
    info = inspect_bag(BAG)
    assert info.usable, info.problems
    assert info.exact_pairs >= 20
    assert info.rig is not None
    assert abs(info.rig.doffs_px) > 1


def test_frames_are_those_of_the_generator() -> None:
    sequence = SyntheticSequence()
    with BagReader(BAG) as reader:
        topics = ["/left/image_raw", "/right/image_raw", "/truth/disparity"]
        messages = {topic: [reader.deserialize(m) for m in reader.messages([topic])] for topic in topics}
    for index in (0, 13):
        frame = sequence[index]
        for topic, side in (("/left/image_raw", frame.pair.left), ("/right/image_raw", frame.pair.right)):
            message = messages[topic][index]
            assert stamp_ns(message.header) == side.stamp_ns
            np.testing.assert_array_equal(message.data.reshape(480, 640), side.pixels)
        truth = published_disparity(messages["/truth/disparity"][index])
        expected = frame.truth_disparity_px - sequence.rig.doffs_px
        np.testing.assert_allclose(truth, expected, atol=1 / 512 + 1e-5)  # rounded to 1/256 px
