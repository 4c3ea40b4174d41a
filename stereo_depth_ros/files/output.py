# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Safe output files: inputs and existing files are protected, and a file appears only when it is complete.

A file is written under a temporary name in the same folder and renamed when it is complete.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.core.in_words import DISK_FULL, in_words

__all__ = ["OutputFile", "as_output_errors", "check_outputs", "write_file"]


def check_outputs(
    outputs: Iterable[Path],
    inputs: Iterable[Path] = (),
    *,
    reports: Iterable[Path | None] = (),
    overwrite: bool = False,
) -> None:
    """Refuse files that must not or cannot be written; call it before anything is read or computed.

    Args:
        outputs: files that will be written; missing parent folders will be created.
        inputs: files that are read; none of them may be written, also not through a link.
        reports: more files that will be written, in existing folders; None and "-" (stdout) are ignored.
        overwrite: existing files may be replaced.

    Raises:
        OutputError: a file is an input, is named twice, already exists, is a folder, or its folder is not writable.
    """
    created = list(outputs)
    written = [*created, *(report for report in reports if report is not None and str(report) != "-")]
    read = {_identity(path) for path in inputs} - {None} if any(map(_identity, written)) else set()
    names: set[str] = set()
    folders: set[Path] = set()
    for number, path in enumerate(written):
        if _identity(path) in read:
            raise OutputError(
                "would overwrite an input", subject=str(path), value=str(path), remedy="write to another file"
            )
        _check_free(path, overwrite)
        if _is_device(path):
            continue
        if path.parent not in folders:
            _check_folder(path, may_be_created=number < len(created))
            folders.add(path.parent)
        if (name := os.path.realpath(path)) in names:
            raise OutputError("two outputs have this name", subject=str(path), remedy="give each a different name")
        names.add(name)


def write_file(path: Path, data: bytes | str, *, overwrite: bool = False, make_folders: bool = False) -> None:
    """Write a complete file; text as UTF-8. The arguments are those of :class:`OutputFile`.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be written.
    """
    with OutputFile(path, overwrite=overwrite, make_folders=make_folders) as output, as_output_errors(path):
        output.file.write(data.encode() if isinstance(data, str) else data)


_records: list[list[OutputFile]] = []


@contextmanager
def recorded_outputs() -> Iterator[list[OutputFile]]:
    """The output files that are opened in the ``with`` block, in this order; without devices and pipes."""
    outputs: list[OutputFile] = []
    _records.append(outputs)
    try:
        yield outputs
    finally:
        _records.remove(outputs)


class OutputFile:
    """A file that appears when its ``with`` block has ended without an error.

    Devices and pipes have no content to protect and are written directly.

    Args:
        path: the file.
        overwrite: replace an existing file; of a link, the link is replaced and its target is kept.
        make_folders: create missing parent folders.

    Attributes:
        path: the file.
        file: binary file object to write to.
        complete: whether it has appeared under its name.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be created.
    """

    def __init__(self, path: Path, *, overwrite: bool = False, make_folders: bool = False) -> None:
        _check_free(path, overwrite)
        self.path = path
        self.complete = False
        self._overwrite = overwrite
        self._temporary = None if _is_device(path) else path.with_name(f".{secrets.token_hex(8)}.partial")
        with as_output_errors(path):
            if make_folders:
                path.parent.mkdir(parents=True, exist_ok=True)
            if self._temporary is None:
                self.file: BinaryIO = path.open("wb")
            else:
                # runs at process exit too, wherever an interrupt occurs
                self._remove = weakref.finalize(self, self._temporary.unlink, missing_ok=True)
                self.file = self._create(self._temporary)

    def close(self) -> None:
        """Complete the file and give it its name.

        Raises:
            OutputError: writing fails, or a file of this name has been created in the meantime.
        """
        try:
            with as_output_errors(self.path):
                self.file.close()
                if self._temporary is not None:
                    self._rename(self._temporary)
            self.complete = True
        finally:
            self.discard()

    def discard(self) -> None:
        """Remove the incomplete file; does nothing after :meth:`close`."""
        if file := getattr(self, "file", None):  # not yet there after an interrupt while it was created
            with suppress(OSError):
                file.close()
        if self._temporary is not None:
            self._remove()

    def __enter__(self) -> OutputFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def _create(self, temporary: Path) -> BinaryIO:
        """The file, recorded before it exists: whoever is interrupted in between tells of it too."""
        for outputs in _records:
            outputs.append(self)
        try:
            return temporary.open("xb")  # exclusive: a link of this name is not followed
        except OSError:
            for outputs in _records:
                outputs.remove(self)
            raise

    def _rename(self, temporary: Path) -> None:
        if self._overwrite:
            temporary.replace(self.path)
            return
        try:
            os.link(temporary, self.path)
        except FileExistsError:
            _check_free(self.path, overwrite=False)
            raise
        except OSError:  # a file system without hard links: reserve the name first
            self.path.open("xb").close()
            temporary.replace(self.path)


@contextmanager
def as_output_errors(subject: Path | str) -> Iterator[None]:
    """Convert OSErrors raised while ``subject`` is written; BrokenPipeError passes unchanged.

    Raises:
        OutputError: in place of an OSError.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        reason = "its folder does not exist" if error.errno == errno.ENOENT else in_words(error)
        raise _cannot_write(subject, reason, _remedy(error)) from error


def _remedy(error: OSError) -> str:
    if error.errno in DISK_FULL:
        return "free space on the disk"
    other = {errno.ENAMETOOLONG: "choose a shorter name", errno.EEXIST: "write to another file"}
    return other.get(error.errno or 0, "choose a writable folder")


def _check_free(path: Path, overwrite: bool) -> None:
    with as_output_errors(path):
        try:
            os.lstat(path)
        except FileNotFoundError:
            return
    mode = _mode(path)
    if stat.S_ISDIR(mode):
        raise _cannot_write(path, "it is a folder", "name a file")
    if _is_device(path):
        return
    if not overwrite:
        remedy = "remove it, write to another file, or allow overwriting"
        raise OutputError("already exists", subject=str(path), remedy=remedy, settings=("overwrite",))
    if mode and not os.access(path, os.W_OK):
        raise _cannot_write(path, "it is write-protected", "change its permissions, or write to another file")


def _check_folder(path: Path, may_be_created: bool) -> None:
    """Try to create an unnamed file in the folder: its permissions alone do not show whether this is possible."""
    folder = path.parent
    if not may_be_created and not stat.S_ISDIR(_mode(folder)):
        raise _cannot_write(path, f"folder {folder} does not exist", "create it, or choose another folder")
    while not _mode(folder):
        folder = folder.parent
    with as_output_errors(path), tempfile.TemporaryFile(dir=folder):
        pass


def _cannot_write(subject: Path | str, reason: str, remedy: str) -> OutputError:
    return OutputError(f"cannot be written: {reason}", subject=str(subject), remedy=remedy)


def _is_device(path: Path) -> bool:
    """Whether the path is a device, a pipe or a socket."""
    mode = _mode(path)
    return mode != 0 and not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


def _mode(path: Path) -> int:
    """File type and permissions, links followed; 0 if the path does not exist."""
    found = _stat(path)
    return found.st_mode if found is not None else 0


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and inode, equal for all names of a file; None if the path does not exist."""
    found = _stat(path)
    return (found.st_dev, found.st_ino) if found is not None else None


def _stat(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except OSError:
        return None
