# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree of frames of /tf and /tf_static: poses between frames at a time, interpolated, and between two times."""

from __future__ import annotations

import bisect
import itertools
from dataclasses import dataclass, field

from stereo_depth_ros.core.errors import TransformError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.quoted import quoted

__all__ = ["StaticTransform", "Transforms"]

_SHOWN = 8  # names of frames in an error


@dataclass(frozen=True)
class StaticTransform:
    """A transform that never changes: ``parent_from_child`` takes points of the child to the parent."""

    parent: str
    child: str
    parent_from_child: Pose


@dataclass
class _Link:
    """Poses of a frame in its parent, in the order of their stamps; one without a stamp holds for ever."""

    parent: str
    fixed: Pose | None = None
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)


class _NoPoseError(TransformError):
    """The frames are connected, but no pose is known at this time."""


class Transforms:
    """Poses of frames in their parents, as tf2 buffers them.

    Between the stamps of two poses the pose is interpolated: the translation on a line, the rotation on the shortest
    arc. Before the first and after the last one there is none: nothing is extrapolated.

    Args:
        keep_ns: how long poses are kept, nanoseconds before the newest one of their frame; None keeps all.
        max_gap_ns: longest time between two poses between which others are interpolated; None is any.
        rounding_ns: where there is none at a time, the nearest one counts within this time, as stamps are rounded.
    """

    def __init__(self, keep_ns: int | None = None, *, max_gap_ns: int | None = None, rounding_ns: int = 0) -> None:
        self._keep_ns = keep_ns
        self._max_gap_ns = max_gap_ns
        self._rounding_ns = rounding_ns
        self._links: dict[str, _Link] = {}

    @property
    def frames(self) -> list[str]:
        """All frames, sorted."""
        return sorted(self._links.keys() | {link.parent for link in self._links.values()})

    def add(self, parent: str, child: str, parent_from_child: Pose, stamp_ns: int | None = None) -> None:
        """Add the pose of ``child`` in ``parent``.

        A new parent replaces the old one, a static pose all others: some drivers repeat fixed poses over time.

        Args:
            parent, child: names of the frames; the leading slash of ROS 1 does not count.
            parent_from_child: takes points of the child to the parent.
            stamp_ns: time of the pose, integer nanoseconds; None for one that never changes.

        Raises:
            TransformError: both frames are the same, or one has no name.
        """
        parent, child = _name(parent), _name(child)
        if parent == child or not parent or not child:
            raise TransformError(
                f"a transform from {quoted(child)} to {quoted(parent)} is not one between two frames",
                value=(parent, child),
                limit="two different names",
                remedy="correct its publisher",
            )
        link = self._links.get(child)
        if link is None or link.parent != parent:
            link = self._links[child] = _Link(parent)
        if stamp_ns is None:
            self._links[child] = _Link(parent, parent_from_child)
        elif link.fixed is None:
            self._insert(link, stamp_ns, parent_from_child)

    def add_missing(self, other: Transforms) -> None:
        """Add the frames of another tree that have no parent in this one."""
        for child, link in other._links.items():
            self._links.setdefault(child, link)

    def pose(self, target: str, source: str, stamp_ns: int) -> Pose:
        """The pose ``target_from_source`` at a time, integer nanoseconds.

        Raises:
            TransformError: the frames are not connected, or not at this time.
        """
        return self.pose_between(target, stamp_ns, source, stamp_ns)

    def find(self, target: str, source: str, stamp_ns: int) -> Pose | None:
        """As :meth:`pose`, but None where the frames are connected and no pose is known at this time.

        Raises:
            TransformError: the frames are not connected.
        """
        self.motion_known(target, source)
        try:
            return self.pose(target, source, stamp_ns)
        except _NoPoseError:
            return None

    def ancestors(self, frame: str) -> list[str]:
        """The frame, its parent and so on up to the root.

        Raises:
            TransformError: they are a loop.
        """
        return self._ancestors(frame)

    def moves(self, above: str, frame: str) -> bool:
        """Whether a pose between a frame and one of its ancestors has a stamp."""
        return any(
            self._links[name].fixed is None for name in itertools.takewhile(_name(above).__ne__, self._ancestors(frame))
        )

    def pose_between(self, target: str, target_ns: int, source: str, source_ns: int) -> Pose:
        """The pose from ``source`` at one time to ``target`` at another one.

        Where the two times differ, the frame in which nothing moves meanwhile is the root of the tree, such as ``odom``
        or ``map``; see :meth:`motion_known`.

        Raises:
            TransformError: the frames are not connected, or not at these times.
        """
        up, down = self._ancestors(source), self._ancestors(target)
        common = next((name for name in up if name in down), None)
        if common is None:
            raise self._unconnected(target, source)
        top = common if target_ns == source_ns or not self._moves(down, common) else down[-1]
        return self._to(top, down, target_ns).inverse() @ self._to(top, up, source_ns)

    def motion_known(self, target: str, source: str) -> bool:
        """Whether the tree tells how both frames together move: a frame above both has poses with stamps.

        Raises:
            TransformError: the frames are not connected.
        """
        up, down = self._ancestors(source), self._ancestors(target)
        common = next((name for name in up if name in down), None)
        if common is None:
            raise self._unconnected(target, source)
        return self._moves(down, common)

    def _moves(self, names: list[str], common: str) -> bool:
        return any(self._links[name].fixed is None for name in names[names.index(common) : -1])

    def _ancestors(self, name: str) -> list[str]:
        """The frame, its parent and so on up to the root."""
        names = [_name(name)]
        while (link := self._links.get(names[-1])) is not None:
            if link.parent in names:
                raise TransformError(
                    f"the frames {', '.join(map(quoted, [*names, link.parent][:_SHOWN]))} are a loop",
                    value=names,
                    limit="a tree",
                    remedy="correct the publishers of /tf: a frame has one parent",
                )
            names.append(link.parent)
        return names

    def _to(self, top: str, names: list[str], stamp_ns: int) -> Pose:
        """The pose from the first one of ``names`` to ``top``, which is one of them."""
        pose = Pose.identity()
        for name in names[: names.index(top)]:
            pose = self._at(name, stamp_ns) @ pose
        return pose

    def _at(self, name: str, stamp_ns: int) -> Pose:
        link = self._links[name]
        if link.fixed is not None:
            return link.fixed
        after = bisect.bisect_left(link.stamps_ns, stamp_ns)
        nearest = min(
            (n for n in (after, after - 1) if 0 <= n < len(link.stamps_ns)),
            key=lambda n: abs(link.stamps_ns[n] - stamp_ns),
        )
        off_ns, outside = abs(link.stamps_ns[nearest] - stamp_ns), after in (0, len(link.stamps_ns))
        gap_ns = 0 if outside else link.stamps_ns[after] - link.stamps_ns[after - 1]
        in_gap = self._max_gap_ns is not None and gap_ns > self._max_gap_ns
        if off_ns == 0 or ((outside or in_gap) and off_ns <= self._rounding_ns):
            return link.poses[nearest]
        if in_gap:
            raise _NoPoseError(
                f"the transform from {quoted(name)} to {quoted(link.parent)} is asked for in a gap of "
                f"{gap_ns / 1e9:.3f} s",
                value=gap_ns,
                limit=self._max_gap_ns,
                remedy="allow longer gaps, or record it more often",
                settings=("max_gap",),
            )
        if outside:
            nearest_ns = link.stamps_ns[nearest]
            when = "before its first" if after == 0 else "after its last"
            raise _NoPoseError(
                f"the transform from {quoted(name)} to {quoted(link.parent)} is asked for "
                f"{abs(stamp_ns - nearest_ns) / 1e9:.3f} s {when} stamp",
                value=stamp_ns,
                limit=(link.stamps_ns[0], link.stamps_ns[-1]),
                remedy="publish or record /tf for the whole time of the images, with the same clock",
            )
        return link.poses[after - 1].interpolate(link.poses[after], (stamp_ns - link.stamps_ns[after - 1]) / gap_ns)

    def _insert(self, link: _Link, stamp_ns: int, pose: Pose) -> None:
        at = bisect.bisect_left(link.stamps_ns, stamp_ns)
        if at < len(link.stamps_ns) and link.stamps_ns[at] == stamp_ns:
            link.poses[at] = pose
            return
        link.stamps_ns.insert(at, stamp_ns)
        link.poses.insert(at, pose)
        if self._keep_ns is not None:
            old = bisect.bisect_left(link.stamps_ns, link.stamps_ns[-1] - self._keep_ns)
            del link.stamps_ns[:old], link.poses[:old]

    def _unconnected(self, target: str, source: str) -> TransformError:
        frames = self.frames
        known = ", ".join(map(quoted, frames[:_SHOWN])) + (", ..." if len(frames) > _SHOWN else "")
        return TransformError(
            f"no transform from {quoted(source)} to {quoted(target)}, "
            + (f"the frames known are {known}" if frames else "no transforms are known"),
            value=(source, target),
            limit=frames,
            remedy="publish or record it on /tf_static, or give a file with it",
        )


def _name(frame: str) -> str:
    return frame.removeprefix("/")
