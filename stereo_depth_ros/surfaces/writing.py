# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of surfaces and clouds: the format follows from the end of the name."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.files.glb import write_glb
from stereo_depth_ros.files.las import check_las, write_las
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.files.pcd import write_pcd
from stereo_depth_ros.files.ply import write_ply
from stereo_depth_ros.files.xyz import write_xyz
from stereo_depth_ros.stages.depth import millimeters
from stereo_depth_ros.surfaces.mesh import ImageMesh, Mesh, mesh_of, normal_image
from stereo_depth_ros.surfaces.range_image import RangeImage

__all__ = [
    "MESH_ENDS",
    "POINT_ENDS",
    "SURFACE_ENDS",
    "WrittenFile",
    "check_ending",
    "write_mesh",
    "write_points",
    "write_surface",
]


@dataclass(frozen=True)
class WrittenFile:
    """What has been written.

    Attributes:
        path: the file.
        points: vertices, points, or pixels with a depth.
        triangles: of a mesh; None for files without.
        left_out: measured pixels that the file does not have.
        why: the reason for that.
    """

    path: Path
    points: int
    triangles: int | None = None
    left_out: int = 0
    why: str = ""

    @property
    def text(self) -> str:
        """The numbers in words."""
        parts = [f"{self.points} points"]
        if self.triangles is not None:
            parts.append(f"{self.triangles} triangles")
        if self.left_out:
            parts.append(f"{self.left_out} pixels left out, {self.why}")
        return ", ".join(parts)

    def to_json(self) -> dict[str, Any]:
        """The file as plain data."""
        return {
            "path": str(self.path),
            "points": self.points,
            "triangles": self.triangles,
            "left_out": self.left_out,
        }


def write_surface(path: Path, image: RangeImage, *, overwrite: bool = False) -> WrittenFile:
    """Write a range image in the format that the end of the name tells.

    - .ply: mesh with normals and colors; .glb: mesh with normals and the left image as texture.
    - .cloud.ply, .pcd (organized), .las, .laz: points with colors and standard deviations (``sigma``, meters).
    - .png: depth, 16 bits, millimeters, 0 where not measured or beyond 65.535 m.
    - .npz: depth_m, sigma_m, normals (:func:`normal_image`), color, K of the left rectified image, baseline_m.

    All coordinates are in the left rectified optical frame, meters; .glb holds the turn into the axes of its format.

    Args:
        path: the file; missing folders are created.
        image: the range image.
        overwrite: replace a file that is there.

    Raises:
        OutputError: another end of the name, a missing library, the file exists and ``overwrite`` is false, or it
            cannot be written.
    """
    return _WRITERS[check_ending(path)](path, image, overwrite)


def write_mesh(path: Path, mesh: Mesh, *, z_up: bool = False, overwrite: bool = False) -> WrittenFile:
    """Write a mesh that is not that of one image, or its vertices as points.

    - .ply, .glb: mesh with normals and colors.
    - .cloud.ply, .pcd, .las, .laz: points with colors, normals (but .las, .laz) and standard deviations (``sigma``, m).
    - .xyz: text, x y z red green blue in each line.

    Args:
        path: the file; missing folders are created.
        mesh: the mesh.
        z_up: its axes are x forward, y left, z up, and not those of an optical frame; .glb has axes of its own.
        overwrite: replace a file that is there.

    Raises:
        OutputError: as of :func:`write_surface`.
    """
    end = check_ending(path, MESH_ENDS)
    points, normals = mesh.points_m, dict(zip(("nx", "ny", "nz"), mesh.normals.T, strict=True))
    if end == ".glb":
        write_glb(path, points, mesh.triangles, mesh.normals, colors=mesh.colors, z_up=z_up, overwrite=overwrite)
    elif end == ".ply":
        values = {**normals, **_named_colors(mesh.colors)}
        write_ply(path, points, values, triangles=mesh.triangles, overwrite=overwrite)
    elif end == ".cloud.ply":
        values = {**normals, "sigma": mesh.sigma_m, **_named_colors(mesh.colors)}
        write_ply(path, points, values, overwrite=overwrite)
    elif end == ".pcd":
        values = {f"normal_{axis}": normals[f"n{axis}"] for axis in "xyz"} | {"sigma": mesh.sigma_m}
        write_pcd(path, points, values, rgb=mesh.colors, overwrite=overwrite)
    elif end == ".xyz":
        write_xyz(path, points, mesh.colors, overwrite=overwrite)
    else:
        write_las(path, points, {"sigma": mesh.sigma_m}, rgb=mesh.colors, overwrite=overwrite)
    return WrittenFile(path, len(points), len(mesh.triangles) if end in (".glb", ".ply") else None)


def write_points(
    path: Path, points_m: F64, values: Mapping[str, npt.NDArray[Any]], *, overwrite: bool = False
) -> WrittenFile:
    """Write points that are not those of an image, as .ply, .pcd, .las or .laz.

    Args:
        path: the file; missing folders are created.
        points_m: float64 (N, 3), meters.
        values: further values by name, (N,), such as intensity (0..255) and sigma.
        overwrite: replace a file that is there.

    Raises:
        OutputError: as of :func:`write_surface`.
    """
    end = check_ending(path, POINT_ENDS)
    write: Callable[..., None] = {".pcd": write_pcd, ".las": write_las, ".laz": write_las}.get(end, write_ply)
    write(path, points_m, values, overwrite=overwrite)
    return WrittenFile(path, len(points_m))


