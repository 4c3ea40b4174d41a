# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Finds the stereo pairs among image files: names that differ only in the camera name."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TypeAlias

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.datasets.image_files import IMAGE_SUFFIXES, read_image
from stereo_depth_ros.messages.side_by_side import WIDE

__all__ = ["ImagePairs", "find_image_pairs"]

Key: TypeAlias = tuple[str | tuple[int, str], ...]  # text and numbers in turn
Texts: TypeAlias = dict[Path, str]  # path in lower case; equal in a pair except for camera words and padding of numbers

_DEPTH = 4  # levels of folders
_NAMING = "name them left*.png and right*.png, or put them into left/ and right/ under equal names"
_SIDES = ("left", "right")
_WORDS = (re.compile(r"left|(?<![a-z])l(?![a-z])"), re.compile(r"(?<!b)(?<!up)right|(?<![a-z])r(?![a-z])"))
_ANY_WORD = re.compile("|".join(word.pattern for word in _WORDS))
# of cam0, camera0, cam_0, camera_0, image_0
_DIGIT = r"(?:(?<=cam)|(?<=camera)|(?<=cam_)|(?<=camera_)|(?<=image_)){}(?!\d)"
_DIGITS = (re.compile(_DIGIT.format("0")), re.compile(_DIGIT.format("1")))
_ANY_DIGIT = re.compile(_DIGIT.format("[01]"))
_FOLDER_PREFIXES = ("", "cam", "cam_", "camera", "camera_", "image_")
_BEFORE_NUMBER = re.compile(r"(cam|camera|image|view|sensor)[_-]?$")
_WILDCARD = re.compile(r"(\*\*/|\*|\?)")
_MASK = re.compile(r"masks?(?![a-z])")
_NUMBER = re.compile(r"(\d+(?:\.\d+)*)")


@dataclass(frozen=True)
class ImagePairs:
    """Result of :func:`find_image_pairs`.

    Attributes:
        pairs: left and right file, in the order of the numbers in their names.
        skipped: files without a partner.
        warnings: a sentence for each file in ``skipped``.
    """

    pairs: list[tuple[Path, Path]]
    skipped: list[Path] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def find_image_pairs(
    folder: Path, left: str | None = None, right: str | None = None, *, side_by_side: bool = False
) -> ImagePairs:
    """Pairs of files whose paths differ only in the camera: left, right; l, r; cam0, cam1; image_0, image_1.

    Leading zeros, case and the suffixes of image files are ignored. The side is given by a folder named after a camera,
    or else by the file name; where no name has such a word, by one letter, as in imgL01.png and imgR01.png. Files named
    mask and hidden files are ignored.

    Args:
        folder: holds the images, itself or in folders below.
        left, right: patterns such as "a/*.png" and "b/*.png"; in a pair the wildcards match text that is equal but for
            the camera. One pattern, or twice the same, stands for the files of both cameras, where a wildcard matches
            the camera: "cam*/*.png" of cam1 and cam2, "img*.png" of imgL01.png and imgR01.png.
        side_by_side: each file holds both images and is both files of a pair; a pattern is that of these files.

    Raises:
        BagError: no pairs, files of one side only, or two files that could be the same image of a pair.
    """
    if side_by_side:
        return _both_in_one(folder, left or right)
    skipped: dict[Path, str] = {}
    whole: tuple[Texts, Texts] | None = None
    one = left or right if None in (left, right) or left == right else None
    if one is not None and any(texts := _by_one_pattern(folder, one)):
        pass
    elif one is not None and None in (left, right):
        raise BagError(
            f"one pattern alone, {one}, does not match the files of both cameras",
            subject=str(folder),
            value=one,
            remedy="give both patterns, or none",
            settings=("left", "right"),
        )
    elif left is not None and right is not None:
        texts = _by_pattern(folder, left), _by_pattern(folder, right)
        _check_patterns(*texts)
        whole = _paths(folder, texts[0]), _paths(folder, texts[1])
    else:
        texts, skipped = _by_word(_paths(folder, _images(folder)))
        if not any(texts):
            texts = _by_letter(_paths(folder, _images(folder)))
    whole = texts if whole is None else whole  # a wildcard may cut the word for the camera
    _check_sides(folder, *texts)
    ways = [(each, way) for each in (texts, whole) for way in (_without_words, _without_words_and_digits)]
    for files, common in (*ways, (texts, _without_letter(texts))):
        sides = [_grouped(side, common) for side in files]
        if keys := sorted(sides[0].keys() & sides[1].keys()):
            break
    else:
        examples = " and ".join(next(iter(side)).name for side in texts)
        raise BagError(
            f"no left image has the number of a right one, such as {examples}", subject=str(folder), remedy=_NAMING
        )
    pairs = [(_single(sides[0][key], "left"), _single(sides[1][key], "right")) for key in keys]
    for side, other in zip(sides, reversed(_SIDES), strict=True):
        alone = [path for key in sorted(side.keys() - set(keys)) for path in side[key]]
        skipped |= {path: f"{path}: skipped, it has no {other} image" for path in alone}
    return ImagePairs(pairs, list(skipped), list(skipped.values()))


