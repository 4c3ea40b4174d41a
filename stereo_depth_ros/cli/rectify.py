# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth rectify`: rectifies a pair of images, with or without a calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.cli.camera_info import CommandWithCameraInfo
from stereo_depth_ros.cli.errors import param_options
from stereo_depth_ros.cli.given import refuse_files, refuse_ignored
from stereo_depth_ros.cli.options import Json, Overwrite, new_app
from stereo_depth_ros.cli.output import show, warn
from stereo_depth_ros.cli.tables import TextTable, facts_table
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8, Frame
from stereo_depth_ros.core.uncalibrated_rig import UncalibratedRig
from stereo_depth_ros.datasets.image_files import read_image, read_pair
from stereo_depth_ros.datasets.rig_files import read_rig, rig_files
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.geometry.calibrated_rectification import METHODS, common_area, rectify_calibrated
from stereo_depth_ros.geometry.correspondences import Correspondences, match_features
from stereo_depth_ros.geometry.fundamental import estimate_fundamental
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.geometry.uncalibrated_rectification import rectify_uncalibrated
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.rows import rows_plot
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["app"]

app = new_app()

_MIN_MATCHES = 20  # needed for a row error
_AGREE_PX = 3.0  # matches whose row error differs more from the median are outliers


@app.command(cls=CommandWithCameraInfo)
def rectify(
    context: typer.Context,
    left: Annotated[Path, typer.Argument(metavar="LEFT", help="Read this raw image of the left camera.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Write the files to this folder.")],
    right: Annotated[
        Path | None, typer.Argument(metavar="RIGHT", help="Read this raw image of the right camera.")
    ] = None,
    side_by_side: Annotated[
        bool, typer.Option("--side-by-side", help="Read both images from LEFT, which is the only one then.")
    ] = False,
    rig: Annotated[
        list[Path] | None,
        typer.Option(
            "--camera-info",
            "--rig",
            metavar="LEFT RIGHT",
            help="Use this calibration: its files, their folder, or a bag.",
        ),
    ] = None,
    uncalibrated: Annotated[
        bool,
        typer.Option(
            "--uncalibrated", help="Rectify from matched features; --camera-info then removes distortion only."
        ),
    ] = False,
    method: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"Compute new R and P by this method: {', '.join(METHODS)}; by default, use those of the rig.",
            autocompletion=lambda: [*METHODS],
        ),
    ] = None,
    alpha: Annotated[
        float, typer.Option(metavar="0..1", help="Keep valid pixels only with 0, all raw pixels with 1; for --method.")
    ] = 0.0,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Rectify a pair of images, with or without a calibration.

    With --camera-info, the calibration is used. With --uncalibrated, the fundamental matrix is estimated from matched
    features, and the images are rectified by the two homographies of least distortion (Loop and Zhang 1999). Lenses
    with distortion need --camera-info in addition. Disparities of these images cannot be converted to meters.

    DIR receives left.png and right.png, rows.png with lines across both images, and with --method left.yaml and
    right.yaml. Row errors are measured on matched features.

    \b
    Examples:
      stereo-depth rectify left.png right.png --camera-info calibration -o out
      stereo-depth rectify left.png right.png --camera-info left.yaml --method textbook --alpha 0.5 -o out
      stereo-depth rectify left.jpg right.jpg --uncalibrated -o out --json -
      stereo-depth rectify both.png --side-by-side --camera-info calibration -o out
    """
    if rig is None and not uncalibrated:
        raise ConfigError(
            "neither --camera-info nor --uncalibrated is given", remedy="give the calibration, or rectify without one"
        )
    right = _right_path(left, right, side_by_side)
    refuse_files("--output", output)
    if method is None:
        refuse_ignored(context, ["alpha"], "without --method", "add --method, such as textbook")
    if uncalibrated and method is not None:
        raise ConfigError(
            f"--method {method} needs a calibration, --uncalibrated does not use one", remedy="give one of the options"
        )
    names = ("left.png", "right.png", "rows.png", *(("left.yaml", "right.yaml") if method is not None else ()))
    inputs = [left, right, *(rig_files(rig) if rig else ())]
    check_outputs([output / name for name in names], inputs, reports=[json_file], overwrite=overwrite)
    images = _Pair(*(read_pair(left, right) if side_by_side else (read_image(left), read_image(right))))
    known = read_rig(rig, size=(images.left.shape[1], images.left.shape[0])) if rig else None
    for path, pixels in ((left, images.left), (right, images.right)):
        if known is not None:
            known.check_image(pixels.shape[1], pixels.shape[0], str(path))
    raw = match_features(images.left_gray, images.right_gray)
    result: dict[str, Any] = {"left": str(left), "right": str(right), "output": str(output)}
    used: StereoRig | UncalibratedRig
    if known is None or uncalibrated:
        used, found = _from_images(images, raw, known)
    else:
        used, found = _from_calibration(known, method, alpha)
    result |= found
    rectified = _rectified(images, used)
    result |= {"before": _rows(raw), "after": _rows(match_features(rectified.left_gray, rectified.right_gray))}
    save_png(output / "left.png", rectified.left, overwrite=overwrite)
    save_png(output / "right.png", rectified.right, overwrite=overwrite)
    rows = rows_plot(rectified.left, rectified.right, _title(result))
    save_png(output / "rows.png", rows, overwrite=overwrite)
    if method is not None and isinstance(used, StereoRig):
        write_camera(output / "left.yaml", used.left, "left", overwrite=overwrite)
        write_camera(output / "right.yaml", used.right, "right", overwrite=overwrite)
    show([_table(result)], result, json_file, overwrite=overwrite)
    if uncalibrated and known is None:
        warn("the lenses are assumed to have no distortion: give --camera-info if they have")


def _right_path(left: Path, right: Path | None, side_by_side: bool) -> Path:
    """The file of the right image: that of the left one where both are side by side."""
    if side_by_side and right is not None:
        raise ConfigError(
            f"{right} has no effect with --side-by-side, both images are in {left}", remedy="name one image"
        )
    if right is None and not side_by_side:
        raise ConfigError(
            "the image of the right camera is missing",
            remedy="name it after that of the left camera, or give --side-by-side where one file holds both",
        )
    return right or left


@dataclass(frozen=True)
class _Pair:
    """A pair of images, uint8 (H, W) or (H, W, 3) BGR, and the same in gray, uint8 (H, W)."""

    left: U8
    right: U8
    left_gray: U8 = field(init=False)
    right_gray: U8 = field(init=False)

    def __post_init__(self) -> None:
        for name in ("left", "right"):
            pixels = getattr(self, name)
            gray = to_gray(Frame(pixels, 0, "", "mono8" if pixels.ndim == 2 else "bgr8"))
            object.__setattr__(self, f"{name}_gray", gray)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of both images.

        Raises:
            CalibrationError: they differ.
        """
        if self.left.shape[:2] != self.right.shape[:2]:
            left, right = (f"{each.shape[1]}x{each.shape[0]}" for each in (self.left, self.right))
            raise CalibrationError(
                f"the images are {left} and {right}", value=right, limit=left, remedy="use two images of the same size"
            )
        return self.left.shape[1], self.left.shape[0]


