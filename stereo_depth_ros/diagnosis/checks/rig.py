# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of two cameras together and with their images: all faults, not only the first one.

The checks are those of :class:`StereoRig`, as in the nodes, which stops at the first fault; here a rig is constructed
for each part, with all other parts replaced by valid ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import (
    MAX_BASELINE_M,
    MAX_VERTICAL,
    MIN_BASELINE_M,
    StereoRig,
    check_reference,
    check_vertical,
)
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.diagnosis.checks.cameras import fits_image
from stereo_depth_ros.diagnosis.finding import Finding, Level

__all__ = ["check_frame", "check_frame_names", "check_image_size", "check_pair", "check_shown", "rectification_rig"]

WIDE_BASELINE_M = 1.5  # few rigs are wider; a small one with centimeters taken for meters is
MIN_SHOWN = 0.4  # share of the rectified image that has a source; wide lenses with alpha = 1 have 60 % and more
FULL_SIZE_MM = 20.0  # a baseline of more meters than this was in millimeters, else in centimeters
_EXAMPLE_BASELINE_M = 0.1
_ANY_MATRIX = np.identity(3)
_REFERENCE, _SIGN = "left P[:, 3]", "right P[0,3]"
_Part: TypeAlias = tuple[str, Callable[[], object], str, str]  # name, what raises where it is wrong, value, limit


def check_pair(left: CameraModel, right: CameraModel) -> list[Finding]:
    """Sizes, focal lengths, rows, and the baseline of two cameras whose P are usable, separately."""
    findings = []
    for name, check, value, limit in _pair_parts(left, right):
        try:
            check()
        except CalibrationError as error:
            refused = Finding.refused(name, error, limit, _remedy(name, left, right))
            if name in (_REFERENCE, _SIGN):
                refused = replace(refused, figures={"left": float(left.P[0, 3]), "right": float(right.P[0, 3])})
            findings.append(refused)
        else:
            findings.append(_wide(right.P, limit) if name == "baseline" else Finding(name, Level.OK, value, limit))
    return findings


def _remedy(name: str, left: CameraModel, right: CameraModel) -> str:
    """A better remedy than that of the error; empty where there is none."""
    equal = all(np.array_equal(getattr(left, part), getattr(right, part)) for part in ("K", "D", "R", "P"))
    if name == _SIGN and equal:
        return "both camera infos are equal: give the right camera its calibration, P[0,3] is -fx * baseline in it"
    return _unit_remedy(right.P) if name == "baseline" else ""


def _pair_parts(left: CameraModel, right: CameraModel) -> Iterator[_Part]:
    """Each part with all other parts valid."""
    P = left.P[:, :3]
    sizes = f"{left.width}x{left.height}, {right.width}x{right.height}"
    yield "sizes", partial(StereoRig, _plain(left, P), _plain(right, P, _EXAMPLE_BASELINE_M)), sizes, "equal"
    if (left.width, left.height) != (right.width, right.height):
        yield from _baseline_parts(left, right)
        return  # what is in px cannot be compared
    yield _REFERENCE, partial(check_reference, left.P, right.P), str(left.P[:2, 3].tolist()), "0"
    for name, at in (("fx", (0, 0)), ("fy", (1, 1)), ("cy", (1, 2))):
        other = P.copy()
        other[at] = right.P[at]
        limit = "equal within 0.01 px" if name == "cy" else "equal within 0.1 %"
        value = f"{left.P[at]:.3f}, {right.P[at]:.3f} px"
        check = partial(StereoRig, _plain(left, P), _plain(left, other, _EXAMPLE_BASELINE_M))
        yield f"{name} of P", check, value, limit
    yield from _baseline_parts(left, right)


def _baseline_parts(left: CameraModel, right: CameraModel) -> Iterator[_Part]:
    P = right.P[:, :3]
    plain, fx = _plain(right, P), right.P[0, 0]

    def side(across: float) -> CameraModel:
        return replace(plain, P=np.column_stack([P, [across, 0.0, 0.0]]))

    vertical = partial(check_vertical, left.P, right.P)
    yield "right P[1,3]", vertical, f"{right.P[1, 3]:g}", f"up to {MAX_VERTICAL:g} of P[0,3]: cameras side by side"
    sign = side(right.P[0, 3] if right.P[0, 3] >= 0 else -fx * _EXAMPLE_BASELINE_M)
    yield _SIGN, partial(StereoRig, plain, sign), f"{right.P[0, 3]:.4f}", "below 0"
    if right.P[0, 3]:
        limit = f"{MIN_BASELINE_M:g}..{MAX_BASELINE_M:g} m"
        yield "baseline", partial(StereoRig, plain, side(-abs(right.P[0, 3]))), "", limit


def _plain(camera: CameraModel, P: F64, baseline_m: float = 0.0) -> CameraModel:
    """A valid camera of the same size: no distortion, rectified, P from float64 (3, 3)."""
    fourth = [-P[0, 0] * baseline_m, 0.0, 0.0]
    P = np.column_stack([P, fourth])
    return CameraModel(camera.width, camera.height, "plumb_bob", _ANY_MATRIX, np.zeros(0), _ANY_MATRIX, P)