def _paths(folder: Path, files: Iterable[Path]) -> Texts:
    return {path: path.relative_to(folder).as_posix().lower() for path in files}


def _both_in_one(folder: Path, pattern: str | None) -> ImagePairs:
    texts = _by_pattern(folder, pattern or "**/*")
    if not texts:
        raise BagError("has no images", subject=str(folder), value=pattern, remedy="name a folder with images")
    paths = sorted(texts, key=lambda path: _key(path.relative_to(folder).as_posix().lower()))
    return ImagePairs([(path, path) for path in paths])


def _images(folder: Path) -> list[Path]:
    levels = ("*/" * depth + "*" for depth in range(_DEPTH))
    return sorted(path for level in levels for path in folder.glob(level) if _is_image(path.relative_to(folder)))


def _is_image(path: Path) -> bool:
    *folders, name = path.as_posix().lower().split("/")
    is_mask = _MASK.search(name) or {"mask", "masks"} & set(folders)
    return path.suffix.lower() in IMAGE_SUFFIXES and not name.startswith(".") and not is_mask


def _by_word(files: Texts) -> tuple[tuple[Texts, Texts], dict[Path, str]]:
    """The files of both sides by the words in their paths, and a warning for each that could be of either."""
    sides: tuple[Texts, Texts] = {}, {}
    unclear: dict[Path, str] = {}
    for path, text in files.items():
        named = _named_sides(text)
        if len(named) == 1:
            sides[named.pop()][path] = text
        elif named:
            unclear[path] = f"{path}: skipped, it names the left and the right camera"
    return sides, unclear


def _named_sides(text: str) -> set[int]:
    """0 left, 1 right: by a folder named after a camera, or by words of the file name, words of the path, digits."""
    *folders, name = text.split("/")
    readings = [
        {side for side in (0, 1) if any(_is_camera(part, side) for part in folders)},
        {side for side in (0, 1) if _WORDS[side].search(name)},
        {side for side in (0, 1) if _WORDS[side].search(text)},
        {side for side in (0, 1) if _DIGITS[side].search(text)},
    ]
    return next((sides for sides in readings if len(sides) == 1), set().union(*readings))


def _is_camera(part: str, side: int) -> bool:
    return any(word.search(part) and word.sub("", part) in _FOLDER_PREFIXES for word in (_WORDS[side], _DIGITS[side]))


def _by_letter(files: Texts) -> tuple[Texts, Texts]:
    """The files of both sides where a pair differs in one letter, l and r."""
    twins = _twins(files.values(), files.values())
    right = set(twins.values())
    return (
        {path: text for path, text in files.items() if text in twins and text not in right},
        {path: text for path, text in files.items() if text in right and text not in twins},
    )


def _twins(left: Iterable[str], right: Iterable[str]) -> dict[str, str]:
    """Left texts to the right ones that differ in one letter, r for l, where there is one only."""
    known = set(right)
    found = {
        text: {t for at in range(len(text)) if text[at] == "l" and (t := f"{text[:at]}r{text[at + 1 :]}") in known}
        for text in left
    }
    return {text: twins.pop() for text, twins in found.items() if len(twins) == 1}


def _by_one_pattern(folder: Path, pattern: str) -> tuple[Texts, Texts]:
    """The files of both sides among those that match: by words, by two values of a wildcard, by one letter."""
    matches = _matches(folder, pattern)
    files = _paths(folder, matches)
    sides, _ = _by_word(files)
    if all(sides):
        return sides
    before = [text.lower() for text in _WILDCARD.split(pattern)[::2]]
    for number in range(len(next(iter(matches.values()), ()))):
        values = sorted({groups[number] for groups in matches.values()})
        if len(values) == 2 and _are_cameras(before[number] + values[0], before[number] + values[1]):
            sides = {}, {}
            for path, groups in matches.items():
                rest = (*groups[:number], *groups[number + 1 :])
                sides[values.index(groups[number])][path] = "|".join(("*", *rest))
            return sides
    return _by_letter(files)


