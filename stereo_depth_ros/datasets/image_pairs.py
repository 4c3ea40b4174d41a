# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which image files of a folder make stereo pairs: those whose names differ in the word for the camera only."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TypeAlias

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.datasets.image_files import IMAGE_SUFFIXES

__all__ = ["ImagePairs", "find_image_pairs"]

Key: TypeAlias = tuple[str | tuple[int, str], ...]  # text and numbers in turn
Texts: TypeAlias = dict[Path, str]  # what a pair has in common, but for words for cameras and the padding of numbers

_DEPTH = 4  # folders below the one that is named
_NAMING = "name them left*.png and right*.png, or put them into left/ and right/ under equal names"
_SIDES = ("left", "right")
_WORDS = (re.compile(r"left|(?<![a-z])l(?![a-z])"), re.compile(r"(?<!b)(?<!up)right|(?<![a-z])r(?![a-z])"))
_ANY_WORD = re.compile("|".join(word.pattern for word in _WORDS))
# of cam0, camera0, cam_0, camera_0, image_0
_DIGIT = r"(?:(?<=cam)|(?<=camera)|(?<=cam_)|(?<=camera_)|(?<=image_)){}(?!\d)"
_DIGITS = (re.compile(_DIGIT.format("0")), re.compile(_DIGIT.format("1")))
_ANY_DIGIT = re.compile(_DIGIT.format("[01]"))
_FOLDER_PREFIXES = ("", "cam", "cam_", "camera", "camera_", "image_")
_MASK = re.compile(r"masks?(?![a-z])")
_NUMBER = re.compile(r"(\d+(?:\.\d+)*)")


@dataclass(frozen=True)
class ImagePairs:
    """What was found.

    Attributes:
        pairs: left and right file, in the order of the numbers in their names.
        left_out: files without a partner.
        warnings: a sentence for each of ``left_out``.
    """

    pairs: list[tuple[Path, Path]]
    left_out: list[Path] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def find_image_pairs(folder: Path, left: str | None = None, right: str | None = None) -> ImagePairs:
    """Image files whose paths differ in the word for the camera: left, right; l, r; cam0, cam1; image_0, image_1.

    Numbers are compared without leading zeros, letters without case, suffixes of image files not at all. A folder named
    after a camera tells the side, then the file name. Masks (names with that word) and hidden files are no images.

    Args:
        folder: where they are, in it or in folders below.
        left, right: patterns such as "a/*.png" and "b/*.png", both or neither; what the wild cards stand for is equal
            in a pair.

    Raises:
        BagError: no pairs, files of one side only, or two files that could be the same image of a pair.
    """
    left_out: dict[Path, str] = {}
    if left is not None and right is not None:
        texts = _by_pattern(folder, left), _by_pattern(folder, right)
        _check_patterns(*texts)
    else:
        texts, left_out = _by_word(folder)
    _check_sides(folder, *texts)
    for common in (_without_words, _without_words_and_digits):
        sides = [_grouped(side, common) for side in texts]
        if keys := sorted(sides[0].keys() & sides[1].keys()):
            break
    else:
        examples = " and ".join(next(iter(side)).name for side in texts)
        raise BagError(f"{folder}: no left image has the number of a right one, such as {examples}: {_NAMING}")
    pairs = [(_single(sides[0][key], "left"), _single(sides[1][key], "right")) for key in keys]
    for side, other in zip(sides, reversed(_SIDES), strict=True):
        alone = [path for key in sorted(side.keys() - set(keys)) for path in side[key]]
        left_out |= {path: f"{path} has no {other} image beside it: it is left out" for path in alone}
    return ImagePairs(pairs, list(left_out), list(left_out.values()))


def _images(folder: Path) -> list[Path]:
    levels = ("*/" * depth + "*" for depth in range(_DEPTH))
    return sorted(path for level in levels for path in folder.glob(level) if _is_picture(path.relative_to(folder)))


def _is_picture(path: Path) -> bool:
    *folders, name = path.as_posix().lower().split("/")
    is_mask = _MASK.search(name) or {"mask", "masks"} & set(folders)
    return path.suffix.lower() in IMAGE_SUFFIXES and not name.startswith(".") and not is_mask


