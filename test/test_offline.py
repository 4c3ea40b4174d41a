# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Offline processing of bags: outputs against the truth, provenance, skipped pairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from stereo_bags import HEIGHT, PARAMETERS, WIDTH, median_relative_depth_error, messages_of, sequence, write_truth_bag

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config.output_topics import OUTPUT_TOPICS, output_topics
from stereo_depth_ros.config.values import parse_assignments, pipeline_config
from stereo_depth_ros.core.errors import BagError, ConfigError, ImageError, OutputError
from stereo_depth_ros.matching import MATCHERS
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.offline import engine
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.outputs import OUTPUTS

FRAMES = 3
TOPICS = ("/left/image_rect", "/left/image_rect_color", "/right/image_rect", "/disparity", "/depth/image_rect",
          "/depth/camera_info", "/points2", "/left/camera_info", "/right/camera_info")  # fmt: skip
CONFIG = pipeline_config(PARAMETERS)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("offline")
    write_truth_bag(folder / "in.mcap", FRAMES)
    return folder / "in.mcap", folder / "out.mcap"


def test_every_pair_gives_every_output_with_the_depth_of_the_truth(bags: tuple[Path, Path]) -> None:
    calls: list[tuple[int, int]] = []
    result = process_bag(BagSelection(bags[0]), bags[1], CONFIG, lambda done, total: calls.append((done, total)))
    assert calls == [(1, 3), (2, 3), (3, 3)]
    made = sequence(FRAMES)
    for topic in TOPICS:
        assert sorted(messages_of(bags[1], topic)) == [made.stamp_ns(index) for index in range(FRAMES)], topic
    # 1/8 px of the 4 to 8 px that this small rig has at 2 to 4 m is 3 %
    assert median_relative_depth_error(bags[1], made) < 0.03
    assert result.pairs == FRAMES and result.lost == 0
    assert result.score is not None and result.score.truth_frames == FRAMES
    assert result.score.median_px < 0.25
    assert 0.3 < result.score.valid_fraction < 0.95
    assert {"rectify", "match", "depth"} <= set(result.stages_ms)


