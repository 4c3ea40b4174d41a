# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Automatic correction of the rig: a closed loop from row errors of rectified pairs to the next rectification."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereo_depth_ros.calibration.misalignment import (
    CorrectionLimits,
    Misalignment,
    MisalignmentEstimator,
    corrected_rig,
)
from stereo_depth_ros.calibration.row_error import RowMatches
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

__all__ = ["AutoCorrection", "Correction"]

MIN_FRAMES = 5  # before a misalignment is corrected: a vehicle that fills the image has passed by then
STALE_PAIRS = 2  # in transit when the rig changes, rectified with the previous one


@dataclass(frozen=True, eq=False)
class Correction:
    """Difference of the right camera in use from the calibrated one.

    Attributes:
        rotation_deg: float64 (3,), rotation vector about x, y, z of the rectified camera: pitch, yaw, roll.
        scale: relative change of the focal length.
        steps: number of corrections applied.
    """

    rotation_deg: F64
    scale: float
    steps: int


class AutoCorrection:
    """Corrects significant misalignments within limits, and restarts the estimate after each correction.

    Args:
        rig: as calibrated.
        limits: of the total correction.
        reference_yaw_deg: see :func:`~stereo_depth_ros.calibration.misalignment.corrected_rig`.

    Attributes:
        rig: to rectify the next pairs with.
        refusal: why the newest misalignment is not corrected; empty if it is, or if none is detected.
    """

    def __init__(
        self, rig: StereoRig, limits: CorrectionLimits | None = None, reference_yaw_deg: float | None = None
    ) -> None:
        self._calibrated = self.rig = rig
        self._limits = limits or CorrectionLimits()
        self._reference_yaw_deg = reference_yaw_deg
        self._estimator = MisalignmentEstimator(rig, reference_yaw_deg)
        self._stale = 0
        self._steps = 0
        self.refusal = ""

    def add(self, matches: RowMatches) -> tuple[Misalignment | None, bool]:
        """Add the row errors of a pair that was rectified with :attr:`rig`.

        Returns:
            The misalignment over the pairs since the last correction, None while they are too few; and whether the rig
            was changed.
        """
        if self._stale:
            self._stale -= 1
            return None, False
        found = self._estimator.add(matches)
        if found is None or not found.detected or found.frames < MIN_FRAMES:
            self.refusal = "" if found is not None and not found.detected else self.refusal
            return found, False
        try:
            corrected = corrected_rig(self.rig, found, self._limits, self._reference_yaw_deg)
            self._check_total(corrected)
        except CalibrationError as error:
            self.refusal = str(error)
            return found, False
        self._apply(corrected)
        return found, True

    @property
    def correction(self) -> Correction:
        """The total correction applied so far."""
        return _difference(self._calibrated, self.rig, self._steps)

    def _apply(self, corrected: StereoRig) -> None:
        self.rig, self.refusal = corrected, ""
        self._steps += 1
        self._stale = STALE_PAIRS
        self._estimator.restart(corrected)

    def _check_total(self, corrected: StereoRig) -> None:
        total = _difference(self._calibrated, corrected, self._steps)
        largest_deg = float(np.abs(total.rotation_deg).max())
        if largest_deg > self._limits.rotation_deg or abs(total.scale) > self._limits.scale:
            raise CalibrationError(
                f"the total correction would be {largest_deg:.3f} degrees and {100 * total.scale:+.2f} % of the focal "
                f"length, limits {self._limits.rotation_deg:g} and {100 * self._limits.scale:g} %",
                value=(largest_deg, total.scale),
                limit=(self._limits.rotation_deg, self._limits.scale),
                remedy="calibrate again",
            )


def _difference(calibrated: StereoRig, used: StereoRig, steps: int) -> Correction:
    old, new = calibrated.right, used.right
    turn = cv2.Rodrigues(old.R @ new.R.T)[0].ravel()
    scale = float(new.K[0, 0] / old.K[0, 0] - 1)
    return Correction(np.degrees(turn), scale, steps)
