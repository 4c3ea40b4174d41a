# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the first pairs of a rig fit its calibration, examined while they are processed, offline and live."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.calibration.row_error import RowMatches, match_rows
from stereo_depth_ros.core.errors import CalibrationError, CameraOrderError, ImageError, StereoDepthError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, U8, MatchResult, StereoPair
from stereo_depth_ros.diagnosis.checks.cameras import check_resolution
from stereo_depth_ros.diagnosis.checks.disparities import BEHIND_PX, MOSTLY
from stereo_depth_ros.diagnosis.checks.images import MIN_CONTRAST
from stereo_depth_ros.diagnosis.checks.rig import check_shown
from stereo_depth_ros.diagnosis.checks.rows import USABLE_ROWS_PX
from stereo_depth_ros.diagnosis.finding import Finding, Level

__all__ = ["FirstPairs"]

# The largest median row error of 84 pairs of 20 real scenes and sequences is 0.42 px. Unrectified images of four rigs
# have 3.5 px and more, images with the calibration of another rig 2.4 px and more.
LIMIT_PX = USABLE_ROWS_PX
LIMIT_MEASURED_PX = 0.4  # of the images as measured, where these are much smaller than the originals
WIDTH_PX = 640  # of the images as measured, at most
CORNERS_PER_CELL = 8
NEAR_PX, WIDE = 3.0, 0.25  # rows searched first, px; where nothing fits there, as a fraction of the height
MIN_MATCHES = 40
AGREE_PX, MIN_AGREEING = 2.0, 0.75  # row errors of neighbors; share of the matches with such a neighbor
MAJORITY = 2  # of three conclusive pairs
ALWAYS, EVERY, LOOKS = 10, 10, 40  # the first pairs, then each tenth, up to so many that are examined
LAST = ALWAYS + EVERY * (LOOKS - ALWAYS)  # no later pair is examined
REMEDY = (
    "the images are not rectified, left and right are swapped, or the calibration does not belong to them: run "
    "stereo-depth doctor"
)


