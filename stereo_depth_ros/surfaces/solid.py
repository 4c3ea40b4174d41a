# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Solids: a volume whose unseen part counts as full, so that its surface is closed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.surfaces.extraction_kernels import distances_at
from stereo_depth_ros.surfaces.mesh import Mesh
from stereo_depth_ros.surfaces.mesh_repair import piece_sizes, without_small_pieces
from stereo_depth_ros.surfaces.volume import SurfaceVolume
from stereo_depth_ros.surfaces.volume_kernels import SIDE, VOXELS

__all__ = ["Box", "Solid", "SolidVolume"]

_BAND = 4.0  # voxels, the distance of what is unseen or outside


@dataclass(frozen=True, eq=False)
class Box:
    """A box with sides along the axes.

    Attributes:
        low, high: float64 (3,), corners, meters.
    """

    low: F64
    high: F64

    def contains(self, points_m: F64) -> npt.NDArray[np.bool_]:
        """Whether points, float64 (N, 3), are inside, bool (N,); False for NaN."""
        return np.asarray(((points_m > self.low) & (points_m < self.high)).all(axis=1))


@dataclass(frozen=True, eq=False)
class Solid:
    """The surface of a solid.

    Attributes:
        mesh: closed; ``sigma_m`` is NaN where it was not measured: unseen, or on a side of the box.
        measured_share: share of the area that was measured.
        pieces, piece_triangles: pieces beside the largest one, which are left out, and their triangles.
    """

    mesh: Mesh
    measured_share: float
    pieces: int
    piece_triangles: int


class SolidVolume(SurfaceVolume):
    """A volume that fills a box from the beginning, so that all rays through it carve it.

    What no ray has crossed counts as full, as Curless and Levoy 1996 (section 4) fill holes: the surface is that of
    what was measured where it was, and elsewhere the border of what was seen to be empty. It is closed.

    Args:
        voxel_m: distance of the grid points, meters.
        box: the surface is that of what is in it.
        most_bytes: bound of the memory.

    Raises:
        ConfigError: a voxel that is not above 0, or the box does not fit into the memory.
    """

    def __init__(self, voxel_m: float, box: Box, *, most_bytes: int = 2**31) -> None:
        super().__init__(voxel_m, most_bytes=most_bytes)
        self.box = box
        block_m = SIDE * self.voxel_m
        low = np.floor((box.low - 2 * voxel_m) / block_m).astype(np.int64)
        counts = np.floor((box.high + 2 * voxel_m) / block_m).astype(np.int64) + 1 - low
        total = int(np.prod(counts.astype(np.float64)))
        if 8 * VOXELS * total > most_bytes:
            width, depth, height = box.high - box.low
            raise ConfigError(
                f"a box of {width:.3g} x {depth:.3g} x {height:.3g} m does not fit into {most_bytes / 2**20:.0f} MiB "
                f"of memory with voxels of {voxel_m:g} m",
                value=voxel_m,
                limit=most_bytes,
                remedy="set larger voxels, or allow more memory",
                settings=("voxel", "memory"),
            )
        while len(self._coordinates) < total:
            self._grow()
        steps = np.indices(tuple(counts)).reshape(3, -1).T
        self._coordinates[:total] = low + steps
        self._count[0] = total
        self._make_table()

    def solid(self) -> Solid:
        """The largest piece of the surface; no image can be added any more.

        Raises:
            ConfigError: nothing is in the box.
        """
        count = self.block_count
        unknown = self._weight[:count] == 0
        known = np.asarray(~unknown, np.float32)
        full = np.float32(-_BAND * self.voxel_m)
        self._distance[:count][unknown] = full
        self._weight[:count][unknown] = np.float32(1)
        for block in range(count):
            np.maximum(self._distance[block], self._outside(block), out=self._distance[block])
        mesh = self.surface().mesh
        sizes = piece_sizes(mesh)
        if not len(sizes):
            raise ConfigError(
                "nothing is in the box above the sheet",
                value=0,
                remedy="show the object from all sides, with a depth, and smaller than the sheet",
            )
        mesh, pieces, removed = without_small_pieces(mesh, int(sizes.max()))
        colored = np.asarray(self._color[:count].any(axis=2), np.float32)  # grid points in the band of an image
        inside = Box(self.box.low + 0.5 * self.voxel_m, self.box.high - 0.5 * self.voxel_m)
        measured = self._has(known, mesh, -0.75) & inside.contains(mesh.points_m.astype(np.float64))
        with_color = measured & self._has(colored, mesh, -0.75) & self._has(colored, mesh, 0.75)
        sigma = np.where(measured, mesh.sigma_m, np.float32(np.nan))
        closed = replace(mesh, sigma_m=sigma, colors=_spread_colors(mesh, with_color))
        return Solid(closed, _share(mesh, measured), pieces, removed)

    def _has(self, flags: F32, mesh: Mesh, voxels: float) -> npt.NDArray[np.bool_]:
        """Whether the grid point so far from each vertex along its normal has a flag, float32 (N, 512), above 0."""
        found = np.empty(len(mesh.points_m))
        points = mesh.points_m.astype(np.float64) + voxels * self.voxel_m * mesh.normals
        distances_at(self._distance, flags, self._keys, self._blocks, points, self.voxel_m, found)
        return np.isfinite(found)

    def _outside(self, block: int) -> npt.NDArray[np.float32]:
        """The distance of each grid point of a block from the box, positive outside, float32 (512,), m."""
        place = np.arange(VOXELS)
        steps = np.stack((place & 7, (place >> 3) & 7, place >> 6), axis=1)
        points = (SIDE * self._coordinates[block].astype(np.int64) + steps) * self.voxel_m
        outside = np.maximum(self.box.low - points, points - self.box.high).max(axis=1)
        return np.asarray(np.minimum(outside, _BAND * self.voxel_m), np.float32)


def _spread_colors(mesh: Mesh, measured: npt.NDArray[np.bool_]) -> U8:
    """The colors of the vertices; those that were not measured have the mean color of their neighbors that have one."""
    colors, known = mesh.colors.astype(np.float64), measured.copy()
    edges = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = np.concatenate((edges, edges[:, ::-1]))
    while not known.all():
        used = edges[known[edges[:, 0]] & ~known[edges[:, 1]]]
        if not len(used):
            break
        count = np.bincount(used[:, 1], minlength=len(known))
        new = count > 0
        for channel in range(3):
            total = np.bincount(used[:, 1], weights=colors[used[:, 0], channel], minlength=len(known))
            colors[new, channel] = total[new] / count[new]
        known |= new
    return np.rint(colors).astype(np.uint8)


def _share(mesh: Mesh, measured: npt.NDArray[np.bool_]) -> float:
    """The share of the area whose vertices were measured."""
    a, b, c = (mesh.points_m[mesh.triangles[:, corner]].astype(np.float64) for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return float(areas[measured[mesh.triangles].all(axis=1)].sum() / areas.sum())
