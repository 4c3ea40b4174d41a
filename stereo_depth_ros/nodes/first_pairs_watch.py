# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Examines the first pairs of a node; where they do not fit the rig, the log and /diagnostics say so once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from stereo_depth_ros.core.errors import CalibrationError, CameraOrderError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8, MatchResult, StereoPair
from stereo_depth_ros.diagnosis.first_pairs import FirstPairs
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.log import log_warning

__all__ = ["FIRST_PAIRS", "ORDER", "FirstPairsWatch"]

FIRST_PAIRS, ORDER = "first pairs", "order of the cameras"  # what is wrong, in the values of the diagnostics
_MONITORED = "health/row_error"  # published by a calibration monitor, which warns of row errors itself


class FirstPairsWatch:
    """Examines the first pairs of each rig of a node; ``node`` logs and has the diagnostics."""

    def __init__(self, node: StereoNode) -> None:
        self._node = node
        self._rig: StereoRig | None = None
        self._first: FirstPairs | None = None

    @contextmanager
    def refusing(self) -> Iterator[None]:
        """Notes in the diagnostics that the block refuses swapped cameras, until a pair passes."""
        try:
            yield
        except CameraOrderError as error:
            self._node.diagnostics.facts[ORDER] = str(error)
            raise
        self._node.diagnostics.facts.pop(ORDER, None)

    def look(self, rig: StereoRig, shown: float, pair: StereoPair, left: U8, right: U8, match: MatchResult) -> None:
        """Examine a pair if its turn has come, see :class:`FirstPairs`; call it before its outputs are published.

        Raises:
            CameraOrderError: the cameras are swapped, nothing is to be published.
        """
        if self._first is None or self._rig is not rig:
            self._rig, self._first = rig, FirstPairs(rig, shown)
            self._node.diagnostics.facts.pop(FIRST_PAIRS, None)
            self._node.diagnostics.warning = ""
        fault = self._first.look(pair, left, right, match)
        if fault is None:
            return
        self._node.diagnostics.facts[FIRST_PAIRS] = str(fault)
        if isinstance(fault, CalibrationError) and self._node.count_publishers(_MONITORED):
            return
        self._node.diagnostics.warning = str(fault)
        log_warning(self._node.get_logger(), str(fault))
