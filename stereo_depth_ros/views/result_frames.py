# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The frames of views of results of the pipeline, by way of the messages, as a node has them."""

from __future__ import annotations

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.messages.image import decode_pair
from stereo_depth_ros.outputs import ResultMessages
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.views.frame import RECTIFIED, ViewFrame

__all__ = ["ResultFrames"]


class ResultFrames:
    """Frames of a stream of results of the pipeline: the same as a node has them from the messages."""

    def __init__(self) -> None:
        self._messages = ResultMessages(RosbagsTypes())
        self._depth = BitDepth()

    def of(self, result: StereoResult) -> ViewFrame:
        """The frame of a result; it is valid until the next one.

        Raises:
            CalibrationError: the rig is not calibrated.
        """
        left, right = self._messages.left_rectified_color(result), self._messages.right_rectified_color(result)
        pair = decode_pair(left, right, RECTIFIED, self._depth)
        return ViewFrame.of_message(self._messages.disparity(result), result.calibrated_rig, pair, "disparity")
