# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The closed loop that keeps rows together: from row errors of rectified pairs to the rig to rectify with next."""

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

MIN_FRAMES = 5  # of a misalignment, before it is believed: a truck that fills an image is gone by then
STALE_PAIRS = 2  # that may be on their way still, rectified as before


@dataclass(frozen=True, eq=False)
class Correction:
    """By how much the right camera in use differs from the calibrated one.

    Attributes:
        rotation_deg: float64 (3,), rotation vector about x, y, z of the rectified camera: pitch, yaw, roll.
        scale: of the focal length, as a share.
        steps: how many corrections led there.
    """

    rotation_deg: F64
    scale: float
    steps: int


class AutoCorrection:
    """Corrects what is beyond doubt, as far as it may, and begins to look anew after each correction.

    Args:
        rig: as calibrated.
        limits: of all corrections together.
        reference_yaw_deg: see :func:`~stereo_depth_ros.calibration.misalignment.corrected_rig`.

    Attributes:
        rig: to rectify with, from now on.
        refusal: why the newest misalignment is not corrected; empty where there is none or it is.
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

    def look(self, matches: RowMatches) -> tuple[Misalignment | None, bool]:
        """Takes the row errors of a pair that :attr:`rig` has rectified.

        Returns:
            What the pairs since the last correction say, None while they are too few; and whether the rig was changed.
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
        """All that has been applied, together."""
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
                f"the corrections together come to {largest_deg:.3f} degrees and {100 * total.scale:+.2f} % of the "
                f"focal length, limits {self._limits.rotation_deg:g} and {100 * self._limits.scale:g}: calibrate again"
            )


def _difference(calibrated: StereoRig, used: StereoRig, steps: int) -> Correction:
    old, new = calibrated.right, used.right
    turn = cv2.Rodrigues(old.R @ new.R.T)[0].ravel()
    scale = float(new.K[0, 0] / old.K[0, 0] - 1)
    return Correction(np.degrees(turn), scale, steps)