def _from_calibration(known: StereoRig, method: str | None, alpha: float) -> tuple[StereoRig, dict[str, Any]]:
    used = known
    if method is not None:
        used = rectify_calibrated(known.left, known.right, RelativePose.from_rig(known), method=method, alpha=alpha)
    area = common_area(used)._asdict()
    return used, {"method": method or "R and P of the calibration", "metric": True, "common_area": area}


def _from_images(
    images: _Pair, raw: Correspondences, known: StereoRig | None
) -> tuple[UncalibratedRig, dict[str, Any]]:
    matches = raw.undistorted(known.left, known.right) if known else raw
    estimate = estimate_fundamental(matches.left_px, matches.right_px)
    found = rectify_uncalibrated(estimate.F, images.size)
    cameras = (known.left, known.right) if known else None
    left_px, right_px = found.rectified(matches.left_px[estimate.inliers], matches.right_px[estimate.inliers])
    disparity_px = np.percentile(left_px[:, 0] - right_px[:, 0], (1, 99))
    first = 16 * int(np.floor((disparity_px[0] - 8) / 16))
    values = {
        "method": "uncalibrated, Loop and Zhang",
        "metric": False,
        "distortion_removed": known is not None,
        "matches": len(matches),
        "inliers": int(estimate.inliers.sum()),
        "sampson_rms_px": estimate.sampson_rms_px,
        "F": estimate.F.tolist(),
        "H_left": found.H_left.tolist(),
        "H_right": found.H_right.tolist(),
        "projective_distortion": found.distortion,
        "midlines_left": found.shape_left._asdict(),
        "midlines_right": found.shape_right._asdict(),
        "recommended": {
            "min_disparity": first,
            "disparity_range": max(32, 16 * int(np.ceil((disparity_px[1] + 8 - first) / 16))),
        },
    }
    return UncalibratedRig.from_homographies(found.H_left, found.H_right, found.size, cameras), values


def _rectified(images: _Pair, rig: StereoRig | UncalibratedRig) -> _Pair:
    rectifier = Rectifier(rig)
    return _Pair(rectifier.rectify_left(images.left), rectifier.rectify_right(images.right))


def _rows(matches: Correspondences) -> dict[str, float | None]:
    """Median and RMS row error of the matches without outliers, px; None if there are too few."""
    errors = matches.left_px[:, 1] - matches.right_px[:, 1]
    if len(errors) < _MIN_MATCHES:
        return {"matches": len(errors), "median_px": None, "rms_px": None}
    spread = 4.5 * float(np.median(np.abs(errors - np.median(errors))))
    near = errors[np.abs(errors - np.median(errors)) <= max(_AGREE_PX, spread)]
    rms = float(np.sqrt(np.mean(near**2)))
    return {"matches": len(near), "median_px": float(np.median(np.abs(near))), "rms_px": rms}


def _title(result: dict[str, Any]) -> str:
    return f"{result['method']}, row error {_error(result['before'])} before, {_error(result['after'])} after"


def _error(rows: dict[str, float | None]) -> str:
    return "unknown" if rows["median_px"] is None else f"{rows['median_px']:.2f} px"


def _table(result: dict[str, Any]) -> TextTable:
    facts = facts_table()
    facts.add_row("method", result["method"])
    facts.add_row("depth", "in meters" if result["metric"] else "not in meters: only the order of depths is known")
    for name in ("before", "after"):
        rows = result[name]
        text = f"unknown: {rows['matches']} matched features, at least {_MIN_MATCHES} are needed"
        if rows["median_px"] is not None:
            text = f"median {rows['median_px']:.2f} px, rms {rows['rms_px']:.2f} px of {rows['matches']} matches"
        facts.add_row(f"row error {name}", text)
    if not result["metric"]:
        facts.add_row("matches", f"{result['inliers']} of {result['matches']} fit the fundamental matrix")
        facts.add_row("options", param_options(result["recommended"]))
    else:
        area = result["common_area"]
        facts.add_row("common area", f"{area['width']}x{area['height']} px from ({area['x']}, {area['y']})")
    facts.add_row("files", result["output"])
    return facts
