# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Examines a stereo set-up: camera infos, stamps, pictures, and how well they fit together."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.diagnosis.checks.cameras import check_camera, check_resolution, fits_picture
from stereo_depth_ros.diagnosis.checks.disparities import check_depths, check_eyes
from stereo_depth_ros.diagnosis.checks.images import check_exposure, check_two_eyes
from stereo_depth_ros.diagnosis.checks.rig import (
    check_frame,
    check_frame_names,
    check_image_size,
    check_pair,
    picture_rig,
)
from stereo_depth_ros.diagnosis.checks.rows import (
    GOOD_ROWS_PX,
    PicturePairs,
    check_raw_rows,
    check_rows,
    match_pictures,
)
from stereo_depth_ros.diagnosis.checks.streams import check_streams
from stereo_depth_ros.diagnosis.finding import Finding, Level, is_wrong
from stereo_depth_ros.diagnosis.root_causes import settled
from stereo_depth_ros.diagnosis.survey import EyeRecord, StereoSetUp
from stereo_depth_ros.diagnosis.verdict import Diagnosis
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["diagnose"]

MIN_SHOWN = 0.4  # share of the rectified picture that has a source; alpha = 1 of wide lenses leaves 60 % and more


def diagnose(set_up: StereoSetUp, progress: Callable[[int, int], None] = lambda done, total: None) -> Diagnosis:
    """Everything that can be said of a set-up; no fault hides another one.

    Args:
        set_up: what there is.
        progress: called with pairs matched and pairs to match.
    """
    cameras, findings = _examine_infos(set_up)
    findings += _examine_streams(set_up)
    findings += _examine_images(set_up, cameras)
    findings += _examine_rows(set_up, cameras, findings, progress)
    return Diagnosis(set_up, (*set_up.findings, *settled(findings)))


def _eyes(set_up: StereoSetUp) -> tuple[tuple[str, EyeRecord], tuple[str, EyeRecord]]:
    return ("left", set_up.left), ("right", set_up.right)


def _examine_infos(set_up: StereoSetUp) -> tuple[list[CameraModel], list[Finding]]:
    """The cameras, both or none, and what the camera infos say by themselves."""
    cameras: list[CameraModel] = []
    findings: list[Finding] = []
    faulty = False
    for eye, record in _eyes(set_up):
        own, camera = _examine_eye(set_up, eye, record)
        findings += own
        faulty |= is_wrong(own, f"{eye} size", f"{eye} P")
        if camera is not None:
            cameras.append(camera)
    if len(cameras) < 2:
        return [], findings
    if not faulty:
        findings += check_pair(*cameras)
    findings += check_frame_names(*cameras)
    if max(finding.level for finding in findings) < Level.ERROR:
        findings += _rest(cameras, (set_up.left.info_topic or "left", set_up.right.info_topic or "right"))
    return cameras, findings


def _rest(cameras: list[CameraModel], topics: tuple[str, str]) -> list[Finding]:
    """What the nodes refuse and no check above has told."""
    try:
        StereoRig(cameras[0], cameras[1], topics)
    except CalibrationError as error:
        return [Finding.refused("rig", error)]
    return []


def _examine_eye(set_up: StereoSetUp, eye: str, record: EyeRecord) -> tuple[list[Finding], CameraModel | None]:
    check, topic = f"{eye} camera info", record.info_topic
    if not record.infos:
        came = f"nothing on {topic}" if topic else f"none belongs to {record.image_topic}"
        remedy = set_up.silent.get(topic or "", "publish camera infos, or record them too")
        return [Finding(check, Level.ERROR, came, "1", remedy)], None
    findings = []
    if len(record.infos) > 1:
        remedy = "one of them is wrong, or something publishes on the same topic: stop one publisher"
        findings.append(Finding(check, Level.WARNING, f"{len(record.infos)} different ones", "1", remedy))
    else:
        findings.append(Finding(check, Level.OK, record.info_topic or "", "1"))
    try:
        camera = camera_from_info(record.infos[0], eye)
    except CalibrationError as error:
        return [*findings, Finding.refused(f"{eye} roi", error, eye, "inside the sensor")], None
    own = check_camera(camera, eye)
    findings += own
    if not is_wrong(own, f"{eye} size", f"{eye} K", f"{eye} distortion"):
        findings += check_resolution(camera, eye, *_size_of_K(set_up, eye, camera))
    return findings, camera


def _size_of_K(set_up: StereoSetUp, eye: str, camera: CameraModel) -> tuple[int, int]:  # noqa: N802
    """Width and height that K is held against: of the pictures where it fits them, else of the camera info.

    That the two sizes differ is told by the check of the images.
    """
    if set_up.pairs:
        height, width = getattr(set_up.pairs[0], eye).pixels.shape[:2]
        if fits_picture(camera, width, height):
            return width, height
    return camera.width, camera.height


def _examine_streams(set_up: StereoSetUp) -> list[Finding]:
    missing = []
    for eye, record in _eyes(set_up):
        if not len(record.stamps_ns):
            remedy = set_up.silent.get(record.image_topic, "record it again, or name another topic")
            missing.append(Finding(f"{eye} images", Level.ERROR, f"nothing on {record.image_topic}", "1", remedy))
    return missing or check_streams(set_up.left.stamps_ns, set_up.right.stamps_ns)


