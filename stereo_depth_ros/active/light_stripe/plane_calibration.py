# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of a light plane from images of its stripe on a board in several poses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.light_stripe.extraction import CHANNELS, StripeExtractor
from stereo_depth_ros.active.light_stripe.light_plane import LightPlane
from stereo_depth_ros.calibration.boards import Board, Corners
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.types import F64, U8, Frame
from stereo_depth_ros.geometry.rays import camera_rays, undistort_points
from stereo_depth_ros.geometry.robust import robust_sigma

__all__ = [
    "MIN_POSES",
    "BoardStripe",
    "PlaneCalibration",
    "board_pose",
    "board_stripe",
    "calibrate_plane",
    "fit_plane",
]

MIN_POSES = 3  # two stripes determine the plane, a third one verifies it
_MIN_POINTS = 10  # of a stripe on a board
_MAX_TILT_SIGMA_DEG = 0.5  # of the plane, about either axis
_TRIALS = 300  # of random samples
_MIN_ANGLE_DEG = 1.0  # between the rays and the light plane
_NEAR_PX = 1.0  # distance from a line within which points support it
_OUTLIER_SIGMAS = 4.0
_ITERATIONS = 20  # of reweighting
_TUKEY = 4.685  # of the biweight: efficiency of 95 % for normal errors
_LEAST_SIGMA_M = 1e-6
_MAX_RATIO = 8.0  # of the median residual of a pose to that of most: it is dropped above
_LEAST_LIMIT = 1e-3  # of the distance of the pose: boards are not more exact
_LEAST_SCALE = 2e-4  # of the distance: standard deviation of the points of a plane, at least


@dataclass(frozen=True, eq=False)
class BoardStripe:
    """A stripe on a board.

    Attributes:
        name: of the image.
        points_px: float64 (N, 2), of the stripe on the board, raw px.
        points_m: float64 (N, 3), the same points on the board, in the optical frame, meters.
        normal: float64 (3,), of the board.
        pose_rms_px: rms of the reprojection of the corners, px.
    """

    name: str
    points_px: F64
    points_m: F64
    normal: F64
    pose_rms_px: float


@dataclass(frozen=True, eq=False)
class PlaneCalibration:
    """Result of the calibration of a light plane.

    Attributes:
        plane: with standard deviations.
        stripes: those used.
        residuals_m: of the points of each stripe, signed distances from the plane, float64 (N,), meters.
        channel: name of the colors in which the stripe was sought.
        dropped: a sentence for each stripe that is not on the plane of the others.
        skipped: a sentence for each image without board or stripe.
    """

    plane: LightPlane
    stripes: list[BoardStripe]
    residuals_m: list[F64]
    channel: str
    dropped: list[str]
    skipped: list[str]

    @property
    def median_m(self) -> float:
        """Median absolute residual of all points, meters."""
        return float(np.median(np.abs(np.concatenate(self.residuals_m))))

    @property
    def rms_m(self) -> float:
        """Root mean square residual of all points, meters."""
        return float(np.sqrt(np.square(np.concatenate(self.residuals_m)).mean()))

    def residuals(self) -> dict[str, Any]:
        """Median and rms of the residuals, number of points, and the median of each pose; plain values, meters."""
        poses = {s.name: float(np.median(np.abs(r))) for s, r in zip(self.stripes, self.residuals_m, strict=True)}
        count = sum(map(len, self.residuals_m))
        return {"median_m": self.median_m, "rms_m": self.rms_m, "points": count, "poses": poses}


