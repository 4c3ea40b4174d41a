# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Binary glTF files (.glb, glTF 2.0 of the Khronos Group) of a mesh with normals and a texture."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.core.version import __version__
from stereo_depth_ros.files.output import write_file

__all__ = ["write_glb"]

_FLOAT, _UINT32 = 5126, 5125  # component types
_VERTICES, _INDICES = 34962, 34963  # targets of buffer views


def write_glb(
    path: Path,
    points_m: F32,
    triangles: npt.NDArray[np.int32],
    normals: F32,
    texture_coordinates: F32,
    texture: U8,
    *,
    overwrite: bool = False,
) -> None:
    """Write a mesh. A node turns it from an optical frame (y down, z forward) into the axes of glTF (y up, z backward).

    Args:
        path: the file; missing folders are created.
        points_m: float32 (N, 3), vertices, meters.
        triangles: int32 (M, 3), counter-clockwise seen from outside; without one, the scene is empty.
        normals: float32 (N, 3), unit vectors.
        texture_coordinates: float32 (N, 2), 0..1 from the upper left corner of the texture.
        texture: uint8 (H, W) gray or (H, W, 3) RGB, stored as PNG.
        overwrite: replace a file that is there.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be written.
    """
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"stereo_depth_ros {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": []}],
    }
    chunks = _Chunks()
    if len(triangles):
        document |= _surface(chunks, points_m, triangles, normals, texture_coordinates, texture)
    else:
        del document["scenes"][0]["nodes"]
    text = json.dumps(document, separators=(",", ":")).encode()
    parts = [_chunk(b"JSON", text, b" ")]
    if chunks.views:
        parts.append(_chunk(b"BIN\0", b"".join(chunks.parts), b"\0"))
    data = b"".join(parts)
    header = struct.pack("<4sII", b"glTF", 2, 12 + len(data))
    write_file(path, header + data, overwrite=overwrite, make_folders=True)


def _surface(
    chunks: _Chunks,
    points_m: F32,
    triangles: npt.NDArray[np.int32],
    normals: F32,
    texture_coordinates: F32,
    texture: U8,
) -> dict[str, Any]:
    """The parts of the document that describe the mesh; its arrays are added to the chunks."""
    count = len(points_m)
    pixels = texture if texture.ndim == 2 else cv2.cvtColor(texture, cv2.COLOR_RGB2BGR)
    image = cv2.imencode(".png", pixels)[1].tobytes()
    low, high = (getattr(points_m, name)(axis=0).astype(float).tolist() for name in ("min", "max"))

    def vertices(array: F32, kind: str, **more: Any) -> dict[str, Any]:
        view = chunks.add(np.ascontiguousarray(array, "<f4").tobytes(), target=_VERTICES)
        return {"bufferView": view, "componentType": _FLOAT, "count": count, "type": kind, **more}

    accessors = [
        vertices(points_m, "VEC3", min=low, max=high),
        vertices(normals, "VEC3"),
        vertices(texture_coordinates, "VEC2"),
    ]
    view = chunks.add(triangles.astype("<u4").tobytes(), target=_INDICES)
    accessors.append({"bufferView": view, "componentType": _UINT32, "count": triangles.size, "type": "SCALAR"})
    shown = {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0, "roughnessFactor": 1.0}
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
    return {
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [1.0, 0.0, 0.0, 0.0]}],  # half a turn about x
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": shown, "doubleSided": True}],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}],  # linear, clamped
        "images": [{"bufferView": chunks.add(image), "mimeType": "image/png"}],
        "accessors": accessors,
        "bufferViews": chunks.views,
        "buffers": [{"byteLength": chunks.size}],
    }


class _Chunks:
    """The binary chunk: parts that begin at multiples of 4 bytes, and their buffer views."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.views: list[dict[str, Any]] = []
        self.size = 0

    def add(self, data: bytes, **more: Any) -> int:
        """Append a part; the number of its view."""
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": len(data), **more})
        self.parts.append(data + b"\0" * (-len(data) % 4))
        self.size += len(self.parts[-1])
        return len(self.views) - 1


def _chunk(kind: bytes, data: bytes, padding: bytes) -> bytes:
    padded = data + padding * (-len(data) % 4)
    return struct.pack("<I4s", len(padded), kind) + padded
