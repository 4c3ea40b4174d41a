# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Binary glTF files (.glb, glTF 2.0 of the Khronos Group) of a mesh with normals, and a texture or colors."""

from __future__ import annotations

import json
import math
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

_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125  # component types
_VERTICES, _INDICES = 34962, 34963  # targets of buffer views
# Turns about x into the axes of glTF, as quaternions
_OPTICAL, _Z_UP = [1.0, 0.0, 0.0, 0.0], [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]


def write_glb(
    path: Path,
    points_m: F32,
    triangles: npt.NDArray[np.int32],
    normals: F32,
    texture_coordinates: F32 | None = None,
    texture: U8 | None = None,
    *,
    colors: U8 | None = None,
    z_up: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a mesh. A node turns it into the axes of glTF (y up, z backward).

    Args:
        path: the file; missing folders are created.
        points_m: float32 (N, 3), vertices, meters.
        triangles: int32 (M, 3), counter-clockwise seen from outside; without one, the scene is empty.
        normals: float32 (N, 3), unit vectors.
        texture_coordinates: float32 (N, 2), 0..1 from the upper left corner of the texture.
        texture: uint8 (H, W) gray or (H, W, 3) RGB, stored as PNG.
        colors: uint8 (N, 3) RGB, of vertices without a texture; stored as linear light, which the format demands.
        z_up: the axes are those of a robot (x forward, y left, z up), not an optical frame (y down, z forward).
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
        attributes = {"POSITION": _vertices(chunks, points_m), "NORMAL": _vertices(chunks, normals)}
        if texture_coordinates is not None:
            attributes["TEXCOORD_0"] = _vertices(chunks, texture_coordinates)
        if colors is not None:
            attributes["COLOR_0"] = _colors(chunks, colors)
        document |= _surface(chunks, attributes, triangles, _Z_UP if z_up else _OPTICAL)
        if texture is not None:
            document |= _texture(chunks, document["materials"][0]["pbrMetallicRoughness"], texture)
        document["buffers"] = [{"byteLength": chunks.size}]
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
    chunks: _Chunks, attributes: dict[str, dict[str, Any]], triangles: npt.NDArray[np.int32], rotation: list[float]
) -> dict[str, Any]:
    """The parts of the document that describe the mesh, of the accessors of its attributes."""
    view = chunks.add(triangles.astype("<u4").tobytes(), target=_INDICES)
    indices = {"bufferView": view, "componentType": _UINT32, "count": triangles.size, "type": "SCALAR"}
    numbers = {name: number for number, name in enumerate(attributes)}
    return {
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": rotation}],
        "meshes": [{"primitives": [{"attributes": numbers, "indices": len(numbers), "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}, "doubleSided": True}],
        "accessors": [*attributes.values(), indices],
        "bufferViews": chunks.views,
    }


def _vertices(chunks: _Chunks, array: F32) -> dict[str, Any]:
    """The accessor of an array with a row for each vertex; that of positions needs their limits."""
    view = chunks.add(np.ascontiguousarray(array, "<f4").tobytes(), target=_VERTICES)
    accessor = {"bufferView": view, "componentType": _FLOAT, "count": len(array), "type": f"VEC{array.shape[1]}"}
    low, high = (getattr(array, name)(axis=0).astype(float).tolist() for name in ("min", "max"))
    return accessor if view else {**accessor, "min": low, "max": high}


def _colors(chunks: _Chunks, colors: U8) -> dict[str, Any]:
    """The accessor of colors: linear light in 16 bits, with an alpha, so that each begins at a multiple of 4 bytes."""
    levels = np.arange(256) / 255
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)  # of sRGB, IEC 61966-2-1
    values = np.full((len(colors), 4), 65535, "<u2")
    values[:, :3] = np.rint(65535 * linear).astype("<u2")[colors]
    view = chunks.add(values.tobytes(), target=_VERTICES)
    return {"bufferView": view, "componentType": _UINT16, "normalized": True, "count": len(colors), "type": "VEC4"}


def _texture(chunks: _Chunks, material: dict[str, Any], texture: U8) -> dict[str, Any]:
    """The parts of the document that describe a texture, which the material gets."""
    pixels = texture if texture.ndim == 2 else cv2.cvtColor(texture, cv2.COLOR_RGB2BGR)
    image = cv2.imencode(".png", pixels)[1].tobytes()
    material["baseColorTexture"] = {"index": 0}
    return {
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}],  # linear, clamped
        "images": [{"bufferView": chunks.add(image), "mimeType": "image/png"}],
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
