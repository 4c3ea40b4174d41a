# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result of the calibration of a projector: camera and projector as a rig, and what the poses do not determine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stereo_depth_ros.active.projector.raster import Size
from stereo_depth_ros.calibration.calibration_result import StereoCalibration

__all__ = ["ProjectorCalibration"]


@dataclass(frozen=True, eq=False)
class ProjectorCalibration:
    """Result of :func:`calibrate_projector`.

    Attributes:
        stereo: the camera as the left, the projector as the right one of a rig. K, sigmas, errors and corners of the
            projector are in its own pixels; in ``stereo.rig`` it is a camera of the size of the camera's images.
        projector_size: width, height of the projector, px.
        camera_known: the camera was given, not calibrated; its standard deviations are 0.
        zero_coefficients: of the projector, which the poses do not determine.
    """

    stereo: StereoCalibration
    projector_size: Size
    camera_known: bool
    zero_coefficients: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """All values in types of JSON: those of a stereo calibration, with camera and projector by their names."""
        values = self.stereo.to_json()
        del values["image_circles_px"]
        renamed = {_renamed(key): value for key, value in values.items()}
        renamed["views"] = [{_renamed(key): value for key, value in view.items()} for view in values["views"]]
        width, height = self.projector_size
        return {
            **renamed,
            "projector_width": width,
            "projector_height": height,
            "projector_K_px": self.stereo.right.K.tolist(),
            "projector_zero_coefficients": list(self.zero_coefficients),
            "camera_known": self.camera_known,
            "raster": {
                "right_yaml": "the pattern resized to the size of the camera image, x' + 0.5 = scale (x + 0.5)",
                "scale": [self.stereo.size[0] / width, self.stereo.size[1] / height],
            },
        }


def _renamed(key: str) -> str:
    return key.replace("left", "camera").replace("right", "projector")
