# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses of the left rectified camera for each pair: of a file or a topic, of the camera or of what carries it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeAlias

import numpy as np

from stereo_depth_ros.bags.poses import BagPoses
from stereo_depth_ros.core.errors import BagError, ConfigError, TopicError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import Rig
from stereo_depth_ros.core.transforms import Transforms
from stereo_depth_ros.datasets.pose_files import EUROC, KITTI, PoseFile, read_poses
from stereo_depth_ros.datasets.posed import PosedDataset, sensor_in_body

__all__ = ["BODY", "CAMERA", "RECTIFIED", "CameraPoses", "poses_of_file", "poses_of_topic"]

CAMERA, RECTIFIED, BODY = "camera", "rectified", "body"
_WORLD, _POSED = "world", "posed"  # frames of poses over time
_ROUNDING_NS = 1_000_000  # stamps in text files may have three decimals
_NAMES = f"{CAMERA} (the left camera), {RECTIFIED} (the left camera after rectification) or {BODY}"

# Pose of the left camera by frame number, which is found only where it is needed, stamp and frame of the image
_Number: TypeAlias = Callable[[], int]
_Lookup: TypeAlias = Callable[[_Number, int, str], Pose | None]


class CameraPoses:
    """The pose of the left rectified camera in the world, for each pair.

    Args:
        lookup: pose of the left camera by what finds the number of the pair, stamp in nanoseconds, and frame of the
            image; None where it is not known.
        rectified: that camera is the rectified one.
        text: what the poses are of, in words.
        files: what is read.
        warnings: what is left out, a sentence each.
    """

    def __init__(
        self,
        lookup: _Lookup,
        *,
        rectified: bool,
        text: str,
        files: tuple[Path, ...] = (),
        warnings: tuple[str, ...] = (),
    ) -> None:
        self._lookup = lookup
        self._rectified = rectified
        self.text = text
        self.files = files
        self.warnings = warnings

    def at(self, number: _Number, stamp_ns: int, frame_id: str, rig: Rig | None) -> Pose | None:
        """The pose for a pair, or without a rig for a camera without lens distortion; None where it is not known.

        Raises:
            TopicError: the frame of the image is not connected with that of the poses.
        """
        pose = self._lookup(number, stamp_ns, frame_id)
        if pose is None or self._rectified or rig is None:
            return pose
        return pose @ Pose(np.ascontiguousarray(rig.left.R.T), np.zeros(3))  # X_rectified = R X_raw


def poses_of_file(path: Path, max_gap_ns: int, frame: str | None = None, of: PosedDataset | None = None) -> CameraPoses:
    """Poses of a file.

    Without ``frame``, poses of KITTI are those of camera 0 after rectification, of EuRoC those of the sensor whose
    sensor.yaml lies beside the file, in the body, and of TUM those of the left camera.

    Args:
        path: the file.
        max_gap_ns: longest time between two poses between which others are interpolated.
        frame: what the poses are of: CAMERA, RECTIFIED or BODY.
        of: the dataset of the pairs; None where they are those of a bag.

    Raises:
        BagError: not a file of poses, or one that does not fit the dataset.
        ConfigError: another frame, or BODY where the pose of the camera in the body is not known.
    """
    file = read_poses(path)
    files = (path,)
    if frame is not None and frame not in (CAMERA, RECTIFIED, BODY):
        raise ConfigError(
            f"pose_frame = {frame} is not {_NAMES}",
            value=frame,
            limit=(CAMERA, RECTIFIED, BODY),
            remedy="name one of them",
            settings=("pose_frame",),
        )
    chosen = frame or {KITTI: RECTIFIED, EUROC: BODY}.get(file.kind, CAMERA)
    find = _finder(path, file, max_gap_ns, of)
    if chosen == BODY:
        body_from_left = None if of is None else of.body_from_left
        if body_from_left is None:
            raise ConfigError(
                "the poses are those of a body, and the pose of the camera in it is not known",
                subject=str(path),
                value=BODY,
                limit=(CAMERA, RECTIFIED),
                remedy=f"read the sequence of EuRoC itself, or say that the poses are those of the {CAMERA}",
                settings=("pose_frame",),
            )
        sensor = sensor_in_body(path) if file.kind == EUROC and frame is None else Pose.identity()
        return CameraPoses(
            _moved(find, sensor.inverse() @ body_from_left),
            rectified=False,
            text=f"{path}, {file.kind}, of the body",
            files=files,
        )
    if chosen == RECTIFIED and file.kind == KITTI and of is not None and of.reference_from_left is not None:
        moved = _moved(find, of.reference_from_left)
        return CameraPoses(moved, rectified=True, text=f"{path}, KITTI, of camera 0", files=files)
    text = f"{path}, {file.kind}, of the left {'rectified ' * (chosen == RECTIFIED)}camera"
    return CameraPoses(find, rectified=chosen == RECTIFIED, text=text, files=files)


def _moved(find: _Lookup, posed_from_left: Pose) -> _Lookup:
    def lookup(number: _Number, stamp_ns: int, frame_id: str) -> Pose | None:
        pose = find(number, stamp_ns, frame_id)
        return None if pose is None else pose @ posed_from_left

    return lookup


