# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Opens the files of a bag, of any format and compression."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from stereo_depth_ros.bags.chunked_file import Channel, RawMessage, Waiting
from stereo_depth_ros.bags.inflate import InflationBudget, inflate_file
from stereo_depth_ros.bags.losses import Losses, cause_text
from stereo_depth_ros.bags.mcap_file import McapFile
from stereo_depth_ros.bags.metadata import METADATA, listed_files
from stereo_depth_ros.bags.ros1_file import Ros1File
from stereo_depth_ros.bags.sqlite_file import SqliteFile
from stereo_depth_ros.core.errors import BagError

__all__ = ["BagSource", "bag_files", "is_bag", "open_sources"]

_ROSBAG2_KINDS = (".mcap", ".db3")
_KINDS = "an .mcap, .db3 or .bag file or a rosbag2 folder"


class BagSource(Protocol):
    """One file of a bag; ``counts`` gives its channels and their numbers of messages."""

    path: Path
    cut: bool
    losses: Losses
    budget: InflationBudget

    @property
    def start_ns(self) -> int: ...

    @property
    def end_ns(self) -> int: ...

    @property
    def counts(self) -> list[tuple[Channel, int]]: ...

    def messages(self, topics: set[str], start_ns: int, end_ns: int, waiting: Waiting) -> Iterator[RawMessage]: ...

    def close(self) -> None: ...


def is_bag(path: Path) -> bool:
    """Whether a path is a bag by its name: an .mcap, .db3 or .bag file, or a folder with .mcap or .db3 files.

    The files may be compressed as a whole, which adds ``.zstd``. What is in them is not read.
    """
    if path.is_dir():
        return any(_kind(file) in _ROSBAG2_KINDS for file in path.iterdir())
    return path.is_file() and _kind(path) in (*_ROSBAG2_KINDS, ".bag")


def open_sources(path: Path, stack: ExitStack) -> tuple[list[BagSource], list[str]]:
    """The files of a bag, opened; ``stack`` closes them.

    Returns:
        The files, and what of the bag is not read, a part of a sentence about the bag each.

    Raises:
        BagError: the path does not exist, is not a bag, is empty, or cannot be read.
    """
    if not path.exists():
        raise BagError("does not exist", subject=str(path), remedy=f"give {_KINDS}")
    if not path.is_dir():
        return [_open_file(path, stack)], []
    listed, note = listed_files(path)
    files = _existing(path, listed) if listed else _found(path)
    if not files:
        raise BagError("is not a bag, it holds no .mcap or .db3 file", subject=str(path), remedy=f"give {_KINDS}")
    sources: list[BagSource] = []
    errors: list[BagError] = []
    for file in files:
        try:
            sources.append(_open_file(file, stack))
        except BagError as error:
            errors.append(error)
    if not sources:
        raise errors[0]
    notes = [f"lacks {Path(error.subject).name}, which {error.problem}" for error in errors]
    return sources, [note, *notes] if note else notes


def bag_files(path: Path) -> list[Path]:
    """Every file of a bag: itself, or all files of its folder."""
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


def _existing(folder: Path, listed: list[Path]) -> list[Path]:
    """The listed files; one that a recorder was about to compress, or that was decompressed, has the other name."""
    others = {file: file.with_suffix("") if file.suffix == ".zstd" else Path(f"{file}.zstd") for file in listed}
    files = [file if file.exists() or not others[file].exists() else others[file] for file in listed]
    if missing := [file.name for file in files if not file.exists()]:
        raise BagError(
            f"lacks {', '.join(missing[:5])}{', ...' * (len(missing) > 5)}, which its {METADATA} lists",
            subject=str(folder),
            value=missing,
            remedy="copy the whole folder",
        )
    return files


def _found(folder: Path) -> list[Path]:
    """The bag files of a folder, without those that a recorder was about to compress when it was killed."""
    files = sorted(file for file in folder.iterdir() if _kind(file) in _ROSBAG2_KINDS)
    return [file for file in files if file.suffix != ".zstd" or file.with_suffix("") not in files]


def _open_file(path: Path, stack: ExitStack) -> BagSource:
    kind = _kind(path)
    if kind not in _OPENERS or not path.is_file():
        raise BagError("is not a bag", subject=str(path), remedy=f"give {_KINDS}")
    try:
        if not path.stat().st_size:
            raise BagError("is empty (0 bytes)", subject=str(path), value=0, remedy="record it again")
        source = _open_compressed(path, kind, stack) if path.suffix == ".zstd" else _OPENERS[kind](path)
    except OSError as error:
        why = error.strerror or cause_text(error)
        raise BagError(f"cannot be read ({why})", subject=str(path), remedy="check its permissions") from error
    except BagError as error:
        raise BagError(
            error.problem, subject=str(path), value=error.value, limit=error.limit, remedy=error.remedy
        ) from error
    except Exception as error:  # those of the libraries that parse it have no common base class
        raise BagError(
            f"is cut or damaged ({cause_text(error)})", subject=str(path), remedy="record or copy it again"
        ) from error
    stack.callback(source.close)
    return source


def _open_compressed(path: Path, kind: str, stack: ExitStack) -> BagSource:
    file = Path(stack.enter_context(TemporaryDirectory()), path.stem)
    damage = inflate_file(path, file)
    try:
        source = _OPENERS[kind](file)
    except BagError as error:
        raise damage or error from error
    source.cut = source.cut or damage is not None
    return source


_OPENERS: Mapping[str, Callable[[Path], BagSource]] = {".mcap": McapFile, ".db3": SqliteFile, ".bag": Ros1File}


def _kind(path: Path) -> str:
    """The file suffix, ignoring a trailing .zstd, and the .active of ROS 1 bags whose recorder was killed."""
    return Path(path.stem).suffix if path.suffix in (".zstd", ".active") else path.suffix
