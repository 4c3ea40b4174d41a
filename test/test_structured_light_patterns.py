# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sequences of patterns: their pixels, their manifest, and errors that name the image."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from stereo_depth_ros.active.structured_light.decoding import decode
from stereo_depth_ros.active.structured_light.manifest import manifest_text, read_manifest
from stereo_depth_ros.active.structured_light.patterns import KINDS, Pattern, PatternSequence
from stereo_depth_ros.core.errors import BagError, ConfigError, StereoDepthError

SIZE = (200, 123)
FOREIGN = PatternSequence(
    SIZE,
    (
        Pattern("ambient"),
        Pattern("unused"),
        Pattern("black"),
        Pattern("white"),
        *(Pattern("gray", "rows", bit, cell_px=2, offset_px=5) for bit in range(6)),
        *(Pattern("phase", "columns", period_px=p, shift_deg=-s) for p in (42.0, 45.5) for s in (0.0, 120.0, 240.0)),
    ),
)


def test_gray_code_of_neighbors_differs_in_one_bit() -> None:
    sequence = PatternSequence.of_kind("gray", SIZE, rows=True)
    for axis, length in zip(("columns", "rows"), SIZE, strict=True):
        images = [sequence.patterns[number] for number in sequence.coded("gray", axis)]
        bits = np.array([pattern.line(length) for pattern in images if not pattern.inverse])
        inverse = np.array([pattern.line(length) for pattern in images if pattern.inverse])
        assert np.array_equal(bits + inverse, np.ones_like(bits))
        assert np.array_equal(np.abs(np.diff(bits, axis=1)).sum(axis=0), np.ones(length - 1))
        assert len(np.unique(bits, axis=1).T) == length
        assert [pattern.bit for pattern in images[::2]] == [*range(len(bits) - 1, -1, -1)]


