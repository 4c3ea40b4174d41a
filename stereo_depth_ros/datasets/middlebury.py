# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Middlebury stereo scenes of 2001 to 2014, and ETH3D two-view scenes, which have the 2014 layout.

Middlebury writes Z = f B / (d + doffs) with doffs = cx_right - cx_left; a rig's ``doffs_px`` is the negative of it.
Scharstein and Szeliski, "A taxonomy and evaluation of dense two-frame stereo correspondence algorithms", IJCV 2002;
Scharstein et al., "High-resolution stereo datasets with subpixel-accurate ground truth", GCPR 2014.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from stereo_depth_ros.camera_files.middlebury import parse_rig
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.datasets.dataset import DatasetFrame
from stereo_depth_ros.datasets.image_files import check_sizes, read_frame
from stereo_depth_ros.datasets.middlebury_scene import MiddleburyScene, view_scale

__all__ = ["MiddleburyDataset"]

_COPY = "copy it again"
# published for the scenes of 2005 and 2006 at full size
_VIEW_FOCAL_PX, _VIEW_BASELINE_M = 3740.0, 0.160


class MiddleburyDataset:
    """One scene: one pair with its truth and calibration.

    The calibration is read from ``calib.txt``. Scenes of 2005 and 2006 have none and use the published focal length and
    baseline with their ``dmin.txt``. All others need the arguments.

    Args:
        folder: folder of the scene.
        calibration_file: another ``calib.txt``.
        focal_px, baseline_m: used instead of a file, with the principal point in the center of the left image.
        doffs: cx_right - cx_left, pixels, for use with these.

    Raises:
        BagError: unknown layout, no calibration, or a file that cannot be read.
        CalibrationError: a calibration for another image size.
    """

    has_stamps = False

    def __init__(
        self,
        folder: Path,
        *,
        calibration_file: Path | None = None,
        focal_px: float | None = None,
        baseline_m: float | None = None,
        doffs: float | None = None,
    ) -> None:
        self.scene = MiddleburyScene(folder)
        width, height = self.scene.size
        calibration_file = calibration_file or folder / "calib.txt"
        if focal_px is not None and baseline_m is not None:
            self.rig = _centered_rig(focal_px, baseline_m, doffs or 0.0, (width, height))
        elif calibration_file.exists():
            self.rig = _read_rig(calibration_file, (width, height))
        else:
            self.rig = self._published_rig(folder, (width, height), doffs)
        check_sizes(self.rig, self.scene.right_path)
        self.files = [*self.scene.files, calibration_file, folder / "dmin.txt"]

    def __len__(self) -> int:
        return 1

    def __iter__(self) -> Iterator[DatasetFrame]:
        left = read_frame(self.scene.left_path, self.rig.left)
        right = read_frame(self.scene.right_path, self.rig.right)
        yield DatasetFrame(left, right, self.scene.truth())

    def _published_rig(self, folder: Path, size: tuple[int, int], doffs: float | None) -> StereoRig:
        remedy = "give focal length and baseline (and doffs where the principal points differ)"
        settings = ("focal_px", "baseline_m", "doffs")
        if not self.scene.left_path.stem == "view1":
            raise BagError(
                "has no calib.txt",
                subject=str(folder),
                remedy=f"add the calib.txt of the scene, or {remedy}",
                settings=settings,
            )
        scale = view_scale(size[0])
        dmin = folder / "dmin.txt"
        if doffs is None and not dmin.exists():
            raise BagError(
                "has neither calib.txt nor dmin.txt, so that its depth is not metric",
                subject=str(folder),
                remedy=f"add one of them, or {remedy}",
                settings=settings,
            )
        offset = doffs if doffs is not None else _read_number(dmin) / scale
        return _centered_rig(_VIEW_FOCAL_PX / scale, _VIEW_BASELINE_M, offset, size)


def _centered_rig(focal_px: float, baseline_m: float, doffs: float, size: tuple[int, int]) -> StereoRig:
    cx, cy = (size[0] - 1) / 2, (size[1] - 1) / 2
    return StereoRig.from_rectified(focal_px, focal_px, cx, cx + doffs, cy, baseline_m, size)


def _read_rig(path: Path, size: tuple[int, int]) -> StereoRig:
    text = read_text(path, BagError, _COPY)
    try:
        rig = parse_rig(text, size)
    except (BagError, CalibrationError) as error:
        raise error.about(path) from error
    rig.check_image(*size, str(path))
    return rig


def _read_number(path: Path) -> float:
    text = read_text(path, BagError, _COPY)
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise BagError(f"does not hold one number but {quoted(text)}", subject=str(path), value=text, remedy=_COPY)
    return number
