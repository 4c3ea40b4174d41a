# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The content of a calibration file as plain data or text: YAML, JSON, XML of OpenCV, text, or an archive of them."""

from __future__ import annotations

import gzip
import io
import json
import re
import tarfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.safe_yaml import MAX_DEPTH, YamlError, load_yaml
from stereo_depth_ros.core.text_files import MAX_TEXT_BYTES, decode_text, read_bytes, read_head

__all__ = ["MAX_ARCHIVE_BYTES", "Document", "read_documents"]

MAX_ARCHIVE_BYTES = 2**28  # packed or unpacked: camera_calibration adds all of its images
_MAX_MEMBERS = 10_000
_LARGEST_READ = 2**22
_GZIP, _BZIP2, _XZ, _ZIP = b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"PK\x03\x04"
_MEMBERS = ("left.yaml", "right.yaml", "ost.yaml", "ost.txt")
_REMEDY = "give a calibration file"
# a row of text that is not YAML, or would be something else in it: of a Videre ini, of KITTI, of Middlebury
_TEXT = re.compile(r"[ \t]*(\[image\]|(P_?(rect_)?\d+:[ \t]*)?[-+.\deE]+([ \t]+[-+.\deE]+){11}[ \t]*$|cam0[ \t]*=)")
_TEXT_BEGINS = 4000  # characters in which such a row stands


@dataclass(frozen=True)
class Document:
    """The content of one file.

    Attributes:
        source: its path, in an archive with the name of the member.
        values: its plain data; empty where it is text.
        text: what is neither YAML, JSON nor XML; else empty.
        folder: holds the file; None for a member of an archive.
    """

    source: str
    values: Mapping[str, Any] = field(default_factory=dict)
    text: str = ""
    folder: Path | None = None


def read_documents(path: Path) -> list[Document]:
    """The documents of a file: one, or those of an archive of camera_calibration.

    Raises:
        CalibrationError: the file cannot be read, is too large, or is none of the kinds.
    """
    head = read_head(path, CalibrationError, _REMEDY, 512)
    if head.startswith(_GZIP) or head[257:262] == b"ustar":
        return _of_archive(path, head.startswith(_GZIP))
    if head.startswith((_BZIP2, _XZ, _ZIP)):
        raise CalibrationError("is a packed file, not a calibration", subject=str(path), remedy="unpack it")
    return [_document(read_bytes(path, CalibrationError, _REMEDY), str(path), path.parent)]


def _document(data: bytes, source: str, folder: Path | None) -> Document:
    text = decode_text(data, source, CalibrationError, _REMEDY)
    first = text.lstrip()[:1]
    try:
        if first == "<":
            values = _from_xml(text)
        elif first == "{":
            values = _from_json(text)
        elif any(map(_TEXT.match, text[:_TEXT_BEGINS].splitlines())):
            return Document(source, text=text, folder=folder)
        else:
            values = load_yaml(text)
    except YamlError as error:
        raise CalibrationError(f"is not plain YAML ({error})", subject=source, remedy=_REMEDY) from error
    except CalibrationError as error:
        raise error.about(source) from error
    if not isinstance(values, Mapping) or not values:
        raise CalibrationError("is not a calibration file, it has no keys", subject=source, remedy=_REMEDY)
    return Document(source, values=values, folder=folder)