def _by_word(folder: Path) -> tuple[tuple[Texts, Texts], dict[Path, str]]:
    """The files of both sides, and what is to be said of those that could be of either."""
    sides: tuple[Texts, Texts] = {}, {}
    unclear: dict[Path, str] = {}
    for path in _images(folder):
        text = path.relative_to(folder).as_posix().lower()
        told = _sides_told(text)
        if len(told) == 1:
            sides[told.pop()][path] = text
        elif told:
            unclear[path] = f"{path} names the left and the right camera: it is left out"
    return sides, unclear


def _sides_told(text: str) -> set[int]:
    """0 left, 1 right: by a folder named after a camera, by the words of the file name, of the path, by digits."""
    *folders, name = text.split("/")
    readings = [
        {side for side in (0, 1) if any(_is_camera(part, side) for part in folders)},
        {side for side in (0, 1) if _WORDS[side].search(name)},
        {side for side in (0, 1) if _WORDS[side].search(text)},
        {side for side in (0, 1) if _DIGITS[side].search(text)},
    ]
    return next((told for told in readings if len(told) == 1), set().union(*readings))


def _is_camera(part: str, side: int) -> bool:
    return any(word.search(part) and word.sub("", part) in _FOLDER_PREFIXES for word in (_WORDS[side], _DIGITS[side]))


def _by_pattern(folder: Path, pattern: str) -> Texts:
    """Files that match, with what the wild cards of the pattern stand for."""
    parts = re.split(r"(\*\*/|\*|\?)", pattern)
    wild = {"**/": "((?:.*/)?)", "*": "([^/]*)", "?": "([^/])"}
    expression = re.compile("".join(wild.get(part, re.escape(part)) for part in parts))
    matches = ((path, expression.fullmatch(path.relative_to(folder).as_posix())) for path in _images(folder))
    # "*" is the word for the camera, which the pattern has
    return {path: "|".join(("*", *match.groups())).lower() for path, match in matches if match}


def _without_words(text: str) -> Key:
    return _key(_ANY_WORD.sub("*", text))


def _without_words_and_digits(text: str) -> Key:
    """Beside a word for the camera, as in left/image_0.png, the only number is that of the frame and stays."""
    text = _ANY_WORD.sub("*", text)
    is_frame = "*" in text and len(_NUMBER.findall(text)) == 1
    return _key(text if is_frame else _ANY_DIGIT.sub("*", text))


def _key(text: str) -> Key:
    """Without the suffix; 007 is 7, and 1.05 is neither 1.5 nor 1.50."""
    suffix = PurePosixPath(text).suffix
    parts = _NUMBER.split(text.removesuffix(suffix) if suffix in IMAGE_SUFFIXES else text)
    return tuple(_number(part) if index % 2 else part for index, part in enumerate(parts))


def _number(digits: str) -> tuple[int, str]:
    whole, _, rest = digits.partition(".")
    return int(whole), rest


def _grouped(texts: Texts, common: Callable[[str], Key]) -> dict[Key, list[Path]]:
    groups: dict[Key, list[Path]] = {}
    for path, text in texts.items():
        groups.setdefault(common(text), []).append(path)
    return groups


def _single(paths: list[Path], side: str) -> Path:
    if len(paths) > 1:
        raise BagError(f"{paths[0]} and {paths[1]} are the {side} image of one pair: remove one or rename it")
    return paths[0]


def _check_patterns(left: Texts, right: Texts) -> None:
    if both := left.keys() & right.keys():
        raise BagError(f"{min(both)} is a left and a right image: give patterns that no file matches both")


def _check_sides(folder: Path, left: Texts, right: Texts) -> None:
    if not left and not right:
        raise BagError(f"{folder} has no images of a left and a right camera: {_NAMING}")
    for paths, here, missing in ((right, left, "right"), (left, right, "left")):
        if not paths:
            example = next(iter(here)).name
            raise BagError(f"{folder} has {len(here)} images as {example} and none of the {missing} camera: {_NAMING}")
