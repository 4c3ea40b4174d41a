# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Real pairs through live nodes: each once, the same numbers in every shape, and the depth that the truth has."""

from __future__ import annotations

import functools
import itertools
import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ros_domain import own_number
from stereo_bags import messages_of

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.datasets.dataset import DatasetFrame, StereoDataset
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.datasets.middlebury import MiddleburyDataset
from stereo_depth_ros.datasets.to_bag import convert_dataset
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import compressed_message
from stereo_depth_ros.offline.engine import process_bag

pytestmark = [pytest.mark.graph, pytest.mark.real_data]

ROOT = Path(__file__).resolve().parents[1]
SGBM = 1
PARAMETERS: dict[str, dict[str, Any]] = {
    "kitti": {"stereo_algorithm": SGBM, "disparity_range": 96},
    "euroc": {},  # block matching, as a user gets it
}
SIZES = {"kitti": (1226, 370), "euroc": (752, 480)}
PAIRS = 7
ENCODINGS = {
    "/left/image_rect": "mono8",
    "/left/image_rect_color": "mono8",  # both sequences are gray
    "/right/image_rect": "mono8",
    "/depth/image_rect": "32FC1",
}
COMPUTED = (*ENCODINGS, "/disparity", "/points2")
OUTPUTS = (*COMPUTED, "/depth/camera_info")
FRAME_ID = "left_optical_frame"
TYPES = RosbagsTypes()


# A separate process: Fast DDS takes its profile once, and other tests may have started it without. The outputs are
# noted before the replay sorts out what it did not expect.
PLAY = """
import json, sys
from stereo_depth_ros.nodes.live_replay import replay_through_graph
from stereo_depth_ros.nodes.replay.tracker import PairTracker
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.replay.options import ReplayOptions

bag, output, shape, parameters = json.loads(sys.argv[1])
received, sort_out = [], PairTracker.received
def note(tracker, topic, stamp_ns, now_ns):
    received.append((f"/{topic}", stamp_ns))
    return sort_out(tracker, topic, stamp_ns, now_ns)
PairTracker.received = note
options, config = ReplayOptions(bag=bag, output=output), pipeline_config(parameters)
result = replay_through_graph(options, shape, parameters, config, lambda sent, total: None)
print(json.dumps({"result": result.to_json(), "received": received}))
"""


class FirstPairs:
    """The first pairs of a dataset, as a dataset."""

    def __init__(self, dataset: StereoDataset) -> None:
        self._dataset = dataset
        self.rig, self.has_stamps, self.files = dataset.rig, dataset.has_stamps, dataset.files

    def __len__(self) -> int:
        return PAIRS

    def __iter__(self) -> Iterator[DatasetFrame]:
        return itertools.islice(self._dataset, PAIRS)


@dataclass(frozen=True)
class Played:
    """A bag, its outputs, the report of the replay, and topic and stamp of every output received."""

    bag: Path
    output: Path
    result: dict[str, Any]
    received: list[tuple[str, int]]

    def topic(self, name: str) -> dict[int, Any]:
        """The recorded messages by stamp."""
        with BagReader(self.output) as reader:
            msgtype = reader.topics[name].msgtype
        return {stamp: TYPES.deserialize(data, msgtype) for stamp, data in messages_of(self.output, name).items()}


