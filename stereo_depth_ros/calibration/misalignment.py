# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Misalignment of the right camera since its calibration, estimated from row errors, and the rig corrected for it.

If the rays of the right camera have rotated by a small rotation vector w, and its focal length has changed by the share
s, a point of rectified coordinates (x, y, 1) appears lower in the right image than in the left one by
(-(1 + y^2) w_x + x y w_y + x w_z + y s) f (Longuet-Higgins and Prazdny 1980, the rotational part). Row errors do not
distinguish w_x from a vertical shift f w_x of the principal point, nor a keystone x y w_y of a rotated camera, which
shifts all disparities, from that of a calibration whose principal point is wrong by f w_y, which does not. Yaw is
therefore significant only relative to a reference that was measured while the calibration was valid.
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
from stereo_depth_ros.geometry.robust import robust_sigma

__all__ = ["CorrectionLimits", "Misalignment", "MisalignmentEstimator", "corrected_rig"]

WINDOW = 20  # newest frames, used for the estimate
MIN_FRAMES, MIN_MATCHES = 3, 100
SIGNIFICANT_SIGMAS = 5.0
SIGNIFICANT_PX = 0.5  # largest row error in the image
ROUNDS = 3  # number of linearizations; the second changes the result by less than a hundredth
REWEIGHTINGS = 10
SCALE_SIGMAS = 2.0  # scale of the robust weights, in standard deviations of the residuals