def board_pose(corners: Corners, camera: CameraModel) -> tuple[F64, F64, float]:
    """Rotation (3, 3) and translation (3,) in meters from the board to the camera, and the rms of the corners, px.

    By a method for planes (IPPE, Collins and Bartoli 2014), refined to the least reprojection error.

    Raises:
        CalibrationError: the corners have no pose in front of the camera.
    """
    seen = undistort_points(corners.image_px, camera)
    usable = np.isfinite(seen).all(axis=1)
    points, seen = corners.board_m[usable], seen[usable]
    try:
        found, rotation, translation = cv2.solvePnP(points, seen, camera.K, None, flags=cv2.SOLVEPNP_IPPE)
        rotation, translation = cv2.solvePnPRefineLM(points, seen, camera.K, None, rotation, translation)
    except cv2.error:  # collinear
        found = False
    if not found or not np.isfinite(translation).all() or translation[2, 0] <= 0:
        raise CalibrationError("its corners have no pose in front of the camera", remedy="check size and camera")
    errors = cv2.projectPoints(points, rotation, translation, camera.K, None)[0][:, 0] - seen
    rms = float(np.sqrt(np.square(errors).sum(axis=1).mean()))
    return np.asarray(cv2.Rodrigues(rotation)[0], np.float64), np.asarray(translation, np.float64).ravel(), rms


def board_region(gray: U8, corners: Corners, margin_m: float) -> npt.NDArray[np.bool_]:
    """Pixels of the board, bool (H, W): its corners, and what is white around them up to a margin.

    White is what is brighter than halfway between the dark and the bright squares, and connected with the board.

    Args:
        gray: uint8 (H, W).
        corners: on the board and in the image.
        margin_m: largest width of what lies outside the corners, meters.
    """
    inside, widest = (_rectangle(corners, gray.shape, margin) for margin in (0.0, margin_m))
    if not inside.any():
        return inside
    dark, bright = np.percentile(gray[inside], (10, 90))
    white = inside | (widest & (gray > (dark + bright) / 2))
    labels = np.asarray(cv2.connectedComponents(white.astype(np.uint8), connectivity=4)[1])
    return np.asarray(labels == np.bincount(labels[inside]).argmax(), bool)


def _rectangle(corners: Corners, shape: tuple[int, ...], margin_m: float) -> npt.NDArray[np.bool_]:
    """Pixels of the rectangle around the corners, enlarged by a margin on all sides, bool (H, W)."""
    low, high = corners.board_m[:, :2].min(axis=0) - margin_m, corners.board_m[:, :2].max(axis=0) + margin_m
    share = np.linspace(0.0, 1.0, 20)[:, None]
    outline = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
    edges = np.concatenate([a + share * (b - a) for a, b in pairwise(outline)])
    to_image, _ = cv2.findHomography(corners.board_m[:, :2], corners.image_px)
    mask = np.zeros(shape[:2], np.uint8)
    if to_image is not None:
        polygon = cv2.perspectiveTransform(edges[None], to_image)[0]
        cv2.fillPoly(mask, [np.clip(np.rint(polygon), -9999, 9999).astype(np.int32)], 1)
    return mask.astype(bool)


