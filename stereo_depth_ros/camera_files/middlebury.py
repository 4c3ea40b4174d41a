# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The calib.txt of Middlebury 2014 and ETH3D: cam0, cam1 as [fx 0 cx; 0 fy cy; 0 0 1], baseline in millimeters.

Scharstein et al., "High-resolution stereo datasets with subpixel-accurate ground truth", GCPR 2014.
"""

from __future__ import annotations

import re

import numpy as np

from stereo_depth_ros.camera_files.documents import Document
from stereo_depth_ros.camera_files.stored import Size, StoredFile
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.rig import StereoRig

__all__ = ["MIDDLEBURY", "is_middlebury", "parse_rig", "read_middlebury"]

MIDDLEBURY = "Middlebury calibration"


def is_middlebury(document: Document) -> bool:
    """Whether the document is such a text."""
    return re.search(r"^[ \t]*cam0[ \t]*=", document.text, re.MULTILINE) is not None


def read_middlebury(document: Document) -> StoredFile:
    """The rig of the rectified images."""

    def build(size: Size | None) -> StereoRig:
        try:
            return parse_rig(document.text, size)
        except BagError as error:
            raise CalibrationError(error.problem, subject=document.source, remedy=error.remedy) from error

    return StoredFile(MIDDLEBURY, document.source, build=build)


def parse_rig(text: str, size: Size | None = None) -> StereoRig:
    """The rig of a calib.txt.

    Args:
        text: its content.
        size: of the images, px, where the text does not state it.

    Raises:
        BagError: a value is missing or not a number.
    """
    values = {name.strip(): value for name, _, value in (row.partition("=") for row in text.splitlines())}
    try:
        K_left, K_right = (
            np.array([row.split() for row in values[name].strip(" []").split(";")], np.float64).reshape(3, 3)
            for name in ("cam0", "cam1")
        )
        baseline_m = float(values["baseline"]) / 1000
        width, height = (
            (int(values[name]) for name in ("width", "height")) if "width" in values or size is None else size
        )
    except (KeyError, ValueError) as error:
        raise BagError(
            f"is not a Middlebury calibration, which has cam0, cam1 and baseline ({_fault(error)})",
            value=list(values),
            limit=("cam0", "cam1", "baseline"),
            remedy="copy it again",
        ) from error
    return StereoRig.from_rectified(
        K_left[0, 0], K_left[1, 1], K_left[0, 2], K_right[0, 2], K_left[1, 2], baseline_m, (width, height)
    )


def _fault(error: KeyError | ValueError) -> str:
    return f"it has no {error.args[0]}" if isinstance(error, KeyError) else "a value is not a number"
