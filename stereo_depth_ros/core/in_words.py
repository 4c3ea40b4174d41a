# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the system, and types of values, in words for users."""

from __future__ import annotations

import errno
from collections.abc import Mapping

__all__ = ["DISK_FULL", "in_words", "kind_in_words"]

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_SYSTEM: Mapping[int, str] = {
    errno.ENOENT: "it does not exist",
    errno.EISDIR: "it is a folder",
    errno.ENOTDIR: "what its path names as a folder is a file",
    errno.EEXIST: "it exists already",
    errno.EACCES: "the permission is missing",
    errno.EPERM: "the permission is missing",
    errno.EROFS: "the disk is read-only",
    errno.ENAMETOOLONG: "its name is too long",
    errno.ELOOP: "its links form a circle",
    errno.ENXIO: "it is a device or a pipe without another end",
    errno.EBUSY: "another program uses it",
    errno.ETXTBSY: "another program uses it",
    errno.EMFILE: "too many files are open",
    errno.ENFILE: "too many files are open",
    errno.ENOMEM: "memory is exhausted",
    errno.EIO: "the disk fails",
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "the disk is full"),
    errno.EFBIG: "the file is too large for the disk",
}


def in_words(error: BaseException) -> str:
    """The cause that an error of the system states, a clause such as "it is a folder"; the text of other errors."""
    if not isinstance(error, OSError) or not error.errno or not error.strerror:
        return str(error)
    return _SYSTEM.get(error.errno, f"the system says {error.strerror[:1].lower()}{error.strerror[1:]}")


def kind_in_words(kind: type) -> str:
    """What a value of a Python type is to the user of a parameter: "a whole number", "text"."""
    return {
        bool: "true or false",
        int: "a whole number",
        float: "a number",
        str: "text",
        type(None): "empty",
    }.get(kind, "a list" if issubclass(kind, (list, tuple)) or kind.__module__ in ("array", "numpy") else "a mapping")
