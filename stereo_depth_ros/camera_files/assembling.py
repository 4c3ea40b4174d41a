# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rig of what one or two calibration files hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from stereo_depth_ros.camera_files.stored import Pose, Size, StoredCamera, StoredFile
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.distortion import known_distortion
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig

__all__ = ["no_size", "rig_of"]


def rig_of(files: Sequence[StoredFile], size: Size | None, sizes: tuple[Size, Size] | None = None) -> StereoRig:
    """The rig of the files, rectified by :meth:`StereoRig.from_calibration` where they hold no rectification.

    Args:
        files: in the order left, right.
        size: of the images where it is known: for files that do not state it, and for cameras that scale.
        sizes: of the left and of the right images where they differ. Both cameras become as wide and as high as the
            larger one, at the right and at the bottom.

    Raises:
        CalibrationError: a camera or its pose is missing, or they are not those of a stereo rig.
    """
    for file in files:
        if file.build is not None:
            return _labeled(file.build(size), (f"{file.source}: left", f"{file.source}: right"))
    found = [(file, camera) for file in files for camera in file.cameras]
    if len(found) != 2:
        raise _incomplete(files, len(found))
    pair = found[0], found[1]
    (left_file, left), (right_file, right) = pair
    poses = [file.pose for file in files if file.pose is not None]
    pose = poses[0] if poses else _pose_of_bodies(left, right)
    if pose is not None and left_file.numbered and pose[1][0] > 0:
        (left_file, left), (right_file, right), pose = pair[1], pair[0], (pose[0].T, -pose[0].T @ pose[1])
    elif given := next((file.rectification for file in files if file.rectification is not None), None):
        left, right = (replace(camera, R=R, P=P) for camera, (R, P) in zip((left, right), given, strict=True))
    labels = tuple(
        f"{file.source}: {camera.name}" if camera.name else file.source
        for file, camera in ((left_file, left), (right_file, right))
    )
    if pose is None and (left.P is None or right.P is None):
        raise CalibrationError(
            f"{left_file.format}, intrinsics only", subject=left_file.source, remedy="give the file of R and T too"
        )
    own = sizes or (size, size)
    cameras = _sized(left_file, left, own[0], labels[0]), _sized(right_file, right, own[1], labels[1])
    if sizes is not None:
        cameras = _extended(cameras, sizes, (labels[0], labels[1]))
    if all(camera.P is not None and camera.R is not None for camera in cameras):
        return StereoRig(_model(cameras[0]), _model(cameras[1]), (labels[0], labels[1]))
    assert pose is not None  # there is a pose where there is no rectification
    return _labeled(_rectified(cameras, pose, labels[0]), (labels[0], labels[1]))


def no_size(source: str) -> CalibrationError:
    """The error for a file that does not state the size of the images, where nothing else does."""
    return CalibrationError(
        "does not state the size of the images",
        subject=source,
        limit="width and height",
        remedy="write image_width and image_height into it, or convert it with its size",
        settings=("size",),
    )


def _labeled(rig: StereoRig, labels: tuple[str, str]) -> StereoRig:
    """The rig with its files as topics, and without frames: files have none."""
    return StereoRig(replace(rig.left, frame_id=""), replace(rig.right, frame_id=""), labels)


def _incomplete(files: Sequence[StoredFile], count: int) -> CalibrationError:
    formats = ", ".join(dict.fromkeys(file.format for file in files))
    problem, remedy = f"{formats}, one camera", "give the file of the other camera too"
    if count == 0:
        problem, remedy = f"{formats}, extrinsics only", "give the file of the intrinsics too"
    if count > 2:
        problem, remedy = f"{formats}, {count} cameras", "give the files of one stereo pair"
    return CalibrationError(
        problem, subject=", ".join(file.source for file in files), value=count, limit=2, remedy=remedy
    )


def _pose_of_bodies(left: StoredCamera, right: StoredCamera) -> Pose | None:
    if left.body is None or right.body is None:
        return None
    right_left = np.linalg.inv(right.body) @ left.body
    return right_left[:3, :3], right_left[:3, 3]


def _sized(file: StoredFile, camera: StoredCamera, size: Size | None, label: str) -> StoredCamera:
    """The camera with a size: that of the images where the file has none, or where the camera scales."""
    if camera.size is None and size is None:
        raise no_size(label)
    if camera.size is None:
        return replace(camera, size=size)
    return _scaled(camera, size) if file.scales and size is not None and size != camera.size else camera


def _extended(
    cameras: tuple[StoredCamera, StoredCamera], sizes: tuple[Size, Size], labels: tuple[str, str]
) -> tuple[StoredCamera, StoredCamera]:
    """Cameras of one size: that of the larger one; the pixels keep their coordinates."""
    for camera, size, label in zip(cameras, sizes, labels, strict=True):
        if camera.size != size and camera.size is not None:
            (width, height), own = size, camera.size
            raise CalibrationError(
                f"the image is {width}x{height}, its camera info is for {own[0]}x{own[1]}",
                subject=label,
                value=size,
                limit=own,
                remedy="use the calibration of these images",
            )
    common = (max(size[0] for size in sizes), max(size[1] for size in sizes))
    return replace(cameras[0], size=common), replace(cameras[1], size=common)


def _scaled(camera: StoredCamera, size: Size) -> StoredCamera:
    """The camera of smaller images: scaled to fill them, what sticks out is cropped on both sides."""
    assert camera.size is not None
    scale = max(size[0] / camera.size[0], size[1] / camera.size[1])
    K = np.diag([scale, scale, 1.0]) @ camera.K
    K[:2, 2] -= [(scale * camera.size[0] - size[0]) / 2, (scale * camera.size[1] - size[1]) / 2]
    return replace(camera, K=K, size=size)


def _model(camera: StoredCamera) -> CameraModel:
    assert camera.size is not None and camera.R is not None and camera.P is not None
    width, height = camera.size
    return CameraModel(width, height, camera.distortion_model, camera.K, camera.D, camera.R, camera.P).described()


def _rectified(cameras: tuple[StoredCamera, StoredCamera], pose: Pose, label: str) -> StereoRig:
    left, right = cameras
    if left.size != right.size or left.size is None:
        raise CalibrationError(
            f"the images of the cameras are {left.size} and {right.size} px",
            subject=label,
            value=right.size,
            limit=left.size,
            remedy="calibrate both cameras at one resolution",
        )
    model, D_left, D_right = _common_model(left, right, label)
    try:
        return StereoRig.from_calibration(left.K, D_left, right.K, D_right, *pose, left.size, model)
    except CalibrationError as error:
        raise error.about(label) from error
    except (cv2.error, np.linalg.LinAlgError) as error:
        raise CalibrationError(
            "cannot be rectified, K, D, R and T contradict each other", subject=label, remedy="calibrate again"
        ) from error


def _common_model(left: StoredCamera, right: StoredCamera, label: str) -> tuple[str, np.ndarray, np.ndarray]:
    """One distortion model and the coefficients of both cameras: plumb_bob is the beginning of rational_polynomial."""
    (model, D_left), (other, D_right) = (known_distortion(each.distortion_model, each.D) for each in (left, right))
    if model != other and {model, other} == {"plumb_bob", "rational_polynomial"}:
        count = max(D_left.size, D_right.size)
        padded = [np.pad(D, (0, count - D.size)) for D in (D_left, D_right)]
        return "rational_polynomial", padded[0], padded[1]
    if model != other:
        raise CalibrationError(
            f"the cameras have different distortion models, {model} and {other}",
            subject=label,
            value=other,
            limit=model,
            remedy="calibrate both cameras with one model",
        )
    return model, D_left, D_right