@dataclass(frozen=True, eq=False)
class Misalignment:
    """Misalignment of the right camera, estimated from the row errors of several frames.

    Attributes:
        rotation_deg: float64 (3,), rotation vector of the rays of the right camera about x (right), y (down) and z
            (forward) of the rectified camera: pitch, yaw and roll.
        rotation_sigma_deg: float64 (3,), standard deviations.
        scale: relative change of the focal length of the right camera.
        scale_sigma: standard deviation.
        shift_px: vertical shift of the center of the right image, downward, equivalent to the pitch.
        row_median_px, row_rms_px: median of the absolute row errors, and their root mean square, of all frames.
        residual_px: standard deviation of the row errors that rotation and scale do not explain.
        matches, frames: number of them.
        significant: those of "pitch", "yaw", "roll" and "scale" that are statistically significant and of visible size.
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
        """Whether the right camera differs significantly from the calibration."""
        return bool(self.significant)


@dataclass(frozen=True)
class CorrectionLimits:
    """Limits of a correction, beyond which a new calibration is needed.

    Attributes:
        rotation_deg: about each axis.
        scale: relative change of the focal length.
    """

    rotation_deg: float = 1.0
    scale: float = 0.01


class MisalignmentEstimator:
    """Estimates the misalignment from the newest frames.

    Args:
        rig: that the images were rectified with.
        reference_yaw_deg: yaw measured while the calibration was valid; with None, yaw is reported but never
            significant.
    """

    def __init__(self, rig: StereoRig, reference_yaw_deg: float | None = None) -> None:
        self._rig, self._reference_yaw_deg = rig, reference_yaw_deg
        self._frames: deque[RowMatches] = deque(maxlen=WINDOW)

    def restart(self, rig: StereoRig) -> None:
        """Discard all frames; the next ones are rectified with this rig."""
        self._rig = rig
        self._frames.clear()

    def add(self, matches: RowMatches) -> Misalignment | None:
        """Misalignment over this frame and those before it; None while frames or matches are too few."""
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
    """The rig with R and K of the right camera corrected, so that rows agree again.

    P does not change, so that users of the rectified images are not affected. Yaw is corrected relative to
    ``reference_yaw_deg``, and not at all if that is None.

    Raises:
        CalibrationError: the correction exceeds the limits.
    """
    pitch_deg, yaw_deg, roll_deg = misalignment.rotation_deg
    changed_deg = np.array([pitch_deg, 0.0 if reference_yaw_deg is None else yaw_deg - reference_yaw_deg, roll_deg])
    _check_limits(changed_deg, misalignment.scale, limits or CorrectionLimits())
    right, rotation = rig.right, cv2.Rodrigues(np.radians(changed_deg))[0]
    K = right.K.copy()
    K[:2, :2] *= 1 + misalignment.scale
    return replace(rig, right=replace(right, R=rotation.T @ right.R, K=K))


def _check_limits(rotation_deg: F64, scale: float, limits: CorrectionLimits) -> None:
    largest_deg = float(np.abs(rotation_deg).max())
    if largest_deg > limits.rotation_deg:
        raise CalibrationError(
            f"the right camera has rotated by {largest_deg:.3f} degrees, limit of a correction {limits.rotation_deg:g}",
            value=largest_deg,
            limit=limits.rotation_deg,
            remedy="fasten the cameras and calibrate again",
        )
    if abs(scale) > limits.scale:
        raise CalibrationError(
            f"the focal length of the right camera has changed by {100 * scale:+.2f} %, limit of a correction "
            f"{100 * limits.scale:g} %",
            value=scale,
            limit=limits.scale,
            remedy="check the focus and calibrate again",
        )


def _estimate(frames: list[RowMatches], rig: StereoRig, reference_yaw_deg: float | None) -> Misalignment:
    left, right = (np.concatenate([getattr(frame, side) for frame in frames]) for side in ("left_px", "right_px"))
    frame_of_match = np.repeat(np.arange(len(frames)), [len(frame) for frame in frames])
    parameters = np.zeros(4)
    for _ in range(ROUNDS):
        errors, jacobian = _row_errors(left, right, rig, parameters)
        step, weights = _robust_step(errors, jacobian)
        parameters = parameters + step
    errors, jacobian = _row_errors(left, right, rig, parameters)
    sigma = _standard_deviations(errors, jacobian, weights, frame_of_match)
    raw = left[:, 1] - right[:, 1]
    return Misalignment(
        rotation_deg=np.degrees(parameters[:3]),
        rotation_sigma_deg=np.degrees(sigma[:3]),
        scale=float(parameters[3]),
        scale_sigma=float(sigma[3]),
        shift_px=-rig.fy_px * math.tan(parameters[0]),
        row_median_px=float(np.median(np.abs(raw))),
        row_rms_px=float(np.sqrt(np.mean(raw**2))),
        residual_px=_deviation(errors),
        matches=len(left),
        frames=len(frames),
        significant=_significant(parameters, sigma, rig, reference_yaw_deg),
    )


def _row_errors(left: F64, right: F64, rig: StereoRig, parameters: F64) -> tuple[F64, F64]:
    """Row errors after correction by rotation and scale, float64 (N,) px, and their Jacobian, float64 (N, 4)."""
    principal = np.array([rig.cx_right, rig.cy])
    rays = (right - principal) / [rig.f_px, rig.fy_px] / (1 + parameters[3])
    rotated = np.column_stack((rays, np.ones(len(rays)))) @ cv2.Rodrigues(parameters[:3])[0]
    x, y = (rotated[:, :2] / rotated[:, 2:]).T
    jacobian = rig.fy_px * np.stack((-(1 + y**2), x * y, x, y), axis=1)
    errors: F64 = y * rig.fy_px + principal[1] - left[:, 1]
    return errors, jacobian


def _robust_step(errors: F64, jacobian: F64) -> tuple[F64, F64]:
    """Reweighted least-squares step, float64 (4,), and the weight of each match (Geman and McClure 1985)."""
    weights = np.ones(len(errors))
    for _ in range(REWEIGHTINGS):
        weighted = jacobian * weights[:, None]
        step: F64 = np.linalg.solve(weighted.T @ jacobian, weighted.T @ errors).astype(np.float64)
        residuals = errors - jacobian @ step
        weights = 1 / (1 + (residuals / (SCALE_SIGMAS * _deviation(residuals))) ** 2) ** 2
    return step, weights


def _deviation(values: F64) -> float:
    """Standard deviation from the median absolute value; above 0."""
    return max(robust_sigma(values), 1e-6)


def _standard_deviations(errors: F64, jacobian: F64, weights: F64, frame_of_match: npt.NDArray[np.intp]) -> F64:
    """float64 (4,), by Huber's sandwich formula (1967), the larger of independent matches and of independent frames."""
    weighted = jacobian * weights[:, None]
    # Mean derivative of the influence function over the mean weight
    squares = 1 / np.sqrt(weights) - 1
    influence = np.sum((1 - 3 * squares) * weights**1.5) / np.sum(weights)
    inverse = np.linalg.inv(weighted.T @ jacobian) / max(influence, 0.1)
    scores = weighted * errors[:, None]
    by_match = scores.T @ scores
    frames = np.zeros((int(frame_of_match.max()) + 1, 4))
    np.add.at(frames, frame_of_match, scores)
    by_frame = frames.T @ frames * len(frames) / (len(frames) - 1)
    variances = [np.diag(inverse @ middle @ inverse) for middle in (by_match, by_frame)]
    sigma: F64 = np.sqrt(np.maximum(*variances))
    return sigma


def _significant(parameters: F64, sigma: F64, rig: StereoRig, reference_yaw_deg: float | None) -> tuple[str, ...]:
    reference = parameters[1] if reference_yaw_deg is None else math.radians(reference_yaw_deg)
    changed = parameters - [0, reference, 0, 0]
    x = max(rig.cx_right, rig.width - 1 - rig.cx_right) / rig.f_px
    y = max(rig.cy, rig.height - 1 - rig.cy) / rig.fy_px
    largest_px = rig.fy_px * np.abs(changed) * [1 + y**2, x * y, x, y]
    significant = (largest_px > SIGNIFICANT_PX) & (np.abs(changed) > SIGNIFICANT_SIGMAS * sigma)
    return tuple(name for name, yes in zip(("pitch", "yaw", "roll", "scale"), significant, strict=True) if yes)
