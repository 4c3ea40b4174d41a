# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Light stripe scanner: from images of one or two cameras, and the motion at their time, to points in one frame."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.light_stripe.extraction import StripeExtractor
from stereo_depth_ros.active.light_stripe.light_plane import LightPlane, ProfilePoints, profile_points, search_range
from stereo_depth_ros.active.light_stripe.motion import StripeMotion
from stereo_depth_ros.active.light_stripe.profile import StripeReason
from stereo_depth_ros.active.light_stripe.two_cameras import stereo_points
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, F64, Frame, StereoPair
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["MergedCloud", "ScannedProfile", "StereoStripeScanner", "StripeScanner"]


@dataclass(frozen=True, eq=False)
class ScannedProfile:
    """One profile of a scan.

    Attributes:
        stamp_ns, frame_id: of its image.
        found: the points, in the optical frame of the image.
        merged_m: float64 (N, 3), the same points in the frame of the merged cloud, meters.
    """

    stamp_ns: int
    frame_id: str
    found: ProfilePoints
    merged_m: F64

    def reasons(self) -> dict[str, int]:
        """Lines with a point, as POINTS, and lines without by reason."""
        return {"POINTS": len(self.found.lines), **self.found.profile.reason_counts()}


class StripeScanner:
    """A camera and a laser whose light plane is known.

    Args:
        plane, camera: the light plane, and the camera in whose frame it is.
        config: how the stripe is found.
        motion: what moves between the images.
        ambient: image without the stripe.
    """

    def __init__(
        self,
        plane: LightPlane,
        camera: CameraModel,
        config: LightStripeConfig,
        motion: StripeMotion | None = None,
        ambient: Frame | None = None,
    ) -> None:
        self.motion = motion or StripeMotion()
        self._plane, self._camera, self._config = plane, camera, config
        self._extractor = StripeExtractor(config, ambient)
        self._search = None if self.motion.moving == "plane" else self._search_range(plane)

    def scan(self, frame: Frame, value: F64 | None = None) -> ScannedProfile:
        """The profile of an image.

        Args:
            frame: raw image of the camera.
            value: motion at its time, see :meth:`StripeMotion.matrix`; None for none.

        Raises:
            CalibrationError: the image has another size than the camera.
        """
        _check_size(frame, self._camera)
        motion = self.motion.matrix(np.zeros(0) if value is None else value)
        plane, search = self.motion.plane(self._plane, motion), self._search
        if self.motion.moving == "plane":
            search = self._search_range(plane)
        found = profile_points(self._extractor.extract(frame, search), self._camera, plane, self._config)
        found = _near_axis(found, self.motion, self._config.max_axis_distance)
        return ScannedProfile(frame.stamp_ns, frame.frame_id, found, self.motion.merged(found.points_m, motion))

    def _search_range(self, plane: LightPlane) -> npt.NDArray[np.int32] | None:
        limit_m = self._config.max_axis_distance
        near = None if self.motion.turntable is None or not limit_m else partial(_is_near, self.motion, limit_m)
        return search_range(self._camera, plane, self._config, near)


