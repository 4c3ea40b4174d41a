# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of a Middlebury (2001 to 2014) or ETH3D two-view scene: images, truth and masks, without calibration."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.datasets.image_files import checked_truth, read_disparity_image, read_image
from stereo_depth_ros.datasets.npz import read_npz

__all__ = ["MiddleburyScene", "view_scale"]

# left, right, truth; the first match is used
_LAYOUTS = (
    ("im0.*", "im1.*", "disp0.pfm"),
    ("im0.*", "im1.*", "disp0GT.pfm"),
    ("im0.*", "im1.*", "disp0.pgm"),
    ("view1.*", "view5.*", "disp1.*"),
    ("im2.*", "im6.*", "disp2.*"),
    ("scene1.row3.col3.*", "scene1.row3.col4.*", "truedisp.row3.col3.*"),
    ("scene1.row3.col3.*", "scene1.row3.col5.*", "truedisp.row3.col3.*"),
    ("*_left.png", "*_right.png", "*_disp.npz"),
    ("im0.*", "im1.*", None),  # last: those of 2001 and 2003 have im0 to im8, and truth for im2 and im6
)
# of 2014 and ETH3D; of the second evaluation; of 2003. All are white where both cameras see the point.
_VISIBLE_MASKS = ("mask0nocc.png", "nonocc.png", "occl.png")
_WHITE = 255


class MiddleburyScene:
    """One pair with its truth and its mask, where it has them.

    Args:
        folder: folder of the scene.

    Attributes:
        left_path, right_path: the images.
        truth_path: file of the true disparities of the left image; None without truth.
        files: all files that are read.

    Raises:
        BagError: unknown layout.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.left_path, self.right_path, self.truth_path = _find_layout(folder)
        truth = [self.truth_path] if self.truth_path else []
        self.files = [self.left_path, self.right_path, *truth, *(folder / name for name in _VISIBLE_MASKS)]

    @cached_property
    def size(self) -> tuple[int, int]:
        """(width, height) of the left image, pixels."""
        height, width = read_image(self.left_path).shape[:2]
        return width, height

    def truth(self) -> F32 | None:
        """True disparities, float32 (H, W), x_left - x_right in pixels, NaN where unknown; None without truth.

        Raises:
            BagError: a file that cannot be read, or truth of another size than the image.
        """
        if self.truth_path is None:
            return None
        return checked_truth(_read_truth(self.truth_path, self._truth_scale()), self.size, self.truth_path)

    def visible(self) -> npt.NDArray[np.bool_] | None:
        """Mask of the scene, bool (H, W), true where both cameras see the point; None without a mask.

        Raises:
            BagError: a file that cannot be read.
        """
        path = next((self.folder / name for name in _VISIBLE_MASKS if (self.folder / name).exists()), None)
        if path is None:
            return None
        mask = read_image(path)
        return np.equal(mask if mask.ndim == 2 else mask[..., 0], _WHITE)

    def _truth_scale(self) -> float:
        """Gray levels per pixel of disparity, as published for each year and size."""
        width, name = self.size[0], self.left_path.stem
        if name == "view1":
            return view_scale(width)
        if name == "scene1.row3.col3":
            return 16 if self.right_path.stem.endswith("col4") else 8
        return {450: 4, 900: 2, 1800: 1}.get(width, 8)  # scenes of 2003 have these widths, those of 2001 smaller ones


def view_scale(width: int) -> int:
    """Factor by which an image of 2005 or 2006 is smaller than full size (about 1240 to 1400 px wide)."""
    return 1 if width > 1000 else 2 if width > 550 else 3


def _find_layout(folder: Path) -> tuple[Path, Path, Path | None]:
    for layout in _LAYOUTS:
        for scene in _scene_names(folder, layout[0]):
            left, right, truth = (pattern and _single(folder, scene, pattern) for pattern in layout)
            if left and right and (truth or not layout[2]):
                return left, right, truth or None
    known = "; ".join(f"{left} with {right}" for left, right, _ in dict.fromkeys(_LAYOUTS))
    raise BagError(
        f"is not a Middlebury scene, it holds none of {known}",
        subject=str(folder),
        limit=known,
        remedy="name the folder of one scene",
    )


def _scene_names(folder: Path, left: str) -> list[str]:
    """The prefixes that a pattern like *_left.png matches, one per scene; an empty one for other patterns."""
    if not left.startswith("*"):
        return [""]
    return sorted(path.name.removesuffix(left[1:]) for path in folder.glob(left))


def _single(folder: Path, scene: str, pattern: str) -> Path | None:
    if pattern.startswith("*"):
        path = folder / (scene + pattern[1:])
        return path if path.exists() else None
    return next(iter(sorted(folder.glob(pattern))), None)


def _read_truth(path: Path, scale: float) -> F32:
    """float32 (H, W), NaN where unknown: infinite in .pfm and .npz, 0 in images of ``scale`` levels per pixel."""
    if path.suffix == ".npz":
        truth = read_npz(path)
    else:
        with np.errstate(over="ignore"):  # inf is unknown
            truth = read_disparity_image(path).astype(np.float32)
        if path.suffix != ".pfm":
            truth = np.where(truth > 0, truth / np.float32(scale), np.float32(np.nan))
    truth[~np.isfinite(truth)] = np.nan
    return truth