def test_the_same_input_gives_the_same_bytes_however_the_steps_overlap(
    bags: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = set()
    for waiting in (1, 1, 3):
        monkeypatch.setattr(engine, "_WAITING", waiting)
        process_bag(BagSelection(bags[0]), bags[1], CONFIG, overwrite=True)
        written.add(bags[1].read_bytes())
    assert len(written) == 1


def test_an_output_that_cannot_be_written_ends_the_run_and_leaves_nothing(
    tmp_path: Path, bags: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    full = OutputError("cannot be written: the disk is full", subject="out.mcap", remedy="free space on the disk")

    def write_raw(*_: object, **__: object) -> None:
        raise full

    monkeypatch.setattr(BagWriter, "write_raw", write_raw)
    with pytest.raises(OutputError, match="disk is full"):
        process_bag(BagSelection(bags[0]), tmp_path / "out.mcap", CONFIG)
    assert not [*tmp_path.iterdir()]


def test_only_the_outputs_that_are_named_are_written_of_every_second_pair(bags: tuple[Path, Path]) -> None:
    process_bag(BagSelection(bags[0]), bags[1], CONFIG, overwrite=True)
    whole = {topic: messages_of(bags[1], topic) for topic in TOPICS}
    calls: list[tuple[int, int]] = []
    result = process_bag(
        BagSelection(bags[0]),
        bags[1],
        CONFIG,
        lambda done, total: calls.append((done, total)),
        overwrite=True,
        outputs=["points", "depth/image_rect"],
        also=["confidence"],
        compression="zstd",
        every=2,
    )
    assert (calls, result.pairs, result.score) == ([(1, 2), (2, 2)], 2, None)
    with BagReader(bags[1]) as reader:
        infos = {"/left/camera_info", "/right/camera_info"}
        assert {*reader.topics} == infos | {"/points2", "/depth/image_rect", "/confidence"}
    first, _, third = sorted(whole["/points2"])
    for topic in ("/points2", "/depth/image_rect"):
        assert messages_of(bags[1], topic) == {stamp: whole[topic][stamp] for stamp in (first, third)}


def test_names_of_outputs_are_those_of_the_table() -> None:
    assert tuple(row.topic for row in OUTPUTS) == OUTPUT_TOPICS
    assert output_topics(["points,depth", "disparity", "confidence"]) == (
        *("disparity", "depth/image_rect", "depth/camera_info", "points2", "confidence"),
    )
    with pytest.raises(ConfigError, match="output 'cloud' is not one of disparity, depth, rect, points, all, depth/im"):
        output_topics(["depth,cloud"])


def test_progress_counts_the_part_that_is_read(bags: tuple[Path, Path]) -> None:
    calls: list[tuple[int, int]] = []
    selection = BagSelection(bags[0], start_seconds=0.1)
    process_bag(selection, bags[1], CONFIG, lambda done, total: calls.append((done, total)), overwrite=True)
    assert calls == [(1, 2), (2, 2)]
    empty = BagSelection(bags[0], start_seconds=0.05, duration_seconds=0.01)
    with pytest.raises(BagError, match=r"processed: there are none from 0\.05 to 0\.060 s of 0\.200 s"):
        process_bag(empty, bags[1], CONFIG, overwrite=True)


@pytest.mark.parametrize("name", [name for name in MATCHERS if name != "onnx"])  # needs a network
def test_every_matcher_by_name(bags: tuple[Path, Path], name: str) -> None:
    values = {**PARAMETERS, **parse_assignments([], name)}
    result = process_bag(BagSelection(bags[0], duration_seconds=0.05), bags[1], pipeline_config(values), overwrite=True)
    assert result.score is not None and (result.pairs, result.lost) == (1, 0)
    assert result.score.median_px < 0.5  # some give whole pixels only
    assert (result.score.valid_fraction > 0.3) == (name != "features")


def test_outputs_have_frames_encodings_and_a_cloud_that_agrees_with_the_depth(bags: tuple[Path, Path]) -> None:
    process_bag(BagSelection(bags[0]), bags[1], CONFIG, overwrite=True)
    made = sequence(FRAMES)
    with BagReader(bags[1]) as reader:
        first = {topic: reader.deserialize(next(reader.messages([topic]))) for topic in TOPICS}
    assert {first[topic].header.frame_id for topic in TOPICS if "right" not in topic} == {made.rig.frame_id}
    assert first["/left/image_rect"].encoding == first["/right/image_rect"].encoding == "mono8"
    cloud, depth = first["/points2"], first["/depth/image_rect"]
    assert (cloud.height, cloud.width, cloud.point_step, cloud.is_dense) == (HEIGHT, WIDTH, 32, False)
    z = np.frombuffer(cloud.data, np.float32).reshape(HEIGHT, WIDTH, 8)[..., 2]
    np.testing.assert_allclose(z, depth.data.view(np.float32).reshape(HEIGHT, WIDTH), rtol=1e-6)
    assert first["/depth/camera_info"].k[0] == pytest.approx(made.rig.left.P[0, 0])


def test_provenance_is_written_with_the_outputs(bags: tuple[Path, Path]) -> None:
    process_bag(BagSelection(bags[0]), bags[1], CONFIG, overwrite=True)
    with bags[1].open("rb") as file:
        (record,) = [item for item in make_reader(file).iter_metadata() if item.name == "stereo_depth_ros"]
    assert record.metadata["disparity_range"] == "32"
    assert record.metadata["bag"] == str(bags[0])
    assert float(record.metadata["rig.baseline_m"]) == sequence(1).rig.baseline_m
    assert record.metadata["version"]
    assert (record.metadata["pairs"], record.metadata["skipped_pairs"]) == (str(FRAMES), "0")


def write_with_wrong_image(path: Path, bad: tuple[int, ...]) -> None:
    """Frames of which some have a left image of another size than their camera info."""
    made, types = sequence(3), RosbagsTypes()
    with BagWriter(path) as bag:
        for index, frame in enumerate(made):
            stamp = frame.pair.left.stamp_ns
            for side, image, camera in (
                ("left", frame.pair.left, made.rig.left),
                ("right", frame.pair.right, made.rig.right),
            ):
                pixels = image.pixels[: HEIGHT - 2] if side == "left" and index in bad else image.pixels
                bag.write(f"/{side}/camera_info", camera_info_message(types, camera, stamp), stamp)
                bag.write(f"/{side}/image_raw", image_message(types, pixels, "mono8", stamp, side), stamp)


def test_swapped_cameras_leave_no_output_even_where_a_later_pair_shows_it(tmp_path: Path) -> None:
    made, types = sequence(3), RosbagsTypes()
    with BagWriter(tmp_path / "in.mcap") as bag:
        for index, frame in enumerate(made):
            images = {"left": frame.pair.right.pixels, "right": frame.pair.left.pixels}  # swapped
            for side, camera in (("left", made.rig.left), ("right", made.rig.right)):
                stamp_ns, pixels = made.stamp_ns(index), images[side] if index else np.zeros((HEIGHT, WIDTH), np.uint8)
                bag.write(f"/{side}/camera_info", camera_info_message(types, camera, stamp_ns), stamp_ns)
                bag.write(f"/{side}/image_raw", image_message(types, pixels, "mono8", stamp_ns, ""), stamp_ns)
    with pytest.raises(ImageError, match=r"in\.mcap: cameras look swapped: .*: exchange the image topics of left and"):
        process_bag(BagSelection(tmp_path / "in.mcap"), tmp_path / "out.mcap", CONFIG)
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


def test_refused_pair_is_skipped_and_reported(tmp_path: Path) -> None:
    write_with_wrong_image(tmp_path / "in.mcap", bad=(1,))
    result = process_bag(BagSelection(tmp_path / "in.mcap"), tmp_path / "out.mcap", CONFIG)
    made = sequence(3)
    assert sorted(messages_of(tmp_path / "out.mcap", "/disparity")) == [made.stamp_ns(0), made.stamp_ns(2)]
    assert (result.pairs, result.skipped) == (3, 1)
    (warning,) = result.warnings
    assert "pair 1700000000.100000000" in warning and f"{WIDTH}x{HEIGHT - 2}" in warning


def test_bag_without_a_pair_that_can_be_processed_is_an_error_and_writes_no_bag(tmp_path: Path) -> None:
    write_with_wrong_image(tmp_path / "in.mcap", bad=(0, 1, 2))
    with pytest.raises(BagError, match=r"no pair could be processed: pair 1700000000\.0+ skipped: .*148"):
        process_bag(BagSelection(tmp_path / "in.mcap"), tmp_path / "out.mcap", CONFIG)
    assert not (tmp_path / "out.mcap").exists()
