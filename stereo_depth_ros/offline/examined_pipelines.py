# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pipeline of the rig of each pair, whose first pairs are examined."""

from __future__ import annotations

from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.diagnosis.first_pairs import FirstPairs
from stereo_depth_ros.pipeline import StereoPipeline, StereoResult

__all__ = ["ExaminedPipelines"]


class ExaminedPipelines:
    """Computes pairs; the pipeline is made anew where the rig is another one, and the first pairs of it examined.

    Args:
        config: parameters of all stages.

    Attributes:
        fault: the first one that the first pairs of a rig show; None where they show none.
    """

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self._depth = BitDepth()
        self._pipeline: StereoPipeline | None = None
        self._first: FirstPairs | None = None
        self.fault: StereoDepthError | None = None

    def compute(self, pair: StereoPair, rig: StereoRig, prior: DisparityPrior | None = None) -> StereoResult:
        """The result of a pair.

        Raises:
            CameraOrderError: the cameras are swapped.
        """
        if self._pipeline is None or self._first is None or self._pipeline.rig is not rig:
            self.finish()
            self._pipeline = StereoPipeline(self._config, rig, self._depth)
            self._first = FirstPairs(rig, self._pipeline.shown)
        result = self._pipeline.process(pair, prior)
        found = self._first.look(result.pair, result.rectified.left, result.rectified.right, result.disparity)
        self.fault = self.fault or found
        return result

    def finish(self) -> None:
        """No more pair of the current rig comes."""
        if self._first is not None:
            self.fault = self.fault or self._first.finish()
