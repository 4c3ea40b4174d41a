# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Examines a stereo setup: camera infos, stamps, images, row errors."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from stereo_depth_ros.core.camera import CameraModel, check_calibrated
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.diagnosis.checks.cameras import check_camera, check_resolution, fits_image
from stereo_depth_ros.diagnosis.checks.disparities import check_camera_order, check_depths
from stereo_depth_ros.diagnosis.checks.images import check_bit_depth, check_exposure, check_two_cameras
from stereo_depth_ros.diagnosis.checks.matcher import check_matcher
from stereo_depth_ros.diagnosis.checks.rig import (
    check_frame,
    check_frame_names,
    check_image_size,
    check_pair,
    check_shown,
    rectification_rig,
)
from stereo_depth_ros.diagnosis.checks.rows import (
    GOOD_ROWS_PX,
    ImageArrayPairs,
    check_raw_rows,
    check_rows,
    match_image_pairs,
)
from stereo_depth_ros.diagnosis.checks.streams import check_streams
from stereo_depth_ros.diagnosis.finding import Finding, Level, is_wrong
from stereo_depth_ros.diagnosis.root_causes import settled
from stereo_depth_ros.diagnosis.survey import CameraRecord, StereoSetup
from stereo_depth_ros.diagnosis.verdict import Diagnosis
from stereo_depth_ros.matching import Matcher
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["diagnose"]


def diagnose(
    setup: StereoSetup,
    progress: Callable[[int, int], None] = lambda done, total: None,
    matcher: Matcher | None = None,
) -> Diagnosis:
    """All findings on a setup; no fault hides another one.

    Args:
        setup: what to examine.
        progress: called with pairs matched and pairs to match.
        matcher: whose disparities are compared with those of features; None compares none.
    """
    cameras, findings = _examine_infos(setup)
    findings += _examine_streams(setup)
    findings += _examine_images(setup, cameras, findings)
    findings += _examine_rows(setup, cameras, findings, progress, matcher)
    return Diagnosis(setup, (*setup.findings, *settled(findings)))


def _sides(setup: StereoSetup) -> tuple[tuple[str, CameraRecord], tuple[str, CameraRecord]]:
    return ("left", setup.left), ("right", setup.right)


def _examine_infos(setup: StereoSetup) -> tuple[list[CameraModel], list[Finding]]:
    """The cameras, both or none, and the findings on the camera infos."""
    cameras: list[CameraModel] = []
    findings: list[Finding] = []
    faulty = False
    for side, record in _sides(setup):
        own, camera = _examine_camera(setup, side, record)
        findings += own
        faulty |= is_wrong(own, f"{side} size", f"{side} P")
        if camera is not None:
            cameras.append(camera)
    if len(cameras) < 2:
        return [], findings
    if not faulty:
        findings += check_pair(*cameras)
    findings += check_frame_names(*cameras)
    if max(finding.level for finding in findings) < Level.ERROR:
        findings += _examine_rig(cameras, (setup.left.info_topic or "left", setup.right.info_topic or "right"))
    return cameras, findings


def _examine_rig(cameras: list[CameraModel], topics: tuple[str, str]) -> list[Finding]:
    """What the nodes refuse and no other check has found."""
    try:
        StereoRig(cameras[0], cameras[1], topics)
    except CalibrationError as error:
        return [replace(Finding.refused("rig", error), value=f"{error.subject}: {error.problem}")]
    return []


def _examine_camera(setup: StereoSetup, side: str, record: CameraRecord) -> tuple[list[Finding], CameraModel | None]:
    check, topic = f"{side} camera info", record.info_topic
    if not record.infos:
        value = f"nothing on {topic}" if topic else f"none belongs to {record.image_topic}"
        remedy = setup.silent.get(topic or "", "record the camera infos too, or give calibration files")
        return [Finding(check, Level.ERROR, value, "1", remedy)], None
    findings = []
    if len(record.infos) > 1:
        remedy = "one of them is wrong, or there are two publishers: stop one"
        findings.append(Finding(check, Level.WARNING, f"{len(record.infos)} different ones", "1", remedy))
    else:
        findings.append(Finding(check, Level.OK, record.info_topic or "", "1"))
    try:
        camera = camera_from_info(record.infos[0], side)
    except CalibrationError as error:
        return [*findings, Finding.refused(f"{side} roi", error, "inside the sensor")], None
    try:
        check_calibrated(camera, side)
    except CalibrationError as error:
        refused = Finding.refused(f"{side} calibration", error, "size, K and P")
        return [*findings, replace(refused, value=f"{topic or side}: {refused.value}")], None
    if setup.rectified:
        camera = camera.rectified()
    own = check_camera(camera, side, rectified=setup.rectified)
    findings += own
    if not is_wrong(
        own, *(f"{side} {part}" for part in ("size", "K", "distortion", *(["P"] if setup.rectified else [])))
    ):
        findings += check_resolution(camera, side, *_size_of_K(setup, side, camera))
    return findings, camera


def _size_of_K(setup: StereoSetup, side: str, camera: CameraModel) -> tuple[int, int]:  # noqa: N802
    """Width and height that K is compared with: of the images where it fits them, else of the camera info.

    The check of the images reports where the two sizes differ.
    """
    if setup.pairs:
        height, width = getattr(setup.pairs[0], side).pixels.shape[:2]
        if fits_image(camera, width, height):
            return width, height
    return camera.width, camera.height


