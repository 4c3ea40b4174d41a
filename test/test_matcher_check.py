# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The check of a matcher against features: textures with known disparities, and matchers that return them changed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import CommandLine
from test_cli_doctor import variant

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.diagnosis.checks.matcher import check_matcher
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.matching.serial import SerialMatcher

HEIGHT, WIDTH = 120, 200


class KnownMatcher(SerialMatcher):
    """Returns given disparities."""

    step_px = 1 / 16

    def __init__(self, found: F32, name: str = "onnx", **fields: Any) -> None:
        super().__init__(MatchingConfig(**fields))
        self.name, self._found = name, found

    def _match(self, left: U8, right: U8) -> MatchResult:
        return MatchResult(self._found, np.isnan(self._found).astype(np.uint8), self.step_px)


def slanted_pair() -> tuple[U8, U8, F32]:
    """A texture on a slanted surface: x_right = x_left - d with d = 6 + x / 10, so x_right = 0.9 x_left - 6."""
    noise = np.random.default_rng(4).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    left = np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.2).astype(np.float32) * 4 - 384).clip(0, 255).astype(np.uint8)
    columns, rows = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    right = cv2.remap(left, (columns + 6) / np.float32(0.9), rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return left, np.asarray(right, np.uint8), 6 + columns / 10


@pytest.fixture(scope="module")
def pair() -> tuple[U8, U8, F32]:
    return slanted_pair()


def check(pair: tuple[U8, U8, F32], found: F32, **fields: Any) -> Finding:
    left, right, _ = pair
    (finding,) = check_matcher(KnownMatcher(found, **fields), [(left, right)])
    return finding


def noisy(truth: F32) -> F32:
    return truth + np.random.default_rng(6).normal(0, 0.2, truth.shape).astype(np.float32)


def test_right_disparities(pair: tuple[U8, U8, F32]) -> None:
    found = check(pair, noisy(pair[2]))
    assert (found.check, found.level, found.remedy) == ("disparities of onnx", Level.OK, "")
    assert abs(found.figures["offset_px"] or 0) < 0.1
    assert (found.figures["near"] or 0) > 0.9


@pytest.mark.parametrize("offset", [0.6, -1.25])
def test_a_constant_offset_is_named_with_what_undoes_it(pair: tuple[U8, U8, F32], offset: float) -> None:
    found = check(pair, noisy(pair[2]) + np.float32(offset), onnx_offset=0.1)
    assert found.level is Level.WARNING
    assert found.figures["offset_px"] == pytest.approx(offset, abs=0.1)
    assert found.settings["onnx_offset"] == pytest.approx(0.1 - offset, abs=0.1)
    assert f"px too {'large' if offset > 0 else 'small'} everywhere" in found.remedy
    other = check(pair, noisy(pair[2]) + np.float32(offset), name="sgm")
    assert (other.check, other.level, dict(other.settings)) == ("disparities of sgm", Level.WARNING, {})


@pytest.mark.parametrize("factor", [1 / WIDTH, 0.5, -1.0, 1.2])
def test_a_scale_is_named_with_what_undoes_it(pair: tuple[U8, U8, F32], factor: float) -> None:
    found = check(pair, noisy(pair[2]) * np.float32(factor), onnx_scale=2.0)
    assert found.level is Level.WARNING
    assert found.figures["scale"] == pytest.approx(factor, rel=0.02)
    assert found.settings["onnx_scale"] == pytest.approx(2 / factor, rel=0.02)


def test_wrong_and_missing_disparities(pair: tuple[U8, U8, F32]) -> None:
    random = np.random.default_rng(7).uniform(0, 30, pair[2].shape).astype(np.float32)
    wrong = check(pair, random)
    assert (wrong.level, wrong.limit) == (Level.WARNING, "50 %")
    assert "% within 1 px" in wrong.value and "onnx_normalization" in wrong.remedy
    missing = check(pair, np.full_like(random, np.nan))
    assert missing.level is Level.WARNING
    assert missing.value.startswith("at 0 % of") and "onnx_scale" in missing.remedy


def test_errors_and_too_few_features_are_findings(pair: tuple[U8, U8, F32]) -> None:
    class Failing(KnownMatcher):
        def _match(self, left: U8, right: U8) -> MatchResult:
            raise ImageError("too small", value=1, limit=2, remedy="use larger ones")

    left, right, truth = pair
    (failed,) = check_matcher(Failing(truth), [(left, right)])
    assert (failed.level, failed.value, failed.remedy) == (Level.ERROR, "too small", "use larger ones")
    flat = np.full_like(left, 90)
    (few,) = check_matcher(KnownMatcher(truth), [(flat, flat)])
    assert (few.level, few.limit) == (Level.SKIPPED, "50 features")


def test_doctor_examines_a_matcher_where_one_is_given(command_line: CommandLine, tmp_path: Path) -> None:
    run = command_line("doctor")
    bag = variant(tmp_path / "room.mcap", lambda topic, message: (topic, message), frames=1)
    code, out, _ = run(bag, "--matcher", "bm", "--param", "disparity_range:=48", "--json", "-")
    found = {finding["check"]: finding for finding in json.loads(out)["findings"]}
    assert (code, found["disparities of bm"]["level"]) == (0, "ok")
    assert abs(found["disparities of bm"]["figures"]["offset_px"]) < 0.2
    code, _, err = run(bag, "--param", "depth_encoding:=16UC1")
    assert code == 2 and "depth_encoding has no effect" in err
