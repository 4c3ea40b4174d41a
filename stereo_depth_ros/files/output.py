# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rule for every file that is written: nothing that is read or already there is lost, nothing half written shows.

A file is written under a temporary name beside its own and gets its own name when it is complete.
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

from stereo_depth_ros.core.errors import OutputError

__all__ = ["OutputFile", "check_outputs", "telling", "write_file"]

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def check_outputs(
    outputs: Iterable[Path],
    inputs: Iterable[Path] = (),
    *,
    reports: Iterable[Path | None] = (),
    overwrite: bool = False,
) -> None:
    """Refuse files that must not or cannot be written; to be called before anything is read or computed.

    Args:
        outputs: files that will be written; the folders above them will be made.
        inputs: files that are read; none of them is written, not even under another name.
        reports: further files that will be written, in folders that are there; None and "-" (stdout) are none.
        overwrite: files that are there may be replaced.

    Raises:
        OutputError: a file is an input, is named twice, is there already, is a folder, or its folder cannot be written.
    """
    made = list(outputs)
    written = [*made, *(report for report in reports if report is not None and str(report) != "-")]
    read = {_identity(path) for path in inputs} - {None} if any(map(_identity, written)) else set()
    names: set[str] = set()
    folders: set[Path] = set()
    for number, path in enumerate(written):
        if _identity(path) in read:
            raise OutputError(f"{path} is read by this command: write to another file")
        _check_free(path, overwrite)
        if _is_device(path):
            continue
        if path.parent not in folders:
            _check_folder(path, may_be_made=number < len(made))
            folders.add(path.parent)
        if (name := os.path.realpath(path)) in names:
            raise OutputError(f"{path} is named for two outputs: give each a file of its own")
        names.add(name)


def write_file(path: Path, data: bytes | str, *, overwrite: bool = False, make_folders: bool = False) -> None:
    """Write a whole file; text as UTF-8. The arguments are those of :class:`OutputFile`.

    Raises:
        OutputError: the file is there and ``overwrite`` is false, or it cannot be written.
    """
    with OutputFile(path, overwrite=overwrite, make_folders=make_folders) as output, telling(path):
        output.file.write(data.encode() if isinstance(data, str) else data)


class OutputFile:
    """A file that appears under its name when the ``with`` block has ended, and not at all where it ends in an error.

    Devices and pipes have no content to lose: they are written directly.

    Args:
        path: the file.
        overwrite: replace a file that is there; a link is replaced, what it points to stays.
        make_folders: make the folders above it.

    Attributes:
        path: the file.
        file: where to write, binary.

    Raises:
        OutputError: the file is there and ``overwrite`` is false, or it cannot be made.
    """

    def __init__(self, path: Path, *, overwrite: bool = False, make_folders: bool = False) -> None:
        _check_free(path, overwrite)
        self.path = path
        self._overwrite = overwrite
        self._temporary = None if _is_device(path) else path.with_name(f".{secrets.token_hex(8)}.partial")
        with telling(path):
            if make_folders:
                path.parent.mkdir(parents=True, exist_ok=True)
            if self._temporary is None:
                self.file = path.open("wb")
            else:
                # also at the end of the process, wherever an interrupt strikes
                self._remove = weakref.finalize(self, self._temporary.unlink, missing_ok=True)
                self.file = self._temporary.open("xb")  # exclusive: a link of this name is not followed

    def close(self) -> None:
        """Give the file its name.

        Raises:
            OutputError: it cannot be written to its end, or a file of this name has appeared meanwhile.
        """
        try:
            with telling(self.path):
                self.file.close()
                if self._temporary is not None:
                    self._rename(self._temporary)
        finally:
            self.discard()

    def discard(self) -> None:
        """Leave nothing behind; after :meth:`close` this does nothing."""
        with suppress(OSError):
            self.file.close()
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

    def _rename(self, temporary: Path) -> None:
        if self._overwrite:
            temporary.replace(self.path)
            return
        try:
            os.link(temporary, self.path)
        except FileExistsError:
            _check_free(self.path, overwrite=False)
            raise
        except OSError:  # a file system without hard links: the name is taken first
            self.path.open("xb").close()
            temporary.replace(self.path)


@contextmanager
def telling(what: Path | str) -> Iterator[None]:
    """Errors of the system while ``what`` is written become errors of the package; a pipe that is closed stays one.

    Raises:
        OutputError: instead of OSError.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        remedy = "make room on the disk" if error.errno in _DISK_FULL else "take a folder that can be written"
        raise OutputError(f"cannot write {what}: {error.strerror or error}: {remedy}") from error


def _check_free(path: Path, overwrite: bool) -> None:
    with telling(path):
        try:
            os.lstat(path)
        except FileNotFoundError:
            return
    mode = _mode(path)
    if stat.S_ISDIR(mode):
        raise OutputError(f"cannot write {path}: it is a folder, name a file")
    if _is_device(path):
        return
    if not overwrite:
        raise OutputError(f"{path} exists: remove it, write to another file, or give --overwrite")
    if mode and not os.access(path, os.W_OK):
        raise OutputError(f"cannot write {path}: it is write-protected: allow writing, or write to another file")


def _check_folder(path: Path, may_be_made: bool) -> None:
    """A file without a name is made there, for permissions do not tell everything."""
    folder = path.parent
    if not may_be_made and not stat.S_ISDIR(_mode(folder)):
        raise OutputError(f"cannot write {path}: there is no folder {folder}: make it, or name another")
    while not _mode(folder):
        folder = folder.parent
    with telling(path), tempfile.TemporaryFile(dir=folder):
        pass


def _is_device(path: Path) -> bool:
    """Whether there is something that has no content of its own."""
    mode = _mode(path)
    return mode != 0 and not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


def _mode(path: Path) -> int:
    """Kind and permissions, links followed; 0 where there is nothing."""
    found = _stat(path)
    return found.st_mode if found is not None else 0


def _identity(path: Path) -> tuple[int, int] | None:
    """The same for all names of a file; None where there is nothing."""
    found = _stat(path)
    return (found.st_dev, found.st_ino) if found is not None else None


def _stat(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except OSError:
        return None
