# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth patterns`: images, manifest and video of each kind, and wrong usage in one line."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run

from stereo_depth_ros.active.one_shot.stripes import stripe_pattern
from stereo_depth_ros.active.structured_light.decoding import decode
from stereo_depth_ros.active.structured_light.manifest import read_manifest
from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.active.structured_light.video import mp4_video
from stereo_depth_ros.core.errors import ConfigError, OutputError


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("patterns")


def frames(path: Path) -> list[np.ndarray]:
    video = cv2.VideoCapture(str(path))
    found = []
    while (shown := video.read())[0]:
        found.append(shown[1])
    return found


@pytest.mark.parametrize("kind", ["gray", "phase", "gray+phase"])
def test_images_manifest_and_video_are_one_sequence(run: Run, tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "patterns"
    code, out, err = run("--kind", kind, "--size", "160x91", "-o", folder, "--rows", "--seconds", "0.2", "--json", "-")
    assert (code, err) == (0, "")
    values = json.loads(out)
    sequence = read_manifest(folder / "patterns.json")
    assert sequence == PatternSequence.of_kind(kind, (160, 91), rows=True)
    assert values["images"] == len(sequence) and values["manifest"] == sequence.to_json()
    assert sorted(path.name for path in folder.iterdir()) == sorted(values["files"])
    images = [cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED) for name in values["files"] if name.endswith(".png")]
    assert all(np.array_equal(image, pattern) for image, pattern in zip(images, sequence.render(), strict=True))
    shown = frames(folder / "patterns.mp4")  # 0.2 s are two frames; an odd height is made even
    assert len(shown) == 2 * len(sequence) and shown[0].shape == (92, 160, 3)
    levels = [frame[:91, :, 1] for frame in shown[1::2]]
    for level, image in zip(levels, images, strict=True):
        assert np.percentile(np.abs(level.astype(int) - image), 99) <= 12
    found = decode(sequence, [np.ascontiguousarray(level // 2) for level in levels])
    assert found.column_px is not None
    assert np.nanpercentile(np.abs(found.column_px - np.arange(160)), 99) < 0.6
    assert np.mean(found.reasons == 0) > 0.99


def test_foreign_periods_and_steps(run: Run, tmp_path: Path) -> None:
    options = ("--period", "42", "--period", "45", "--period", "48", "--steps", "3", "--no-video")
    code, out, _ = run("--kind", "phase", "--size", "320x200", "-o", tmp_path, *options)
    sequence = read_manifest(tmp_path / "patterns.json")
    assert code == 0 and "11 of kind phase" in out and "pattern_001.png to pattern_011.png, patterns.json" in out
    assert [pattern.period_px for pattern in sequence.patterns[2:]] == [42.0] * 3 + [45.0] * 3 + [48.0] * 3
    assert not (tmp_path / "patterns.mp4").exists()


def test_stripes_are_one_image_in_color(run: Run, tmp_path: Path) -> None:
    code, out, _ = run("--kind", "stripes", "--size", "161x90", "-o", tmp_path, "--json", "-")
    assert code == 0 and json.loads(out)["files"] == ["pattern_001.png", "patterns.mp4"]
    assert np.array_equal(cv2.imread(str(tmp_path / "pattern_001.png"))[..., ::-1], stripe_pattern((161, 90)))
    assert frames(tmp_path / "patterns.mp4")[0].shape == (90, 162, 3)


def test_earlier_files_are_kept(run: Run, tmp_path: Path) -> None:
    arguments = ("--kind", "gray", "--size", "32x24", "-o", tmp_path, "--no-video")
    (tmp_path / "pattern_003.png").write_text("mine")
    code, _, err = run(*arguments)
    assert code == 1 and "pattern_003.png: already exists" in err and "--overwrite" in err
    assert [path.name for path in tmp_path.iterdir()] == ["pattern_003.png"]
    assert run(*arguments, "--overwrite")[0] == 0
    assert cv2.imread(str(tmp_path / "pattern_003.png")) is not None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--kind", "gray-code"), "kind = 'gray-code' is not one of gray, phase, gray+phase"),
        (("--size", "1024"), "'1024' is not a width and a height"),
        (("--size", "99999x5"), "width = 99999 is not a whole number of 1 to 16384"),
        (("--kind", "phase", "--period", "2"), "period_px = 2.0 is not a number of 3"),
        (("--kind", "phase", "--steps", "2"), "--steps"),
        (("--kind", "phase", "--period", "40"), "have phases of one period, 40 px, and no Gray code"),
        (("--kind", "gray", "--period", "16"), "--period has no effect with --kind gray"),
        (("--kind", "stripes", "--steps", "5"), "--steps has no effect with --kind stripes"),
        (("--kind", "stripes", "--rows"), "--rows has no effect with --kind stripes"),
        (("--no-video", "--seconds", "2"), "--seconds has no effect with --no-video"),
        (("--seconds", "0"), "seconds = 0 is not 0.01 to 60"),
        (("-o", "out.png"), "is the name of a file, a folder is written"),
    ],
)
def test_wrong_usage_is_one_line(run: Run, tmp_path: Path, options: tuple[str, ...], words: str) -> None:
    code, out, err = run("--size", "64x48", "-o", tmp_path / "out", *options)
    assert (code, out) == (2, "") and words in err and "Traceback" not in err
    assert not (tmp_path / "out").exists()


def test_a_video_that_cannot_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError) as error:
        mp4_video([np.zeros((4, 6), np.uint8)], 61.0)
    assert error.value.settings == ("seconds",)
    monkeypatch.setattr(
        cv2,
        "VideoWriter",
        type(
            "Broken",
            (),
            {
                "fourcc": staticmethod(lambda *_: 0),
                "__init__": lambda *_: None,
                "write": lambda *_: None,
                "release": lambda _: None,
            },
        ),
    )
    with pytest.raises(OutputError) as failure:
        mp4_video([np.zeros((4, 6), np.uint8)], 1.0)
    assert failure.value.settings == ("video",)
