# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads small text files: a stated largest size, UTF-8 only, and an error that says what a file is instead."""

from __future__ import annotations

import stat
from pathlib import Path

from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.core.in_words import in_words

__all__ = ["MAX_TEXT_BYTES", "decode_text", "read_bytes", "read_head", "read_text"]

MAX_TEXT_BYTES = 2**20  # a calibration has some kilobytes
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


def read_text(path: Path, error: type[StereoDepthError], remedy: str, most_bytes: int = MAX_TEXT_BYTES) -> str:
    """The text of a file, without a byte order mark.

    Args:
        path: a regular file; a folder, a device or a pipe is an error.
        error: class of the errors.
        remedy: what to give instead, where the file is not there or is not text.
        most_bytes: largest size.

    Raises:
        error: the file cannot be read, is too large, or is not UTF-8.
    """
    return decode_text(read_bytes(path, error, remedy, most_bytes), str(path), error, remedy)


def read_bytes(path: Path, error: type[StereoDepthError], remedy: str, most_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """The bytes of a regular file; arguments and errors as of :func:`read_text`."""
    data = read_head(path, error, remedy, most_bytes + 1)
    if len(data) > most_bytes:
        raise error(
            f"is larger than {most_bytes} bytes",
            subject=str(path),
            value=path.stat().st_size,
            limit=most_bytes,
            remedy=remedy,
        )
    return data


def read_head(path: Path, error: type[StereoDepthError], remedy: str, count: int) -> bytes:
    """The first ``count`` bytes of a regular file, or all where it has fewer; else as :func:`read_text`."""
    try:
        kind = path.stat().st_mode
        if not stat.S_ISREG(kind) and not stat.S_ISDIR(kind):  # opening a pipe would wait for a writer
            raise error("is a device or a pipe, not a file", subject=str(path), remedy=remedy)
        with path.open("rb") as file:
            return file.read(count)
    except (OSError, ValueError) as failure:  # ValueError: a NUL character in the path
        raise error(_why(failure), subject=str(path), remedy=remedy) from failure


def decode_text(data: bytes, subject: str, error: type[StereoDepthError], remedy: str) -> str:
    """The text of UTF-8 bytes, without a byte order mark.

    Args:
        data: the content of a file.
        subject: its path, the subject of errors.
        error: class of the errors.
        remedy: what to give instead, where it is not text.

    Raises:
        error: not UTF-8.
    """
    if data.startswith(_UTF16):
        raise error("is UTF-16 text", subject=subject, value="UTF-16", limit="UTF-8", remedy="save it as UTF-8")
    if b"\0" in data:
        raise error("is a binary file, not text", subject=subject, limit="UTF-8", remedy=remedy)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        line = data.count(b"\n", 0, failure.start) + 1
        raise error(
            f"byte 0x{data[failure.start]:02x} in line {line} is not UTF-8",
            subject=subject,
            value=data[failure.start],
            limit="UTF-8",
            remedy="save it as UTF-8",
        ) from failure


def _why(failure: OSError | ValueError) -> str:
    if isinstance(failure, FileNotFoundError):
        return "does not exist"
    if isinstance(failure, IsADirectoryError):
        return "is a folder, not a file"
    reason = in_words(failure) if isinstance(failure, OSError) else "it is not a path"
    return f"cannot be read, {reason}"
