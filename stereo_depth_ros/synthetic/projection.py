# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Synthetic captures of active stereo: what two cameras see of the patterns of a projector, with exact truth.

The projector has a gamma, a lens that is out of focus and darkens towards the corners, and colors that mix. Surfaces
are matte or glossy, reflect light onto each other once, and cast shadows. The cameras add ambient light, vignetting,
noise and saturation.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.synthetic.rays import SUPERSAMPLING, in_shadow, rays_of, trace
from stereo_depth_ros.synthetic.rig import (
    CENTER_LEFT_RIGHT_M,
    R_RIGHT_LEFT,
    inside_raw_image,
    product,
    raw_pixels,
    rotation_into,
    synthetic_rig,
)
from stereo_depth_ros.synthetic.scene import Cylinder, Primitive, Rectangle, Scene, Sphere, Texture

__all__ = ["Gloss", "Optics", "ScannerTruth", "SyntheticScanner", "scanner_scene"]

# X_projector = R_PROJECTOR_LEFT (X_left - CENTER_LEFT_PROJECTOR_M), in the frame of the raw left camera
R_PROJECTOR_LEFT = rotation_into(math.radians(12.0), math.radians(-1.5), math.radians(-0.6))
CENTER_LEFT_PROJECTOR_M = np.array([0.26, -0.03, 0.02])

_K_PROJECTOR = ((0.74, 0.0, 0.492), (0.0, 0.75, 0.53), (0.0, 0.0, 1.0))  # of the width; cy of the height
_D_PROJECTOR = np.array([-0.04, 0.01, 0.0004, -0.0003, 0.0])

_WHITE_LEVEL = 190.0  # of the brighter surfaces under a white pattern; highlights saturate
_CELLS = 40  # columns of the grid of projector pixels whose light is reflected onto other surfaces
_GLOBAL_STEP = 8  # pixels between the points at which that light is computed
_TINTS = np.array([[1.0, 0.93, 0.82], [0.88, 1.0, 0.95], [0.97, 0.9, 1.0]])  # RGB of the surfaces, in turns


@dataclass(frozen=True)
class Gloss:
    """A glossy surface: a lobe around the mirrored light (Phong 1975) beside its matte reflection.

    Attributes:
        strength: of the lobe, relative to a white matte surface.
        exponent: the higher, the sharper.
    """

    strength: float = 2.5
    exponent: float = 40.0


@dataclass(frozen=True)
class Optics:
    """What stands between a pattern and an image of it.

    Attributes:
        projector_gamma: the light of a pattern level p is (p / 255) ** gamma.
        defocus_px: standard deviation of the blur of the projector, projector px.
        crosstalk: share of each color of the projector that the other two color channels of a camera see.
        vignetting: share of the light that is missing in the corners, of the cameras and of the projector.
        ambient: light that is always there, relative to that of the projector at a distance of 1 m.
        black: light of the projector where a pattern is black, relative to white.
        noise: standard deviation of the read noise, gray levels.
        shot: variance of the shot noise for each gray level.
        interreflection: factor of the light that surfaces reflect onto each other; 0 leaves it out.
    """

    projector_gamma: float = 2.2
    defocus_px: float = 0.7
    crosstalk: float = 0.08
    vignetting: float = 0.25
    ambient: float = 0.06
    black: float = 0.01
    noise: float = 0.8
    shot: float = 0.01
    interreflection: float = 1.0


@dataclass(frozen=True)
class ScannerTruth:
    """Truth of the rectified left image of a scanner.

    Attributes:
        depth_m: float32 (H, W), Z in the rectified left frame, meters; NaN without a surface.
        disparity_px: float32 (H, W), x_left - x_right of the rectified images, px; NaN without a surface.
        occluded: bool (H, W), the right camera does not see the point.
        column_px, row_px: float32 (H, W), where the projector lights the point, projector px; NaN where it does not.
        lit: bool (H, W), whether the projector lights the point.
        surface: int32 (H, W), index of the primitive of the scene; -1 without a surface.
    """

    depth_m: F32
    disparity_px: F32
    occluded: npt.NDArray[np.bool_]
    column_px: F32
    row_px: F32
    lit: npt.NDArray[np.bool_]
    surface: npt.NDArray[np.int32]


