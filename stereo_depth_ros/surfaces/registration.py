# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Registration of a range image with another one or with points of a surface: the pose between them (ICP)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError, RegistrationError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.geometry.robust import robust_sigma
from stereo_depth_ros.surfaces.mesh import Mesh, normal_image
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.registration_kernels import (
    CHUNK,
    OUTSIDE,
    accumulate,
    measure,
    nearest,
    project,
)

__all__ = ["OrientedImage", "OrientedPoints", "Registration", "moved_by", "register"]

I32 = npt.NDArray[np.int32]

_RADIUS_PX = 2  # of the windows of normals
_STRIDES, _LEAST_POINTS = (8, 4, 2), 2000  # coarse levels, and points that make one worthwhile
_DENSER = 2.0  # pixels for each point of the target
_MOST_STEPS = 40  # of a level
# Root mean square of a step in standard deviations: that of one that has converged, and of those that may not become
# smaller any more, as the corresponding points change from pixel to pixel.
_SMALL_STEP, _FLOOR = 0.01, 0.1
_REACH = 0.5  # largest distance of corresponding points, relative to the depth
_LEAST_COSINE = 0.5  # of the angle between their normals
_TUKEY = 4.685  # residuals from which on the weight is 0: 95 % efficiency (Holland and Welsch 1977)
_FIRST_SHARE, _FIRST_CUT, _NARROWING = 90.0, 3.0, 1.5  # the first cut: percentile of residuals and its factor
_INLIER = 3.0
_LARGEST_SCALE = 4.0  # of the residuals in standard deviations, in the end
_FEWEST, _LEAST_OVERLAP = 100, 0.03
_SMALLEST_RATIO = 1e-5  # of eigenvalues
_SIGNIFICANCE = 4.0  # of an eigenvalue, in its own standard deviations
_TESTED = 40000  # points of that test


@dataclass(frozen=True, eq=False)
class OrientedImage:
    """A range image and its normals; made once for an image that is registered several times.

    Attributes:
        image: the range image.
        normals: float32 (H, W, 3), unit vectors that point to the side of the camera, NaN where there is none.
    """

    image: RangeImage
    normals: F32

    @classmethod
    def of(cls, image: RangeImage) -> OrientedImage:
        """With the normals of :func:`normal_image`."""
        return cls(image, normal_image(image, radius_px=_RADIUS_PX))


@dataclass(frozen=True, eq=False)
class OrientedPoints:
    """Points of a surface with normals, such as the vertices of a mesh.

    Attributes:
        points_m: float32 (N, 3), meters.
        normals: float32 (N, 3), unit vectors that point to the side from which the surface is seen.
        sigma_m: float32 (N,), standard deviation along the normal, meters.

    Points with a value that is not finite are not used.
    """

    points_m: F32
    normals: F32
    sigma_m: F32

    @classmethod
    def of(cls, mesh: Mesh, sigma_m: float) -> OrientedPoints:
        """The vertices of a mesh, all with one standard deviation."""
        return cls(mesh.points_m, mesh.normals, np.full(len(mesh.points_m), sigma_m, np.float32))


@dataclass(frozen=True, eq=False)
class Registration:
    """Where a range image lies.

    Attributes:
        pose: from the frame of the source to that of the target.
        covariance: float64 (6, 6), of a small motion (rotation vector in rad, translation in m) that follows the pose,
            in the frame of the target: X -> X + rotation x X + translation.
        corresponding: number of points that have a corresponding point.
        inlier_share: share of them within three standard deviations.
        residual_rms: root mean square of the distances of the inliers along the normals, in standard deviations; about
            1 where the standard deviations of the depths are right.
        iterations: number of steps, of all levels.
    """

    pose: Pose
    covariance: F64
    corresponding: int
    inlier_share: float
    residual_rms: float
    iterations: int