class FirstPairs:
    """Examines pairs of one rig until two of them agree on whether calibration and images fit.

    Pairs that show too little say nothing; then later ones are examined, 40 of the first 310 at most. Not thread-safe.

    Args:
        rig: the cameras.
        shown: share of the rectified images that has a source, 0..1.
    """

    def __init__(self, rig: StereoRig, shown: float) -> None:
        self._rig = rig
        self._shown = shown
        self._pairs = self._looks = self._good = 0
        self._faults: list[StereoDepthError] = []
        self._decided = False

    @property
    def fits(self) -> bool | None:
        """Whether calibration and images fit by the pairs so far; None where they show too little."""
        return None if not (self._faults or self._good) else self._good >= len(self._faults)

    @property
    def decided(self) -> bool:
        """No further pair will be examined."""
        return self._decided

    @property
    def due(self) -> bool:
        """The next pair will be examined."""
        number = self._pairs + 1
        return not self._decided and self._looks < LOOKS and (number <= ALWAYS or number % EVERY == 0)

    def skip(self) -> None:
        """Count a pair that is not due, so that it need not be decoded."""
        self._pairs += 1

    def look(self, pair: StereoPair, left: U8, right: U8, match: MatchResult | None = None) -> StereoDepthError | None:
        """Examine a pair if its turn has come.

        Args:
            pair: the images as received.
            left, right: uint8 (H, W), gray, rectified.
            match: of these, for the text of the error; None where they are not matched.

        Returns:
            What is wrong, once, as soon as it is known; else None.

        Raises:
            CameraOrderError: the cameras are swapped; of this pair and of all later ones.
        """
        due = self.due
        self._pairs += 1
        self._looks += due
        if due:
            fault = self._fault_of_rig() if self._looks == 1 else None
            if fault is not None:
                return self._decide(fault)
            self._count(*self._examine(pair, left, right, match))
            if len(self._faults) == MAJORITY:
                return self._decide(self._faults[-1])
        self._refuse_swapped()
        return None

    def finish(self) -> StereoDepthError | None:
        """What is wrong by fewer pairs, where no more will come and it is not said yet; else None."""
        return self._faults[-1] if self._faults and not self._good and not self._decided else None

    def _count(self, fault: StereoDepthError | None, conclusive: bool) -> None:
        if fault is not None:
            self._faults.append(fault)
        elif conclusive:
            self._good += 1
            self._decided = self._good == MAJORITY

    def _decide(self, fault: StereoDepthError) -> StereoDepthError:
        self._decided = True
        self._faults = [fault]
        self._refuse_swapped()
        return fault

    def _refuse_swapped(self) -> None:
        if self._decided and self._faults and isinstance(self._faults[-1], CameraOrderError):
            raise self._faults[-1].with_traceback(None)

    def _fault_of_rig(self) -> StereoDepthError | None:
        """What the camera infos alone show."""
        rig = self._rig
        for camera, topic in zip((rig.left, rig.right), rig.topics, strict=True):
            center = check_resolution(camera, "", rig.width, rig.height)[0]
            if center.level is Level.ERROR:
                return _refused(f"the center of K is at {center.value}", topic, center)
        shown = check_shown(self._shown)
        return None if shown.level is Level.OK else _refused(shown.value, " and ".join(rig.topics), shown)

    def _examine(
        self, pair: StereoPair, left: U8, right: U8, match: MatchResult | None
    ) -> tuple[StereoDepthError | None, bool]:
        """What is wrong with a pair, and whether it shows enough."""
        if np.array_equal(pair.left.pixels, pair.right.pixels):
            return (_one_camera(), True) if left.std() >= MIN_CONTRAST else (None, False)
        scale = min(1.0, WIDTH_PX / left.shape[1])
        small = [cv2.resize(i, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for i in (left, right)]
        one, other = (np.asarray(image, np.uint8) for image in small) if scale < 1 else (left, right)
        limit_px = max(LIMIT_PX * scale, LIMIT_MEASURED_PX)
        near = match_rows(one, other, CORNERS_PER_CELL, NEAR_PX)
        if len(near) >= MIN_MATCHES and near.median_px <= limit_px:
            return self._order(near, scale), True
        wide = match_rows(one, other, CORNERS_PER_CELL, WIDE * len(one))
        if len(wide) >= MIN_MATCHES and wide.median_px > limit_px and _agreeing(wide) >= MIN_AGREEING:
            return _rows_differ(wide.median_px / scale, limit_px / scale, match), True
        return None, False

    def _order(self, matches: RowMatches, scale: float) -> StereoDepthError | None:
        disparity_px: F64 = (matches.left_px[:, 0] - matches.right_px[:, 0]) / scale
        behind = float((disparity_px < self._rig.doffs_px - BEHIND_PX).mean())
        if behind <= MOSTLY:
            return None
        return CameraOrderError(
            f"cameras look swapped: {100 * behind:.0f} % of the features behind infinity (limit {100 * MOSTLY:.0f} %)",
            value=behind,
            limit=MOSTLY,
            remedy="exchange the image topics of left and right, or calibrate again if they are in order",
            settings=("left", "right"),
        )


def _refused(problem: str, subject: str, finding: Finding) -> CalibrationError:
    return CalibrationError(
        f"{problem}, limit {finding.limit}", subject=subject, limit=finding.limit, remedy=finding.remedy
    )


def _agreeing(matches: RowMatches) -> float:
    """Share of the matches whose nearest neighbor in the image has nearly their row error, which wrong ones lack."""
    x, y = matches.left_px.T
    distance = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    distance[distance < WIDTH_PX / 100] = np.inf  # itself, and other corners of the same spot
    errors = matches.errors_px
    return float((np.abs(errors - errors[distance.argmin(axis=1)]) <= AGREE_PX).mean())


def _one_camera() -> ImageError:
    return ImageError(
        "left and right image are identical",
        value=1,
        limit=2,
        remedy="both topics show one camera: check drivers and remappings",
        settings=("left", "right"),
    )


def _rows_differ(median_px: float, limit_px: float, match: MatchResult | None) -> CalibrationError:
    valid = "" if match is None else f", {100 * match.valid_fraction:.0f} % of the pixels have a disparity"
    return CalibrationError(
        f"rows of left and right differ by {median_px:.1f} px (limit {limit_px:.2g} px){valid}",
        value=median_px,
        limit=limit_px,
        remedy=REMEDY,
    )
