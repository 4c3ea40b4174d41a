# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of surfaces: each format read back, by another library where one is installed."""

from __future__ import annotations

import importlib
import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.files.glb import write_glb
from stereo_depth_ros.files.las import write_las
from stereo_depth_ros.files.pcd import write_pcd
from stereo_depth_ros.stages.depth import depth_sigma
from stereo_depth_ros.surfaces.mesh import mesh_of, normal_image
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.writing import SURFACE_ENDS, check_ending, write_points, write_surface

GEOMETRY = Triangulation(60.0, 55.0, 9.5, 6.0, 0.12, 3.5)
KNOWN = 17 * 11 - 3  # measured pixels of image()


def image(*, gray: bool = False) -> RangeImage:
    """A slanted plane with a hole, a pixel beyond 65.535 m, and one apart from all others."""
    y, x = np.indices((11, 17))
    depth = (2.0 + 0.02 * x - 0.01 * y).astype(np.float32)
    depth[2, 3], depth[5, 0], depth[4, 0], depth[7, 8] = np.nan, 80.0, np.nan, np.nan
    color = np.stack((10 * x, 20 * y, x + y), axis=2).astype(np.uint8)
    return RangeImage(depth, depth_sigma(depth, GEOMETRY, 0.1), GEOMETRY, color[:, :, 0] if gray else color)


def table(path: Path) -> tuple[list[str], bytes]:
    """The lines of the header of a PLY or PCD file, and its data."""
    data = path.read_bytes()
    end = b"end_header\n" if data.startswith(b"ply") else b"DATA binary\n"
    header, _, rest = data.partition(end)
    return header.decode().splitlines(), rest


def test_mesh_as_ply(tmp_path: Path) -> None:
    mesh = mesh_of(image())
    written = write_surface(tmp_path / "new" / "m.ply", image())
    assert (written.points, written.triangles, written.left_out) == (KNOWN - 1, len(mesh.triangles), 1)
    assert written.text == f"{KNOWN - 1} points, {len(mesh.triangles)} triangles, 1 pixels left out, " + written.why
    header, data = table(written.path)
    names = [line.split()[-1] for line in header if line.startswith("property")]
    assert names == ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "vertex_indices"]
    assert f"element vertex {KNOWN - 1}" in header and f"element face {len(mesh.triangles)}" in header
    kinds = [(name, "<f4" if len(name) < 3 else "u1") for name in names[:9]]
    vertices = np.frombuffer(data, kinds, KNOWN - 1)
    np.testing.assert_array_equal(np.stack([vertices[n] for n in "xyz"], axis=1), mesh.points_m)
    np.testing.assert_array_equal(np.stack([vertices[n] for n in names[3:6]], axis=1), mesh.normals)
    np.testing.assert_array_equal(np.stack([vertices[n] for n in names[6:9]], axis=1), mesh.colors)
    faces = np.frombuffer(data[vertices.nbytes :], [("count", "u1"), ("vertices", "<i4", 3)])
    assert (faces["count"] == 3).all()
    np.testing.assert_array_equal(faces["vertices"], mesh.triangles)


def glb(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """The document of a binary glTF file, and the array or bytes of each buffer view; its layout is checked."""
    data = path.read_bytes()
    magic, version, length, size, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, length, kind, size % 4) == (b"glTF", 2, len(data), b"JSON", 0)
    document = json.loads(data[20 : 20 + size])
    if 20 + size == len(data):
        return document, []
    binary_size, kind = struct.unpack("<I4s", data[20 + size : 28 + size])
    binary = data[28 + size :]
    assert (kind, binary_size) == (b"BIN\0", len(binary))
    assert document["buffers"] == [{"byteLength": len(binary)}]
    views = []
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        views.append(binary[view["byteOffset"] :][: view["byteLength"]])
    for accessor in document["accessors"]:
        dtype = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
        array = np.frombuffer(views[accessor["bufferView"]], dtype).reshape(-1, width)
        assert len(array) == accessor["count"]
        views[accessor["bufferView"]] = array
    return document, views