def _from_json(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        try:
            return load_yaml(text)  # {a: 1} is a mapping of YAML
        except YamlError:
            raise CalibrationError(f"is not JSON ({error.msg} in line {error.lineno})", remedy=_REMEDY) from error
    except (ValueError, RecursionError) as error:
        raise CalibrationError("is not plain JSON, a number is too long or lists too deep", remedy=_REMEDY) from error


def _from_xml(text: str) -> dict[str, Any]:
    """The plain data of OpenCV's FileStorage."""
    if "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):
        raise CalibrationError("is XML with a document type or entities", remedy="write it with OpenCV's FileStorage")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise CalibrationError(f"is not XML ({error})", remedy=_REMEDY) from error
    if root.tag != "opencv_storage":
        raise CalibrationError("is XML, but not of OpenCV's FileStorage", value=root.tag, remedy=_REMEDY)
    return {child.tag: _xml_value(child, 1) for child in root}


def _xml_value(element: ElementTree.Element, depth: int) -> Any:
    if depth > MAX_DEPTH:
        raise CalibrationError(f"is XML of more than {MAX_DEPTH} levels", limit=MAX_DEPTH, remedy=_REMEDY)
    children = list(element)
    if children and all(child.tag == "_" for child in children):
        return [_xml_value(child, depth + 1) for child in children]
    if children:
        return {child.tag: _xml_value(child, depth + 1) for child in children}
    words = [_xml_word(word) for word in (element.text or "").split()]
    return words[0] if len(words) == 1 and element.tag != "data" else words


def _xml_word(word: str) -> float | str:
    text = word.strip('"')
    try:
        return float(text) if "_" not in text else text
    except ValueError:
        return text


def _of_archive(path: Path, packed: bool) -> list[Document]:
    """The calibration files in a calibrationdata.tar.gz; nothing is written, whatever their paths are."""
    found: dict[str, bytes] = {}
    data = read_bytes(path, CalibrationError, _REMEDY, MAX_ARCHIVE_BYTES)
    raw: Any = io.BytesIO(data)
    stream = _Limited(gzip.GzipFile(fileobj=raw) if packed else raw, str(path))
    try:
        with tarfile.open(fileobj=stream, mode="r:") as archive:
            for number, member in enumerate(archive):
                if number == _MAX_MEMBERS:
                    raise CalibrationError(
                        f"holds more than {_MAX_MEMBERS} files", subject=str(path), limit=_MAX_MEMBERS, remedy=_REMEDY
                    )
                name = PurePosixPath(member.name).name
                if not member.isreg() or name not in _MEMBERS or name in found:
                    continue
                if member.size > MAX_TEXT_BYTES:
                    raise CalibrationError(
                        f"{name} in it is larger than {MAX_TEXT_BYTES} bytes",
                        subject=str(path),
                        value=member.size,
                        limit=MAX_TEXT_BYTES,
                        remedy=_REMEDY,
                    )
                file = archive.extractfile(member)
                found[name] = file.read() if file is not None else b""
    except (tarfile.TarError, OSError, EOFError, zlib.error, ValueError, OverflowError) as error:
        kind = "gzip archive" if packed else "tar archive"
        raise CalibrationError(
            f"is not the {kind} of a calibration, or is damaged", subject=str(path), remedy="copy it again"
        ) from error
    names = [name for name in _MEMBERS if name in found]
    if {"left.yaml", "right.yaml"} <= found.keys():
        names = ["left.yaml", "right.yaml"]
    if not names:
        raise CalibrationError(
            "is an archive without left.yaml and right.yaml",
            subject=str(path),
            limit=_MEMBERS,
            remedy="give the calibrationdata.tar.gz of a stereo calibration",
        )
    if names[0] == "ost.yaml" and "ost.txt" in names:
        names = ["ost.txt"] if found["ost.txt"].count(b"[image]") == 2 else ["ost.yaml"]
    return [_document(found[name], f"{path}: {name}", None) for name in names]


class _Limited(io.RawIOBase):
    """A stream that is read up to a limit: a few kilobytes may unpack to gigabytes.

    Args:
        stream: seeks forward, as in gzip, by reading.
        source: for the error.
    """

    def __init__(self, stream: Any, source: str) -> None:
        self._stream = stream
        self._source = source

    def read(self, size: int = -1) -> bytes:
        if size < 0 or size > _LARGEST_READ:
            raise tarfile.ReadError("a header of an impossible size")
        self._check(self._stream.tell() + size)
        return bytes(self._stream.read(size))

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if whence != io.SEEK_SET:
            raise tarfile.ReadError("only forward")
        self._check(offset)
        return int(self._stream.seek(offset))

    def tell(self) -> int:
        return int(self._stream.tell())

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def _check(self, end: int) -> None:
        if end > MAX_ARCHIVE_BYTES + _LARGEST_READ:
            raise CalibrationError(
                f"unpacks to more than {MAX_ARCHIVE_BYTES} bytes",
                subject=self._source,
                value=end,
                limit=MAX_ARCHIVE_BYTES,
                remedy="give left.yaml and right.yaml, without the images",
            )
