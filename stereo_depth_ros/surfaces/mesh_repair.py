# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Repair of a fused mesh: small pieces are removed, and small holes are filled where the space behind is unknown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.surfaces.mesh import Mesh

__all__ = ["filled_holes", "hole_loops", "piece_sizes", "without_small_pieces"]


def without_small_pieces(mesh: Mesh, fewest: int) -> tuple[Mesh, int, int]:
    """The mesh without the pieces of fewer than ``fewest`` triangles.

    Returns:
        The mesh, and the number of pieces and of triangles that are removed. A piece is what is connected by vertices.
    """
    if fewest <= 1 or not len(mesh.triangles):
        return mesh, 0, 0
    labels, sizes = _pieces(mesh)
    kept = sizes[labels] >= fewest
    small = (sizes > 0) & (sizes < fewest)
    triangles = mesh.triangles[kept[mesh.triangles[:, 0]]]
    numbers = np.cumsum(kept, dtype=np.int32) - np.int32(1)
    pieces, removed = int(np.count_nonzero(small)), len(mesh.triangles) - len(triangles)
    vertices = (mesh.normals[kept], mesh.colors[kept], mesh.sigma_m[kept])
    return Mesh(mesh.points_m[kept], numbers[triangles], *vertices), pieces, removed


def piece_sizes(mesh: Mesh) -> npt.NDArray[np.intp]:
    """The number of triangles of each piece, int (K,)."""
    if not len(mesh.triangles):
        return np.zeros(0, np.intp)
    sizes = _pieces(mesh)[1]
    return sizes[sizes > 0]


def _pieces(mesh: Mesh) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.intp]]:
    """The label of the piece of each vertex, and the number of triangles of each label."""
    labels = np.arange(len(mesh.points_m), dtype=np.int32)
    _label_pieces(mesh.triangles, labels)
    return labels, np.bincount(labels[mesh.triangles[:, 0]], minlength=len(labels))


@compiled("void(int32[:, ::1], int32[::1])")
def _label_pieces(triangles: Any, labels: Any) -> None:
    """Union-find with path halving: afterwards vertices of one piece have one label, the number of one of them."""
    for i in range(triangles.shape[0]):
        root = triangles[i, 0]
        while labels[root] != root:
            labels[root] = labels[labels[root]]
            root = labels[root]
        for corner in range(1, 3):
            other = triangles[i, corner]
            while labels[other] != other:
                labels[other] = labels[labels[other]]
                other = labels[other]
            if other < root:
                root, other = other, root
            labels[other] = root
    for vertex in range(labels.shape[0]):  # roots are smaller than what they hold
        labels[vertex] = labels[labels[vertex]]


def hole_loops(triangles: npt.NDArray[np.int32], most_edges: int) -> list[list[int]]:
    """The borders of holes, each a loop of vertices in the direction of the triangles beside it.

    A border that meets itself in a vertex is several loops.

    Args:
        triangles: int32 (M, 3).
        most_edges: longer loops are left out.
    """
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    if not len(edges):
        return []
    keys = (edges.min(axis=1) << 32) | edges.max(axis=1)
    _, places, counts = np.unique(keys, return_index=True, return_counts=True)
    border = edges[places[counts == 1]]
    following: dict[int, list[int]] = {}
    for start, end in border.tolist():
        following.setdefault(start, []).append(end)
    loops = []
    while following:
        way = [next(iter(following))]
        places_on_way = {way[0]: 0}
        while way and (ends := following.get(way[-1])):
            vertex = ends.pop()
            if not ends:
                del following[way[-1]]
            begin = places_on_way.get(vertex)
            if begin is None:
                places_on_way[vertex] = len(way)
                way.append(vertex)
                continue
            loop = way[begin:]
            if 3 <= len(loop) <= most_edges:
                loops.append(loop)
            for passed in way[begin + 1 :]:
                del places_on_way[passed]
            del way[begin + 1 :]
    return loops


def filled_holes(
    mesh: Mesh, largest_m: float, voxel_m: float, distances: Callable[[F64], F64]
) -> tuple[Mesh, int, int]:
    """The mesh with its holes up to a size filled, each by triangles from its border to a vertex in its center.

    A hole stays open where rays have crossed it, or the space behind it: there is no surface, or it is that of a ring.
    Curless and Levoy 1996 fill holes likewise where what is known to be empty meets what is unseen.

    Args:
        mesh: of a volume.
        largest_m: the largest diameter of a border, m; 0 fills nothing.
        voxel_m: between the grid points of the volume.
        distances: the signed distances at points, float64 (N, 3) to (N,), NaN where unknown.

    Returns:
        The mesh, and the numbers of holes that are filled, and that stay open though they are small enough. The
        standard deviation of a center is NaN.
    """
    if not largest_m > 0:
        return mesh, 0, 0
    loops = []
    for loop in hole_loops(mesh.triangles, int(8 * largest_m / voxel_m) + 8):
        border = mesh.points_m[loop].astype(np.float64)
        if np.linalg.norm(border - border.mean(axis=0), axis=1).max() <= 0.5 * largest_m:
            loops.append(loop)
    if not loops:
        return mesh, 0, 0
    centers = np.array([mesh.points_m[loop].mean(axis=0, dtype=np.float64) for loop in loops])
    normals = np.array([_mean_normal(mesh.points_m[loop].astype(np.float64)) for loop in loops])
    behind = distances(centers - 2 * voxel_m * normals)
    crossed = (distances(centers) >= voxel_m) | (behind > 0)
    closed = [number for number in range(len(loops)) if not crossed[number]]
    if not closed:
        return mesh, 0, len(loops)
    first = len(mesh.points_m)
    triangles = [mesh.triangles]
    for number, hole in enumerate(closed):
        border_vertices = np.array(loops[hole], np.int32)
        center = np.full(len(border_vertices), first + number, np.int32)
        triangles.append(np.stack((np.roll(border_vertices, -1), border_vertices, center), axis=1))
    colors = [np.rint(mesh.colors[loops[hole]].mean(axis=0)).astype(np.uint8) for hole in closed]
    filled = Mesh(
        np.concatenate((mesh.points_m, centers[closed].astype(np.float32))),
        np.concatenate(triangles),
        np.concatenate((mesh.normals, normals[closed].astype(np.float32))),
        np.concatenate((mesh.colors, np.array(colors))),
        np.concatenate((mesh.sigma_m, np.full(len(closed), np.nan, np.float32))),
    )
    return filled, len(closed), len(loops) - len(closed)


def _mean_normal(border: F64) -> F64:
    """The normal of what fills a hole: that of the polygon of its border (Newell), to the outside of the mesh."""
    area = np.cross(np.roll(border, -1, axis=0) - border[0], border - border[0]).sum(axis=0)
    length = float(np.linalg.norm(area))
    return np.asarray(area / length if length > 0 else np.array([0.0, 0.0, 1.0]), np.float64)