def board_stripe(
    name: str, frame: Frame, corners: Corners, camera: CameraModel, extractor: StripeExtractor, margin_m: float
) -> BoardStripe:
    """The stripe on a board: places within the board that are on one straight line of the board.

    Args:
        name: of the image.
        frame: the image.
        corners: of the board in it.
        camera: of the image.
        extractor: finds the stripe.
        margin_m: largest width of the board around its corners, meters.

    Raises:
        CalibrationError: the board has no pose, or too few places are on one line.
    """
    rotation, translation, rms_px = board_pose(corners, camera)
    region = board_region(to_gray(frame), corners, margin_m)
    points_px = extractor.extract(frame, _ranges(region if extractor.vertical else region.T)).points_px()
    rays = camera_rays(points_px, camera)
    normal = rotation[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        points_m = rays * (normal @ translation / (rays @ normal))[:, None]
    valid = np.isfinite(points_m).all(axis=1) & (points_m[:, 2] > 0)
    points_px, points_m = points_px[valid], points_m[valid]
    on_board = (points_m - translation) @ rotation[:, :2]
    kept = _on_line(on_board, _NEAR_PX * float(translation[2]) / float(camera.K[0, 0]))
    count = int(np.count_nonzero(kept))
    if count < _MIN_POINTS:
        raise CalibrationError(
            f"the stripe is found on {count} lines of the board, at least {_MIN_POINTS} are required",
            value=count,
            limit=_MIN_POINTS,
            remedy="hold the board into the laser",
        )
    return BoardStripe(name, points_px[kept], points_m[kept], normal, rms_px)


def _ranges(region: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """First and last column, excluded, of each row of a region, int32 (H, 2)."""
    found = region.any(axis=1)
    first = np.where(found, region.argmax(axis=1), 0)
    last = np.where(found, region.shape[1] - region[:, ::-1].argmax(axis=1), 0)
    return np.stack((first, last), axis=1).astype(np.int32)


def _on_line(points: F64, near: float) -> npt.NDArray[np.bool_]:
    """Which of some points, float64 (N, 2), are on the straight line that most of them are near; bool (N,)."""
    if len(points) < 2:
        return np.zeros(len(points), bool)
    random = np.random.default_rng(0)
    best = np.zeros(len(points), bool)
    for _ in range(_TRIALS):
        first, second = points[random.choice(len(points), 2, replace=False)]
        near_line = np.abs(_offsets(points, first, second - first)) < near
        if np.count_nonzero(near_line) > np.count_nonzero(best):
            best = near_line
    for _ in range(3):
        if np.count_nonzero(best) < 2:
            break
        center = points[best].mean(axis=0)
        direction = np.linalg.svd(points[best] - center, full_matrices=False)[2][0]
        offsets = _offsets(points, center, direction)
        best = np.abs(offsets) < max(min(near, _OUTLIER_SIGMAS * robust_sigma(offsets[best])), _LEAST_SIGMA_M)
    return best


def _offsets(points: F64, origin: F64, direction: F64) -> F64:
    length = float(np.hypot(*direction))
    if length == 0:
        return np.full(len(points), np.inf)
    x, y = (points - origin).T
    return np.asarray((x * direction[1] - y * direction[0]) / length, np.float64)


def fit_plane(points_m: F64, groups: npt.NDArray[np.int64]) -> tuple[LightPlane, F64]:
    """The plane of points with outliers: least median of random triples, then Tukey's biweight.

    Points of one group, which share the errors of one pose, count together as one observation in the standard
    deviations (a sandwich estimator for groups, Liang and Zeger 1986).

    Args:
        points_m: float64 (N, 3), at least three.
        groups: int64 (N,), number of the group of each point.

    Returns:
        The plane, and the weights of the points, float64 (N,) in [0, 1].
    """
    plane = _sampled(points_m, groups)
    weights = np.ones(len(points_m))
    for _ in range(_ITERATIONS):
        residuals = plane.distances(points_m)
        scale = max(robust_sigma(residuals), _LEAST_SCALE * float(np.linalg.norm(plane.center_m)), _LEAST_SIGMA_M)
        weights = np.square(np.clip(1 - np.square(residuals / (_TUKEY * scale)), 0, None))
        plane = _weighted(points_m, weights)
    return _with_sigmas(plane, points_m, weights, groups), weights


def _sampled(points_m: F64, groups: npt.NDArray[np.int64]) -> LightPlane:
    random = np.random.default_rng(0)
    best, least = _weighted(points_m, np.ones(len(points_m))), np.inf
    for _ in range(_TRIALS):
        sample = points_m[random.choice(len(points_m), 3, replace=False)]
        normal = np.cross(sample[1] - sample[0], sample[2] - sample[0])
        if not np.linalg.norm(normal) > 0:
            continue
        plane = LightPlane.exact(normal, -float(normal @ sample[0]))
        median = float(np.median(np.abs(plane.distances(points_m))))
        if median < least:
            best, least = plane, median
    return best


def _weighted(points_m: F64, weights: F64) -> LightPlane:
    """The plane of least weighted squares, its normal so that D is negative or zero: it points away from the camera."""
    center = np.average(points_m, axis=0, weights=weights)
    axes = np.linalg.svd(np.sqrt(weights)[:, None] * (points_m - center), full_matrices=False)[2]
    normal = axes[2] if axes[2] @ center >= 0 else -axes[2]
    return LightPlane(normal, float(-normal @ center), center, axes[:2])


def _with_sigmas(plane: LightPlane, points_m: F64, weights: F64, groups: npt.NDArray[np.int64]) -> LightPlane:
    along = (points_m - plane.center_m) @ plane.tilt_axes.T
    jacobian = np.column_stack((np.ones(len(along)), along))
    bread = np.linalg.pinv((weights[:, None] * jacobian).T @ jacobian)
    scores = (weights * plane.distances(points_m))[:, None] * jacobian
    count = int(groups.max()) + 1
    sums = np.stack([scores[groups == group].sum(axis=0) for group in range(count)])
    covariance = bread @ (sums.T @ sums) @ bread * (count / max(count - 3, 1))
    sigmas = np.sqrt(np.clip(covariance.diagonal(), 0, None))
    return replace(plane, offset_sigma_m=float(sigmas[0]), tilt_sigma=(float(sigmas[1]), float(sigmas[2])))


def calibrate_plane(
    images: Iterable[tuple[str, Frame]],
    board: Board,
    camera: CameraModel,
    config: LightStripeConfig,
    margin_m: float,
) -> PlaneCalibration:
    """The light plane from images of its stripe on a board.

    Args:
        images: names and images; at least three poses of the board, at different distances and tilted.
        board: the board.
        camera: of the images.
        config: how the stripe is found; with the channel "auto" the one that finds most places on the boards is taken.
        margin_m: largest width of the board around its corners, meters.

    Raises:
        CalibrationError: an image has another size than the camera, too few images show board and stripe, or the poses
            do not determine the plane.
    """
    channels = [*CHANNELS] if config.stripe_channel == "auto" else [config.stripe_channel]
    extractors = {name: StripeExtractor(replace(config, stripe_channel=name)) for name in channels}
    found: dict[str, list[BoardStripe]] = {name: [] for name in channels}
    without: dict[str, list[str]] = {name: [] for name in channels}
    count = 0
    for label, frame in images:
        count += 1
        _check_size(label, frame, camera)
        corners = board.detect(to_gray(frame))
        for name in channels:
            if corners is None:
                without[name].append(f"{label}: no board of {board.size[0]}x{board.size[1]} {board.counted}")
                continue
            try:
                found[name].append(board_stripe(label, frame, corners, camera, extractors[name], margin_m))
            except CalibrationError as error:
                without[name].append(f"{label}: {error.problem}")
    channel = max(channels, key=lambda name: sum(len(stripe.points_px) for stripe in found[name]))
    stripes, skipped = found[channel], without[channel]
    if len(stripes) < MIN_POSES:
        raise CalibrationError(
            f"board and stripe are found in {len(stripes)} of {count} images, at least {MIN_POSES} are required"
            f"{_because(skipped)}",
            value=len(stripes),
            limit=MIN_POSES,
            remedy="take images of the board in different poses, each with the stripe across it",
            settings=("size", "stripe_channel"),
        )
    plane, stripes, dropped = _without_outliers(stripes)
    if len(stripes) < MIN_POSES:
        raise CalibrationError(
            f"{len(stripes)} stripes are on one plane, at least {MIN_POSES} are required"
            f"{_because([*dropped, *skipped])}",
            value=len(stripes),
            limit=MIN_POSES,
            remedy="check that laser and camera did not move between the images",
        )
    _check_determined(plane, stripes)
    _check_angle(plane, stripes)
    residuals = [plane.distances(stripe.points_m) for stripe in stripes]
    return PlaneCalibration(plane, stripes, residuals, channel, dropped, skipped)


def _fitted(stripes: Sequence[BoardStripe]) -> LightPlane:
    groups = np.repeat(np.arange(len(stripes)), [len(stripe.points_m) for stripe in stripes])
    return fit_plane(np.concatenate([stripe.points_m for stripe in stripes]), groups)[0]


def _without_outliers(stripes: list[BoardStripe]) -> tuple[LightPlane, list[BoardStripe], list[str]]:
    """The plane of the stripes, those on it, and a sentence for each of the others."""
    kept = list(stripes)
    dropped: list[str] = []
    while True:
        plane = _fitted(kept)
        medians = np.array([np.median(np.abs(plane.distances(stripe.points_m))) for stripe in kept])
        worst = int(np.argmax(medians))
        limit = max(_MAX_RATIO * float(np.median(medians)), _LEAST_LIMIT * float(kept[worst].points_m[:, 2].mean()))
        if medians[worst] <= limit or len(kept) < MIN_POSES:
            return plane, kept, dropped
        dropped.append(
            f"{kept[worst].name}: its stripe is {1e3 * medians[worst]:.2f} mm off the plane of the others, "
            f"{1e3 * limit:.2f} mm is the limit"
        )
        del kept[worst]


def _check_size(name: str, frame: Frame, camera: CameraModel) -> None:
    height, width = frame.pixels.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise CalibrationError(
            f"the image is {width}x{height}, the camera is calibrated for {camera.width}x{camera.height}",
            subject=name,
            value=(width, height),
            limit=(camera.width, camera.height),
            remedy="use the calibration of this camera at this size",
            settings=("camera",),
        )


def _check_determined(plane: LightPlane, stripes: Sequence[BoardStripe]) -> None:
    """Raise CalibrationError where the stripes are nearly one line: the plane may turn about it."""
    points_m = np.concatenate([stripe.points_m for stripe in stripes])
    extent_m = float((np.abs((points_m - plane.center_m) @ plane.tilt_axes[1])).max())
    noise_m = float(np.median(np.abs(plane.distances(points_m))))
    sigma_deg = np.degrees(max(plane.tilt_sigma[1], noise_m / max(extent_m, 1e-12)))
    if sigma_deg <= _MAX_TILT_SIGMA_DEG and extent_m >= 0.01 * float(plane.center_m @ plane.center_m) ** 0.5:
        return
    normals = np.stack([stripe.normal for stripe in stripes])
    angle_deg = float(np.degrees(np.arccos(np.clip(np.abs(normals @ normals.T), 0, 1)).max()))
    raise CalibrationError(
        f"the stripes of {len(stripes)} poses are nearly one line: they extend {1e3 * extent_m:.1f} mm across it, the "
        f"plane may turn about it by {sigma_deg:.2f} degrees, {_MAX_TILT_SIGMA_DEG:g} is the limit (the boards "
        f"differ by up to {angle_deg:.1f} degrees)",
        value=float(sigma_deg),
        limit=_MAX_TILT_SIGMA_DEG,
        remedy="hold the board at different distances, and tilt it",
    )


def _check_angle(plane: LightPlane, stripes: Sequence[BoardStripe]) -> None:
    """Raise CalibrationError where the camera looks along the light plane: its rays have no place on it."""
    points_m = np.concatenate([stripe.points_m for stripe in stripes])
    sines = np.abs(plane.d_m) / np.linalg.norm(points_m, axis=1)
    angle_deg = float(np.degrees(np.arcsin(min(float(np.median(sines)), 1.0))))
    if angle_deg < _MIN_ANGLE_DEG:
        raise CalibrationError(
            f"the light plane passes {1e3 * abs(plane.d_m):.1f} mm from the camera, its rays meet it at "
            f"{angle_deg:.2f} degrees, {_MIN_ANGLE_DEG:g} is the limit",
            value=angle_deg,
            limit=_MIN_ANGLE_DEG,
            remedy="place the laser farther from the camera",
        )


def _because(skipped: Sequence[str]) -> str:
    shown = "; ".join(skipped[:3]) + (f" and {len(skipped) - 3} more" if len(skipped) > 3 else "")
    return f" ({shown})" if skipped else ""