@pytest.mark.parametrize("gray", [False, True])
def test_mesh_as_gltf(tmp_path: Path, gray: bool) -> None:
    own = image(gray=gray)
    mesh = mesh_of(own)
    written = write_surface(tmp_path / "m.glb", own)
    document, (points, normals, texture, indices, png) = glb(written.path)
    np.testing.assert_array_equal(points, mesh.points_m)
    np.testing.assert_array_equal(normals, mesh.normals)
    np.testing.assert_array_equal(indices.reshape(-1, 3), mesh.triangles)
    position = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    np.testing.assert_allclose([position["min"], position["max"]], [points.min(axis=0), points.max(axis=0)])
    pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(pixels if gray else pixels[:, :, ::-1], own.color)
    # texture coordinates are from the corner of the image
    sampled = own.color[(texture[:, 1] * 11).astype(int), (texture[:, 0] * 17).astype(int)]
    np.testing.assert_array_equal(np.repeat(sampled[:, None], 3, axis=1) if gray else sampled, mesh.colors)
    np.testing.assert_allclose(texture * [17, 11] - 0.5, mesh.texture_px, atol=1e-5)


def test_gltf_of_another_reader(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    mesh = mesh_of(image())
    write_surface(tmp_path / "m.glb", image())
    scene = trimesh.load_scene(tmp_path / "m.glb", process=False)
    (node,) = scene.graph.nodes_geometry
    turn, name = scene.graph[node]
    np.testing.assert_allclose(turn, np.diag([1, -1, -1, 1]), atol=1e-12)  # y up, z backward
    read = scene.geometry[name]
    np.testing.assert_array_equal(read.vertices, mesh.points_m)
    np.testing.assert_array_equal(read.faces, mesh.triangles)
    np.testing.assert_allclose(read.vertex_normals, mesh.normals, atol=1e-6)
    write_surface(tmp_path / "m.ply", image())
    read = trimesh.load(tmp_path / "m.ply", process=False)
    np.testing.assert_allclose(read.vertices, mesh.points_m)
    np.testing.assert_array_equal(read.faces, mesh.triangles)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], mesh.colors)


def test_clouds(tmp_path: Path) -> None:
    own = image()
    written = write_surface(tmp_path / "c.cloud.ply", own)
    header, data = table(written.path)
    assert written.points == KNOWN and written.triangles is None
    assert not [line for line in header if "face" in line]
    kinds = [*((name, "<f4") for name in ("x", "y", "z", "sigma")), *((name, "u1") for name in "rgb")]
    rows = np.frombuffer(data, kinds)
    known = own.measured
    np.testing.assert_array_equal(rows["z"], own.depth_m[known])
    np.testing.assert_array_equal(rows["sigma"], own.sigma_m[known])
    np.testing.assert_array_equal(rows["g"], own.color[known][:, 1])
    written = write_surface(tmp_path / "c.pcd", own)
    header, data = table(written.path)
    assert {"FIELDS x y z sigma rgb", "SIZE 4 4 4 4 4", "WIDTH 17", "HEIGHT 11", "POINTS 187"} <= {*header}
    words = np.frombuffer(data, "<f4").reshape(11, 17, 5)
    np.testing.assert_array_equal(words[:, :, :3], own.points())
    packed = words[:, :, 4].view("<u4")
    np.testing.assert_array_equal((packed >> 16) & 255, own.color[:, :, 0])
    np.testing.assert_array_equal(packed & 255, own.color[:, :, 2])