def _unit_remedy(P: F64) -> str:
    """The unit that was probably meant."""
    baseline_m, entry = abs(P[0, 3] / P[0, 0]), abs(P[0, 3])
    if baseline_m > MAX_BASELINE_M:
        unit, factor = ("millimeters", 1e-3) if baseline_m >= FULL_SIZE_MM else ("centimeters", 1e-2)
        if factor * baseline_m <= MAX_BASELINE_M:
            return (
                f"written in {unit}: multiply P[0,3] of the right camera by {factor:g}, "
                f"the baseline is then {factor * baseline_m:.4g} m"
            )
    elif MIN_BASELINE_M <= entry <= MAX_BASELINE_M:
        return f"P[0,3] is the baseline itself: multiply it by fx = {P[0, 0]:.4g}, the baseline is then {entry:.4g} m"
    return ""


def _wide(P: F64, limit: str) -> Finding:
    baseline_m = abs(float(P[0, 3] / P[0, 0]))
    value, figures = f"{baseline_m:.4f} m", {"baseline_m": baseline_m}
    if baseline_m <= WIDE_BASELINE_M:
        return Finding("baseline", Level.OK, value, limit, "", figures)
    remedy = f"measure it: if it was written in centimeters, multiply P[0,3] by 0.01 ({0.01 * baseline_m:.4g} m)"
    return Finding("baseline", Level.WARNING, value, f"{limit}, usually below {WIDE_BASELINE_M:g} m", remedy, figures)


def rectification_rig(left: CameraModel, right: CameraModel, topics: tuple[str, str]) -> tuple[StereoRig | None, str]:
    """The rig to rectify images with, and why it gives no depth; empty where it does.

    The baseline moves no pixel: where only that is wrong the images can be examined all the same.
    """
    try:
        return StereoRig(left, right, topics), ""
    except CalibrationError as error:
        why = str(error)
    try:
        P_left, P_right = left.P[:, :3], right.P[:, :3]
        straight = replace(left, P=np.column_stack([P_left, np.zeros(3)]))
        beside = np.column_stack([P_right, [-P_right[0, 0] * _EXAMPLE_BASELINE_M, 0.0, 0.0]])
        return StereoRig(straight, replace(right, P=beside), topics), why
    except CalibrationError:
        return None, why


def check_image_size(
    camera: CameraModel, sensor: tuple[int, int], width: int, height: int, side: str, topic: str, K_known: bool = True
) -> Finding:
    """Whether the images have the size of their camera info.

    Args:
        camera: after binning and roi.
        sensor: width and height in the camera info, px, of the whole sensor.
        width, height: of the images, px.
        K_known: K is one, so that it may show which size it is for.
    """
    check, limit = f"{side} image size", f"{camera.width}x{camera.height}"
    try:
        _rig_of(camera, camera).check_image(width, height, topic)
    except CalibrationError as error:
        return Finding.refused(check, error, limit, _size_remedy(camera if K_known else None, sensor, width, height))
    return Finding(check, Level.OK, f"{width}x{height}", limit)


def check_frame(left: CameraModel, right: CameraModel, side: str, frame_id: str, topic: str) -> Finding:
    """Whether an image has the frame of its camera info."""
    check, limit = f"{side} frame_id", (left if side == "left" else right).frame_id
    try:
        _rig_of(left, right).check_side(side, frame_id, topic)
    except CalibrationError as error:
        return Finding.refused(check, error, limit)
    if not frame_id:
        remedy = "set frame_id in the driver: without it nothing can be transformed by tf"
        return Finding(check, Level.WARNING, "empty", limit, remedy)
    return Finding(check, Level.OK, frame_id, limit)


def check_frame_names(left: CameraModel, right: CameraModel) -> list[Finding]:
    """A warning where the frame names of the camera infos are those of the other camera."""
    if "right" not in left.frame_id.lower() or "left" not in right.frame_id.lower():
        return []
    value, remedy = f"{left.frame_id}, {right.frame_id}", "exchange the frame_ids, or the camera infos"
    return [Finding("frame names", Level.WARNING, value, "left, right", remedy)]


def check_shown(shown: float) -> Finding:
    """Whether enough of the rectified images has a source; ``shown`` is its share, 0..1."""
    value, limit = f"{100 * shown:.0f} % of the rectified image has a source", f"{100 * MIN_SHOWN:.0f} %"
    if shown >= MIN_SHOWN:
        return Finding("rectified image", Level.OK, value, limit, "", {"share": shown})
    remedy = "R and P do not fit K: use all matrices of one calibration, or calibrate again"
    return Finding("rectified image", Level.WARNING if shown else Level.ERROR, value, limit, remedy, {"share": shown})


def _size_remedy(camera: CameraModel | None, sensor: tuple[int, int], width: int, height: int) -> str:
    """The remedy where the size of the images shows the fault of the camera info; else empty."""
    if (width, height) == sensor:
        return "the images are of the whole sensor: set binning and roi of the camera info to 0"
    if camera is not None and fits_image(camera, width, height):
        return f"K is for images of {width}x{height}: set width and height of the camera info to that"
    across, down = sensor[0] / width, sensor[1] / height
    text = f"the images are {1 / across:.4g} times the size that was calibrated"
    if across == down and across in (2, 3, 4):
        return f"{text}: set binning to {across:.0f}, or roi where they are a crop"
    if abs(across / down - 1) <= 0.01:
        return f"{text}: scale K and P by that"
    crop = width <= sensor[0] and height <= sensor[1]
    return "the images are a crop of what was calibrated: set the roi of the camera info" if crop else ""


def _rig_of(left: CameraModel, right: CameraModel) -> StereoRig:
    """A valid rig with the frames of these cameras and the size of the left one."""
    one, other = _plain(left, _ANY_MATRIX), _plain(left, _ANY_MATRIX, _EXAMPLE_BASELINE_M)
    return StereoRig(replace(one, frame_id=left.frame_id), replace(other, frame_id=right.frame_id))