class StereoStripeScanner:
    """Two cameras that see one stripe, with or without a light plane in the frame of the raw left camera.

    Args:
        rig: the cameras.
        config: how the stripe is found.
        motion: what moves between the images, in the frame of the raw left camera.
        plane: the light plane in that frame; None uses the disparities alone.
    """

    def __init__(
        self,
        rig: StereoRig,
        config: LightStripeConfig,
        motion: StripeMotion | None = None,
        plane: LightPlane | None = None,
    ) -> None:
        self.motion = replace(motion or StripeMotion(), rotation=rig.left.R)
        self._config, self._plane = config, plane
        self._triangulation = Triangulation.from_rig(rig)
        self._rectifier = Rectifier(rig)
        self._left, self._right = StripeExtractor(config), StripeExtractor(config)

    def scan(self, pair: StereoPair, value: F64 | None = None) -> ScannedProfile:
        """The profile of a raw pair, in the left rectified frame.

        Args:
            pair: raw images.
            value: motion at its time; None for none.

        Raises:
            CalibrationError: an image has another size than the rig.
            ConfigError: the stripe is horizontal.
        """
        motion = self.motion.matrix(np.zeros(0) if value is None else value)
        plane = None if self._plane is None else self.motion.plane(self._plane, motion)
        left = self._left.extract(_rectified(pair.left, self._rectifier.rectify_left(pair.left.pixels)))
        right = self._right.extract(_rectified(pair.right, self._rectifier.rectify_right(pair.right.pixels)))
        found = stereo_points(left, right, self._triangulation, self._config, plane)
        found = _near_axis(found, self.motion, self._config.max_axis_distance)
        merged_m = self.motion.merged(found.points_m, motion)
        return ScannedProfile(pair.left.stamp_ns, pair.left.frame_id, found, merged_m)


def _rectified(frame: Frame, pixels: npt.NDArray[np.uint8]) -> Frame:
    return Frame(pixels, frame.stamp_ns, frame.frame_id, frame.encoding)


class MergedCloud:
    """The points of many profiles in one frame.

    Args:
        most: profiles kept; the oldest are dropped.

    Attributes:
        reasons: lines with a point, as POINTS, and without by reason, of all profiles.
    """

    def __init__(self, most: int) -> None:
        self.reasons: Counter[str] = Counter()
        self._profiles: deque[ScannedProfile] = deque(maxlen=most)

    def __len__(self) -> int:
        """Number of profiles."""
        return len(self._profiles)

    def add(self, profile: ScannedProfile) -> bool:
        """Add a profile; whether the oldest was dropped for it."""
        full = len(self._profiles) == self._profiles.maxlen
        self._profiles.append(profile)
        self.reasons.update(profile.reasons())
        return full

    def points(self) -> tuple[F64, F32, F32]:
        """Points (N, 3), float64, meters; their gray levels and standard deviations in meters, float32 (N,)."""
        if not self._profiles:
            return np.empty((0, 3)), np.empty(0, np.float32), np.empty(0, np.float32)
        return (
            np.concatenate([profile.merged_m for profile in self._profiles]),
            np.concatenate([profile.found.level for profile in self._profiles]).astype(np.float32),
            np.concatenate([profile.found.sigma_m for profile in self._profiles]).astype(np.float32),
        )


def _is_near(motion: StripeMotion, limit_m: float, points_m: F64) -> npt.NDArray[np.bool_]:
    """Which points are within a distance of the axis of the turntable."""
    assert motion.turntable is not None
    rotation = np.identity(3) if motion.rotation is None else motion.rotation
    offsets = points_m @ rotation - motion.turntable.point_m
    return np.asarray(np.linalg.norm(np.cross(offsets, motion.turntable.axis), axis=1) <= limit_m, bool)


def _near_axis(found: ProfilePoints, motion: StripeMotion, limit_m: float) -> ProfilePoints:
    """Without the points that are farther from the axis of a turntable."""
    if motion.turntable is None or not limit_m:
        return found
    near = _is_near(motion, limit_m, found.points_m)
    far = np.zeros(len(found.profile.reasons), bool)
    far[found.lines[~near]] = True
    return ProfilePoints(
        found.profile.rejected(far, StripeReason.RANGE),
        found.lines[near],
        found.points_m[near],
        found.sigma_m[near],
        found.level[near],
    )


def _check_size(frame: Frame, camera: CameraModel) -> None:
    height, width = frame.pixels.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise CalibrationError(
            f"the image is {width}x{height}, the light plane was calibrated with images of "
            f"{camera.width}x{camera.height}",
            value=(width, height),
            limit=(camera.width, camera.height),
            remedy="use images of the camera of the light plane at this size",
            settings=("laser", "laser_file"),
        )
