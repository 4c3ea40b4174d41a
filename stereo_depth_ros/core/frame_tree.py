# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tree of frames, as of tf2: the pose of any frame in any other one, fixed or over time."""

from __future__ import annotations

from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.pose_track import PoseTrack

__all__ = ["FrameTree", "frame_name"]


class FrameTree:
    """Frames, each with its pose in its parent.

    Args:
        max_gap_ns: longest time between two poses between which others are interpolated.
    """

    def __init__(self, max_gap_ns: int) -> None:
        self._max_gap_ns = max_gap_ns
        self._parents: dict[str, str] = {}
        self._fixed: dict[str, Pose] = {}
        self._moving: dict[str, PoseTrack] = {}

    @property
    def frames(self) -> list[str]:
        """All names, sorted."""
        return sorted({*self._parents, *self._parents.values()})

    def add(self, parent: str, child: str, pose: Pose, stamp_ns: int | None = None) -> None:
        """Add the pose of ``child`` in ``parent``, fixed without a stamp; a new parent replaces the old one."""
        parent, child = frame_name(parent), frame_name(child)
        if self._parents.get(child) != parent:
            self._fixed.pop(child, None)
            self._moving.pop(child, None)
        self._parents[child] = parent
        if stamp_ns is None:
            self._fixed[child] = pose
        else:
            self._moving.setdefault(child, PoseTrack(self._max_gap_ns)).add(stamp_ns, pose)

    def path(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the root; a loop is cut where it begins again."""
        path = [frame_name(frame)]
        while (parent := self._parents.get(path[-1])) is not None and parent not in path:
            path.append(parent)
        return path

    def moves(self, frame: str, above: str) -> bool:
        """Whether a pose between a frame and one above it is known over time."""
        path = self.path(frame)
        return any(name in self._moving for name in path[: path.index(frame_name(above))])

    def pose(self, above: str, frame: str, stamp_ns: int) -> Pose | None:
        """The pose of a frame in another one at a time; None where they are not connected, or not at that time."""
        ours, theirs = self.path(frame), self.path(above)
        common = next((name for name in ours if name in theirs), None)
        if common is None:
            return None
        up = self._in_ancestor(ours[: ours.index(common)], stamp_ns)
        down = self._in_ancestor(theirs[: theirs.index(common)], stamp_ns)
        return None if up is None or down is None else down.inverse() @ up

    def _in_ancestor(self, path: list[str], stamp_ns: int) -> Pose | None:
        """The pose of the first frame in the parent of the last one."""
        total = Pose.identity()
        for name in path:
            # a link that is published as both is fixed: some drivers repeat fixed poses over time
            pose = self._fixed.get(name) or self._moving[name].at(stamp_ns)
            if pose is None:
                return None
            total = pose @ total
        return total


def frame_name(name: str) -> str:
    """The name without the leading slash of ROS 1."""
    return name.lstrip("/")
