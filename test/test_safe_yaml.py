# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""YAML and text files: plain data as ruamel resolves it, and one line for what is hostile or not text."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.safe_yaml import MAX_DEPTH, MAX_NODES, MAX_TEXT, YamlError, load_yaml
from stereo_depth_ros.core.text_files import read_text

SCALARS = [
    *("1", "-7", "+7", "0", "007", "0x1F", "0o17", "1.", ".5", "-1e-05", "1e5", "2.5E+3", "~", "null", "", "true"),
    *("FALSE", "yes", "a b", "'5'", '"x"', "-.inf", ".INF", "1.2.3", "e5", "0x", "!!str 5"),
]
LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]\n" for level in range(1, 12)
)
MERGED = "a: &a {x: 1}\nb: &b\n  - *a\n  - *a\nc:\n  <<: *b\n"


@pytest.mark.parametrize("text", SCALARS)
def test_scalars_are_those_of_yaml(text: str) -> None:
    expected = YAML(typ="safe", pure=True).load(f"a: {text}\n")["a"]
    found = load_yaml(f"a: {text}\n")["a"]
    assert (type(found), found) == (type(expected), expected)


def test_structure_aliases_and_what_opencv_writes() -> None:
    text = (
        "%YAML:1.0\n# comment\nK: &k !!opencv-matrix\n   rows: 1\n   dt: d\n   data: [ 1.5, 2.,\n       -.5 ]\n"
        "copy: *k\nempty: {}\nnested: [[1, [2]], {a: [3]}]\n"
    )
    matrix = {"rows": 1, "dt": "d", "data": [1.5, 2.0, -0.5]}
    assert load_yaml(text) == {"K": matrix, "copy": matrix, "empty": {}, "nested": [[1, [2]], {"a": [3]}]}
    assert load_yaml("") is None
    assert load_yaml("a: " + "9" * 400)["a"] == float("inf")
    assert load_yaml(MERGED)["c"] == {"<<": [{"x": 1}, {"x": 1}]}


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (LAUGHS, f"more than {MAX_NODES} values, those that aliases repeat included"),
        ("[" * 5000, f"more than {MAX_DEPTH} levels deep"),
        ("- " * 5000, f"more than {MAX_DEPTH} levels deep"),
        ("a: &a [*a]", r"alias \*a stands before its anchor is complete"),
        ("a: *b", r"alias \*b stands before"),
        ("x" * (MAX_TEXT + 1), f"more than {MAX_TEXT} characters"),
        ("a: [1, 2", "in line 1"),
        ("a: 1\nb: c: 2", "mapping values are not allowed.* in line 2"),
        ("a: 1\na: 2", "the key 'a' stands twice"),
        ("? [1, 2]\n: 3", "a list or a mapping is used as a key"),
        ("a: 1\n---\nb: 2", "2 documents, not one"),
        ("a: \x1b[31m", "(?s)^[^\x1b]*$"),
        ("!<tag:\x00> 1", "."),
        ("%TAG ! !\n!x!y 1", "."),
        ('"\\UFFFFFFFF"', "."),
        ("--- |99999999999999999999\n x", "."),
    ],
)
def test_refused_in_one_line(text: str, match: str) -> None:
    with pytest.raises(YamlError, match=match) as caught:
        load_yaml(text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"a: \xe4\n", "x.yaml: byte 0xe4 in line 1 is not UTF-8: save it as UTF-8"),
        ("a: 1\n".encode("utf-16"), "x.yaml: is UTF-16 text: save it as UTF-8"),
        (b"MZ\0\0", "x.yaml: is a binary file, not text: give another"),
        (b"a" * 1001, "x.yaml: is larger than 1000 bytes: give another"),
    ],
)
def test_files_of_other_encodings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes, match: str) -> None:
    monkeypatch.chdir(tmp_path)
    Path("x.yaml").write_bytes(content)
    with pytest.raises(CalibrationError, match=f"^{match}$"):
        read_text(Path("x.yaml"), CalibrationError, "give another", 1000)


def test_paths_that_are_not_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, match in (
        (tmp_path, "is a folder, not a file"),
        (tmp_path / "none", "does not exist"),
        (tmp_path / "pipe", "is a device or a pipe, not a file"),
        (Path("/dev/zero"), "is a device or a pipe, not a file"),
        (tmp_path / "a\0b", "cannot be read, it is not a path"),
        (tmp_path / ("a" * 300), "cannot be read, .*too long"),
    ):
        with pytest.raises(CalibrationError, match=f"{match}: give another$"):
            read_text(path, CalibrationError, "give another")
    (tmp_path / "bom").write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert read_text(tmp_path / "bom", CalibrationError, "") == "a: 1\n"