def _finder(path: Path, file: PoseFile, max_gap_ns: int, of: PosedDataset | None) -> _Lookup:
    """The poses of a file by time, by number of the frame, or in the order of the frames."""
    if file.stamps_ns:
        if of is not None and not of.dataset.has_stamps:
            raise BagError(
                "has poses over time, and the images have no times",
                subject=str(path),
                remedy="give a file with a row for each pair, or a bag",
                settings=("poses",),
            )
        return _over_time(zip(file.stamps_ns, file.poses, strict=True), max_gap_ns)
    if file.numbers:
        by_number = dict(zip(file.numbers, file.poses, strict=True))
        return lambda number, stamp_ns, frame_id: by_number.get(number())
    poses, shift = file.poses, {}
    if of is not None and max(of.numbers, default=0) >= len(poses):
        if len(poses) != len(of.image_numbers):
            raise BagError(
                f"has {len(poses)} poses for {len(of.image_numbers)} images, the last one is frame {max(of.numbers)}",
                subject=str(path),
                value=len(poses),
                limit=len(of.image_numbers),
                remedy="give the poses of this sequence",
                settings=("poses",),
            )
        shift = {
            number: row for row, number in enumerate(of.image_numbers)
        }  # an excerpt: the rows are those of its images

    def lookup(number: _Number, stamp_ns: int, frame_id: str) -> Pose | None:
        frame = number()
        return _row(poses, shift.get(frame, frame))

    return lookup


def _over_time(poses: Iterable[tuple[int, Pose]], max_gap_ns: int) -> _Lookup:
    """Poses by time, interpolated."""
    track = Transforms(max_gap_ns=max_gap_ns, rounding_ns=_ROUNDING_NS)
    for stamp_ns, pose in poses:
        track.add(_WORLD, _POSED, pose, stamp_ns)
    return lambda number, stamp_ns, frame_id: track.find(_WORLD, _POSED, stamp_ns)


def _row(poses: list[Pose], row: int) -> Pose | None:
    return poses[row] if row < len(poses) else None


def poses_of_topic(
    topic: str, poses: BagPoses, max_gap_ns: int, frame: str | None = None, world: str | None = None
) -> CameraPoses:
    """Poses of a topic of the bag.

    Args:
        topic: its name.
        poses: of it.
        max_gap_ns: longest time between two poses between which others are interpolated.
        frame: what the poses are of: CAMERA, RECTIFIED, or a frame of the tree; None takes what the messages tell,
            and CAMERA where they tell nothing.
        world: frame of the result, of a topic of transforms; None takes the root of the tree.

    Raises:
        ConfigError: an option that has no effect on this type.
    """
    given = {"pose_frame": frame} if poses.is_tree else {"world_frame": world}
    for name, value in given.items():
        if value is not None:
            kind = "transforms, which name the frames" if poses.is_tree else "poses of one frame"
            raise ConfigError(
                f"{name} has no effect: {topic} holds {kind}", value=value, remedy="leave it out", settings=(name,)
            )
    warnings = (poses.warning,) if poses.warning else ()
    if poses.is_tree:
        text = f"{topic}, transforms, to {world or 'their root'}"
        return CameraPoses(_of_tree(topic, poses.tree, world), rectified=False, text=text, warnings=warnings)
    chosen = frame or poses.child or CAMERA
    over_time = _over_time(poses.poses, max_gap_ns)
    if chosen in (CAMERA, RECTIFIED):
        text = f"{topic}, of the left {'rectified ' * (chosen == RECTIFIED)}camera"
        return CameraPoses(over_time, rectified=chosen == RECTIFIED, text=text)
    carried = _of_carrier(topic, over_time, poses.tree, chosen.removeprefix("/"))
    return CameraPoses(carried, rectified=False, text=f"{topic}, of {chosen}", warnings=warnings)


def _of_tree(topic: str, tree: Transforms, world: str | None) -> _Lookup:
    def lookup(number: _Number, stamp_ns: int, frame_id: str) -> Pose | None:
        path = tree.ancestors(frame_id)
        above = world.removeprefix("/") if world is not None else path[-1]
        if above not in path or not tree.moves(above, frame_id):
            above_it = ", ".join(path[1:]) or "none"
            what = f"does not move in {above}" if above in path else f"is not below {above}"
            raise TopicError(
                f"the frame of the left images, {frame_id or '(empty)'}, {what}: above it are {above_it}",
                subject=topic,
                value=frame_id,
                limit=tree.frames,
                remedy="record the transforms of the robot, /tf and /tf_static, or name another world frame or topic",
                settings=("world_frame", "poses"),
            )
        return tree.find(above, frame_id, stamp_ns)

    return lookup


def _of_carrier(topic: str, over_time: _Lookup, tree: Transforms, carrier: str) -> _Lookup:
    def lookup(number: _Number, stamp_ns: int, frame_id: str) -> Pose | None:
        pose = over_time(number, stamp_ns, frame_id)
        if pose is None or frame_id.removeprefix("/") == carrier:
            return pose
        if not {*tree.ancestors(frame_id)} & {*tree.ancestors(carrier)}:
            known = ", ".join(tree.frames) or "none"
            raise TopicError(
                f"the poses are those of {carrier}, and /tf_static does not connect it with {frame_id or '(empty)'}, "
                f"the frame of the left images; its frames are {known}",
                subject=topic,
                value=carrier,
                limit=tree.frames,
                remedy=f"record /tf_static, or set {CAMERA} where the poses are those of the left camera",
                settings=("pose_frame",),
            )
        left = tree.find(carrier, frame_id, stamp_ns)
        return None if left is None else pose @ left

    return lookup
