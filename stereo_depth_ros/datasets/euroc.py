# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sequences in the ASL layout of EuRoC MAV and TUM VI: raw pairs of cam0 and cam1 with lens distortion.

Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 2016; Schubert et al., "The TUM VI benchmark for
evaluating visual-inertial odometry", IROS 2018, whose fisheye cameras are calibrated in a camchain of Kalibr.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path

from stereo_depth_ros.camera_files.documents import read_documents
from stereo_depth_ros.camera_files.reading import read_rig_files
from stereo_depth_ros.camera_files.values import rigid
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.plain_values import entry
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.datasets.dataset import DatasetFrame
from stereo_depth_ros.datasets.image_files import check_sizes, framed, read_frame

__all__ = ["EurocDataset", "body_from_sensor"]

_COPY = "copy it again"
_MOST_BYTES = 2**26  # of data.csv
_END_NS = 2**31 * 10**9  # of the stamps of ROS


class EurocDataset:
    """One sequence; a pair has equal stamps in both cameras, ``skipped`` counts the images without a partner.

    Its calibration are the files sensor.yaml of both cameras, or a camchain beside ``mav0`` or in ``dso``.

    Args:
        folder: the folder that holds ``mav0``, or ``mav0`` itself.

    Attributes:
        root: the folder ``mav0``.

    Raises:
        BagError: another layout, or a file that cannot be read.
        CalibrationError: a calibration for another image size.
    """

    has_stamps = True

    def __init__(self, folder: Path) -> None:
        self.root = root = folder / "mav0" if (folder / "mav0").is_dir() else folder
        if missing := [name for name in ("cam0", "cam1") if not (root / name / "data.csv").exists()]:
            raise BagError(
                f"is not an EuRoC sequence, it has no {', '.join(f'mav0/{name}/data.csv' for name in missing)}",
                subject=str(folder),
                remedy="name the folder that holds mav0",
            )
        left, right = _read_index(root / "cam0"), _read_index(root / "cam1")
        self._pairs = [(stamp, left[stamp], right[stamp]) for stamp in sorted(left.keys() & right.keys())]
        self.skipped = len(left.keys() ^ right.keys())
        if not self._pairs:
            raise BagError(
                f"none of {len(left)} left and {len(right)} right images have equal stamps",
                subject=str(folder),
                value=0,
                remedy="copy the images and data.csv of both cameras again",
            )
        calibration = _calibration(root)
        self.rig = _rig(calibration)
        check_sizes(self.rig, self._pairs[0][1])
        indices = [root / side / "data.csv" for side in ("cam0", "cam1")]
        self.files = [*indices, *calibration, *left.values(), *right.values()]

    def body_from_left(self) -> Pose:
        """Pose of the raw left camera in the body, T_BS of its sensor.yaml.

        Raises:
            BagError: a file that is not a sensor.yaml.
        """
        return body_from_sensor(self.root / "cam0" / "sensor.yaml")

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[DatasetFrame]:
        for stamp_ns, left, right in self._pairs:
            yield DatasetFrame(read_frame(left, self.rig.left, stamp_ns), read_frame(right, self.rig.right, stamp_ns))


def _read_index(camera: Path) -> dict[int, Path]:
    """Image file per stamp in nanoseconds; rows without an image file, as in an excerpt, are skipped."""
    path = camera / "data.csv"
    text = read_text(path, BagError, _COPY, _MOST_BYTES)
    try:
        rows = [row for row in csv.reader(io.StringIO(text)) if row and not row[0].startswith("#")]
        images = {int(row[0]): camera / "data" / Path(row[1].strip()).name for row in rows}
    except (ValueError, IndexError, csv.Error) as error:
        raise BagError("its rows are not a stamp and a file name", subject=str(path), remedy=_COPY) from error
    if images and not 0 <= min(images) <= max(images) < _END_NS:
        raise BagError(
            f"has stamps outside 0..{_END_NS // 10**9} s, they are in nanoseconds",
            subject=str(path),
            value=(min(images), max(images)),
            limit=_END_NS,
            remedy=_COPY,
        )
    present = {path.name for path in (camera / "data").glob("*")}
    return {stamp_ns: path for stamp_ns, path in images.items() if path.name in present}


def _calibration(root: Path) -> list[Path]:
    """The files of both cameras, or that of the rig."""
    sensors = [root / side / "sensor.yaml" for side in ("cam0", "cam1")]
    folders = root / "dso", root.parent / "dso", root, root.parent
    chains = [path for folder in folders for path in sorted(folder.glob("*camchain*.yaml"))]
    if any(path.exists() for path in sensors) or not chains:
        return sensors
    if len(chains) > 1:
        raise BagError(
            f"has several calibrations: {', '.join(map(str, chains))}",
            subject=str(root),
            value=len(chains),
            limit=1,
            remedy="leave one of them, or sensor.yaml in cam0 and cam1",
        )
    return chains


def _rig(files: list[Path]) -> StereoRig:
    try:
        return framed(read_rig_files(files))
    except CalibrationError as error:
        kind = "the sensor.yaml of an EuRoC camera" if len(files) > 1 else "a camchain of Kalibr"
        raise BagError(
            f"is not {kind} ({error.problem})",
            subject=error.subject,
            value=error.value,
            limit=error.limit,
            remedy=_COPY,
        ) from error


def body_from_sensor(path: Path) -> Pose:
    """Pose of a sensor in the body, T_BS of its sensor.yaml, of any kind of sensor.

    Raises:
        BagError: a file that is not one.
    """
    try:
        (document,) = read_documents(path)
        return Pose.from_matrix(rigid(entry(document.values, "T_BS"), "T_BS"))
    except (CalibrationError, ValueError) as error:
        problem = error.problem if isinstance(error, CalibrationError) else str(error)
        raise BagError(f"is not a sensor.yaml ({problem})", subject=str(path), remedy=_COPY) from error
