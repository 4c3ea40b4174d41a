# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the right camera has moved since it was calibrated, from row errors, and the rig that accounts for it.

A right camera whose rays have turned by a small rotation vector w, and whose focal length has grown by the share s,
sees a point of rectified coordinates (x, y, 1) lower than the left camera does, by (-(1 + y^2) w_x + x y w_y + x w_z +
y s) f (Longuet-Higgins and Prazdny 1980, the rotational part). Rows cannot tell w_x from a vertical shift f w_x of the
principal point, nor whether a keystone x y w_y comes of a camera that has turned, which shifts all disparities, or of a
calibration whose principal point is f w_y off, which does not. So yaw says something only beside what the rig has shown
when it was healthy.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.calibration.row_error import RowMatches
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

__all__ = ["CorrectionLimits", "Misalignment", "MisalignmentEstimator", "corrected_rig"]

WINDOW = 20  # frames that count, the newest
MIN_FRAMES, MIN_MATCHES = 3, 100
SIGNIFICANT_SIGMAS = 5.0
SIGNIFICANT_PX = 0.5  # of row error, where in the image it is largest
ROUNDS = 3  # of linearization; the second one changes the first by less than a hundredth
REWEIGHTINGS = 10
SCALE_DEVIATIONS = 2.0  # of the weights: matches further off than that count little


@dataclass(frozen=True, eq=False)
class Misalignment:
    """What the row errors of some frames say about the right camera.

    Attributes:
        rotation_deg: float64 (3,), rotation vector by which the rays of the right camera have turned, about x (right),
            y (down) and z (forward) of the rectified camera: pitch, yaw and roll.
        scale: growth of the focal length of the right camera, as a share.
        rotation_sigma_deg, scale_sigma: their standard deviations.
        shift_px: how much lower the right image is in its middle; another word for the pitch.
        row_median_px, row_rms_px: median of the absolute row errors, and their root mean square, of all frames.
        residual_px: standard deviation of what the rotation and the scale do not explain.
        matches, frames: how many.
        significant: of pitch, yaw, roll and scale those that are beyond doubt and large enough to matter.
    """

    rotation_deg: F64
    rotation_sigma_deg: F64
    scale: float
    scale_sigma: float
    shift_px: float
    row_median_px: float
    row_rms_px: float
    residual_px: float
    matches: int
    frames: int
    significant: tuple[str, ...]

    @property
    def detected(self) -> bool:
        """The right camera is not where the calibration has it."""
        return bool(self.significant)


@dataclass(frozen=True)
class CorrectionLimits:
    """What may be corrected; more than that takes a new calibration.

    Attributes:
        rotation_deg: about each axis.
        scale: of the focal length, as a share.
    """

    rotation_deg: float = 1.0
    scale: float = 0.01


class MisalignmentEstimator:
    """Gathers the newest frames, and gives what they together say.

    Args:
        rig: that the images were rectified with.
        reference_yaw_deg: yaw that the healthy rig has shown; None where nobody knows: then yaw is told and never
            significant.
    """

    def __init__(self, rig: StereoRig, reference_yaw_deg: float | None = None) -> None:
        self._rig, self._reference_yaw_deg = rig, reference_yaw_deg
        self._frames: deque[RowMatches] = deque(maxlen=WINDOW)

    def restart(self, rig: StereoRig) -> None:
        """Forgets all frames: the next ones are rectified with this rig."""
        self._rig = rig
        self._frames.clear()

    def add(self, matches: RowMatches) -> Misalignment | None:
        """What this frame and those before it say; None as long as they are too few, or have too few matches."""
        self._frames.append(matches)
        if len(self._frames) < MIN_FRAMES or sum(map(len, self._frames)) < MIN_MATCHES:
            return None
        return _estimate(list(self._frames), self._rig, self._reference_yaw_deg)


def corrected_rig(
    rig: StereoRig,
    misalignment: Misalignment,
    limits: CorrectionLimits | None = None,
    reference_yaw_deg: float | None = None,
) -> StereoRig:
    """The rig whose right camera rectifies to the rows of the left one again: R and K of the right camera change.

    P stays as it is, so that nothing changes for who uses the rectified images. Yaw is taken back as far as it goes
    beyond ``reference_yaw_deg``, what the healthy rig has shown; not at all where that is None.

    Raises:
        CalibrationError: a correction beyond the limits.
    """
    pitch_deg, yaw_deg, roll_deg = misalignment.rotation_deg
    changed_deg = np.array([pitch_deg, 0.0 if reference_yaw_deg is None else yaw_deg - reference_yaw_deg, roll_deg])
    _check_limits(changed_deg, misalignment.scale, limits or CorrectionLimits())
    right, turn = rig.right, cv2.Rodrigues(np.radians(changed_deg))[0]
    K = right.K.copy()
    K[:2, :2] *= 1 + misalignment.scale
    return replace(rig, right=replace(right, R=turn.T @ right.R, K=K))