def test_cells_and_offset_of_a_gray_code() -> None:
    line = Pattern("gray", "columns", 1, cell_px=3, offset_px=4).line(20)
    codes = [(column + 4) // 3 for column in range(20)]
    assert line.tolist() == [float(((code ^ (code // 2)) // 2) % 2) for code in codes]


def test_phase_pattern_is_a_sinusoid_that_moves_to_larger_coordinates() -> None:
    pattern = Pattern("phase", "rows", period_px=18.0, shift_deg=40.0)
    image = pattern.render(SIZE)
    row = np.arange(SIZE[1])
    expected = 127.5 * (1 + np.cos(2 * np.pi * row / 18.0 - np.deg2rad(40.0)))
    assert image.shape == SIZE[::-1] and image.dtype == np.uint8
    assert np.array_equal(image, np.repeat(np.round(expected).astype(np.uint8)[:, None], SIZE[0], axis=1))
    assert image[2, 0] == 255  # 40 deg are 2 px


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rows", [False, True])
def test_every_kind_decodes_its_own_patterns(kind: str, rows: bool) -> None:
    sequence = PatternSequence.of_kind(kind, SIZE, rows=rows)
    found = decode(sequence, [image // 2 for image in sequence.render()])  # 255 is saturated
    assert found.column_px is not None and not found.reasons.any()
    assert np.abs(found.column_px - np.arange(SIZE[0])).max() < 0.03
    assert (found.row_px is None) != rows
    if found.row_px is not None:
        assert np.abs(found.row_px - np.arange(SIZE[1])[:, None]).max() < 0.03


def test_gray_plus_phase_has_a_gray_code_down_to_half_a_period() -> None:
    sequence = PatternSequence.of_kind("gray+phase", (1024, 768), periods_px=(20,), steps=5)
    bits = {pattern.bit for pattern in sequence.patterns if pattern.role == "gray"}
    assert min(bits) == 3 and max(bits) == 9
    assert [p.shift_deg for p in sequence.patterns if p.role == "phase"] == [0.0, 72.0, 144.0, 216.0, 288.0]


@pytest.mark.parametrize(
    "sequence", [FOREIGN, *(PatternSequence.of_kind(kind, SIZE, rows=True) for kind in KINDS)], ids=["foreign", *KINDS]
)
def test_manifest_gives_the_same_sequence(sequence: PatternSequence, tmp_path: Path) -> None:
    path = tmp_path / "patterns.json"
    path.write_text(manifest_text(sequence))
    assert read_manifest(path) == sequence
    assert path.read_text().count("\n") == len(sequence) + 5  # one image a line, to be edited by hand


GRAY = {"role": "gray", "axis": "rows", "bit": 3}


@pytest.mark.parametrize(
    ("image", "words"),
    [
        ({"role": "wite"}, ["image 2", "'wite'", "white"]),
        ({"rol": "white"}, ["image 2", "role"]),
        ("white", ["image 2", "role"]),
        ({**GRAY, "axis": "row"}, ["image 2", "'row'", "rows"]),
        ({**GRAY, "bit": 2.5}, ["image 2", "bit", "2.5"]),
        ({**GRAY, "bit": True}, ["image 2", "bit", "True"]),
        ({**GRAY, "inverse": "yes"}, ["image 2", "inverse", "'yes'"]),
        ({**GRAY, "period_px": 5}, ["image 2", "'period_px'", "gray"]),
        ({"role": "gray", "axis": "rows"}, ["image 2", "'bit'"]),
        ({"role": "phase", "axis": "rows", "period_px": 1.0, "shift_deg": 0}, ["image 2", "period_px", "1.0"]),
        ({"role": "phase", "axis": "rows", "period_px": float("nan"), "shift_deg": 0}, ["image 2", "nan"]),
        ({"role": "white"}, ["images 1 and 2", "white"]),
        ({"role": ["white"]}, ["image 2", "role"]),
    ],
)
def test_errors_of_an_image_name_it(image: object, words: list[str]) -> None:
    values = {"projector": {"width": 64, "height": 48}, "images": [{"role": "white"}, image]}
    with pytest.raises(ConfigError) as error:
        PatternSequence.from_json(values)
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize(
    "values",
    [
        [],
        {"images": []},
        {"projector": {"width": 64, "height": 48}, "images": []},
        {"projector": {"width": 64, "height": 48}, "images": "white"},
        {"projector": {"width": 64, "height": 48}, "images": [{"role": "unused"}] * 1001},
        {"projector": {"width": 64}, "images": [{"role": "white"}]},
        {"projector": {"width": 0, "height": 48}, "images": [{"role": "white"}]},
        {"projector": {"width": 64, "height": 10**400}, "images": [{"role": "white"}]},
    ],
)
def test_errors_of_a_manifest(values: object, tmp_path: Path) -> None:
    path = tmp_path / "patterns.json"
    path.write_text(json.dumps(values))
    with pytest.raises(ConfigError) as error:
        read_manifest(path)
    assert error.value.subject.startswith(str(path)) and error.value.remedy and len(str(error.value)) < 400


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "\xff", "projector: 3"])
def test_a_file_that_is_not_json(text: str, tmp_path: Path) -> None:
    path = tmp_path / "patterns.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(BagError) as error:
        read_manifest(path)
    assert error.value.subject == str(path) and error.value.remedy


@pytest.mark.parametrize(
    "settings",
    [
        {"kind": "stripe"},
        {"kind": "phase", "steps": 2},
        {"kind": "phase", "periods_px": (2.0,)},
        {"kind": "gray", "size": (0, 5)},
        {"kind": "gray", "size": (20000, 5)},
    ],
)
def test_errors_of_a_kind(settings: dict[str, object]) -> None:
    with pytest.raises(StereoDepthError) as error:
        PatternSequence.of_kind(**{"size": SIZE, **settings})  # type: ignore[arg-type]
    assert error.value.settings and error.value.remedy
