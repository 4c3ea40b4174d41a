# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses over time: interpolated between neighbors that are close enough, known nowhere else."""

from __future__ import annotations

import bisect

from stereo_depth_ros.core.pose import Pose

__all__ = ["PoseTrack"]

_ROUNDING_NS = 1_000_000  # stamps in text files may have three decimals


class PoseTrack:
    """Poses with stamps.

    Args:
        max_gap_ns: longest time between two poses between which others are interpolated.
    """

    def __init__(self, max_gap_ns: int) -> None:
        self._max_gap_ns = max_gap_ns
        self._stamps: list[int] = []
        self._poses: list[Pose] = []

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """The first and the last stamp; None where there is none."""
        return (self._stamps[0], self._stamps[-1]) if self._stamps else None

    def add(self, stamp_ns: int, pose: Pose) -> None:
        """Add a pose, in any order; one of the same stamp is replaced."""
        if not self._stamps or stamp_ns > self._stamps[-1]:
            self._stamps.append(stamp_ns)
            self._poses.append(pose)
            return
        at = bisect.bisect_left(self._stamps, stamp_ns)
        if self._stamps[at] == stamp_ns:
            self._poses[at] = pose
        else:
            self._stamps.insert(at, stamp_ns)
            self._poses.insert(at, pose)

    def at(self, stamp_ns: int) -> Pose | None:
        """The pose at a time; None in a gap, before the first and after the last one.

        Within a millisecond of a pose it is that pose, which may be the first or the last one.
        """
        after = bisect.bisect_left(self._stamps, stamp_ns)
        near = [i for i in (after, after - 1) if 0 <= i < len(self._stamps)]
        if not near:
            return None
        nearest = min(near, key=lambda i: abs(self._stamps[i] - stamp_ns))
        if self._stamps[nearest] == stamp_ns or len(near) == 1:
            close = abs(self._stamps[nearest] - stamp_ns) <= _ROUNDING_NS
            return self._poses[nearest] if close else None
        gap_ns = self._stamps[after] - self._stamps[after - 1]
        if gap_ns > self._max_gap_ns:
            close = abs(self._stamps[nearest] - stamp_ns) <= _ROUNDING_NS
            return self._poses[nearest] if close else None
        share = (stamp_ns - self._stamps[after - 1]) / gap_ns
        return self._poses[after - 1].interpolate(self._poses[after], share)
