# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Style and types are clean."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from documents import BLOCKS

ROOT = Path(__file__).resolve().parents[1]
CHECKED = ("stereo_depth_ros", "benchmarks", "tools")  # as in pyproject.toml
# What a program of a user does; reveal_type would be Any if the package had no annotations.
PROGRAM = """
import numpy as np

from stereo_depth_ros import Frame, MatchResult, PipelineConfig, StereoPair, StereoPipeline, StereoRig, create_matcher

left, right = np.zeros((2, 120, 160), np.uint8)
found: MatchResult = create_matcher("sgm", num_disparities=64).match(left, right)
rig: StereoRig = StereoRig.from_yaml("left.yaml", "right.yaml")
pair = StereoPair(Frame(left, 0, "left"), Frame(right, 0, "right"))
depth_m = StereoPipeline(PipelineConfig(), rig).process(pair).depth_m
reveal_type(depth_m)
reveal_type(found.confidence)
"""
# As `python -m mypy`; of its time, collecting garbage takes a quarter, and there is hardly any.
MYPY = """
import gc
gc.disable()
gc.enable = lambda: None
from mypy.__main__ import console_entry
console_entry()
"""


def checked(*command: str) -> str:
    done = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("command", ["ruff check .", "ruff format --check ."])
def test_clean(command: str) -> None:
    checked("-m", *command.split())


def test_types_are_clean_and_programs_of_users_have_them(tmp_path: Path) -> None:
    """One run of mypy --strict, for the package and for programs that import it."""
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    (readme,) = (block.text for block in BLOCKS if (block.document, block.language) == ("README.md", "python"))
    (tmp_path / "readme.py").write_text(readme, encoding="utf-8")
    said = checked("-c", MYPY, *CHECKED, str(tmp_path / "program.py"), str(tmp_path / "readme.py"))
    revealed = [line.partition("Revealed type is ")[2] for line in said.splitlines() if "Revealed type" in line]
    assert len(revealed) == 2 and all("float" in text and "32" in text for text in revealed), revealed