def register(source: OrientedImage, target: OrientedImage | OrientedPoints, start: Pose) -> Registration:
    """The pose of a range image relative to a surface, from a start near it, by distances along normals.

    Iterative closest points with the distance from a point to the plane of the corresponding one (Chen and Medioni
    1992), divided by its standard deviation: those of both depths along their rays, as far as they are along the
    normal. Corresponding is what lies in the same pixel of the target (Blais and Levine 1995), or the nearest point of
    a grid. The weights are those of Tukey, whose width falls from that of nearly all residuals at the start to that of
    the noise; levels go from every eighth pixel to all.

    The start may be wrong by about 10 degrees and 10 % of the depth, less where little of the surfaces overlaps.

    Args:
        source: the range image whose pose is sought.
        target: a range image or points of a surface; its frame is that of the result.
        start: from the frame of the source to that of the target.

    Raises:
        RegistrationError: too few corresponding points; a motion that the surfaces do not determine, as that along a
            plane; surfaces that do not fit, as from a start that is too far away.
        ConfigError: a start that is not finite.
    """
    _check_start(start)
    levels = _levels(source)
    if isinstance(target, OrientedPoints):  # more pixels than points have the errors of the same points
        levels = [level for level in levels if len(level.points) <= _DENSER * len(target.points_m)] or levels[:1]
    surface = _surface(target, source, len(levels))
    pose, steps, cut = start, 0, math.inf
    for number, level in enumerate(levels):
        surface.use_level(number)
        pose, taken, cut, converged = _approach(level, surface, pose, cut)
        steps += taken
    return _result(levels[-1], surface, pose, steps, converged)


