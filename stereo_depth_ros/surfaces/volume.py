# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Volume of signed distances that fuses range images of known poses into one surface."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.surfaces.extraction_kernels import (
    NEAR,
    distances_at,
    fill_cubes,
    find_kinds,
    find_near,
    make_vertices,
    mark_edges,
)
from stereo_depth_ros.surfaces.marching_cubes import cube_tables
from stereo_depth_ros.surfaces.mesh import Mesh, joined_neighbors
from stereo_depth_ros.surfaces.mesh_kernels import fit_lines
from stereo_depth_ros.surfaces.mesh_repair import filled_holes, without_small_pieces
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.volume_kernels import (
    BAND,
    EMPTY,
    INVERSE,
    OUTSIDE,
    REACH,
    SIDE,
    SLOPE,
    SMOOTH,
    VOXELS,
    WEIGHT,
    add_blocks,
    add_image,
    insert_blocks,
)

__all__ = ["FusedSurface", "IntegratedImage", "SurfaceVolume"]

_NARROWEST, _WIDEST = 4.0, 12.0  # half the width of the band, voxels
_SIGMAS = 3.0  # of it, where that is between these
_FLOOR = (
    0.05  # added to the standard deviation, voxels: an image without noise has a finite weight, and curved surfaces
)
_NORMAL_RADIUS_PX = 5
_SMALLEST_COSINE = 0.1  # between the ray and the normal: a normal from noisy depths may be worse
_SHORTEST_REACH = 1.75  # behind a surface, voxels: the corners of a cube that it crosses are within it
_BLOCK_BYTES = VOXELS * (4 + 4 + 3) + 3 * 4
_ENTRY_BYTES = 8 + 4  # of the table
_FIRST_BLOCKS, _GROWTH = 1024, 1.25
_MOST_BYTES = 2 * 2**30
_CHUNK = 64  # blocks for each core at least


@dataclass(frozen=True)
class IntegratedImage:
    """What of a range image has been fused.

    Attributes:
        used: pixels that count.
        too_far: measured pixels beyond the largest depth.
        uncertain: those whose standard deviation across the surface is above a third of the widest band.
        alone: those that are joined with too few neighbors for a normal: they are between two surfaces.
        apart: mean difference between its surface and that of the images before it, in widths of the truncation band,
            0..2; NaN where it shows nothing that was known.
    """

    used: int
    too_far: int
    uncertain: int
    alone: int
    apart: float


@dataclass(frozen=True, eq=False)
class FusedSurface:
    """The surface of a volume.

    Attributes:
        mesh: in the frame of the volume.
        pieces, piece_triangles: pieces that were too small and are left out, and their triangles.
        filled, open: holes that are filled, and that are small enough but stay open, as rays have crossed them.
    """

    mesh: Mesh
    pieces: int = 0
    piece_triangles: int = 0
    filled: int = 0
    open: int = 0


