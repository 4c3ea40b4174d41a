# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of a program that writes whenever it is asked to: fixed at its start, nothing is written elsewhere."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from stereo_depth_ros.core.errors import ConfigError, OutputError
from stereo_depth_ros.core.quoted import quoted

__all__ = ["OwnFolder"]

_MOST = 1000  # sets of files


class OwnFolder:
    """Sets of files in a folder and in numbered folders below it; none is replaced, unless asked, and no link followed.

    Args:
        text: path of the folder, which need not exist; ``~`` and links in it are resolved now, once and for all.
        setting: name of the parameter that gave it.

    Attributes:
        path: absolute path of the folder.

    Raises:
        ConfigError: not the path of a folder.
    """

    def __init__(self, text: str, setting: str) -> None:
        self._setting = setting
        try:
            if not text.isprintable() or not text.strip():
                raise ValueError("a path has characters, all of them printable")
            self.path = Path(text).expanduser().resolve()
        except (RuntimeError, ValueError, OSError) as error:  # RuntimeError: no such user, or a loop of links
            raise ConfigError(
                f"{setting} = {quoted(text)} is not the path of a folder",
                value=text,
                limit="a path",
                remedy="write another one; ~ is the home of a user who exists",
                settings=(setting,),
            ) from error

    def place(self, names: Sequence[str], *, overwrite: bool = False) -> Path:
        """The folder for a set of files: the first one without any of them, which need not exist.

        Args:
            names: of the files.
            overwrite: the files may be replaced, so that it is :attr:`path` itself.

        Raises:
            OutputError: the folder, or a file to replace, is a link; or there are too many sets of files.
        """
        for folder in self._folders():
            if folder.resolve() != folder:
                raise self._refused(folder)
            there = [folder / name for name in names if os.path.lexists(folder / name)]
            if overwrite and (link := next(filter(Path.is_symlink, there), None)):
                raise self._refused(link)
            if overwrite or not there:
                return folder
        raise OutputError(
            f"holds {_MOST} sets of files",
            subject=str(self.path),
            value=_MOST,
            limit=_MOST,
            remedy="remove some of them, or start again with another folder",
            settings=(self._setting,),
        )

    def _folders(self) -> Iterator[Path]:
        yield self.path
        yield from (self.path / str(number) for number in range(2, _MOST + 1))

    def _refused(self, path: Path) -> OutputError:
        return OutputError(
            "is a link, which is not followed",
            subject=str(path),
            remedy="remove it, or start again with the folder that it stands for",
            settings=(self._setting,),
        )