def play(bag: Path, shape: str, parameters: dict[str, Any], output: Path) -> Played:
    """Play a bag through a new graph."""
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = {
        "PYTHONPATH": path,
        "ROS_DOMAIN_ID": str(10 + own_number(10)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    done = subprocess.run(
        [sys.executable, "-c", PLAY, json.dumps([str(bag), str(output), shape, parameters])],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    reported = json.loads(done.stdout)
    return Played(bag, output, reported["result"], [(topic, stamp) for topic, stamp in reported["received"]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Removed at the end: the recordings are large."""
    path = tmp_path_factory.mktemp("real")
    yield path
    shutil.rmtree(path)


@pytest.fixture(scope="module")
def datasets(stereo_data: Path) -> dict[str, StereoDataset]:
    return {
        "kitti": FirstPairs(KittiDataset(stereo_data / "kitti_odometry" / "seqA_1226x370")),
        "euroc": FirstPairs(EurocDataset(stereo_data / "euroc" / "V1_01_micro")),
    }


@pytest.fixture(scope="module")
def bags(datasets: dict[str, StereoDataset], folder: Path) -> dict[str, Path]:
    for name, dataset in datasets.items():
        convert_dataset(dataset, folder / f"{name}.mcap")
    return {name: folder / f"{name}.mcap" for name in datasets}


@pytest.fixture(scope="module")
def played(bags: dict[str, Path], folder: Path) -> Callable[[str, str], Played]:
    """Each sequence through each shape, once."""

    @functools.cache
    def call(name: str, shape: str) -> Played:
        return play(bags[name], shape, PARAMETERS[name], folder / f"{name}_{shape}.mcap")

    return call


def pixels_of(image: Any) -> Any:
    """uint8 or float32 (H, W)."""
    dtype = {"mono8": np.uint8, "32FC1": np.float32}[image.encoding]
    assert image.step == image.width * np.dtype(dtype).itemsize and not image.is_bigendian
    return image.data.view(dtype).reshape(image.height, image.width)


def disparity_of(message: Any) -> F32:
    """float32 (H, W) as published, NaN where invalid."""
    published = pixels_of(message.image)
    return np.where(published < message.min_disparity, np.float32(np.nan), published)


def points_of(cloud: Any) -> F32:
    """float32 (H, W, 3)."""
    assert [(f.name, f.offset, f.datatype) for f in cloud.fields[:3]] == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]
    assert cloud.row_step == cloud.width * cloud.point_step and not cloud.is_dense and not cloud.is_bigendian
    words: F32 = cloud.data.view(np.float32).reshape(cloud.height, cloud.width, cloud.point_step // 4)
    return words[:, :, :3]


@pytest.mark.parametrize("shape", ["fused", "separate"])
@pytest.mark.parametrize("name", ["kitti", "euroc"])
def test_every_pair_has_its_outputs_once_and_in_order(
    played: Callable[[str, str], Played], datasets: dict[str, StereoDataset], name: str, shape: str
) -> None:
    run = played(name, shape)
    stamps = [frame.left.stamp_ns for frame in datasets[name]]
    assert len(stamps) == PAIRS
    reported = {key: run.result[key] for key in ("pairs", "lost", "unpaired_left", "unpaired_right", "warnings")}
    assert reported == {"pairs": PAIRS, "lost": 0, "unpaired_left": 0, "unpaired_right": 0, "warnings": []}
    for topic in OUTPUTS:
        came = [stamp for name, stamp in run.received if name == topic]
        while came[1:2] == stamps[:1]:
            came.pop(0)  # the first pair is sent again until all links between the nodes are up
        assert came == stamps, topic
        assert list(messages_of(run.output, topic)) == stamps, topic


@pytest.mark.parametrize("shape", ["fused", "separate"])
@pytest.mark.parametrize("name", ["kitti", "euroc"])
def test_outputs_have_frame_size_and_encoding(played: Callable[[str, str], Played], name: str, shape: str) -> None:
    run = played(name, shape)
    for topic, encoding in ENCODINGS.items():
        for image in run.topic(topic).values():
            assert (image.width, image.height, image.encoding) == (*SIZES[name], encoding), topic
            assert image.header.frame_id == FRAME_ID, topic
    for message in run.topic("/disparity").values():
        assert message.header == message.image.header and message.header.frame_id == FRAME_ID
        assert (message.image.width, message.image.height, message.image.encoding) == (*SIZES[name], "32FC1")
    for topic in ("/points2", "/depth/camera_info"):
        for message in run.topic(topic).values():
            assert (message.width, message.height, message.header.frame_id) == (*SIZES[name], FRAME_ID), topic


@pytest.mark.parametrize("name", ["kitti", "euroc"])
def test_separate_nodes_give_the_bytes_of_the_fused_node(played: Callable[[str, str], Played], name: str) -> None:
    fused, separate = played(name, "fused"), played(name, "separate")
    for topic in COMPUTED:
        assert messages_of(fused.output, topic) == messages_of(separate.output, topic), f"{topic} differs"


def test_live_gives_the_bytes_of_the_offline_engine(played: Callable[[str, str], Played], folder: Path) -> None:
    live = played("euroc", "fused")
    process_bag(BagSelection(live.bag), folder / "offline.mcap", pipeline_config(PARAMETERS["euroc"]))
    for topic in COMPUTED:
        assert messages_of(live.output, topic) == messages_of(folder / "offline.mcap", topic), f"{topic} differs"


def median_row_error(left: U8, right: U8) -> float:
    """Median |y_left - y_right| of SIFT features that prefer each other and are twice distinct (ratio 0.8), px."""
    sift = cv2.SIFT.create()
    (left_points, left_features), (right_points, right_features) = (
        sift.detectAndCompute(image, None) for image in (left, right)
    )
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    forth, back = (
        {a.queryIdx: a.trainIdx for a, b in matcher.knnMatch(*features, k=2) if a.distance < 0.8 * b.distance}
        for features in ((left_features, right_features), (right_features, left_features))
    )
    mutual = [(i, j) for i, j in forth.items() if back.get(j) == i]
    assert len(mutual) > 50, "too few matches to say anything"
    return float(np.median([abs(left_points[i].pt[1] - right_points[j].pt[1]) for i, j in mutual]))


def row_errors(bag: Path, topic: str) -> list[float]:
    """Of four pairs over the sequence."""
    images = []
    for side in ("left", "right"):
        found = list(messages_of(bag, f"/{side}/{topic}").values())[::2]
        images.append([pixels_of(TYPES.deserialize(data, "sensor_msgs/msg/Image")) for data in found])
    return [median_row_error(left, right) for left, right in zip(*images, strict=True)]


def test_rectification_brings_matches_into_equal_rows(played: Callable[[str, str], Played]) -> None:
    run = played("euroc", "fused")
    assert min(row_errors(run.bag, "image_raw")) > 5.0
    # 0.13 px is what the calibration of this sequence leaves
    assert max(row_errors(run.output, "image_rect")) < 0.3


def assert_depth_and_points_follow_from_disparity(run: Played) -> None:
    """Z = f B / d, X = (u - cx) Z / fx, Y = (v - cy) Z / fy, in float64, with the numbers that are published."""
    disparities, depths = run.topic("/disparity"), run.topic("/depth/image_rect")
    clouds, infos = run.topic("/points2"), run.topic("/depth/camera_info")
    for stamp, message in disparities.items():
        fx, _, cx, _, fy, cy = infos[stamp].k[:6]
        assert message.f == pytest.approx(fx)
        z = message.f * message.t / disparity_of(message).astype(np.float64)
        v, u = np.indices(z.shape)
        points = np.stack([(u - cx) * z / fx, (v - cy) * z / fy, z], axis=-1)
        # a handful of float32 operations; 1e-4 m is for X and Y near the axis, where u - cx loses digits
        np.testing.assert_allclose(pixels_of(depths[stamp]), z, rtol=1e-6)
        np.testing.assert_allclose(points_of(clouds[stamp]), points, rtol=1e-6, atol=1e-4)


def test_kitti_depth_and_points_follow_from_disparity(played: Callable[[str, str], Played]) -> None:
    run = played("kitti", "fused")
    message = next(iter(run.topic("/disparity").values()))
    assert (message.f, message.t) == pytest.approx((707.0912, 0.5372), abs=1e-4)
    assert_depth_and_points_follow_from_disparity(run)
    for message in run.topic("/disparity").values():
        # 8 % of the width lie left of the search; sky and shadowless road have no texture
        assert 0.5 < np.isfinite(disparity_of(message)).mean() < 0.9


def distance_to_road(points_m: F32) -> float:
    """Of the camera to the plane y = a + b x + c z through what lies below and ahead of it, meters."""
    x, y, z = np.moveaxis(points_m.astype(np.float64), -1, 0)
    ahead = (np.abs(x) < 1.5) & (z > 6) & (z < 16) & (y > 1.0)
    terms, y = np.stack([np.ones(ahead.sum()), x[ahead], z[ahead]], axis=-1), y[ahead]
    near = np.ones(len(y), bool)
    for _ in range(6):  # the shadow of a wrong match is left out by its residual
        assert near.sum() > 1000
        a, b, c = np.linalg.lstsq(terms[near], y[near], rcond=None)[0]
        residuals = np.abs(terms @ (a, b, c) - y)
        near = residuals < 0.05 + 1.5 * np.median(residuals)
    return float(a / np.sqrt(1 + b**2 + c**2))


def test_kitti_road_is_at_the_height_of_the_camera(played: Callable[[str, str], Played]) -> None:
    clouds = played("kitti", "fused").topic("/points2").values()
    # 1.65 m by the data sheet of the car, whose suspension makes some centimeters
    assert np.median([distance_to_road(points_of(cloud)) for cloud in clouds]) == pytest.approx(1.65, abs=0.05)


def test_compressed_pair_gives_the_disparity_of_the_raw_one(
    played: Callable[[str, str], Played], datasets: dict[str, StereoDataset], folder: Path
) -> None:
    dataset = datasets["kitti"]
    frame, path = next(iter(dataset)), folder / "png.mcap"
    with BagWriter(path) as bag:
        sides = (("left", frame.left, dataset.rig.left), ("right", frame.right, dataset.rig.right))
        for side, image, camera in sides:
            stamp = image.stamp_ns
            message = compressed_message(TYPES, image.pixels, image.encoding, "png", stamp, image.frame_id)
            bag.write(f"/{side}/camera_info", camera_info_message(TYPES, camera, stamp), stamp)
            bag.write(f"/{side}/image_raw/compressed", message, stamp)
    compressed = play(path, "fused", PARAMETERS["kitti"], folder / "from_png.mcap")
    stamp = frame.left.stamp_ns
    raw = messages_of(played("kitti", "fused").output, "/disparity")[stamp]
    assert messages_of(compressed.output, "/disparity") == {stamp: raw}


def motorcycle(data: Path, folder: Path) -> MiddleburyDataset:
    """With the published numbers of this scene at a quarter of its size."""
    calibration = folder / "calib.txt"
    calibration.write_text(
        "cam0=[994.978 0 311.193; 0 994.978 254.877; 0 0 1]\n"
        "cam1=[994.978 0 342.279; 0 994.978 254.877; 0 0 1]\n"
        "doffs=31.086\nbaseline=193.001\nwidth=741\nheight=500\n"
    )
    return MiddleburyDataset(data / "middlebury2014" / "Motorcycle_quarter", calibration_file=calibration)


def terrace(data: Path, folder: Path) -> MiddleburyDataset:
    return MiddleburyDataset(data / "eth3d" / "terrace")


@pytest.mark.parametrize(
    ("scene", "focal_px", "baseline_m", "doffs"),
    [(motorcycle, 994.978, 0.193001, 31.086), (terrace, 711.499, 0.0599432, 0.0)],
)
def test_published_disparity_and_depth_agree_with_the_truth(
    stereo_data: Path,
    folder: Path,
    scene: Callable[[Path, Path], MiddleburyDataset],
    focal_px: float,
    baseline_m: float,
    doffs: float,
) -> None:
    dataset, name = scene(stereo_data, folder), scene.__name__
    truth_px = next(iter(dataset)).truth_disparity_px
    assert truth_px is not None
    disparity_range = max(32, 16 * math.ceil((np.nanmax(truth_px) + 1) / 16))
    convert_dataset(dataset, folder / f"{name}.mcap")
    parameters = {"stereo_algorithm": SGBM, "disparity_range": disparity_range}
    run = play(folder / f"{name}.mcap", "fused", parameters, folder / f"{name}_fused.mcap")

    (message,), (depth,) = run.topic("/disparity").values(), run.topic("/depth/image_rect").values()
    assert (message.f, message.t) == pytest.approx((focal_px, baseline_m), rel=1e-6)
    assert (message.min_disparity, message.max_disparity) == pytest.approx((doffs, doffs + disparity_range - 1))
    published, depth_m = disparity_of(message), pixels_of(depth)
    truth_m = focal_px * baseline_m / (truth_px + doffs)  # as the dataset's pages give it
    both = np.isfinite(truth_px) & np.isfinite(published)
    assert np.count_nonzero(both) > 0.7 * np.count_nonzero(np.isfinite(truth_px))
    assert np.median(np.abs(published - (truth_px + doffs))[both]) < 0.5
    # an error of a disparity is one of Z^2 / (f B) times as many meters
    meters_a_pixel = truth_m[both] ** 2 / (focal_px * baseline_m)
    error_m = np.abs(depth_m - truth_m)[both]
    assert np.median(error_m) < 0.5 * np.median(meters_a_pixel)
    assert run.result["score"]["truth_frames"] == 1
    assert run.result["score"]["median_px"] == pytest.approx(np.median(error_m / meters_a_pixel), abs=0.05)
    assert_depth_and_points_follow_from_disparity(run)
