# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of a projector calibration: camera left.yaml, projector right.yaml, calibration.json and calibration.txt."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from stereo_depth_ros.active.projector.result import ProjectorCalibration
from stereo_depth_ros.calibration.calibration_files import write_calibration_files
from stereo_depth_ros.calibration.projection import parameter_names

__all__ = ["save_projector_calibration"]


def save_projector_calibration(calibration: ProjectorCalibration, folder: Path, *, overwrite: bool = False) -> None:
    """Write the files into a folder, which is created if missing; they are read as those of any rig.

    Args:
        calibration: the result.
        folder: the output folder.
        overwrite: replace the files that are there.

    Raises:
        OutputError: one of the files exists and ``overwrite`` is false (then none is written), or cannot be written.
    """
    comment = "".join(f"# {line}\n" for line in _raster(calibration))
    rig = calibration.stereo.rig
    write_calibration_files(folder, calibration.to_json(), _report(calibration), rig, comment, overwrite=overwrite)


def _raster(calibration: ProjectorCalibration) -> Iterator[str]:
    (width, height), size = calibration.projector_size, calibration.stereo.size
    yield f"A projector of {width}x{height} px as a camera of {size[0]}x{size[1]} px: its image is the pattern resized"
    yield f"to that size, x' + 0.5 = {size[0] / width:.9g} (x + 0.5), y' + 0.5 = {size[1] / height:.9g} (y + 0.5)."


def _report(calibration: ProjectorCalibration) -> Iterator[str]:
    c, (width, height) = calibration.stereo, calibration.projector_size
    yield (
        f"{c.model}, camera {c.size[0]}x{c.size[1]}{', given' if calibration.camera_known else ''}, projector "
        f"{width}x{height}, {len(c.views)} poses used, {len(c.dropped)} dropped"
    )
    yield f"distance of camera and projector {1e3 * c.baseline_m:.3f} +- {1e3 * c.baseline_sigma_m:.3f} mm"
    yield f"rms camera {c.left.rms_px:.4f} px, projector {c.right.rms_px:.4f} px, both {c.rms_stereo_px:.4f} px"
    yield f"rms of each alone: camera {c.left.rms_alone_px:.4f} px, projector {c.right.rms_alone_px:.4f} px"
    yield f"row error after rectification: rms {c.epipolar_rms_px:.4f} px"
    for name, camera in (("camera", c.left), ("projector, in its own pixels", c.right)):
        yield ""
        yield f"{name}: value and standard deviation"
        values = (camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], *camera.D)
        for parameter, value, sigma in zip(parameter_names(c.model), values, camera.sigmas, strict=True):
            zero = name != "camera" and parameter in calibration.zero_coefficients
            yield f"  {parameter}  {'0, not determined' if zero else f'{value:.8g} +- {sigma:.3g}'}"
    yield ""
    yield f"T {c.T.tolist()} m +- {c.T_sigma_m.tolist()}, from the camera to the projector"
    yield f"R {c.R.tolist()}, about x, y, z +- {c.R_sigma_deg.tolist()} deg"
    yield ""
    yield from (f"right.yaml: {line}" for line in _raster(calibration))
    yield ""
    for view in c.views:
        yield (
            f"{view.name}: rms camera {view.rms_left:.3f} px, projector {view.rms_right:.3f} px, rows "
            f"{view.rms_rows:.3f} px"
        )
    yield from (f"dropped {view.name}: {view.reason}" for view in c.dropped)
    yield from (f"warning: {text}" for text in c.warnings)
    yield from (f"to improve: {text}" for text in c.coverage.missing)
