# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged bags: whatever is flipped, cut, inserted or enlarged in them, only errors of this package come out."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from bag_kinds import TYPES, write_kind
from mutations import mutated

from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

PLAIN = ("zstd", "lz4", "none")
OTHERS = (
    *("messages compressed, .mcap", "messages compressed, .db3", ".mcap.zstd", ".bag", ".bag of lz4", ".bag of bz2"),
    *("mcap of ros1", "foxglove, protobuf", "foxglove, json", "messages compressed, metadata"),
)
MUTANTS = 40  # of each kind


def tiny_bag(path: Path, compression: str) -> Path:
    """Three pairs of 24x16 with their camera infos, a pair in each chunk."""
    made = SyntheticSequence(1, 24, 16)
    (frame,) = made
    with BagWriter(path, compression=compression, chunk_size=2000) as bag:
        for number in range(3):
            for side, image, camera in (
                ("left", frame.pair.left, made.rig.left),
                ("right", frame.pair.right, made.rig.right),
            ):
                stamp_ns = (number + 1) * 10**8
                bag.write(f"/{side}/camera_info", camera_info_message(TYPES, camera, stamp_ns), stamp_ns)
                bag.write(f"/{side}/image_raw", image_message(TYPES, image.pixels, "mono8", stamp_ns, side), stamp_ns)
    return path


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A tiny bag of each kind."""
    folder = tmp_path_factory.mktemp("bags")
    made = {compression: tiny_bag(folder / f"{compression}.mcap", compression) for compression in PLAIN}
    for number, kind in enumerate(OTHERS):
        (folder / str(number)).mkdir()
        made[kind] = write_kind(kind, made["none"], folder / str(number))
    return made


def examine(path: Path) -> int:
    """Reads a bag as the commands do; the number of messages that deserialize."""
    inspect_bag(path)
    count = 0
    with BagReader(path) as reader:
        for message in reader.messages():
            with suppress(StereoDepthError):
                reader.deserialize(message)
                count += 1
        assert isinstance(reader.warning, str)
    return count


def mutants(bag: Path, folder: Path, seed: int, number: int) -> Iterator[Path]:
    """Damaged copies of a bag, one after the other at the same path; of a folder, its metadata.yaml is damaged."""
    random = np.random.default_rng(seed)
    target = folder / bag.name
    if bag.is_dir():
        shutil.copytree(bag, target)
    source, damaged = (bag / "metadata.yaml", target / "metadata.yaml") if bag.is_dir() else (bag, target)
    data = source.read_bytes()
    for _ in range(number):
        damaged.write_bytes(mutated(data, random))
        yield target


@pytest.mark.parametrize("kind", (*PLAIN, *OTHERS))
def test_only_errors_of_this_package_come_out(bags: dict[str, Path], tmp_path: Path, kind: str) -> None:
    assert examine(bags[kind]) == 12
    for mutant in mutants(bags[kind], tmp_path, len(kind), MUTANTS):
        try:
            examine(mutant)
        except StereoDepthError as error:
            assert error.problem and error.remedy