def check_ending(path: Path, ends: Iterable[str] | None = None) -> str:
    """The end of a name, one of ``ends``, SURFACE_ENDS by default.

    Raises:
        OutputError: it has none of them, or the library that writes it is missing.
    """
    ends = SURFACE_ENDS if ends is None else tuple(ends)
    for end in ends:
        if path.name.lower().endswith(end):
            if end in (".las", ".laz"):
                check_las(path)
            return end
    raise OutputError(
        f"cannot be written: its name does not end in {', '.join(ends[:-1])} or {ends[-1]}",
        subject=str(path),
        value=path.suffix,
        limit=ends,
        remedy="choose one of these formats",
    )


def _mesh_ply(path: Path, image: RangeImage, overwrite: bool) -> WrittenFile:
    mesh = mesh_of(image)
    values = dict(zip(("nx", "ny", "nz"), mesh.normals.T, strict=True))
    values |= _named_colors(mesh.colors)
    write_ply(path, mesh.points_m, values, triangles=mesh.triangles, overwrite=overwrite)
    return _of_mesh(path, mesh)


def _mesh_glb(path: Path, image: RangeImage, overwrite: bool) -> WrittenFile:
    mesh = mesh_of(image)
    # (0, 0) is the corner of the image, and not the center of a pixel
    coordinates = ((mesh.texture_px + np.float32(0.5)) / np.array(image.size, np.float32)).astype(np.float32)
    write_glb(path, mesh.points_m, mesh.triangles, mesh.normals, coordinates, mesh.texture, overwrite=overwrite)
    return _of_mesh(path, mesh)


def _of_mesh(path: Path, mesh: ImageMesh) -> WrittenFile:
    return WrittenFile(path, len(mesh.points_m), len(mesh.triangles), mesh.alone, "they are in no triangle")


def _cloud_ply(path: Path, image: RangeImage, overwrite: bool) -> WrittenFile:
    points, sigma, colors = _cloud(image)
    write_ply(path, points, {"sigma": sigma, **_named_colors(colors)}, overwrite=overwrite)
    return WrittenFile(path, len(points))


def _cloud_las(path: Path, image: RangeImage, overwrite: bool) -> WrittenFile:
    points, sigma, colors = _cloud(image)
    write_las(path, points, {"sigma": sigma}, rgb=colors, overwrite=overwrite)
    return WrittenFile(path, len(points))


def _cloud_pcd(path: Path, image: RangeImage, overwrite: bool) -> WrittenFile:
    sigma = np.where(image.measured, image.sigma_m, np.float32(np.nan))
    write_pcd(path, image.points(), {"sigma": sigma}, rgb=image.rgb, overwrite=overwrite)
    return WrittenFile(path, int(np.count_nonzero(image.measured)))


def _depth_png(path: Path, image: RangeImage, overwrite: bool) -> WrittenFile:
    depth_mm = millimeters(np.where(image.measured, image.depth_m, np.float32(np.nan)))
    write_file(path, cv2.imencode(".png", depth_mm)[1].tobytes(), overwrite=overwrite, make_folders=True)
    points = int(np.count_nonzero(depth_mm))
    lost = int(np.count_nonzero(image.measured)) - points
    return WrittenFile(path, points, None, lost, "16 bits of millimeters end at 65.535 m")


def _arrays_npz(path: Path, image: RangeImage, overwrite: bool) -> WrittenFile:
    t, output = image.triangulation, io.BytesIO()
    K = np.array([[t.f_px, 0, t.cx_px], [0, t.fy_px, t.cy_px], [0, 0, 1]])
    known = image.measured
    np.savez(
        output,
        depth_m=np.where(known, image.depth_m, np.float32(np.nan)),
        sigma_m=np.where(known, image.sigma_m, np.float32(np.nan)),
        normals=normal_image(image),
        color=image.color,
        K=K,
        baseline_m=np.array(t.baseline_m),
    )
    write_file(path, output.getvalue(), overwrite=overwrite, make_folders=True)
    return WrittenFile(path, int(np.count_nonzero(known)))


def _cloud(image: RangeImage) -> tuple[F32, F32, U8]:
    """Points (N, 3), standard deviations (N,) and colors (N, 3) of the measured pixels, row by row."""
    known = image.measured
    return image.points()[known], image.sigma_m[known], image.rgb[known]


def _named_colors(colors: U8) -> dict[str, npt.NDArray[Any]]:
    return dict(zip(("red", "green", "blue"), colors.T, strict=True))


_Writer: TypeAlias = Callable[[Path, RangeImage, bool], WrittenFile]
# of two ends that fit, the first one
_WRITERS: Mapping[str, _Writer] = {
    ".cloud.ply": _cloud_ply,
    ".ply": _mesh_ply,
    ".glb": _mesh_glb,
    ".pcd": _cloud_pcd,
    ".las": _cloud_las,
    ".laz": _cloud_las,
    ".png": _depth_png,
    ".npz": _arrays_npz,
}
SURFACE_ENDS = tuple(_WRITERS)
MESH_ENDS = (".cloud.ply", ".ply", ".glb", ".pcd", ".las", ".laz", ".xyz")
POINT_ENDS = (".ply", ".pcd", ".las", ".laz")