class SurfaceVolume:
    """Signed distances on a grid, in blocks that exist near measured surfaces only (Curless and Levoy 1996).

    Each grid point has the weighted mean of its distances from the surfaces of all images, and the sum of the weights,
    which are 1 / sigma^2 of the measured depth. Distances are truncated to a band of 3 sigma, 4 to 12 voxels, on both
    sides of a surface; in front of the band a ray proves that there is nothing, which removes what single images have
    put there. Pixels whose standard deviation across the surface is above 4 voxels are left out.

    Args:
        voxel_m: distance of the grid points, meters.
        most_bytes: bound of :attr:`memory_bytes`.

    Attributes:
        voxel_m: as given.

    Raises:
        ConfigError: a voxel or a bound that is not above 0.
    """

    def __init__(self, voxel_m: float, *, most_bytes: int = _MOST_BYTES) -> None:
        for name, value, unit in (("voxel", voxel_m, "m"), ("memory", most_bytes, "bytes")):
            if not 0 < value < math.inf:
                raise ConfigError(
                    f"{name} = {value:g} {unit} is not above 0",
                    value=value,
                    limit=0,
                    remedy="set a positive number",
                    settings=(name,),
                )
        self.voxel_m = float(voxel_m)
        self._most_bytes = most_bytes
        self._count = np.zeros(1, np.int64)
        self._distance = np.zeros((_FIRST_BLOCKS, VOXELS), np.float32)
        self._weight = np.zeros((_FIRST_BLOCKS, VOXELS), np.float32)
        self._color = np.zeros((_FIRST_BLOCKS, VOXELS, 3), np.uint8)
        self._coordinates = np.zeros((_FIRST_BLOCKS, 3), np.int32)
        self._make_table()

    @property
    def block_count(self) -> int:
        """Number of blocks of 8 x 8 x 8 grid points."""
        return int(self._count[0])

    @property
    def memory_bytes(self) -> int:
        """Memory of the volume: 5.6 kB for each block, and the table; :meth:`surface` takes 3 kB more for each."""
        return len(self._coordinates) * _BLOCK_BYTES + len(self._keys) * _ENTRY_BYTES

    def integrate(
        self, image: RangeImage, world_from_camera: Pose, *, max_depth_m: float = math.inf
    ) -> IntegratedImage:
        """Fuse a range image.

        Args:
            image: depth, standard deviation and color.
            world_from_camera: pose of its frame, the left rectified optical one, in the frame of the volume.
            max_depth_m: pixels beyond it are left out, meters.

        Raises:
            ConfigError: the volume would be larger than its bound, or a point is too far from its origin.
        """
        measured = image.measured
        sigma = np.hypot(image.sigma_m, np.float32(_FLOOR * self.voxel_m))
        joined = joined_neighbors(replace(image, sigma_m=sigma))
        rays_x, rays_y = image.rays
        normals = np.empty((*measured.shape, 3), np.float32)
        run_bands(fit_lines, len(normals), joined[0], rays_x, rays_y, *joined[1:], _NORMAL_RADIUS_PX, normals)
        lengths = np.sqrt(np.square(rays_x)[None] + np.square(rays_y)[:, None] + 1).astype(np.float32)
        slopes = -(normals[..., 0] * rays_x.astype(np.float32) + normals[..., 2])
        slopes -= normals[..., 1] * rays_y.astype(np.float32)[:, None]
        near, flat = measured & (image.depth_m <= max_depth_m), np.isfinite(slopes)
        with np.errstate(invalid="ignore"):
            across = sigma * slopes
            certain = across <= _WIDEST / _SIGMAS * self.voxel_m
            used = near & flat & certain
            pixels = self._pixels(joined, np.maximum(slopes, _SMALLEST_COSINE * lengths), sigma, lengths)
        pixels[..., BAND] = np.where(used, pixels[..., BAND], np.float32(np.nan))
        pose = (np.ascontiguousarray(world_from_camera.rotation, np.float64), world_from_camera.translation_m)
        self._add_blocks(image.depth_m, normals, np.ascontiguousarray(pixels[..., BAND]), rays_x, rays_y, *pose)
        count = self.block_count
        apart = np.empty((count, 2))
        farthest_m = float(np.max(image.depth_m, where=used, initial=0.0))
        seen = (pixels, np.ascontiguousarray(image.rgb), rays_x, rays_y, *pose, self.voxel_m, farthest_m)
        blocks = (self._distance, self._weight, self._color)
        run_bands(add_image, count, self._coordinates, *seen, *blocks, apart, min_rows=_CHUNK)
        total, known = apart.sum(axis=0)
        return IntegratedImage(
            int(np.count_nonzero(used)),
            int(np.count_nonzero(measured & ~near)),
            int(np.count_nonzero(near & flat & ~certain)),
            int(np.count_nonzero(near & ~flat)),
            float(total / known) if known else math.nan,
        )

    def _pixels(self, joined: tuple[F32, U8, U8], slopes: F32, sigma: F32, lengths: F32) -> F32:
        """The values of each pixel for :func:`add_image`, without regard to what does not count."""
        inverse, right, down = joined
        pixels = np.zeros((*inverse.shape, 8), np.float32)  # of the size of half a cache line
        pixels[..., INVERSE], pixels[..., SLOPE] = inverse, slopes
        pixels[..., WEIGHT] = 1 / np.square(sigma * lengths)
        pixels[..., BAND] = np.clip(_SIGMAS * sigma * slopes, _NARROWEST * self.voxel_m, _WIDEST * self.voxel_m)
        inside = np.zeros(inverse.shape, bool)  # joined with all four neighbors
        inside[1:, 1:] = (right[1:, 1:] & right[1:, :-1] & down[1:, 1:] & down[:-1, 1:]).astype(bool)
        reach = np.where(inside, pixels[..., BAND] * slopes / lengths, np.float32(0))
        pixels[..., REACH] = np.maximum(reach, np.float32(_SHORTEST_REACH * self.voxel_m))
        pixels[:-1, :-1, SMOOTH] = right[:-1, :-1] & right[1:, :-1] & down[:-1, :-1] & down[:-1, 1:]
        return pixels

    def mesh(self) -> Mesh:
        """The whole surface, see :meth:`surface`."""
        return self.surface().mesh

    def surface(self, *, fewest_triangles: int = 0, largest_hole_m: float = 0.0) -> FusedSurface:
        """The surface where the distance is 0, by marching cubes.

        It is closed where all around it was seen, open where a grid point is unknown.

        Args:
            fewest_triangles: connected pieces with fewer triangles are left out.
            largest_hole_m: holes up to this diameter are filled where no ray has crossed them, meters; 0 fills none.
        """
        count, tables = self.block_count, cube_tables()
        near, kinds = np.empty((count, NEAR), np.int32), np.empty((count, VOXELS), np.uint8)
        marks, numbers = np.zeros((count, VOXELS), np.uint8), np.empty((count, VOXELS), np.int32)
        distances = (self._distance, self._weight)
        run_bands(find_near, count, self._coordinates, self._keys, self._blocks, near, min_rows=_CHUNK)
        run_bands(find_kinds, count, near, *distances, kinds, min_rows=_CHUNK)
        total = int(mark_edges(near, kinds, tables.edges, marks, numbers))
        points, normals = np.empty((total, 3), np.float32), np.empty((total, 3), np.float32)
        colors, sigma = np.empty((total, 3), np.uint8), np.empty(total, np.float32)
        grid = (self._coordinates, near, *distances, self._color, marks, numbers, self.voxel_m)
        run_bands(make_vertices, count, *grid, points, normals, colors, sigma, min_rows=_CHUNK)
        of_blocks = np.array([tables.counts[kinds[block]].sum() for block in range(count)], np.int64)
        triangles = np.empty((int(of_blocks.sum()), 3), np.int32)
        starts = np.cumsum(of_blocks) - of_blocks
        cubes = (near, kinds, marks, numbers, tables.counts, tables.triangles, starts, triangles)
        run_bands(fill_cubes, count, *cubes, min_rows=_CHUNK)
        mesh, pieces, removed = without_small_pieces(Mesh(points, triangles, normals, colors, sigma), fewest_triangles)
        mesh, filled, still_open = filled_holes(mesh, largest_hole_m, self.voxel_m, self.distances_at)
        return FusedSurface(mesh, pieces, removed, filled, still_open)

    def distances_at(self, points_m: F64) -> F64:
        """The signed distance at the grid point next to each point, float64 (N, 3) to (N,), m; NaN where unknown."""
        found = np.empty(len(points_m))
        points = np.ascontiguousarray(points_m, np.float64)
        distances_at(self._distance, self._weight, self._keys, self._blocks, points, self.voxel_m, found)
        return found

    def _add_blocks(self, *image: Any) -> None:
        row, height, block_m = 0, len(image[0]), SIDE * self.voxel_m
        while row < height:
            table = (self._keys, self._blocks, self._coordinates)
            arguments = (*image, block_m, *table, self._count)
            row = add_blocks(row, *arguments)
            if row == OUTSIDE:
                raise ConfigError(
                    f"a point is more than {2**20 * SIDE * self.voxel_m:.3g} m from the origin",
                    value=self.voxel_m,
                    limit=2**20 * SIDE,
                    remedy="set larger voxels, or give poses from a nearer origin",
                    settings=("voxel", "poses"),
                )
            if row < height:
                self._grow()

    def _grow(self) -> None:
        """More room for blocks, in place where the system can, and a larger table where it is half full."""
        blocks = int(_GROWTH * len(self._coordinates))
        most = int(self._most_bytes / (_BLOCK_BYTES + 4 * _ENTRY_BYTES))
        if blocks > most:
            blocks = most
        if blocks <= self.block_count:
            raise ConfigError(
                f"the surface does not fit into {self._most_bytes / 2**20:.0f} MiB of memory with voxels of "
                f"{self.voxel_m:g} m",
                value=self.voxel_m,
                limit=self._most_bytes,
                remedy=f"set voxels of {_rounded_up(2 * self.voxel_m):g} m, which take about a quarter, or a smaller "
                "depth, or allow more memory",
                settings=("voxel", "max_depth", "memory"),
            )
        for array in (self._distance, self._weight, self._color, self._coordinates):
            array.resize((blocks, *array.shape[1:]), refcheck=False)  # no view of it is kept anywhere
        if len(self._keys) < 2 * blocks:
            self._make_table()

    def _make_table(self) -> None:
        places = 2 ** math.ceil(math.log2(2 * len(self._coordinates)))
        self._keys: npt.NDArray[np.int64] = np.full(places, EMPTY, np.int64)
        self._blocks: npt.NDArray[np.int32] = np.zeros(places, np.int32)
        insert_blocks(self._coordinates, self.block_count, self._keys, self._blocks)


def _rounded_up(value: float) -> float:
    """With two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / step - 1e-9) * step