@pytest.mark.parametrize("end", [".las", ".laz"])
def test_clouds_as_las(tmp_path: Path, end: str) -> None:
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    own = image()
    written = write_surface(tmp_path / f"c{end}", own)
    read = laspy.read(written.path)
    known = own.measured
    np.testing.assert_allclose(read.xyz, own.points()[known], atol=6e-7)
    np.testing.assert_array_equal(read.blue // 257, own.color[known][:, 2])
    np.testing.assert_array_equal(read["sigma"], own.sigma_m[known])
    assert (np.asarray(read.return_number) == 1).all()
    points = np.array([[1.0, 2.0, 5e4], [-3.0, 0.5, 7.25]])  # 50 km
    write_points(tmp_path / f"p{end}", points, {"intensity": np.array([0.0, 255.0])})
    read = laspy.read(tmp_path / f"p{end}")
    np.testing.assert_allclose(read.xyz, points, atol=6e-5)
    assert read.intensity.tolist() == [0, 65535]
    write_las(tmp_path / f"none{end}", np.empty((0, 3)))
    assert len(laspy.read(tmp_path / f"none{end}").points) == 0


def test_without_the_library_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(
        OutputError, match=r"laz files need laspy and lazrs .*pip install laspy lazrs, which the extra las"
    ):
        write_surface(tmp_path / "c.laz", image())
    with pytest.raises(OutputError, match=r"las files need laspy \(No module named 'laspy'\)"):
        check_ending(tmp_path / "c.las")
    assert not [*tmp_path.iterdir()]


def test_depth_and_arrays(tmp_path: Path) -> None:
    own = image()
    written = write_surface(tmp_path / "d.PNG", own)
    depth_mm = cv2.imread(str(written.path), cv2.IMREAD_UNCHANGED)
    assert depth_mm.dtype == np.uint16
    near = own.measured & (own.depth_m < 65)
    assert np.abs(depth_mm[near] - 1000 * own.depth_m[near]).max() <= 0.51
    assert (depth_mm[~near] == 0).all()
    assert (written.points, written.left_out) == (KNOWN - 1, 1) and "65.535 m" in written.text
    written = write_surface(tmp_path / "a.npz", own)
    with np.load(written.path) as arrays:
        assert {*arrays} == {"depth_m", "sigma_m", "normals", "color", "K", "baseline_m"}
        np.testing.assert_array_equal(arrays["depth_m"], own.depth_m)
        np.testing.assert_array_equal(arrays["normals"], normal_image(own))
        pixel = arrays["K"] @ own.points()[3, 15]
        np.testing.assert_allclose(pixel[:2] / pixel[2], [15, 3], rtol=1e-6)
    assert written.points == KNOWN


def test_points_that_are_not_of_an_image(tmp_path: Path) -> None:
    points, values = np.array([[1.0, 2.0, 3.5], [4.0, 5.25, 6.0]]), {"intensity": np.array([7.0, 9.0])}
    assert write_points(tmp_path / "p.ply", points, values).points == 2
    np.testing.assert_array_equal(np.frombuffer(table(tmp_path / "p.ply")[1], "<f4")[:4], [1, 2, 3.5, 7])
    write_points(tmp_path / "p.pcd", points, values)
    header, data = table(tmp_path / "p.pcd")
    assert "WIDTH 2" in header and "HEIGHT 1" in header
    np.testing.assert_array_equal(np.frombuffer(data, "<f4")[4:], [4, 5.25, 6, 9])
    write_pcd(tmp_path / "none.pcd", np.empty((0, 3)))
    assert "POINTS 0" in table(tmp_path / "none.pcd")[0]
    with pytest.raises(OutputError, match=r"does not end in \.ply, \.pcd, \.las or \.laz"):
        write_points(tmp_path / "p.glb", points, values)


def test_nothing_measured(tmp_path: Path) -> None:
    depth = np.full((4, 5), np.nan, np.float32)
    none = RangeImage(depth, depth, GEOMETRY, np.zeros((4, 5), np.uint8))
    for end in (".ply", ".cloud.ply", ".glb", ".pcd", ".png", ".npz"):
        assert write_surface(tmp_path / f"n{end}", none).points == 0
    document, views = glb(tmp_path / "n.glb")
    assert document["scenes"] == [{}] and views == []
    empty = np.empty((0, 3), np.float32)
    write_glb(tmp_path / "e.glb", empty, np.empty((0, 3), np.int32), empty, empty[:, :2], none.color)
    assert (tmp_path / "e.glb").read_bytes() == (tmp_path / "n.glb").read_bytes()


def test_existing_files_are_kept_and_other_ends_refused(tmp_path: Path) -> None:
    for end in (".ply", ".cloud.ply", ".glb", ".pcd", ".png", ".npz"):
        path = tmp_path / f"s{end}"
        path.write_text("mine")
        with pytest.raises(OutputError, match="already exists"):
            write_surface(path, image())
        assert path.read_text() == "mine"
        write_surface(path, image(), overwrite=True)
        assert path.stat().st_size > 100
    with pytest.raises(OutputError, match=r"does not end in \.cloud\.ply, .*or \.npz") as caught:
        write_surface(tmp_path / "s.obj", image())
    assert caught.value.limit == SURFACE_ENDS
