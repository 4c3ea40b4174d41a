# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes the messages of results into a bag, and measures what is written."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import SerializedPair
from stereo_depth_ros.bags.topics import INFO_TYPE
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config import ViewConfig
from stereo_depth_ros.evaluation.bag_score import BagScore, untrue_score
from stereo_depth_ros.messages.disparity import published_disparity
from stereo_depth_ros.outputs import Output, ResultMessages
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.views.result_frames import ResultFrames
from stereo_depth_ros.views.topics import ViewMessages

__all__ = ["DISPARITY", "ResultWriter"]

DISPARITY = "disparity"


class ResultWriter:
    """Writes the camera infos, outputs and views of results in their order.

    Args:
        writer: of the bag.
        rows: the outputs that are written.
        views: parameters of the views that are written, by topic.
        each: called with every result, after its outputs are written.

    Attributes:
        stages_ms: milliseconds of each result by name of the stage, those of the pipeline among them.
    """

    def __init__(
        self,
        writer: BagWriter,
        rows: Sequence[Output],
        views: Mapping[str, ViewConfig],
        each: Callable[[StereoResult], None],
    ) -> None:
        types = RosbagsTypes()
        self._writer, self._rows, self._views, self._each = writer, rows, views, each
        self._frames, self._view_messages = ResultFrames(), ViewMessages(types)
        self._messages = ResultMessages(types)
        self._valid: list[float] = []
        self.stages_ms: dict[str, list[float]] = defaultdict(list)

    @property
    def score(self) -> BagScore | None:
        """The valid fraction of the disparities written so far; None where none are."""
        return untrue_score(self._valid) if self._valid else None

    def write(self, pair: SerializedPair, result: StereoResult) -> None:
        """Write the messages of a pair.

        Raises:
            OutputError: they cannot be written.
            StereoDepthError: they cannot be made.
        """
        self._writer.write_raw("/left/camera_info", INFO_TYPE, pair.left_info, pair.stamp_ns)
        self._writer.write_raw("/right/camera_info", INFO_TYPE, pair.right_info, pair.right_stamp_ns)
        for topic, message in self._outputs(result):
            start = time.perf_counter()
            self._writer.write(f"/{topic}", message, result.stamp_ns)
            result.timings_ms["write"] = result.timings_ms.get("write", 0.0) + _ms_since(start)
            if topic == DISPARITY:
                disparity_px = published_disparity(message, topic)
                self._valid.append(np.count_nonzero(np.isfinite(disparity_px)) / disparity_px.size)
        self._each(result)
        for stage, ms in result.timings_ms.items():
            self.stages_ms[stage].append(ms)

    def _outputs(self, result: StereoResult) -> Iterator[tuple[str, Any]]:
        for topic, _, build in self._rows:
            start = time.perf_counter()
            message = build(self._messages, result)
            result.timings_ms[f"make {topic}"] = _ms_since(start)
            yield topic, message
        frame = self._frames.of(result) if self._views else None
        for topic, config in self._views.items():
            assert frame is not None  # there are views
            start = time.perf_counter()
            message = self._view_messages.build(topic, frame, config)
            result.timings_ms[f"make {topic}"] = _ms_since(start)
            yield topic, message


def _ms_since(start: float) -> float:
    return 1e3 * (time.perf_counter() - start)
