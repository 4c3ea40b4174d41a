# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The option --export: files of surfaces and clouds, of the first result or of each one."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

from stereo_depth_ros.cli.tables import TextTable
from stereo_depth_ros.core.errors import OutputError, StereoDepthError
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.writing import SURFACE_ENDS, WrittenFile, check_ending, write_surface

__all__ = ["STAMP", "SurfaceExport", "add_files"]

STAMP = "{stamp}"


class SurfaceExport:
    """Writes results as the option tells; the files of a ``with`` block that ends with a StereoDepthError are removed.

    Args:
        name: the file; with ``{stamp}``, one of each result with its stamp, integer nanoseconds; None writes nothing.
        overwrite: replace files that are there.

    Attributes:
        name: as given.
        written: the files.

    Raises:
        OutputError: a name that no format has, a missing library, or without ``overwrite`` a file that is there.
    """

    def __init__(self, name: Path | None, *, overwrite: bool = False) -> None:
        self.name, self._overwrite = name, overwrite
        self.written: list[WrittenFile] = []
        self._every = name is not None and STAMP in name.name
        if name is None:
            return
        check_ending(name, SURFACE_ENDS)
        if STAMP in str(name.parent):
            raise OutputError(
                f"cannot be written: {STAMP} is in the name of a folder",
                subject=str(name),
                value=str(name.parent),
                limit=STAMP,
                remedy="write it into the name of the file",
                settings=("export",),
            )
        if self._every and not overwrite and (found := _existing(name)):
            raise OutputError(
                "already exists",
                subject=str(found),
                remedy="remove it, write to another file, or allow overwriting",
                settings=("overwrite",),
            )

    def add(self, result: StereoResult) -> None:
        """Write a result, if it is to be written.

        Raises:
            OutputError: it cannot be written.
        """
        if self._wants_more:
            self._write(RangeImage.of(result), result.stamp_ns)

    def add_image(self, image: RangeImage, stamp_ns: int) -> None:
        """Write the depth of another sensor in the same way.

        Raises:
            OutputError: it cannot be written.
        """
        if self._wants_more:
            self._write(image, stamp_ns)

    @property
    def _wants_more(self) -> bool:
        return self.name is not None and (self._every or not self.written)

    def _write(self, image: RangeImage, stamp_ns: int) -> None:
        assert self.name is not None
        path = self.name.with_name(self.name.name.replace(STAMP, str(stamp_ns)))
        self.written.append(write_surface(path, image, overwrite=self._overwrite))

    def __enter__(self) -> SurfaceExport:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, StereoDepthError):
            for file in self.written:
                file.path.unlink(missing_ok=True)

    def to_json(self) -> dict[str, Any]:
        """The files as plain data, without --export nothing."""
        return {} if self.name is None else {"surfaces": [file.to_json() for file in self.written]}


def add_files(facts: TextTable, files: Iterable[WrittenFile]) -> None:
    """Add a row for one file, or for several with their number and the sum of what they lack."""
    listed = [*files]
    if len(listed) == 1:
        facts.add_row("surface written", f"{listed[0].path}: {listed[0].text}")
    elif listed:
        text = f"{len(listed)} files, {listed[0].path} to {listed[-1].path.name}"
        left_out = sum(file.left_out for file in listed)
        reason = next((f", {left_out} pixels left out, {file.why}" for file in listed if file.left_out), "")
        facts.add_row("surfaces written", f"{text}{reason}")


def _existing(name: Path) -> Path | None:
    """A file that has the name with a number in place of the stamp."""
    before, _, after = name.name.partition(STAMP)
    if not name.parent.is_dir():
        return None
    for path in sorted(name.parent.iterdir()):
        middle = path.name[len(before) : len(path.name) - len(after)]
        if path.name.startswith(before) and path.name.endswith(after) and middle.isdigit():
            return path
    return None
