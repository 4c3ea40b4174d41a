# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result of a stereo calibration: cameras, relative pose, errors, standard deviations, dropped views."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from stereo_depth_ros.calibration.board_views import Coverage
from stereo_depth_ros.calibration.camera_calibration import DroppedView
from stereo_depth_ros.calibration.lens_circle import LensCircle
from stereo_depth_ros.calibration.projection import parameter_names
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

__all__ = ["CalibratedCamera", "StereoCalibration", "ViewErrors"]


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """One calibrated camera.

    Attributes:
        K: float64 (3, 3), px.
        D: float64 (n,), coefficients of the distortion model.
        sigmas: standard deviations of fx, fy, cx, cy in px and of the coefficients, float64 (4 + n,).
        rms_px: reprojection rms with both cameras calibrated together.
        rms_alone_px: reprojection rms with this camera calibrated alone.
    """

    K: F64
    D: F64
    sigmas: F64
    rms_px: float
    rms_alone_px: float

    def to_json(self, model: str) -> dict[str, Any]:
        """Value and standard deviation of each parameter by name."""
        values = [self.K[0, 0], self.K[1, 1], self.K[0, 2], self.K[1, 2], *self.D]
        return {
            name: {"value": float(value), "sigma": float(sigma)}
            for name, value, sigma in zip(parameter_names(model), values, self.sigmas, strict=True)
        }


@dataclass(frozen=True, eq=False)
class ViewErrors:
    """One view that was used: corners of both cameras, float64 (N, 2), px, and their root mean square errors, px.

    ``rms_rows`` is NaN where both cameras see no corner in common.
    """

    name: str
    left_px: F64
    right_px: F64
    rms_left: float
    rms_right: float
    rms_rows: float

    def to_json(self) -> dict[str, Any]:
        """The errors in types of JSON; NaN becomes None."""
        rows = self.rms_rows if math.isfinite(self.rms_rows) else None
        return {"name": self.name, "rms_left": self.rms_left, "rms_right": self.rms_right, "rms_rows": rows}


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """Result of :func:`~stereo_depth_ros.calibration.stereo_calibration.calibrate`.

    Attributes:
        model: distortion model of both cameras.
        left, right: the cameras.
        R: float64 (3, 3), X_right = R X_left + T.
        T: float64 (3,), meters.
        R_sigma_deg: standard deviations of the rotation about x, y, z of the right camera, float64 (3,), degrees.
        T_sigma_m: of T, float64 (3,), meters.
        baseline_sigma_m: of the length of T; errors of the board size are not included.
        rms_stereo_px: reprojection rms over all corners of both cameras.
        epipolar_rms_px: rms row error of the corners after rectification, px of the rectified images.
        rig: both cameras, rectified.
        views: that were used.
        dropped: views that were rejected, with the reason.
        coverage: of the views that were used.
        circles: image circles of the left and the right lens; None where the image has no dark corners.
        warnings: reasons why the result may be worse than the errors indicate, a sentence each.
    """

    model: str
    left: CalibratedCamera
    right: CalibratedCamera
    R: F64
    T: F64
    R_sigma_deg: F64
    T_sigma_m: F64
    baseline_sigma_m: float
    rms_stereo_px: float
    epipolar_rms_px: float
    rig: StereoRig
    views: tuple[ViewErrors, ...]
    dropped: tuple[DroppedView, ...]
    coverage: Coverage
    warnings: tuple[str, ...]
    circles: tuple[LensCircle | None, LensCircle | None] = (None, None)

    @property
    def baseline_m(self) -> float:
        """Distance between the optical centers, meters."""
        return float(np.linalg.norm(self.T))

    @property
    def size(self) -> tuple[int, int]:
        """Width, height of the images, px."""
        return self.rig.width, self.rig.height

    def to_json(self) -> dict[str, Any]:
        """All values in types of JSON."""
        coverage = {name: getattr(self.coverage, name) for name in ("x", "y", "size", "skew")}
        return {
            "model": self.model,
            "image_width": self.size[0],
            "image_height": self.size[1],
            "rms_left": self.left.rms_px,
            "rms_right": self.right.rms_px,
            "rms_left_alone": self.left.rms_alone_px,
            "rms_right_alone": self.right.rms_alone_px,
            "rms_stereo": self.rms_stereo_px,
            "epipolar_rms_px": self.epipolar_rms_px,
            "baseline_m": self.baseline_m,
            "baseline_sigma_m": self.baseline_sigma_m,
            "views_used": len(self.views),
            "views_dropped": len(self.dropped),
            "left": self.left.to_json(self.model),
            "right": self.right.to_json(self.model),
            "R": self.R.tolist(),
            "R_sigma_deg": self.R_sigma_deg.tolist(),
            "image_circles_px": [None if circle is None else asdict(circle) for circle in self.circles],
            "T_m": self.T.tolist(),
            "T_sigma_m": self.T_sigma_m.tolist(),
            "coverage": {**coverage, "missing": list(self.coverage.missing)},
            "views": [view.to_json() for view in self.views],
            "dropped": [{"name": view.name, "reason": view.reason} for view in self.dropped],
            "warnings": list(self.warnings),
        }
