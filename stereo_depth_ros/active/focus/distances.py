# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Focus distances of a stack: by a law between the nearest and the farthest, by a table, and by the thin lens."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from stereo_depth_ros.core.errors import BagError, ConfigError, ImageError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.core.types import F64

__all__ = ["LAWS", "ORDERS", "even_distances", "read_focus_table", "table_order", "thin_lens_distance"]

LAWS = ("inverse", "distance")
ORDERS = ("near-to-far", "far-to-near")

_SCALES = {"distance_m": 1.0, "distance_mm": 1e-3, "diopters": 1.0, "sensor_mm": 1e-3}
_REMEDY = f"write a header of image or stamp_s, and one of {', '.join(_SCALES)}, and numbers below it"
_NEAREST_M, _STAMP_S = 1e-6, 1e-3
_NAMED = 3


def thin_lens_distance(sensor_m: F64, focal_length_m: float) -> F64:
    """Distances at which a thin lens is in focus: 1/f = 1/Z + 1/v, so Z = f v / (v - f).

    Args:
        sensor_m: v, distances of the sensor behind the lens, meters.
        focal_length_m: f, meters.

    Returns:
        float64, Z before the lens, meters; infinite where v = f.

    Raises:
        ConfigError: a sensor nearer to the lens than its focal length, where nothing is in focus.
    """
    sensor_m = np.asarray(sensor_m, np.float64)
    if not 0 < focal_length_m <= float(sensor_m.min()):
        raise ConfigError(
            f"the sensor is {1e3 * float(sensor_m.min()):g} mm behind the lens and the focal length is "
            f"{1e3 * focal_length_m:g} mm, nothing is in focus nearer to the lens than that",
            value=float(sensor_m.min()),
            limit=focal_length_m,
            remedy="correct the focal length or the table",
            settings=("focal_length", "table"),
        )
    with np.errstate(divide="ignore"):
        return np.asarray(focal_length_m * sensor_m / (sensor_m - focal_length_m))


def even_distances(near_m: float, far_m: float, count: int, law: str = "inverse", order: str = "near-to-far") -> F64:
    """Focus distances in equal steps of the distance, or of its inverse as most lens drives make them.

    Args:
        near_m, far_m: the ends, meters; far may be infinite with the law inverse.
        count: number of images.
        law: "inverse" or "distance".
        order: "near-to-far" or "far-to-near".

    Returns:
        float64 (count,), meters, in the order of the images.

    Raises:
        ConfigError: ends that are not a range, or another law or order.
    """
    for name, value, known in (("law", law, LAWS), ("order", order, ORDERS)):
        if value not in known:
            raise ConfigError(
                f"{name} {quoted(value)} is not one of {', '.join(known)}", value=value, limit=known, settings=(name,)
            )
    if not _NEAREST_M <= near_m < far_m:
        raise ConfigError(
            f"the nearest focus {near_m:g} m and the farthest {far_m:g} m are not a range",
            value=(near_m, far_m),
            limit=f"{_NEAREST_M:g} m <= near < far",
            remedy="give two distances above 0, the smaller one as the nearest",
            settings=("near", "far"),
        )
    if law == "distance" and not math.isfinite(far_m):
        raise ConfigError(
            "the farthest focus is infinite, equal steps of the distance do not reach it",
            value=far_m,
            remedy="use equal steps of its inverse",
            settings=("law",),
        )
    if law == "distance":
        distances_m = np.linspace(near_m, far_m, count)
    else:
        with np.errstate(divide="ignore"):
            distances_m = 1 / np.linspace(1 / near_m, 1 / far_m, count)
    return distances_m if order == "near-to-far" else distances_m[::-1]


def read_focus_table(path: Path, focal_length_m: float | None = None) -> dict[str, float]:
    """Focus distances, meters, by the names or stamps of images: a CSV file with a header.

    The first column is image or stamp_s; the second one distance_m, distance_mm, diopters (1 / meters, 0 is infinity)
    or sensor_mm, the distance of the sensor behind the lens, which needs the focal length.

    Raises:
        BagError: not such a table.
        ConfigError: sensor distances without a focal length, or a focal length without them.
    """
    rows = list(csv.reader(read_text(path, BagError, _REMEDY).splitlines(), skipinitialspace=True))
    rows = [row for row in rows if row and not row[0].startswith("#")]
    header = [name.strip().lower() for name in rows[0]] if rows else []
    if len(header) != 2 or header[0] not in ("image", "stamp_s") or header[1] not in _SCALES or len(rows) < 2:
        raise _refused(path, "is not a table of focus distances", header)
    if (header[1] == "sensor_mm") != (focal_length_m is not None):
        found = "is not given" if focal_length_m is None else f"has no effect with a column {header[1]}"
        raise ConfigError(
            f"the focal length {found}",
            subject=str(path),
            value=focal_length_m,
            remedy="give it with a column sensor_mm, and only then",
            settings=("focal_length",),
        )
    values: dict[str, float] = {}
    for number, row in enumerate(rows[1:], start=2):
        try:
            key, value = row[0].strip(), _SCALES[header[1]] * float(row[1])
            float(key if header[0] == "stamp_s" else 0)
        except (ValueError, IndexError) as error:
            raise _refused(path, f"row {number} holds what is not a number", row) from error
        lowest = 0.0 if header[1] == "diopters" else _NEAREST_M
        if len(row) != 2 or not lowest <= value or (not math.isfinite(value) and not header[1].startswith("distance")):
            raise _refused(path, f"row {number} holds {quoted(row[1])}, which is not a {header[1]}", row)
        if key in values:
            raise _refused(path, f"row {number} names {quoted(key)} again", key)
        values[key] = value
    found_values = np.array([*values.values()])
    if header[1] == "sensor_mm" and focal_length_m is not None:
        found_values = thin_lens_distance(found_values, focal_length_m)
    elif header[1] == "diopters":
        with np.errstate(divide="ignore"):
            found_values = 1 / found_values
    return dict(zip(values, found_values.tolist(), strict=True))


def table_order(table: Mapping[str, float], names: Sequence[str], stamps_ns: Sequence[int], path: Path) -> F64:
    """The focus distances of images by a table.

    Args:
        table: of :func:`read_focus_table`.
        names: of the images; empty where they have none.
        stamps_ns: of the images, used where they have no names.
        path: of the table, for errors.

    Returns:
        float64 (N,), meters, in the order of the images.

    Raises:
        ImageError: an image without a row, or a row without an image.
    """
    found = {name: name for name in names if name in table}
    keys = [*names]
    if not names:
        keys = [f"{stamp / 1e9:.3f}" for stamp in stamps_ns]
        found = {key: row for key, stamp in zip(keys, stamps_ns, strict=True) if (row := _at(table, stamp))}
    for what, missing in (
        ("no row for", [key for key in keys if key not in found]),
        ("rows without an image", [row for row in table if row not in found.values()]),
    ):
        if missing:
            more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
            raise ImageError(
                f"the table does not match the {len(keys)} images, {what}: {', '.join(missing[:_NAMED])}{more}",
                subject=str(path),
                value=len(table),
                limit=len(keys),
                remedy="write one row for each image",
                settings=("table",),
            )
    return np.array([table[found[key]] for key in keys])


def _at(table: Mapping[str, float], stamp_ns: int) -> str | None:
    """The row of a stamp."""
    for row in table:
        try:
            if abs(float(row) - stamp_ns / 1e9) < _STAMP_S:
                return row
        except ValueError:
            return None
    return None


def _refused(path: Path, problem: str, value: object) -> BagError:
    return BagError(problem, subject=str(path), value=value, remedy=_REMEDY, settings=("table",))
