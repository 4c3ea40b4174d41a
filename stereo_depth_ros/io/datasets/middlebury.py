# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Middlebury stereo scenes of 2001 to 2014, and ETH3D two-view scenes, which have the layout of 2014.

Middlebury writes Z = f B / (d + doffs) with doffs = cx_right - cx_left; a rig's ``doffs_px`` is the negative of it.
Scharstein and Szeliski, "A taxonomy and evaluation of dense two-frame stereo correspondence algorithms", IJCV 2002;
Scharstein et al., "High-resolution stereo datasets with subpixel-accurate ground truth", GCPR 2014.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stereo_depth_ros.errors import BagError
from stereo_depth_ros.io.datasets import DatasetFrame, check_sizes, read_frame, read_image, read_picture
from stereo_depth_ros.stereo_rig import StereoRig
from stereo_depth_ros.types import F32

__all__ = ["MiddleburyDataset"]

# left, right, truth; the first that is there
_LAYOUTS = (
    ("im0.*", "im1.*", "disp0.pfm"),
    ("im0.*", "im1.*", "disp0GT.pfm"),
    ("im0.*", "im1.*", None),
    ("view1.*", "view5.*", "disp1.*"),
    ("im2.*", "im6.*", "disp2.*"),
    ("scene1.row3.col3.*", "scene1.row3.col4.*", "truedisp.row3.col3.*"),
    ("scene1.row3.col3.*", "scene1.row3.col5.*", "truedisp.row3.col3.*"),
    ("*_left.png", "*_right.png", "*_disp.npz"),
)
# published for the scenes of 2005 and 2006 at full size
_VIEW_FOCAL_PX, _VIEW_BASELINE_M = 3740.0, 0.160


class MiddleburyDataset:
    """One scene: one pair, its truth, its calibration.

    The calibration is that of ``calib.txt``. Scenes of 2005 and 2006 have none, there the published focal length and
    baseline are used with the scene's ``dmin.txt``. All others need the arguments.

    Args:
        folder: the scene.
        calibration_file: a ``calib.txt`` in another place.
        focal_px, baseline_m: instead of a file; the principal point is then the middle of the left image.
        doffs: cx_right - cx_left, px, to go with them.

    Raises:
        BagError: no known layout, or a file that cannot be read.
        CalibrationError: a calibration that does not fit the images.
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
        self.left_path, self.right_path, self.truth_path = _find_layout(folder)
        height, width = read_image(self.left_path).shape[:2]
        calibration_file = calibration_file or folder / "calib.txt"
        if focal_px is not None and baseline_m is not None:
            self.rig = _centred_rig(focal_px, baseline_m, doffs or 0.0, (width, height))
        elif calibration_file.exists():
            self.rig = _read_rig(calibration_file, (width, height))
        else:
            self.rig = self._published_rig(folder, (width, height), doffs)
        check_sizes(self.rig, self.right_path)

    def __len__(self) -> int:
        return 1

    def __iter__(self) -> Iterator[DatasetFrame]:
        left = read_frame(self.left_path, self.rig.left)
        right = read_frame(self.right_path, self.rig.right)
        truth = None if self.truth_path is None else _read_truth(self.truth_path, self._truth_scale())
        yield DatasetFrame(left, right, truth)

    def _published_rig(self, folder: Path, size: tuple[int, int], doffs: float | None) -> StereoRig:
        options = "give --focal-px and --baseline-m (and --doffs, where the principal points differ)"
        if not self.left_path.stem == "view1":
            raise BagError(f"{folder} has no calib.txt: put the scene's own there, or {options}")
        scale = _view_scale(size[0])
        dmin = folder / "dmin.txt"
        if doffs is None and not dmin.exists():
            raise BagError(
                f"{folder} has neither calib.txt nor dmin.txt, its depth is not metric: put one there, or {options}"
            )
        offset = doffs if doffs is not None else _read_number(dmin) / scale
        return _centred_rig(_VIEW_FOCAL_PX / scale, _VIEW_BASELINE_M, offset, size)

    def _truth_scale(self) -> float:
        """Grey levels per pixel of disparity, as the dataset's pages give them for each year and size."""
        width, name = self.rig.width, self.left_path.stem
        if name == "view1":
            return _view_scale(width)
        if name == "scene1.row3.col3":
            return 16 if self.right_path.stem.endswith("col4") else 8
        return {450: 4, 900: 2, 1800: 1}.get(width, 8)  # 2003 has these widths, 2001 smaller ones


def _find_layout(folder: Path) -> tuple[Path, Path, Path | None]:
    for left, right, truth in _LAYOUTS:
        found = [_single(folder, pattern) for pattern in (left, right, truth) if pattern]
        if all(found):
            paths = [path for path in found if path]
            return paths[0], paths[1], paths[2] if truth else None
    known = "; ".join(f"{left} with {right}" for left, right, _ in dict.fromkeys(_LAYOUTS))
    raise BagError(f"{folder} is not a Middlebury scene: it holds none of {known}")


def _single(folder: Path, pattern: str) -> Path | None:
    return next(iter(sorted(folder.glob(pattern))), None)


def _view_scale(width: int) -> int:
    """How many times smaller than full size (about 1240 to 1400 px) an image of 2005 or 2006 is."""
    return 1 if width > 1000 else 2 if width > 550 else 3


def _centred_rig(focal_px: float, baseline_m: float, doffs: float, size: tuple[int, int]) -> StereoRig:
    cx, cy = (size[0] - 1) / 2, (size[1] - 1) / 2
    return StereoRig.from_rectified(focal_px, focal_px, cx, cx + doffs, cy, baseline_m, size)


def _read_rig(path: Path, size: tuple[int, int]) -> StereoRig:
    """From a calib.txt: cam0, cam1 as [fx 0 cx; 0 fy cy; 0 0 1], baseline in millimetres."""
    values = dict(line.split("=", 1) for line in path.read_text().splitlines() if "=" in line)
    try:
        K_left, K_right = (
            np.array([row.split() for row in values[name].strip(" []").split(";")], np.float64).reshape(3, 3)
            for name in ("cam0", "cam1")
        )
        baseline_m = float(values["baseline"]) / 1000
        calibrated = (int(values.get("width", size[0])), int(values.get("height", size[1])))
    except (KeyError, ValueError) as error:
        raise BagError(f"{path} is not a Middlebury calibration ({error}): it has cam0, cam1, baseline") from error
    rig = StereoRig.from_rectified(
        K_left[0, 0], K_left[1, 1], K_left[0, 2], K_right[0, 2], K_left[1, 2], baseline_m, calibrated
    )
    rig.check_image(*size, str(path))
    return rig


def _read_number(path: Path) -> float:
    try:
        return float(path.read_text())
    except ValueError as error:
        raise BagError(f"{path} does not hold one number: {error}") from error


def _read_truth(path: Path, scale: float) -> F32:
    """float32 (H, W), NaN where unknown: infinite in .pfm and .npz, 0 in pictures of ``scale`` levels a pixel."""
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            truth = np.array(arrays[arrays.files[0]], np.float32)
    else:
        truth = read_picture(path).astype(np.float32)
        if path.suffix != ".pfm":
            truth = np.where(truth > 0, truth / np.float32(scale), np.float32(np.nan))
    truth[~np.isfinite(truth)] = np.nan
    return truth