def _examine_images(set_up: StereoSetUp, cameras: list[CameraModel]) -> list[Finding]:
    """Sizes, frames and exposure."""
    if not set_up.pairs:
        remedy = "let both cameras send, or record both"
        return [Finding("pictures", Level.LEFT_OUT, "no pair of pictures", "1 pair", remedy)]
    findings = []
    for (eye, record), camera in zip(_eyes(set_up), cameras, strict=False):
        frame = getattr(set_up.pairs[0], eye)
        height, width = frame.pixels.shape[:2]
        sensor = (record.infos[0].width, record.infos[0].height)
        findings.append(check_image_size(camera, sensor, width, height, eye, record.image_topic))
        findings.append(check_frame(cameras[0], cameras[1], eye, frame.frame_id, record.image_topic))
    left, right = ([to_gray(getattr(pair, eye)) for pair in set_up.pairs] for eye in ("left", "right"))
    findings += [check_exposure(left, "left"), check_exposure(right, "right"), check_two_eyes(left, right)]
    return findings


def _examine_rows(
    set_up: StereoSetUp,
    cameras: list[CameraModel],
    before: list[Finding],
    progress: Callable[[int, int], None],
) -> list[Finding]:
    """What the features of rectified pictures say."""
    if not set_up.pairs or is_wrong(before, "two eyes"):
        return []
    done = itertools.count(1)
    progress(0, len(set_up.pairs))
    as_came = [(to_gray(pair.left), to_gray(pair.right)) for pair in set_up.pairs]
    rig, why_not = _rig_of_pictures(set_up, cameras)
    raw = None if set_up.rectified else check_raw_rows(as_came[::2])
    findings = [] if raw is None else [raw]
    if rig is None and not set_up.rectified:
        return [*findings, _not_rectified(raw)]
    given, exchanged, shown = _rectified(set_up, rig, as_came)
    if shown is not None:
        findings.append(shown)
    matching = match_pictures(given, lambda: progress(next(done), len(set_up.pairs)))
    columns_fit = not is_wrong(before, "left P[:, 3]", "right P[0,3]")
    order = check_eyes(given, matching, exchanged, rig.doffs_px if rig else 0.0, columns_fit)
    findings.append(order)
    if order.level is Level.ERROR:
        return [*findings, Finding("rows", Level.LEFT_OUT, "not judged while the eyes are swapped")]
    height, width = given[0][0].shape
    findings.append(check_rows(matching, raw, width, height, rig.f_px if rig else None))
    if rig is not None:
        findings += check_depths(matching, rig, not why_not)
    return findings


def _not_rectified(raw: Finding | None) -> Finding:
    """Rows that cannot be judged for want of a calibration; pictures may be rectified without it."""
    value = "no calibration to rectify with"
    median_px = raw.figures["median_px"] if raw is not None else None
    if median_px is None or median_px > GOOD_ROWS_PX:
        return Finding("rows", Level.LEFT_OUT, value)
    return Finding(
        "rows", Level.LEFT_OUT, value, "", "the rows agree as they are: the pictures may be rectified already"
    )


def _rig_of_pictures(set_up: StereoSetUp, cameras: list[CameraModel]) -> tuple[StereoRig | None, str]:
    """The rig that rectifies the pictures as they came, and why it is no whole rig."""
    if not cameras:
        return None, ""
    left, right = (camera.rectified() for camera in cameras) if set_up.rectified else cameras
    rig, why_not = picture_rig(left, right, (set_up.left.image_topic, set_up.right.image_topic))
    if rig is not None and any(
        frame.pixels.shape[:2] != (rig.height, rig.width) for pair in set_up.pairs for frame in (pair.left, pair.right)
    ):
        return None, "the images have another size than the camera infos say: make them agree"
    return rig, why_not


def _rectified(
    set_up: StereoSetUp, rig: StereoRig | None, as_came: PicturePairs
) -> tuple[PicturePairs, Callable[[], PicturePairs], Finding | None]:
    """The rectified pictures, what rectifies them the other way round, and how much of them is shown."""
    if rig is None:
        return as_came, lambda: [(right, left) for left, right in as_came], None
    rectifier = Rectifier(rig)

    def rectify(left: Any, right: Any) -> Any:
        rectified = rectifier.rectify(StereoPair(left, right))
        return rectified.left, rectified.right

    given = [rectify(pair.left, pair.right) for pair in set_up.pairs]
    shown = float(min(rectifier.left_source.mean(), rectifier.right_source.mean()))
    return given, lambda: [rectify(pair.right, pair.left) for pair in set_up.pairs], _check_shown(shown)


def _check_shown(shown: float) -> Finding:
    value, limit = f"{100 * shown:.0f} % of the rectified picture has a source", f"{100 * MIN_SHOWN:.0f} %"
    if shown >= MIN_SHOWN:
        return Finding("rectified picture", Level.OK, value, limit, "", {"share": shown})
    remedy = "R and P do not fit K: take all matrices from one calibration, or calibrate again"
    return Finding("rectified picture", Level.WARNING if shown else Level.ERROR, value, limit, remedy, {"share": shown})
