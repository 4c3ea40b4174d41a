# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A street with a turned right camera, played through a live graph that corrects it, and the recorded bag."""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from graph_harness import ENVIRONMENT
from rosbags.highlevel import AnyReader

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.calibration.row_error import match_rows
from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.core.types import F64, U8, StereoPair
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.nodes.live_replay import replay_through_graph
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.replay.options import ReplayOptions

pytestmark = [pytest.mark.graph, pytest.mark.real_data]

PAIRS = 20
CONFIG = PipelineConfig(matching=MatchingConfig(num_disparities=128, quality="fast"))
PARAMETERS = {"disparity_range": 128, "quality": "fast", "health_rate": 0.0}
SETTLED = 5  # pairs at the end, long after the correction


@dataclass(frozen=True)
class Played:
    """The last pairs: share of pixels with a disparity, and median row error, px."""

    bag: Path
    density: float
    row_error_px: float


def street(data: Path) -> KittiDataset:
    return KittiDataset(data / "kitti_odometry" / "seqA_1226x370")


def write_street(data: Path, path: Path, turn_deg: float) -> Path:
    """The rectified street as raw images, its right camera pitched."""
    dataset, types = street(data), RosbagsTypes()
    K = dataset.rig.right.P[:, :3]
    H = K @ cv2.Rodrigues(np.radians([turn_deg, 0.0, 0.0]))[0] @ np.linalg.inv(K)
    with BagWriter(path) as bag:
        for frame in islice(dataset, PAIRS):
            right = cv2.warpPerspective(frame.right.pixels, H, frame.right.pixels.shape[::-1])
            images = (("left", frame.left, frame.left.pixels), ("right", frame.right, right))
            for (side, image, pixels), camera in zip(images, (dataset.rig.left, dataset.rig.right), strict=True):
                stamp_ns = image.stamp_ns
                bag.write(f"/{side}/camera_info", camera_info_message(types, camera, stamp_ns), stamp_ns)
                message = image_message(types, np.asarray(pixels, np.uint8), "mono8", stamp_ns, image.frame_id)
                bag.write(f"/{side}/image_raw", message, stamp_ns)
    return path


def play_corrected(bag: Path, output: Path) -> Played:
    os.environ.update(ENVIRONMENT)
    options = ReplayOptions(bag=str(bag), output=str(output))
    result = replay_through_graph(options, "fused", PARAMETERS, CONFIG, lambda *_: None, None, "correct")
    assert result.lost == 0
    images: dict[str, list[U8]] = {"left": [], "right": []}
    densities = []
    with BagReader(output) as reader:
        for side in images:
            for message in reader.messages([f"/{side}/image_rect"]):
                image = reader.deserialize(message)
                images[side].append(np.asarray(image.data, np.uint8).reshape(image.height, image.width))
        for message in reader.messages(["/disparity"]):
            found = reader.deserialize(message)
            values = np.frombuffer(found.image.data.tobytes(), np.float32)
            densities.append(np.mean(values >= found.min_disparity))
    errors = [match_rows(*pair).errors_px for pair in list(zip(*images.values(), strict=True))[-SETTLED:]]
    return Played(output, float(np.mean(densities[-SETTLED:])), median(errors))


def median(errors: list[F64]) -> float:
    return float(np.median(np.abs(np.concatenate(errors))))


@pytest.fixture(scope="module")
def undisturbed(stereo_data: Path) -> tuple[float, float]:
    """Density and median row error, px, of the last pairs with nothing wrong; a live graph gives the same bytes."""
    dataset = street(stereo_data)
    pipeline = StereoPipeline(CONFIG, dataset.rig)
    results = [pipeline.process(StereoPair(f.left, f.right)) for f in islice(dataset, PAIRS - SETTLED, PAIRS)]
    densities = [np.mean(np.isfinite(result.disparity.disparity_px)) for result in results]
    errors = [match_rows(result.rectified.left, result.rectified.right).errors_px for result in results]
    return float(np.mean(densities)), median(errors)


@pytest.fixture(scope="module")
def corrected(stereo_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Played:
    folder = tmp_path_factory.mktemp("turned")
    return play_corrected(write_street(stereo_data, folder / "turned.mcap", 0.3), folder / "turned_out.mcap")


def test_density_and_rows_recover(undisturbed: tuple[float, float], corrected: Played) -> None:
    """To within 5 % of the run with nothing wrong."""
    assert (corrected.density, corrected.row_error_px) == pytest.approx(undisturbed, rel=0.05)


def test_the_first_pairs_were_not_right(corrected: Played) -> None:
    """Without correction the rows are off."""
    with BagReader(corrected.bag) as reader:
        first = [next(iter(reader.messages([f"/{side}/image_rect"]))) for side in ("left", "right")]
        images = [reader.deserialize(message) for message in first]
    pair = [np.asarray(image.data, np.uint8).reshape(image.height, image.width) for image in images]
    assert match_rows(pair[0], pair[1]).median_px > 3


def test_the_bag_has_the_correction_for_late_subscribers_too(corrected: Played) -> None:
    with AnyReader([corrected.bag]) as reader:
        (connection,) = [c for c in reader.connections if c.topic == "/health/correction"]
        (profile,) = connection.ext.offered_qos_profiles  # type: ignore[union-attr]
        assert profile.durability.name == "TRANSIENT_LOCAL"
        assert profile.reliability.name == "RELIABLE"
        text: list[Any] = [reader.deserialize(data, connection.msgtype) for _, _, data in reader.messages([connection])]
        values = {item.key: item.value for item in text[-1].status[0].values}
        assert float(values["pitch_deg"]) == pytest.approx(0.3, abs=0.03)
        assert int(values["steps"]) >= 1
        assert "/health/row_error" in reader.topics