def moved_by(pose: Pose, motion: F64) -> Pose:
    """The pose followed by a motion, float64 (6,): rotation vector in rad, and translation in m."""
    R = np.asarray(cv2.Rodrigues(np.asarray(motion[:3], np.float64))[0], np.float64)
    return Pose(R, np.asarray(motion[3:], np.float64)) @ pose


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of the source: finite float32 (N, 3), (N, 3), (N,).

    Attributes:
        middle: float64 (1, 3), the mean of the points.
        length: their root mean square distance from it, m: rotations times this length and translations are alike.
    """

    points: F32
    normals: F32
    sigma: F32
    middle: F64
    length: float

    def center(self, pose: Pose) -> F64:
        """The mean in the frame of the target, float64 (3,)."""
        return np.asarray(pose.apply(self.middle)[0], np.float64)


class _Surface(Protocol):
    points: F32
    normals: F32
    sigma: F32

    def use_level(self, number: int) -> None: ...

    def correspond(self, source: _Points, pose: Pose) -> I32: ...


class _ImageSurface:
    """A range image as a target."""

    def __init__(self, target: OrientedImage) -> None:
        image = target.image
        self.points = image.points().reshape(-1, 3)
        self.normals = target.normals.reshape(-1, 3)
        self.sigma = _along_normals(self.points, self.normals, image.sigma_m.ravel())
        t = image.triangulation
        self._camera, self._size = np.array([t.f_px, t.fy_px, t.cx_px, t.cy_px]), image.size

    def use_level(self, number: int) -> None:
        """All levels are the same."""

    def correspond(self, source: _Points, pose: Pose) -> I32:
        index = np.empty(len(source.points), np.int32)
        given = (source.points, source.normals, pose.rotation, pose.translation_m, self.points, self.normals)
        limits = (*self._size, self._camera, _LEAST_COSINE, _REACH)
        run_bands(project, len(index), *given, *limits, index, min_rows=4096)
        return index


class _PointSurface:
    """Points as a target, in a grid for each level; coarse levels have fewer points and larger cells."""

    def __init__(self, target: OrientedPoints, source: _Points, levels: int) -> None:
        finite = np.flatnonzero(
            np.isfinite(np.column_stack((target.points_m, target.normals, target.sigma_m))).all(axis=1)
        )
        if len(finite) < _FEWEST:
            raise _too_few(len(finite), len(target.points_m), "points of the target are finite")
        self._all = tuple(a[finite] for a in (target.points_m, target.normals, target.sigma_m))
        finest = max(4 * _spacing(self._all[0]), 2 * _INLIER * float(np.median(source.sigma)))
        coarsest = max(0.2 * _REACH * float(np.median(source.points[:, 2])), finest)
        self._reaches = np.geomspace(coarsest, finest, levels) if levels > 1 else np.array([finest])
        self.use_level(0)

    def use_level(self, number: int) -> None:
        self._reach = float(self._reaches[number])
        points, normals, sigma = self._all
        if number + 1 < len(self._reaches):
            keys, _, _ = _cells(points, 0.25 * self._reach)
            kept = np.unique(keys, return_index=True)[1]
            points, normals, sigma = points[kept], normals[kept], sigma[kept]
        keys, self._counts, self._corner = _cells(points, self._reach)
        order = np.argsort(keys, kind="stable")
        self._keys = keys[order]
        self.points, self.normals, self.sigma = points[order], normals[order], sigma[order]

    def correspond(self, source: _Points, pose: Pose) -> I32:
        index = np.empty(len(source.points), np.int32)
        given = (source.points, source.normals, pose.rotation, pose.translation_m, self.points, self.normals)
        grid = (self._keys, self._counts, self._corner, self._reach, _LEAST_COSINE)
        run_bands(nearest, len(index), *given, *grid, index, min_rows=4096)
        return index


@dataclass(frozen=True, eq=False)
class _Fit:
    """Corresponding points at a pose."""

    index: I32
    spread: F32
    residual: F32
    found: F32  # residuals of those that have one, absolute
    scale: float


def _surface(target: OrientedImage | OrientedPoints, source: OrientedImage, levels: int) -> _Surface:
    if isinstance(target, OrientedImage):
        return _ImageSurface(target)
    return _PointSurface(target, _points(source, 1), levels)


def _levels(source: OrientedImage) -> list[_Points]:
    """The points of the source, every eighth of a row and a column first."""
    finest = _points(source, 1)
    if len(finest.points) < _FEWEST:
        raise _too_few(len(finest.points), source.image.depth_m.size, "pixels of the source have a depth and a normal")
    coarse = (_points(source, stride) for stride in _STRIDES)
    return [*(level for level in coarse if len(level.points) >= _LEAST_POINTS), finest]


def _points(source: OrientedImage, stride: int) -> _Points:
    points, normals = source.image.points()[::stride, ::stride], source.normals[::stride, ::stride]
    used = np.isfinite(points[:, :, 2]) & np.isfinite(normals[:, :, 2])
    points = points[used]
    some = points[:: max(1, len(points) // 5000)].astype(np.float64)
    middle = some.mean(axis=0, keepdims=True) if len(some) else np.zeros((1, 3))
    length = math.sqrt(float(np.sum(np.square(some - middle))) / max(len(some), 1))
    sigma_m = source.image.sigma_m[::stride, ::stride][used]
    return _Points(points, normals[used], sigma_m, middle, max(length, 1e-9))


def _along_normals(points: F32, normals: F32, sigma_m: F32) -> F32:
    """The standard deviation of a depth, along the normal: that along the ray, as far as it is."""
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.einsum("ij,ij->i", points, normals) / points[:, 2]
    return np.asarray(np.abs(cosine) * sigma_m, np.float32)


def _cells(points: F32, size_m: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], F64]:
    """The cell of each point, the number of cells along x, y and z, and the corner of the grid, float64 (1, 3)."""
    corner = points.min(axis=0).astype(np.float64)
    places = np.floor((points - corner) / size_m).astype(np.int64)
    counts = places.max(axis=0) + 1
    return (places[:, 2] * counts[1] + places[:, 1]) * counts[0] + places[:, 0], counts, corner[None]


def _spacing(points: F32) -> float:
    """The median distance of a point from its nearest neighbor, m."""
    some = np.arange(0, len(points), max(1, len(points) // 100))
    squared = [np.partition(np.sum(np.square(points - points[i]), axis=1), 1)[1] for i in some]
    return math.sqrt(float(np.median(squared)))


def _approach(source: _Points, surface: _Surface, pose: Pose, cut: float) -> tuple[Pose, int, float, bool]:
    """Steps of one level: the pose, their number, the width of the weights, and whether they have converged."""
    before = math.inf
    for step in range(1, _MOST_STEPS + 1):
        fit = _fit(source, surface, pose)
        least = _TUKEY * max(1.0, fit.scale)
        if math.isinf(cut):
            cut = _FIRST_CUT * float(np.percentile(fit.found, _FIRST_SHARE))
        else:
            cut /= _NARROWING
        narrow = cut <= least
        cut = max(cut, least)
        (own, _), gradient = _normal_equations(source, surface, fit, pose, cut)
        motion = -np.linalg.lstsq(own, gradient, rcond=1e-9)[0]
        pose = _moved_about(pose, motion, source.center(pose), source.length)
        size = math.sqrt(max(float(motion @ own @ motion), 0.0) / 6)
        if narrow and (size <= _SMALL_STEP or before <= size <= _FLOOR):
            return pose, step, cut, True
        before = size if narrow else math.inf
    return pose, _MOST_STEPS, cut, False


def _fit(source: _Points, surface: _Surface, pose: Pose) -> _Fit:
    index = surface.correspond(source, pose)
    spread, residual = np.empty(len(index), np.float32), np.empty(len(index), np.float32)
    given = (source.points, source.sigma, pose.rotation, pose.translation_m)
    run_bands(
        measure, len(index), *given, surface.points, surface.normals, surface.sigma, index, spread, residual,
        min_rows=4096,
    )  # fmt: skip
    found = np.abs(residual[index >= 0])
    if len(found) < max(_FEWEST, _LEAST_OVERLAP * len(index)):
        raise _too_few(len(found), len(index), "points have a corresponding point")
    return _Fit(index, spread, residual, found, robust_sigma(found))


def _normal_equations(source: _Points, surface: _Surface, fit: _Fit, pose: Pose, cut: float) -> tuple[F64, F64]:
    """The sums of :func:`accumulate`: float64 (2, 6, 6) and (6,)."""
    chunks = -(-len(source.points) // CHUNK)
    matrices, gradients = np.empty((chunks, 2, 6, 6)), np.empty((chunks, 6))
    of_surface = (surface.points, surface.normals, surface.sigma)
    given = (source.points, source.normals, pose.rotation, pose.translation_m, *of_surface)
    sums = (fit.index, fit.spread, fit.residual, source.center(pose), source.length, cut, matrices, gradients)
    run_bands(accumulate, chunks, *given, *sums, min_rows=2)
    upper = matrices.sum(axis=0)
    return upper + np.triu(upper, 1).transpose(0, 2, 1), gradients.sum(axis=0)


def _moved_about(pose: Pose, motion: F64, center: F64, length: float) -> Pose:
    """The pose followed by a motion (rotation vector * length, translation) about a center."""
    R = np.asarray(cv2.Rodrigues(motion[:3] / length)[0], np.float64)
    return Pose(R, center - R @ center + motion[3:]) @ pose


def _result(source: _Points, surface: _Surface, pose: Pose, steps: int, converged: bool) -> Registration:
    fit = _fit(source, surface, pose)
    scale = max(1.0, fit.scale)
    center, length = source.center(pose), source.length
    cut = _TUKEY * scale
    (_, cross), _ = _normal_equations(source, surface, fit, pose, cut)
    used = np.flatnonzero((fit.index >= 0) & (np.abs(fit.residual) < cut))
    rows = _rows(source, surface, fit, pose, used)
    _check_directions(rows, cross, center)
    considered = int(np.count_nonzero(fit.index != OUTSIDE))
    inliers = fit.found[fit.found <= _INLIER * scale]
    share = len(inliers) / considered
    if fit.scale > _LARGEST_SCALE:
        raise RegistrationError(
            f"the surfaces are {fit.scale:.1f} standard deviations apart, {_LARGEST_SCALE:g} is the limit",
            value=fit.scale,
            limit=_LARGEST_SCALE,
            remedy="start nearer, within about 10 degrees and 10 % of the depth, or state larger standard deviations",
        )
    if share < 0.5:
        raise RegistrationError(
            f"{share:.0%} of the corresponding points fit, 50 % is the limit",
            value=share,
            limit=0.5,
            remedy="start nearer, within about 10 degrees and 10 % of the depth, or choose views that overlap more",
        )
    if not converged:
        raise RegistrationError(
            f"no end after {steps} steps",
            value=steps,
            limit=steps,
            remedy="start nearer, within about 10 degrees and 10 % of the depth",
        )
    inverse, noise = np.linalg.inv(cross), _noise(rows[0], fit, used, cut, len(surface.points))
    back = np.zeros((6, 6))  # from (rotation vector * length, translation) about the center to a motion
    back[:3, :3], back[3:, :3], back[3:, 3:] = np.identity(3) / length, _cross(center) / length, np.identity(3)
    covariance = back @ inverse @ noise @ inverse @ back.T
    rms = math.sqrt(float(np.mean(np.square(inliers.astype(np.float64)))))
    return Registration(pose, covariance, len(fit.found), share, rms, steps)


def _cross(v: F64) -> F64:
    """The matrix of the cross product with v."""
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], np.float64)


def _rows(source: _Points, surface: _Surface, fit: _Fit, pose: Pose, used: npt.NDArray[np.intp]) -> tuple[F64, F64]:
    """Rows of the Jacobian, float64 (M, 6), with the normals of the target and of the source: as :func:`accumulate`."""
    index, spread = fit.index[used], fit.spread[used, None].astype(np.float64)
    p = pose.apply(source.points[used].astype(np.float64))
    p += (1 - np.square(surface.sigma[index, None] / spread)) * (surface.points[index] - p)
    p = (p - source.center(pose)) / source.length
    n, m = surface.normals[index] / spread, (source.normals[used] @ pose.rotation.T) / spread
    a, b = (np.concatenate((np.cross(p, k), k), axis=1) for k in (n, m))
    return a, b


def _noise(rows: F64, fit: _Fit, used: npt.NDArray[np.intp], cut: float, targets: int) -> F64:
    """The covariance of the gradient, float64 (6, 6), from the residuals (Huber 1967).

    Points with the same corresponding point have a common error: they count as one.
    """
    residual = fit.residual[used].astype(np.float64)
    pull = (residual * np.square(1 - np.square(residual / cut)))[:, None] * rows
    sums = [np.bincount(fit.index[used], weights=column, minlength=targets) for column in pull.T]
    return np.array([[one @ other for other in sums] for one in sums])


def _check_directions(rows: tuple[F64, F64], cross: F64, center: F64) -> None:
    """Refuse surfaces along which the source could move.

    The information about a motion is the sum of products of the distances it causes along both normals, that of the
    target and that of the source, whose errors are independent: along a plane its mean is 0, where that of the squares
    would be the noise of the normals. It counts where it is above its own standard deviation.
    """
    values, vectors = np.linalg.eigh(cross)
    thinning = max(1, len(rows[0]) // _TESTED)
    products = (rows[0][::thinning] @ vectors) * (rows[1][::thinning] @ vectors)
    windows = max(1.0, (2 * _RADIUS_PX + 1) ** 2 / thinning)  # pixels whose normals have a common part
    noise = np.sqrt(windows * np.square(products).sum(axis=0))
    free = (products.sum(axis=0) < _SIGNIFICANCE * noise) | (values < _SMALLEST_RATIO * values[-1])
    if free.any():
        raise RegistrationError(
            f"the surfaces do not determine {_motions(vectors[:, free], center)}",
            value=float(values[0] / values[-1]),
            limit=_SMALLEST_RATIO,
            remedy="choose views that show surfaces of three directions, or give the pose from another source",
        )


def _motions(free: F64, center: F64) -> str:
    """Motions (rotation vector * length, translation), float64 (6, K), in words: translations first."""
    _, turning, mixed = np.linalg.svd(free[:3])
    motions = free @ mixed.T
    turning = np.concatenate((turning, np.zeros(free.shape[1] - len(turning))))
    told = []
    for motion, share in sorted(zip(motions.T, turning, strict=True), key=lambda pair: float(pair[1])):
        vector = motion[3:] if share < 0.5 else motion[:3]
        vector = vector / np.linalg.norm(vector)
        vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
        direction = "({:.2f}, {:.2f}, {:.2f})".format(*(vector + 0.0))
        place = "({:.2f}, {:.2f}, {:.2f}) m".format(*(center + 0.0))
        told.append(f"the motion along {direction}" if share < 0.5 else f"the turn about {direction} through {place}")
    return ", ".join(told)


def _check_start(start: Pose) -> None:
    if not np.isfinite(start.matrix).all():
        raise ConfigError(
            f"start = {start.matrix[:3].tolist()} is not finite",
            value=start.matrix,
            limit="finite numbers",
            remedy="give a rotation and a translation in meters",
            settings=("start",),
        )


def _too_few(count: int, of: int, what: str) -> RegistrationError:
    least = max(_FEWEST, math.ceil(_LEAST_OVERLAP * of))
    return RegistrationError(
        f"{count} of {of} {what}, {least} is the limit",
        value=count,
        limit=least,
        remedy="choose views that overlap, and a start within about 10 degrees and 10 % of the depth",
    )