def _examine_streams(setup: StereoSetup) -> list[Finding]:
    missing = []
    for side, record in _sides(setup):
        if not len(record.stamps_ns):
            remedy = setup.silent.get(record.image_topic, "record it again, or name another topic")
            missing.append(Finding(f"{side} images", Level.ERROR, f"nothing on {record.image_topic}", "1", remedy))
    return missing or check_streams(setup.left.stamps_ns, setup.right.stamps_ns)


def _examine_images(setup: StereoSetup, cameras: list[CameraModel], before: list[Finding]) -> list[Finding]:
    """Sizes, frames and exposure."""
    if not setup.pairs:
        remedy = "make both cameras publish, or record both"
        return [Finding("images", Level.SKIPPED, "no pair of images", "1 pair", remedy)]
    findings = []
    for (side, record), camera in zip(_sides(setup), cameras, strict=False):
        frame = getattr(setup.pairs[0], side)
        height, width = frame.pixels.shape[:2]
        sensor = (record.infos[0].width, record.infos[0].height)
        if not is_wrong(before, f"{side} size"):
            known = not is_wrong(before, f"{side} K", f"{side} P" if setup.rectified else "")
            findings.append(check_image_size(camera, sensor, width, height, side, record.image_topic, known))
        findings.append(check_frame(cameras[0], cameras[1], side, frame.frame_id, record.image_topic))
    if setup.bits:
        findings.append(check_bit_depth(setup.bits))
    left, right = ([to_gray(getattr(pair, side)) for pair in setup.pairs] for side in ("left", "right"))
    findings += [check_exposure(left, "left"), check_exposure(right, "right"), check_two_cameras(left, right)]
    return findings


def _examine_rows(
    setup: StereoSetup,
    cameras: list[CameraModel],
    before: list[Finding],
    progress: Callable[[int, int], None],
    matcher: Matcher | None,
) -> list[Finding]:
    """Findings by the features of rectified images."""
    if not setup.pairs or is_wrong(before, "two cameras"):
        return []
    done = itertools.count(1)
    progress(0, len(setup.pairs))
    as_published = [(to_gray(pair.left), to_gray(pair.right)) for pair in setup.pairs]
    rig, why_not = _rig_of_images(setup, cameras)
    raw = None if setup.rectified else check_raw_rows(as_published[::2])
    findings = [] if raw is None else [raw]
    if rig is None and not setup.rectified:
        return [*findings, _not_rectified(raw)]
    given, exchanged, shown = _rectified(setup, rig, as_published)
    if shown is not None:
        findings.append(shown)
    matching = match_image_pairs(given, lambda: progress(next(done), len(setup.pairs)))
    columns_fit = not is_wrong(before, "left P[:, 3]", "right P[0,3]")
    order = check_camera_order(given, matching, exchanged, rig.doffs_px if rig else 0.0, columns_fit)
    findings.append(order)
    if order.level is Level.ERROR:
        return [*findings, Finding("rows", Level.SKIPPED, "not checked while the cameras are swapped")]
    height, width = given[0][0].shape
    findings.append(check_rows(matching, raw, width, height, rig.f_px if rig else None))
    if rig is not None:
        findings += check_depths(matching, rig, not why_not)
    if matcher is not None:
        findings += check_matcher(matcher, given)
    return findings


def _not_rectified(raw: Finding | None) -> Finding:
    """Rows that cannot be checked without a calibration; the images may be rectified already."""
    value = "no calibration to rectify with"
    median_px = raw.figures["median_px"] if raw is not None else None
    if median_px is None or median_px > GOOD_ROWS_PX:
        return Finding("rows", Level.SKIPPED, value)
    remedy = "the rows already match without rectification: the images may be rectified already"
    return Finding("rows", Level.SKIPPED, value, "", remedy)


def _rig_of_images(setup: StereoSetup, cameras: list[CameraModel]) -> tuple[StereoRig | None, str]:
    """The rig that rectifies the images as published, and why it gives no depth."""
    if not cameras:
        return None, ""
    rig, why_not = rectification_rig(cameras[0], cameras[1], (setup.left.image_topic, setup.right.image_topic))
    if rig is not None and any(
        frame.pixels.shape[:2] != (rig.height, rig.width) for pair in setup.pairs for frame in (pair.left, pair.right)
    ):
        return None, "the images and the camera infos differ in size: make them agree"
    return rig, why_not


def _rectified(
    setup: StereoSetup, rig: StereoRig | None, as_published: ImageArrayPairs
) -> tuple[ImageArrayPairs, Callable[[], ImageArrayPairs], Finding | None]:
    """The rectified images, what rectifies them swapped, and the finding on the share that has a source."""
    if rig is None:
        return as_published, lambda: [(right, left) for left, right in as_published], None
    rectifier = Rectifier(rig)

    def rectify(left: Any, right: Any) -> Any:
        rectified = rectifier.rectify(StereoPair(left, right))
        return rectified.left, rectified.right

    given = [rectify(pair.left, pair.right) for pair in setup.pairs]
    shown = rectifier.shown
    return given, lambda: [rectify(pair.right, pair.left) for pair in setup.pairs], check_shown(shown)
