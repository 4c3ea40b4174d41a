# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Words that the terms of the field, American spelling or plain sentences have replaced do not come back."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
WHERE = ("stereo_depth_ros", "README.md", "config", "launch", "docs", "CONTRIBUTING.md", "test", "benchmarks", "tools")
SUFFIXES = (".py", ".md", ".yaml", ".xml")

# Each with what is written instead; a part of an identifier (EyeOrder, left_eye) counts as a word.
REPLACED = {
    "eye": "camera or side",
    "eyes": "cameras or sides",
    "picture": "image",
    "pictures": "images",
    "colour": "color",
    "colours": "colors",
    "grey": "gray",
    "centre": "center",
    "centres": "centers",
    "neighbour": "neighbor",
    "neighbours": "neighbors",
    "metre": "meter",
    "metres": "meters",
    "behaviour": "behavior",
    "labelling": "labeling, or: global matcher",
    "complain": "report_error, report",
    "complains": "reports",
    "complaint": "error that is reported",
    "complaints": "errors that are reported",
    "guard": "catch, check",
    "guards": "catches, checks",
    "bid": "key",
    "bids": "keys",
    "outbid": "beat",
    "is no": "is not a",
    "is told": "is reported, is given",
    "agreement": "local consistency",
    "lead": "margin",
    "leads": "margins",
    "consequences": "root causes",
    "bag set up": "survey",
    "doctor probe": "survey",
    "window growth": "adaptive window kernel",
    "rig limits": "depth range",
    "can be made of it": "usable for stereo depth",
    "as fast as it goes": "maximum rate",
    "lens fold": "distortion range",
    "lens folds": "distortion range",
    "brightness": "gray levels, gray offset",
    "nobody": "no node, no subscriber",
    "live picture": "live image",
}
# "There is no rig" and "is no longer" are plain English, "this is no rig" is not.
WORD = re.compile(r"(?<![a-z])(?<!there\s)(" + "|".join(REPLACED).replace(" ", r"\s+") + r")(?![a-z]|\s+longer)")


def split_identifiers(text: str) -> str:
    """The text in lower case with the words of identifiers apart: EyeOrder, left_eye_px."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|_", " ", text).lower()


def replaced_words(text: str) -> Iterator[tuple[int, str]]:
    """Line number and word."""
    words = split_identifiers(text)
    for found in WORD.finditer(words):
        yield words.count("\n", 0, found.start()) + 1, " ".join(found[0].split())


def documents() -> list[Path]:
    paths = [path for name in WHERE for path in (ROOT / name, *(ROOT / name).rglob("*"))]
    return sorted(path for path in paths if path.suffix in SUFFIXES and path != Path(__file__).resolve())


@pytest.mark.parametrize("folder", WHERE)
def test_replaced_words_do_not_come_back(folder: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {word!r}: write {REPLACED[word]}"
        for path in documents()
        if path.is_relative_to(ROOT / folder)
        for line, word in replaced_words(path.read_text("utf-8"))
    ]
    assert not found, "\n".join(found)


def test_every_place_has_documents() -> None:
    assert all(any(path.is_relative_to(ROOT / name) for path in documents()) for name in WHERE)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("the left Eye\n", [(1, "eye")]),
        ("\nclass EyeOrder:\n    left_eye_px = 1\n", [(2, "eye"), (3, "eye")]),
        ("a rig is no camera,\na camera is\n  no rig", [(1, "is no"), (2, "is no")]),
        ("COLOUR and grey, centre-left", [(1, "colour"), (1, "grey"), (1, "centre")]),
        (
            "is not, eyelet, forbidden, bidirectional, parameters, row error, there is no rig, is no longer",
            [],
        ),
    ],
)
def test_the_rule_finds_whole_words(text: str, expected: list[tuple[int, str]]) -> None:
    assert list(replaced_words(text)) == expected