def _are_cameras(left: str, right: str) -> bool:
    """Whether two texts differ as the names of cameras: in l and r, a and b, or in the number of a camera."""
    different = [(at, *pair) for at, pair in enumerate(zip(left, right, strict=False)) if pair[0] != pair[1]]
    if len(left) != len(right) or len(different) != 1:
        return False
    at, one, other = different[0]
    if one.isdigit() and other.isdigit():
        return int(other) == int(one) + 1 and bool(_BEFORE_NUMBER.search(left[:at]))
    return (one, other) in (("l", "r"), ("a", "b"))


def _by_pattern(folder: Path, pattern: str) -> Texts:
    """Files that match, with the text that the wildcards of the pattern match."""
    # "*" stands for the word for the camera, which is part of the pattern
    return {path: "|".join(("*", *groups)) for path, groups in _matches(folder, pattern).items()}


def _matches(folder: Path, pattern: str) -> dict[Path, tuple[str, ...]]:
    """Files that match, each with what the wildcards of the pattern match, in lower case."""
    parts = _WILDCARD.split(pattern)
    wild = {"**/": "((?:.*/)?)", "*": "([^/]*)", "?": "([^/])"}
    expression = re.compile("".join(wild.get(part, re.escape(part)) for part in parts))
    matches = ((path, expression.fullmatch(path.relative_to(folder).as_posix())) for path in _images(folder))
    return {path: tuple(text.lower() for text in match.groups()) for path, match in matches if match}


def _without_words(text: str) -> Key:
    return _key(_ANY_WORD.sub("*", text))


def _without_words_and_digits(text: str) -> Key:
    """With a word for the camera, as in left/image_0.png, a single number is that of the frame and is kept."""
    text = _ANY_WORD.sub("*", text)
    is_frame = "*" in text and len(_NUMBER.findall(text)) == 1
    return _key(text if is_frame else _ANY_DIGIT.sub("*", text))


def _without_letter(texts: tuple[Texts, Texts]) -> Callable[[str], Key]:
    """Right texts become the left ones from which they differ in one letter."""
    left = {twin: text for text, twin in _twins(texts[0].values(), texts[1].values()).items()}
    return lambda text: _key(left.get(text, text))


def _key(text: str) -> Key:
    """Text and numbers without the suffix; 007 equals 7, but 1.05, 1.5 and 1.50 differ."""
    suffix = PurePosixPath(text).suffix
    parts = _NUMBER.split(text.removesuffix(suffix) if suffix in IMAGE_SUFFIXES else text)
    return tuple(_number(part) if index % 2 else part for index, part in enumerate(parts))


def _number(digits: str) -> tuple[int, str]:
    whole, _, fraction = digits.partition(".")
    return int(whole), fraction


def _grouped(texts: Texts, common: Callable[[str], Key]) -> dict[Key, list[Path]]:
    groups: dict[Key, list[Path]] = {}
    for path, text in texts.items():
        groups.setdefault(common(text), []).append(path)
    return groups


def _single(paths: list[Path], side: str) -> Path:
    if len(paths) > 1:
        raise BagError(
            f"{paths[0]} and {paths[1]} are both the {side} image of one pair",
            value=paths,
            limit=1,
            remedy="remove one or rename it",
        )
    return paths[0]


def _check_patterns(left: Texts, right: Texts) -> None:
    if both := left.keys() & right.keys():
        raise BagError(
            "matches the left and the right pattern",
            subject=str(min(both)),
            remedy="give patterns that no file matches both",
            settings=("left", "right"),
        )


def _check_sides(folder: Path, left: Texts, right: Texts) -> None:
    if left and right:
        return
    _refuse_side_by_side(folder)
    if not left and not right:
        raise BagError("has no images of a left and a right camera", subject=str(folder), remedy=_NAMING)
    here, missing = (left, "right") if left else (right, "left")
    raise BagError(
        f"has {len(here)} images such as {next(iter(here)).name} and none of the {missing} camera",
        subject=str(folder),
        value=len(here),
        remedy=_NAMING,
    )


def _refuse_side_by_side(folder: Path) -> None:
    """Raise BagError where the first image looks like two side by side."""
    first = next(iter(_images(folder)), None)
    try:
        height, width = (1, 0) if first is None else read_image(first).shape[:2]
    except BagError:
        return
    if first is not None and width >= WIDE * height:
        raise BagError(
            f"{first.name} looks like both images side by side, {width}x{height}",
            subject=str(folder),
            value=(width, height),
            remedy="read both from each file",
            settings=("side_by_side",),
        )