def _check_limits(rotation_deg: F64, scale: float, limits: CorrectionLimits) -> None:
    largest_deg = float(np.abs(rotation_deg).max())
    if largest_deg > limits.rotation_deg:
        raise CalibrationError(
            f"the right camera has turned by {largest_deg:.3f} degrees, corrected are up to {limits.rotation_deg:g}: "
            "fasten the cameras and calibrate again"
        )
    if abs(scale) > limits.scale:
        raise CalibrationError(
            f"the focal length of the right camera has changed by {100 * scale:+.2f} %, corrected are up "
            f"to {100 * limits.scale:g} %: check the focus and calibrate again"
        )


def _estimate(frames: list[RowMatches], rig: StereoRig, reference_yaw_deg: float | None) -> Misalignment:
    left, right = (np.concatenate([getattr(frame, side) for frame in frames]) for side in ("left_px", "right_px"))
    owner = np.repeat(np.arange(len(frames)), [len(frame) for frame in frames])
    parts = np.zeros(4)
    for _ in range(ROUNDS):
        errors, slopes = _row_errors(left, right, rig, parts)
        step, weights = _robust_step(errors, slopes)
        parts = parts + step
    errors, slopes = _row_errors(left, right, rig, parts)
    sigma = _standard_deviations(errors, slopes, weights, owner)
    raw = left[:, 1] - right[:, 1]
    return Misalignment(
        rotation_deg=np.degrees(parts[:3]),
        rotation_sigma_deg=np.degrees(sigma[:3]),
        scale=float(parts[3]),
        scale_sigma=float(sigma[3]),
        shift_px=-rig.fy_px * math.tan(parts[0]),
        row_median_px=float(np.median(np.abs(raw))),
        row_rms_px=float(np.sqrt(np.mean(raw**2))),
        residual_px=_deviation(errors),
        matches=len(left),
        frames=len(frames),
        significant=_significant(parts, sigma, rig, reference_yaw_deg),
    )


def _row_errors(left: F64, right: F64, rig: StereoRig, parts: F64) -> tuple[F64, F64]:
    """Row errors, float64 (N,) px, with the rotation and the scale taken back; and their slopes, float64 (N, 4)."""
    principal = np.array([rig.cx_right, rig.cy])
    rays = (right - principal) / [rig.f_px, rig.fy_px] / (1 + parts[3])
    turned = np.column_stack((rays, np.ones(len(rays)))) @ cv2.Rodrigues(parts[:3])[0]
    x, y = (turned[:, :2] / turned[:, 2:]).T
    slopes = rig.fy_px * np.stack((-(1 + y**2), x * y, x, y), axis=1)
    errors: F64 = y * rig.fy_px + principal[1] - left[:, 1]
    return errors, slopes


def _robust_step(errors: F64, slopes: F64) -> tuple[F64, F64]:
    """The step that explains the errors best, float64 (4,), and the weight of each match (Geman and McClure 1985)."""
    rest, weights = errors, np.ones(len(errors))
    for _ in range(REWEIGHTINGS):
        weighted = slopes * weights[:, None]
        step: F64 = np.linalg.solve(weighted.T @ slopes, weighted.T @ errors).astype(np.float64)
        rest = errors - slopes @ step
        weights = 1 / (1 + (rest / (SCALE_DEVIATIONS * _deviation(rest))) ** 2) ** 2
    return step, weights


def _deviation(values: F64) -> float:
    """Standard deviation, from the median; above 0."""
    return max(1.4826 * float(np.median(np.abs(values))), 1e-6)


def _standard_deviations(errors: F64, slopes: F64, weights: F64, owner: npt.NDArray[np.intp]) -> F64:
    """float64 (4,), by Huber's formula (1967); matches of one frame may be off together, those of several are not."""
    weighted = slopes * weights[:, None]
    # A match that is further off pulls less: the pull grows with the distance less than the weight says
    squares = 1 / np.sqrt(weights) - 1
    pull = np.sum((1 - 3 * squares) * weights**1.5) / np.sum(weights)
    inverse = np.linalg.inv(weighted.T @ slopes) / max(pull, 0.1)
    scores = weighted * errors[:, None]
    alone = scores.T @ scores
    frames = np.zeros((int(owner.max()) + 1, 4))
    np.add.at(frames, owner, scores)
    together = frames.T @ frames * len(frames) / (len(frames) - 1)
    variances = [np.diag(inverse @ middle @ inverse) for middle in (alone, together)]
    sigma: F64 = np.sqrt(np.maximum(*variances))
    return sigma


def _significant(parts: F64, sigma: F64, rig: StereoRig, reference_yaw_deg: float | None) -> tuple[str, ...]:
    reference = parts[1] if reference_yaw_deg is None else math.radians(reference_yaw_deg)
    changed = parts - [0, reference, 0, 0]
    x = max(rig.cx_right, rig.width - 1 - rig.cx_right) / rig.f_px
    y = max(rig.cy, rig.height - 1 - rig.cy) / rig.fy_px
    largest_px = rig.fy_px * np.abs(changed) * [1 + y**2, x * y, x, y]
    chosen = (largest_px > SIGNIFICANT_PX) & (np.abs(changed) > SIGNIFICANT_SIGMAS * sigma)
    return tuple(name for name, yes in zip(("pitch", "yaw", "roll", "scale"), chosen, strict=True) if yes)
