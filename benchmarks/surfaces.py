# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Surfaces of range images: time of meshes, normals and files, and accuracy on a rendered scene with exact truth.

python benchmarks/surfaces.py
python benchmarks/surfaces.py --json surfaces.json

Times are medians over calls in turns in one run.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.stages.depth import depth_sigma
from stereo_depth_ros.surfaces.mesh import mesh_of, normal_image
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.writing import write_surface
from stereo_depth_ros.synthetic.projection import SyntheticScanner

CALLS = 5
SIGMA_PX = 0.1
ENDS = (".ply", ".glb", ".cloud.ply", ".pcd", ".png", ".npz")


class Row(NamedTuple):
    """One measured quantity."""

    data: str
    figure: str
    value: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="640x480", help="width and height, px")
    parser.add_argument("--json", type=Path, help="write the rows as JSON")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    rows = []
    for row in measured(width, height):
        print("| " + " | ".join(row) + " |", flush=True)
        rows.append(row._asdict())
    if arguments.json:
        write_file(arguments.json, json.dumps(rows, indent=2) + "\n", overwrite=True)


def measured(width: int, height: int) -> Iterator[Row]:
    """The table-top scene with the noise of disparities of SIGMA_PX."""
    scanner = SyntheticScanner(width, height, (64, 48))
    truth, geometry = scanner.truth(), Triangulation.from_rig(scanner.rig)
    sigma_m = depth_sigma(truth.depth_m, geometry, SIGMA_PX)
    noise = np.random.default_rng(1).normal(0, 1, sigma_m.shape).astype(np.float32)
    color = np.random.default_rng(2).integers(0, 256, (height, width, 3), np.uint8)
    image = RangeImage(truth.depth_m + noise * sigma_m, sigma_m, geometry, color)
    exact = RangeImage(truth.depth_m, sigma_m, geometry, color)
    data = f"table top, rendered, {width}x{height}"
    mesh = mesh_of(image)
    x, y = mesh.texture_px.T.astype(int)
    corners, depth = truth.surface[y, x][mesh.triangles], truth.depth_m[y, x][mesh.triangles]
    several = (corners != corners[:, :1]).any(axis=1)
    apart = depth.max(axis=1) - depth.min(axis=1) > 6 * sigma_m[y, x][mesh.triangles].max(axis=1)
    yield Row(data, "points, triangles", f"{len(mesh.points_m)}, {len(mesh.triangles)}")
    yield Row(data, "triangles across a depth step", str(int(np.count_nonzero(several & apart))))
    normals = normal_image(exact)
    for radius in (1, 2, 4):
        yield Row(
            data,
            f"median error of normals, window {2 * radius + 1}",
            angle(normal_image(image, radius_px=radius), normals),
        )
    yield Row(data, "median error of normals, mesh", angle(mesh.normals, normals[y, x]))
    for name, call in (("mesh", partial(mesh_of, image)), ("normals, window 5", partial(normal_image, image))):
        yield Row(data, f"time of {name}", f"{median_ms(call):.0f} ms")
    with tempfile.TemporaryDirectory() as folder:
        for end in ENDS:
            path = Path(folder, f"s{end}")
            took_ms = median_ms(partial(write_surface, path, image, overwrite=True))
            yield Row(data, f"time and size of {end}", f"{took_ms:.0f} ms, {path.stat().st_size / 1e6:.1f} MB")


def angle(found: F32, expected: F32) -> str:
    """The median angle between unit vectors."""
    cosines = np.clip(np.sum(found * expected, axis=-1), -1, 1)
    return f"{np.nanmedian(np.degrees(np.arccos(cosines))):.2f} degrees"


def median_ms(call: Callable[[], object]) -> float:
    """Median time after one call."""
    times = []
    for number in range(CALLS + 1):
        start = time.perf_counter()
        call()
        if number:
            times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


if __name__ == "__main__":
    main()