class SyntheticScanner:
    """Two cameras and a projector before a scene; the cameras are those of :func:`synthetic_rig`.

    Args:
        width, height: size of the images of the cameras, px; the field of view is the same at all sizes.
        projector_size: width, height of the projector, px.
        scene: surfaces in the frame of the raw left camera; None uses :func:`scanner_scene`.
        gloss: the glossy surfaces, by index of the primitive; None uses those of :func:`scanner_scene`.
        prints: images, uint8 (h, w) or (h, w, 3) RGB, on rectangles by index of the primitive, in place of their
            textures; the columns run along ``edge_u``.
        optics: of the projector and the cameras.
        seed: of the noise and of the textures.

    Attributes:
        rig: the cameras.
        projector: the projector as a camera; its image has ``projector_size``.
        R_projector_left: float64 (3, 3), and
        T_projector_left: float64 (3,), meters: X_projector = R X_left + T, from the frame of the raw left camera.

    Raises:
        ConfigError: a size that is not above 0.
    """

    def __init__(
        self,
        width: int = 640,
        height: int = 480,
        projector_size: tuple[int, int] = (1024, 768),
        *,
        scene: Scene | None = None,
        gloss: Mapping[int, Gloss] | None = None,
        prints: Mapping[int, U8] | None = None,
        optics: Optics = Optics(),
        seed: int = 7,
    ) -> None:
        if min(width, height, *projector_size) < 1:
            raise ConfigError(
                f"sizes {width}x{height} and {projector_size[0]}x{projector_size[1]} are not above 0",
                subject="synthetic scanner",
                value=(width, height, *projector_size),
                limit=1,
                remedy="set positive sizes",
            )
        self.rig = synthetic_rig(width, height)
        self.projector = _projector(projector_size)
        self.R_projector_left = R_PROJECTOR_LEFT
        self.T_projector_left = -R_PROJECTOR_LEFT @ CENTER_LEFT_PROJECTOR_M
        self.optics = optics
        own = scanner_scene(seed)
        self.scene = scene or own
        self._gloss = dict(gloss) if gloss is not None else ({_GLOSSY: Gloss()} if scene is None else {})
        self._prints = dict(prints or {})
        self._primitives = self.scene.packed()
        self._random = np.random.default_rng(seed)

    def capture(self, pattern: U8) -> tuple[U8, U8]:
        """Raw images of the left and the right camera while the projector shows a pattern; noise differs each time.

        Args:
            pattern: uint8 (h, w) or (h, w, 3) RGB, of the size of the projector.

        Returns:
            Two uint8 (H, W) images, or (H, W, 3) RGB of a pattern in color.

        Raises:
            ConfigError: the pattern has another size.
        """
        if pattern.shape[:2] != (self.projector.height, self.projector.width):
            raise ConfigError(
                f"the pattern is {pattern.shape[1]}x{pattern.shape[0]}, the projector "
                f"{self.projector.width}x{self.projector.height}",
                subject="synthetic scanner",
                value=pattern.shape,
                limit=(self.projector.height, self.projector.width),
                remedy="render the pattern at the size of the projector",
            )
        light = self._projected(pattern)
        left, right = (self._image(view, light) for view in self._views)
        return left, right

    def truth(self) -> ScannerTruth:
        """Truth of the rectified left image."""
        rig, left = self.rig, self.rig.left
        y, x = np.indices((rig.height, rig.width), np.float64)
        rays = np.stack(((x - left.P[0, 2]) / left.P[0, 0], (y - left.P[1, 2]) / left.P[1, 1]), axis=-1)
        points, _, _, surface = self._trace(np.zeros(3), np.ascontiguousarray(left.R.T), rays)
        depth_m = (points @ left.R.T)[..., 2]
        disparity_px = rig.f_px * rig.baseline_m / depth_m + rig.doffs_px
        right = product(R_RIGHT_LEFT, (points - CENTER_LEFT_RIGHT_M).reshape(-1, 3).T).T.reshape(points.shape)
        x_right = x - disparity_px
        seen = inside_raw_image(rig.right, right @ rig.right.R.T) & (x_right >= 0) & (x_right <= rig.width - 1)
        column_px, row_px, lit = self._lit(points)
        return ScannerTruth(
            depth_m.astype(np.float32),
            disparity_px.astype(np.float32),
            ~seen | self._shadow(points, CENTER_LEFT_RIGHT_M),
            np.where(lit, column_px, np.nan).astype(np.float32),
            np.where(lit, row_px, np.nan).astype(np.float32),
            lit,
            surface,
        )

    def _trace(
        self, center: F64, rotation: F64, rays: F64, pixel_rad: float = 1e-3
    ) -> tuple[F64, F64, F64, npt.NDArray[np.int32]]:
        """Points, normals, gray levels and surfaces of rays."""
        points, normals = np.empty((2, *rays.shape[:2], 3))
        levels, surface = np.empty(rays.shape[:2]), np.empty(rays.shape[:2], np.int32)
        geometry = (self._primitives, center, rotation, np.ascontiguousarray(rays), pixel_rad, self.scene.seed)
        run_bands(trace, len(rays), *geometry, points, normals, levels, surface)
        return points, normals, levels, surface

    def _shadow(self, points: F64, light: F64) -> npt.NDArray[np.bool_]:
        shadow = np.empty(points.shape[:2], np.bool_)
        run_bands(in_shadow, len(points), self._primitives, np.ascontiguousarray(points), light, shadow)
        return shadow

    def _lit(self, points: F64) -> tuple[F64, F64, npt.NDArray[np.bool_]]:
        """Projector column and row of points, and whether the projector lights them."""
        projector = self.projector
        column_px, row_px, z = raw_pixels(projector, (points - CENTER_LEFT_PROJECTOR_M) @ R_PROJECTOR_LEFT.T)
        inside = (z > 0) & (np.abs(column_px - (projector.width - 1) / 2) <= projector.width / 2)
        inside &= np.abs(row_px - (projector.height - 1) / 2) <= projector.height / 2
        return column_px, row_px, inside & ~self._shadow(points, CENTER_LEFT_PROJECTOR_M)

    @functools.cached_property
    def _views(self) -> tuple[_View, _View]:
        R_left, left = np.identity(3), np.zeros(3)
        cells = self._cells
        return (
            self._view(self.rig.left, left, R_left, cells),
            self._view(self.rig.right, CENTER_LEFT_RIGHT_M, np.ascontiguousarray(R_RIGHT_LEFT.T), cells),
        )

    def _view(self, camera: CameraModel, center: F64, rotation: F64, cells: _Cells) -> _View:
        """All of a camera that does not depend on the pattern."""
        rays = rays_of(camera)
        points, normals, levels, surface = self._trace(center, rotation, rays, 1.0 / float(camera.K[0, 0]))
        column_px, row_px, lit = self._lit(points)
        to_light = CENTER_LEFT_PROJECTOR_M - points
        distance = np.linalg.norm(to_light, axis=-1)
        to_light /= distance[..., None]
        cosine = np.sum(normals * to_light, axis=-1)
        falloff = np.where(lit & (cosine > 0), 1.0 / distance**2, 0.0)
        albedo = self._albedo(levels, surface, points)
        gloss = np.zeros_like(falloff)
        mirrored = 2.0 * cosine[..., None] * normals - to_light
        to_camera = center - points
        to_camera /= np.linalg.norm(to_camera, axis=-1, keepdims=True)
        aligned = np.clip(np.sum(mirrored * to_camera, axis=-1), 0.0, 1.0)
        for index, lobe in self._gloss.items():
            gloss[surface == index] = lobe.strength * aligned[surface == index] ** lobe.exponent
        direct = (albedo * np.maximum(cosine, 0)[..., None] + gloss[..., None]) * falloff[..., None]
        step = slice(_GLOBAL_STEP, None, SUPERSAMPLING * _GLOBAL_STEP)
        form = cells.form_factors(points[step, step], normals[step, step])
        maps = (np.where(lit, column_px, -1e4).astype(np.float32), np.where(lit, row_px, -1e4).astype(np.float32))
        y, x = np.indices((camera.height, camera.width))
        corner = ((x / (camera.width - 1) - 0.5) ** 2 + (y / (camera.height - 1) - 0.5) ** 2) * 2.0
        return _View(
            maps,
            np.nan_to_num(direct).astype(np.float32),
            albedo.astype(np.float32),
            form.astype(np.float32),
            points[step, step].shape[:2],
            (1.0 - self.optics.vignetting * corner).astype(np.float32),
        )

    def _albedo(self, levels: F64, surface: npt.NDArray[np.int32], points: F64) -> F64:
        """RGB of the matte reflection, float64 (H, W, 3) in 0..1."""
        albedo: F64 = levels[..., None] / 255.0 * _TINTS[surface % len(_TINTS)]
        for index, image in self._prints.items():
            at, row = surface == index, self._primitives[index]
            local = points - row[1:4]
            x = (local @ row[4:7] * image.shape[1] - 0.5).astype(np.float32)
            y = (local @ row[7:10] * image.shape[0] - 0.5).astype(np.float32)
            sampled = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[at]
            albedo[at] = (sampled if image.ndim == 3 else sampled[:, None]) / 255.0
        return albedo

    @functools.cached_property
    def _cells(self) -> _Cells:
        """The surfaces that cells of projector pixels light."""
        projector = self.projector
        columns = min(_CELLS, projector.width)
        rows = max(1, round(columns * projector.height / projector.width))
        x = (np.arange(columns) + 0.5) * projector.width / columns - 0.5
        y = (np.arange(rows) + 0.5) * projector.height / rows - 0.5
        pixels = np.stack(np.meshgrid(x, y), axis=-1)
        rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), projector.K, projector.D).reshape(rows, columns, 2)
        rotation = np.ascontiguousarray(R_PROJECTOR_LEFT.T)
        points, normals, levels, surface = self._trace(CENTER_LEFT_PROJECTOR_M, rotation, rays)
        albedo = self._albedo(levels, surface, points).reshape(-1, 3)
        cell_sr = projector.width / columns / projector.K[0, 0] * projector.height / rows / projector.K[1, 1]
        solid = cell_sr / (1.0 + np.sum(rays**2, axis=-1)) ** 1.5
        return _Cells(points.reshape(-1, 3), normals.reshape(-1, 3), albedo, solid.ravel(), (rows, columns))

    def _projected(self, pattern: U8) -> F32:
        """Light that leaves the projector, float32 (h, w) or (h, w, 3) in 0..1."""
        optics = self.optics
        levels = (np.arange(256) / 255.0) ** optics.projector_gamma
        light = (optics.black + (1.0 - optics.black) * levels).astype(np.float32)[pattern]
        if optics.defocus_px > 0:
            light = cv2.GaussianBlur(light, (0, 0), optics.defocus_px, borderType=cv2.BORDER_REPLICATE)
        if pattern.ndim == 3:
            mixing = np.full((3, 3), optics.crosstalk, np.float32)
            np.fill_diagonal(mixing, 1.0)
            light = light @ mixing / (1.0 + 2.0 * optics.crosstalk)
        y, x = np.indices(pattern.shape[:2])
        corner = ((x / pattern.shape[1] - 0.5) ** 2 + (y / pattern.shape[0] - 0.5) ** 2) * 2.0
        falloff = (1.0 - optics.vignetting * corner).astype(np.float32)
        return np.asarray(light * (falloff[..., None] if light.ndim == 3 else falloff), np.float32)

    def _image(self, view: _View, light: F32) -> U8:
        color = light.ndim == 3
        gray = np.array([[[0.3, 0.5, 0.2]]], np.float32)
        direct = view.direct if color else view.direct @ gray[0, 0]
        albedo = view.albedo if color else view.albedo @ gray[0, 0]
        at = cv2.remap(light, *view.maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        flux = cv2.resize(light, self._cells.shape[::-1], interpolation=cv2.INTER_AREA)
        flux = flux.reshape(-1, 3) if color else flux.reshape(-1, 1)
        emitted = flux * (self._cells.albedo if color else self._cells.albedo @ gray[0, 0, :, None])
        reflected = (view.form @ emitted.astype(np.float32)).reshape(*view.form_shape, -1)
        indirect = cv2.resize(np.squeeze(reflected), albedo.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        radiance = direct * at + albedo * (self.optics.ambient + self.optics.interreflection * indirect)
        pixels = cv2.resize(radiance, view.vignetting.shape[::-1], interpolation=cv2.INTER_AREA)
        pixels *= self._exposure * (view.vignetting[..., None] if color else view.vignetting)
        sigma = np.sqrt(self.optics.noise**2 + self.optics.shot * np.maximum(pixels, 0))
        pixels += sigma * self._random.standard_normal(pixels.shape, np.float32)
        levels: U8 = np.clip(np.rint(pixels), 0, 255).astype(np.uint8)
        return levels

    @functools.cached_property
    def _exposure(self) -> float:
        """Gray levels of a unit of light: the brighter surfaces under a white pattern have the level for white."""
        bright = float(np.percentile(self._views[0].direct[..., 1], 95))
        return _WHITE_LEVEL / max(bright, 1e-6)


@dataclass(frozen=True)
class _View:
    """One camera: projector pixel, direct light and albedo of each ray, and light from other surfaces."""

    maps: tuple[F32, F32]
    direct: F32
    albedo: F32
    form: F32
    form_shape: tuple[int, ...]
    vignetting: F32


@dataclass(frozen=True)
class _Cells:
    """Patches of surface, one for each cell of projector pixels."""

    points: F64
    normals: F64
    albedo: F64
    solid_sr: F64
    shape: tuple[int, int]

    def form_factors(self, points: F64, normals: F64) -> F64:
        """Light that reaches points from the patches, float64 (N, M), for light of 1 in each cell.

        One bounce between matte surfaces, without regard to what stands between them. A patch that is lit by a cell
        of solid angle w, with albedo a, sends a w / pi cos(out) cos(in) / r^2.
        """
        receivers, towards = points.reshape(-1, 3), normals.reshape(-1, 3)
        between = self.points[None] - receivers[:, None]
        squared = np.sum(between**2, axis=-1)
        leaving = np.maximum(-np.einsum("nmk,mk->nm", between, self.normals), 0.0)
        arriving = np.maximum(np.einsum("nmk,nk->nm", between, towards), 0.0)
        size = self.solid_sr * np.sum((self.points - CENTER_LEFT_PROJECTOR_M) ** 2, axis=-1)  # of a patch, squared
        form = leaving * arriving / np.maximum(squared, size) ** 2 * self.solid_sr / math.pi
        return np.asarray(np.nan_to_num(form))


def scanner_scene(seed: int) -> Scene:
    """A table-top scene, 0.75 to 1.5 m before the cameras: walls that meet, a floor, and objects before them."""
    return Scene((*_room(), *_objects()), seed)


_GLOSSY, _BLACK, _POLE = 4, 5, 6  # indices of primitives of scanner_scene


def _room() -> list[Primitive]:
    return [
        Rectangle((-1.5, -1.0, 1.42), (1.87, 0.0, -0.12), (0.0, 1.55, 0.0), Texture(185.0, 30.0)),
        Rectangle((0.37, -1.0, 1.30), (0.75, 0.0, -0.62), (0.0, 1.55, 0.0), Texture(175.0, 25.0)),
        Rectangle((-1.5, 0.46, 0.5), (2.8, 0.0, 0.0), (0.0, -0.02, 1.0), Texture(150.0, 45.0)),
    ]


def _objects() -> list[Primitive]:
    return [
        Sphere((-0.33, 0.13, 1.12), 0.19, Texture(190.0, 35.0)),
        Sphere((0.13, 0.24, 1.02), 0.11, Texture(90.0, 15.0)),
        Rectangle((-0.82, -0.25, 1.22), (0.26, 0.0, 0.05), (0.0, 0.42, 0.0), Texture(5.0, 2.0)),
        Cylinder((-0.03, -0.8, 0.88), (0.02, 1.25, 0.0), 0.011, Texture(180.0, 25.0)),
        Cylinder((-0.55, -0.42, 1.16), (0.5, 0.06, -0.03), 0.075, Texture(165.0, 40.0)),
    ]


def _projector(size: tuple[int, int]) -> CameraModel:
    width, height = size
    K = np.array(_K_PROJECTOR) * [[width], [width], [1.0]]
    K[1, 2] = _K_PROJECTOR[1][2] * height
    return CameraModel(
        width, height, "plumb_bob", K, _D_PROJECTOR, np.identity(3), np.identity(4)[:3], "projector_optical_frame"
    )
