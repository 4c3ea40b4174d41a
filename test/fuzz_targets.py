# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Targets of the fuzzing: cases of each kind of input, and what is done with them; it works or raises StereoDepthError.

The tests run a few cases of each with fixed seeds, `benchmarks/fuzz.py` as many as there is time for with fresh ones.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import io
import json
import os
import shutil
import signal
import struct
import sys
import tarfile
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from camera_file_texts import (
    SIZE,
    camchain,
    camodocal,
    depthai,
    opencv_extrinsics,
    opencv_intrinsics,
    opencv_json,
    opencv_xml,
    opencv_yaml,
    orb_slam,
    truth,
    videre,
)
from hypothesis import strategies as st
from mutations import mutated
from range_messages import cloud, depth_image, laser_scan, xyz_cloud
from rosbags.rosbag2 import StoragePlugin, Writer

from stereo_depth_ros.active.structured_light.correspondence import disparity_from_maps
from stereo_depth_ros.active.structured_light.decoding import decode as decode_patterns
from stereo_depth_ros.active.structured_light.manifest import read_manifest
from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.camera_files.extrinsics import read_extrinsics
from stereo_depth_ros.camera_files.reading import read_rig_files
from stereo_depth_ros.cli import main as cli
from stereo_depth_ros.config import CONFIGS, PipelineConfig, parameter_infos
from stereo_depth_ros.config.values import parse_assignments, pipeline_config, read_params_file
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.camera_yaml import camera_to_yaml
from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.transforms import Transforms
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.image_files import read_disparity_image, read_image
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.datasets.middlebury import MiddleburyDataset
from stereo_depth_ros.datasets.npz import read_npz
from stereo_depth_ros.datasets.pose_files import read_poses
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.diagnosis.checks.cameras import check_camera
from stereo_depth_ros.diagnosis.doctor import diagnose
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.disparity import matched_disparity, published_triangulation
from stereo_depth_ros.messages.encodings import ENCODINGS
from stereo_depth_ros.messages.image import decode, decode_pair, image_message, image_size
from stereo_depth_ros.messages.range_sensor import range_points
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.offline.pairs import read_pairs
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.ranging.placement import Placement
from stereo_depth_ros.ranging.projection import project
from stereo_depth_ros.synthetic.bag import write_synthetic_bag
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

__all__ = ["FILES", "READERS", "SENSOR_YAML", "TARGETS", "Target", "run_case"]


def _mostly(usual: st.SearchStrategy[Any], rare: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """A usual case in seven of eight; ``st.one_of`` has all of its strategies equally often, and repeated ones once."""
    return st.sampled_from(range(8)).flatmap(lambda number: usual if number else rare)


def _rarely(cases: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """None in seven of eight."""
    return _mostly(st.none(), cases)


WIDTH, HEIGHT = 64, 48
_REAL_SIZES = st.sampled_from((0, 1, 2, 3, WIDTH, HEIGHT, 640, 2**15, 2**16, 30_000, 2**31 - 1, 2**31, 2**32 - 1))
_SIZES = st.one_of(st.just(WIDTH), st.just(HEIGHT), _REAL_SIZES, st.integers(0, 2**32 - 1))
_FLOATS = st.one_of(
    st.sampled_from((0.0, 1.0, -1.0, 1e-308, 5e-324, 1e308, -1e308, float("nan"), float("inf"), float("-inf"))),
    st.floats(),
)
_TEXTS = st.one_of(
    st.sampled_from(("", "[/]", "[red]x", "\x1b[2J\x07", "\n\r\0", "\u202eright", "a" * 1000, "plumb_bob", "rgb8")),
    st.text(max_size=12),
)
_SEEDS = st.integers(0, 2**63 - 1)
_NANOSECONDS = st.one_of(st.integers(0, 10**9 - 1), st.sampled_from((10**9, 4 * 10**9, 2**32 - 1)))


@dataclass(frozen=True)
class Target:
    """One kind of input.

    Attributes:
        name: of it.
        cases: makes them; a case is plain data.
        run: uses a case, with an empty folder for files; raises StereoDepthError, or nothing.
        known: cases that failed once.
        examples: cases in a round of the tests, at most; so many that all targets take about as long.
    """

    name: str
    cases: st.SearchStrategy[Any]
    run: Callable[[Any, Path], None]
    known: tuple[Any, ...] = ()
    examples: int = 100


def run_case(target: Target, case: Any) -> None:
    """Use a case in a folder of its own; StereoDepthError is as good as success where its text is one line.

    Raises:
        whatever else the target raises.
    """
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)  # numpy's, which a user would see
        try:
            target.run(case, Path(folder))
        except StereoDepthError as error:
            text = str(error)
            assert error.problem and error.remedy, f"without a problem or a remedy: {text!r}"
            assert len(text) < 3000, f"{len(text)} characters: {text[:200]!r}"
            assert "Error" not in text.replace(folder, ""), f"the name of an exception: {text!r}"


# ---- messages


@functools.cache
def _sequence() -> SyntheticSequence:
    return SyntheticSequence(2, WIDTH, HEIGHT)


@functools.cache
def _pair() -> StereoPair:
    return _sequence()[0].pair


@functools.cache
def _config() -> PipelineConfig:
    return pipeline_config({"stereo_algorithm": 0, "disparity_range": 32, "correlation_window_size": 9})


def _header(stamp: tuple[int, int] = (1, 2), frame_id: str = "left") -> Any:
    return SimpleNamespace(stamp=SimpleNamespace(sec=stamp[0], nanosec=stamp[1]), frame_id=frame_id)


_STAMPS = _mostly(st.just((1, 2)), st.tuples(st.integers(-(2**31), 2**31 - 1), _NANOSECONDS))
_IMAGES = st.fixed_dictionaries(
    {
        "stamp": _STAMPS,
        "frame_id": _TEXTS,
        "height": _mostly(st.integers(1, 40), _SIZES),
        "width": _mostly(st.integers(1, 40), _SIZES),
        "encoding": _mostly(st.sampled_from(sorted(ENCODINGS)), _TEXTS),
        "is_bigendian": st.integers(0, 255),
        "step": _rarely(_SIZES),
        "size": _rarely(st.integers(0, 20_000)),
    }
)


def _image(case: dict[str, Any]) -> Any:
    """Where the case has no step or size, it is that of the other fields; at most a megabyte."""
    encoding = ENCODINGS.get(case["encoding"])
    pixel = encoding.samples * encoding.sample_bytes if encoding else 1
    step = case["width"] * pixel if case["step"] is None else case["step"]
    rows = case["height"] * (encoding.payload_rows if encoding else 2) // 2
    size = step * rows if case["size"] is None else case["size"]
    data = np.arange(min(size, 2**20)).astype(np.uint8)
    fields = {name: case[name] for name in ("height", "width", "encoding", "is_bigendian")}
    return SimpleNamespace(**fields, step=step, data=data, header=_header(case["stamp"], case["frame_id"]))


def _run_image(case: dict[str, Any], _: Path) -> None:
    message = _image(case)
    size = image_size(message, "image")
    frame = decode(message, "image")
    assert frame.pixels.shape[1::-1] == size
    decode_pair(message, message, ("left", "right"))


@functools.cache
def _encoded() -> tuple[bytes, ...]:
    gray = _pair().left.pixels
    color = np.dstack((gray, gray[::-1], gray[:, ::-1]))
    deep = gray.astype(np.uint16) * 257
    images = [(".jpg", gray), (".jpg", color), (".png", gray), (".png", color), (".png", deep), (".tiff", deep)]
    images += [(".webp", color), (".bmp", gray), (".pgm", gray), (".ppm", color), (".pfm", gray.astype(np.float32))]
    images += [(".tiff", gray.astype(np.float32)), (".tiff", gray.astype(np.float64))]
    return tuple(cv2.imencode(suffix, pixels)[1].tobytes() for suffix, pixels in images)


def _mutated_of(samples: Callable[[], tuple[bytes, ...]]) -> st.SearchStrategy[bytes]:
    def damaged(seed: int) -> bytes:
        random = np.random.default_rng(seed)
        return mutated(samples()[int(random.integers(len(samples())))], random)

    return _SEEDS.map(damaged)


_FORMATS = st.one_of(
    st.sampled_from(("jpeg", "png", "rgb8; jpeg compressed bgr8", "bayer_rggb8; png compressed ", "h264", "")), _TEXTS
)


def _run_compressed(case: tuple[str, bytes], _: Path) -> None:
    message = SimpleNamespace(header=_header(), format=case[0], data=case[1])
    with contextlib.suppress(StereoDepthError):
        image_size(message, "image")
    decode(message, "image")


_NUMBERS = st.tuples(
    st.sampled_from("krpd"),
    st.integers(0, 11),
    st.one_of(_FLOATS, st.floats(-1000, 1000), st.floats(-0.1, 0.1), st.just(0.0)),
)
_INFOS = st.fixed_dictionaries(
    {
        "numbers": st.lists(_NUMBERS, max_size=2),
        "count": _rarely(st.sampled_from((0, 1, 4, 5, 8, 12, 14, 15, 1000))),
        "model": _rarely(st.one_of(st.sampled_from(("equidistant", "rational_polynomial", "fisheye")), _TEXTS)),
        "size": _rarely(st.tuples(_SIZES, _SIZES)),
        "binning": _rarely(st.tuples(_SIZES, _SIZES)),
        "roi": _rarely(st.tuples(_SIZES, _SIZES, _SIZES, _SIZES)),
        "frame_id": _rarely(_TEXTS),
        "stamp": _rarely(_STAMPS),
    }
)


def _info(case: dict[str, Any], side: str) -> Any:
    """The camera info of a synthetic camera with the changes of the case."""
    info = camera_info_message(RosbagsTypes(), getattr(_sequence().rig, side), 1)
    if case["count"] is not None:
        info.d = np.linspace(-0.1, 0.2, case["count"])
    for name, place, value in case["numbers"]:
        values = np.array(getattr(info, name), np.float64)
        if values.size:
            values[place % values.size] = value
            setattr(info, name, values)
    info.distortion_model = info.distortion_model if case["model"] is None else case["model"]
    if case["size"] is not None:
        info.width, info.height = case["size"]
    if case["binning"] is not None:
        info.binning_x, info.binning_y = case["binning"]
    if case["roi"] is not None:
        info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = case["roi"]
    if case["frame_id"] is not None:
        info.header.frame_id = case["frame_id"]
    if case["stamp"] is not None:
        info.header.stamp.sec, info.header.stamp.nanosec = case["stamp"]
    return info


def _run_infos(case: tuple[dict[str, Any], dict[str, Any]], _: Path) -> None:
    """As a node: the rig, the check of the images, then the pipeline; and the checks of the doctor."""
    left, right = _info(case[0], "left"), _info(case[1], "right")
    for info, side in ((left, "left"), (right, "right")):
        with contextlib.suppress(StereoDepthError):
            check_camera(camera_from_info(info, side), side)
    stamp_ns(left.header)
    rig = StereoRig.from_infos(left, right)
    rig.check_image(WIDTH, HEIGHT, "left")
    result = StereoPipeline(_config(), rig).process(_pair())
    assert result.depth_m.shape == (HEIGHT, WIDTH)
    assert result.points().shape == (HEIGHT, WIDTH, 3)


_DISPARITIES = st.fixed_dictionaries(
    {
        "image": _IMAGES,
        "plain": st.booleans(),
        "f": _rarely(_FLOATS),
        "t": _rarely(_FLOATS),
        "min_disparity": _FLOATS,
    }
)


def _run_disparity(case: dict[str, Any], _: Path) -> None:
    image = _image(
        {**case["image"], "encoding": "32FC1", "step": 4 * WIDTH if case["plain"] else case["image"]["step"]}
    )
    if case["plain"]:
        image.width, image.height, image.data = WIDTH, HEIGHT, np.arange(4 * WIDTH * HEIGHT).astype(np.uint8)
    rig = _sequence().rig
    f, t = (rig.f_px if case["f"] is None else case["f"]), (rig.baseline_m if case["t"] is None else case["t"])
    message = SimpleNamespace(header=image.header, image=image, f=f, t=t, min_disparity=case["min_disparity"])
    with np.errstate(all="ignore"):
        matched_disparity(message, rig)
    published_triangulation(message, rig)


@functools.cache
def _serialized() -> tuple[tuple[str, bytes], ...]:
    types, frame = RosbagsTypes(), _sequence()[0]
    info = camera_info_message(types, _sequence().rig.left, 5)
    image = image_message(types, frame.pair.left.pixels, "mono8", 5, "left")
    compressed = types.CompressedImage(header=image.header, format="png", data=np.frombuffer(_encoded()[2], np.uint8))
    return tuple((message.__msgtype__, types.serialize(message)) for message in (info, image, compressed))


def _damaged_message(seed: int) -> tuple[str, bytes]:
    random = np.random.default_rng(seed)
    msgtype, data = _serialized()[int(random.integers(len(_serialized())))]
    if random.integers(2):  # the fields, which are at the beginning
        return msgtype, mutated(data[:120], random) + data[120:]
    return msgtype, mutated(data, random)


def _run_serialized(case: tuple[str, bytes], _: Path) -> None:
    msgtype, data = case
    message = RosbagsTypes().deserialize(data, msgtype)
    stamp_ns(message.header)
    if msgtype.endswith("CameraInfo"):
        StereoRig.from_infos(message, camera_info_message(RosbagsTypes(), _sequence().rig.right, 5))
    else:
        image_size(message)
        decode(message)


@functools.cache
def _of_sensors() -> tuple[tuple[str, bytes], ...]:
    points = np.random.default_rng(1).uniform(-5, 5, (40, 3)).astype(np.float32)
    timed = np.zeros(30, np.dtype([("x", "<f8"), ("y", "<f4"), ("ring", "<u2"), ("z", "<f8"), ("time", "<f4")]))
    messages = (
        xyz_cloud(points),
        cloud(timed.reshape(5, 6), row_padding=3),
        laser_scan(np.linspace(0, 14, 40, dtype=np.float32)),
        depth_image(np.linspace(0, 3, WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH), "16UC1"),
    )
    return tuple((message.__msgtype__, RosbagsTypes().serialize(message)) for message in messages)


def _damaged_sweep(seed: int) -> tuple[str, bytes]:
    random = np.random.default_rng(seed)
    msgtype, data = _of_sensors()[int(random.integers(len(_of_sensors())))]
    return msgtype, mutated(data[:240], random) + data[240:] if random.integers(4) else mutated(data, random)


def _run_sweep(case: tuple[str, bytes], _: Path) -> None:
    """Its points, moved with a turning sensor, in the image."""
    rig, turned = _sequence().rig, Pose.from_quaternion(np.array([0.1, 0, 0.2, 0.9]), np.array([0.3, 0, 0]))
    points = range_points(RosbagsTypes().deserialize(case[1], case[0]), "/sensor", rig.left)
    assert np.isfinite(points.points_m).all()
    tree = Transforms()
    for stamp in (-(2**62), 2**62):
        tree.add("odom", rig.frame_id, turned if stamp > 0 else Pose.identity(), stamp)
    tree.add(rig.frame_id, points.frame_id, turned)
    placed = Placement(tree).place(points, rig, 10**9)
    seen = project(placed, points.sigma_m, turned, Triangulation.from_rig(rig), (WIDTH, HEIGHT))
    assert seen.visible == np.count_nonzero(np.isfinite(seen.disparity_px))


_POSES = (
    b"parent: mast\nchild: lidar\ntranslation: [1.0, 2.0, -0.5]\nquaternion: [0.6, 0, 0, 0.8]\n",
    b"transforms:\n- header: {frame_id: mast}\n  child_frame_id: lidar\n  transform:\n"
    b"    translation: {x: 1, y: 2, z: 3}\n    rotation: {x: 0, y: 0, z: 0, w: 1}\n",
    b"matrix: [[1, 0, 0, 1], [0, 0.28, -0.96, 2], [0, 0.96, 0.28, -0.5]]\n",
    b"R: 0 -1 0 0 0 -1 1 0 0\nT: 0.1 0.2 0.3\n",
    b"P0: 7 0 6 0 0 7 1 0 0 0 1 0\nTr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3\n",
)


def _damaged_pose(seed: int) -> tuple[str, bytes]:
    random = np.random.default_rng(seed)
    at = int(random.integers(len(_POSES)))
    return "pose.yaml" if at < 3 else "calib.txt", _edited(_POSES[at], random)


def _run_pose(case: tuple[str, bytes], folder: Path) -> None:
    (folder / case[0]).write_bytes(case[1])
    assert np.isfinite(read_extrinsics(folder / case[0]).parent_from_child.matrix).all()


# ---- bags


@functools.cache
def _bags() -> tuple[tuple[str, bytes], ...]:
    """The same bag without and with compression of its chunks, and as SQLite, by the end of their names."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag.mcap"
        write_synthetic_bag(path, _sequence())
        bags = []
        for compression in ("none", "lz4", "zstd"):
            target = Path(folder) / f"{compression}.mcap"
            with BagReader(path) as reader, BagWriter(target, compression=compression, chunk_size=5000) as writer:
                for message in reader.messages():
                    writer.write_raw(message.topic, message.msgtype, message.data, message.log_time_ns)
            bags.append((".mcap", target.read_bytes()))
        bags.append((".db3", next(_recording().glob("*.db3")).read_bytes()))
    return tuple(bags)


@functools.cache
def _recording() -> Path:
    """A folder of rosbag2, which is removed with the process."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    write_synthetic_bag(folder / "bag.mcap", _sequence())
    typestore = RosbagsTypes().typestore
    with (
        BagReader(folder / "bag.mcap") as reader,
        Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as bag,
    ):
        topics = {
            name: bag.add_connection(name, info.msgtype, typestore=typestore) for name, info in reader.topics.items()
        }
        for message in reader.messages():
            bag.write(topics[message.topic], message.log_time_ns, message.data)
    return folder / "bag"


def _damaged_bag(seed: int) -> tuple[str, bytes]:
    random = np.random.default_rng(seed)
    suffix, data = _bags()[int(random.integers(len(_bags())))]
    return suffix, mutated(data, random)


def _run_bag(case: tuple[str, bytes], folder: Path) -> None:
    path = folder / f"bag{case[0]}"
    path.write_bytes(case[1])
    _use_bag(path, examined=zlib.crc32(case[1]) % 4 == 0)


def _run_metadata(case: bytes, folder: Path) -> None:
    shutil.copytree(_recording(), folder / "bag")
    (folder / "bag" / "metadata.yaml").write_bytes(case)
    _use_bag(folder / "bag", examined=False)


def _use_bag(path: Path, examined: bool) -> None:
    with contextlib.suppress(StereoDepthError):
        inspect_bag(path)
    with contextlib.suppress(StereoDepthError):
        if examined:
            diagnose(survey_bag(BagSelection(path)))
    assert len(list(read_pairs(path))) <= 2


def _damaged_metadata(seed: int) -> bytes:
    return _edited((_recording() / "metadata.yaml").read_bytes(), np.random.default_rng(seed))


# ---- files of text and pixels

_P = "7.188560000000e+02 0.0 6.071928000000e+02 {} 0.0 7.188560000000e+02 1.852157000000e+02 0.0 0.0 0.0 1.0 0.0"
_CALIB_KITTI = f"P0: {_P.format(0)}\nP1: {_P.format(-386.1448)}\nP2: {_P.format(45.4)}\n".encode()
_RAW = "S_00: 64 48\nK_00: 50 0 32 0 50 24 0 0 1\nD_00: -0.3 0.2 0.001 0.001 0\nR_rect_00: 1 0 0 0 1 0 0 0 1\n"
_CALIB_RAW = (
    f"calib_time: 09-Jan-2012 13:57:47\n{_RAW}P_rect_00: 50 0 32 0 0 50 24 0 0 0 1 0\n"
    f"{_RAW.replace('_00', '_01')}P_rect_01: 50 0 32 -25 0 50 24 0 0 0 1 0\n"
).encode()
_TIMES = b"0.0\n1.0e-01\n2.0e-01\n"
_DATES = b"2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26.074344445\n"
_CALIB_2014 = (
    b"cam0=[50.5 0 30.2; 0 50.5 23.1; 0 0 1]\ncam1=[50.5 0 33.4; 0 50.5 23.1; 0 0 1]\ndoffs=3.2\nbaseline=193.001\n"
    b"width=64\nheight=48\nndisp=32\n"
)
SENSOR_YAML = """%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, {}, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [64, 48]
camera_model: pinhole
intrinsics: [50.0, 50.2, 32.1, 23.9]
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.7e-05]
"""
_INDEX = b"#timestamp [ns],filename\n1403636579763555584,1403636579763555584.png\n1403636579813555456,b.png\n"
_WORDS = (
    *(
        b"1e400",
        b"nan",
        b"-inf",
        b"0",
        b"-1",
        b"9" * 400,
        b"1_0",
        b"0x10",
        b"",
        b"\xff\xfe",
        b"\0",
        b"\xe9",
        b"[" * 100,
    ),
    *(b"null", b"true", b"{}", b"[1, 2]", b"&a [*a, *a]", b"*a", b"!!python/object:os.system x", b"!!binary aGk="),
    *(
        b"[/red]",
        b"\x1b[2J",
        b"\r",
        b"2147483648",
        b"1e308",
        b"../../../etc/passwd",
        b"/",
        b"~",
        b'"',
        b"'",
        b"- ",
        b": ",
    ),
)


def _edited(text: bytes, random: np.random.Generator) -> bytes:
    """The text with damages that a parser sees: words exchanged, lines lost or repeated; or with any damage."""
    if random.integers(4) == 0:
        return mutated(text, random)
    lines = text.split(b"\n")
    for _ in range(int(random.integers(1, 4))):
        at, word = int(random.integers(len(lines))), _WORDS[int(random.integers(len(_WORDS)))]
        kind = int(random.integers(6))
        if kind == 0 and len(lines) > 1:
            del lines[at]
        elif kind == 1:
            lines.insert(at, lines[int(random.integers(len(lines)))])
        elif kind == 2:
            lines.insert(at, word)
        else:
            words = lines[at].split(b" ")
            words[int(random.integers(len(words)))] = word
            lines[at] = b" ".join(words)
    return b"\n".join(lines)


FILES: dict[str, Callable[[], dict[str, bytes]]] = {
    "kitti": lambda: {
        **{f"image_{side}/00000{n}.png": _encoded()[2] for side in "01" for n in range(3)},
        **{"calib.txt": _CALIB_KITTI, "times.txt": _TIMES},
    },
    "kitti raw": lambda: {
        **{f"image_0{side}/data/000000000{n}.png": _encoded()[2] for side in "01" for n in range(2)},
        **{"calib_cam_to_cam.txt": _CALIB_RAW, "image_00/timestamps.txt": _DATES},
    },
    "middlebury 2014": lambda: {
        **{"im0.png": _encoded()[2], "im1.png": _encoded()[2], "calib.txt": _CALIB_2014, "disp0.pfm": _encoded()[10]},
    },
    "middlebury 2005": lambda: {
        **{"view1.png": _encoded()[2], "view5.png": _encoded()[2], "dmin.txt": b"10\n", "disp1.png": _encoded()[2]},
    },
    "npz": lambda: {
        **{"a_left.png": _encoded()[2], "a_right.png": _encoded()[2], "calib.txt": _CALIB_2014},
        **{"a_disp.npz": _npz()},
    },
    "euroc": lambda: {
        **{f"mav0/cam{n}/data/1403636579763555584.png": _encoded()[2] for n in range(2)},
        **{f"mav0/cam{n}/data.csv": _INDEX for n in range(2)},
        **{f"mav0/cam{n}/sensor.yaml": SENSOR_YAML.format(0.1 * n).encode() for n in range(2)},
    },
}
READERS: dict[str, Callable[[Path], Any]] = {
    **{"kitti": KittiDataset, "kitti raw": KittiDataset, "euroc": EurocDataset},
    **{"middlebury 2014": MiddleburyDataset, "middlebury 2005": MiddleburyDataset, "npz": MiddleburyDataset},
}


@functools.cache
def _npz() -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, np.arange(WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH))
    return file.getvalue()


def _damaged_npz(seed: int) -> bytes:
    """The file is damaged, or the array in it."""
    random = np.random.default_rng(seed)
    if random.integers(3) == 0:
        return mutated(_npz(), random)
    array, file = io.BytesIO(), io.BytesIO()
    np.save(array, np.arange(24, dtype=np.float32).reshape(4, 6))
    data = array.getvalue()
    data = mutated(data[:128], random) + data[128:] if random.integers(2) else mutated(data, random)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("arr_0.npy", data)
    return file.getvalue()


def _npz_of(header: bytes, payload: bytes, count: int = 1) -> bytes:
    """An .npz file with an array of this header; the payload is repeated."""
    file = io.BytesIO()
    padded = header.ljust(117) + b"\n"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("arr_0.npy", "w") as member:
        member.write(b"\x93NUMPY\x01\0" + struct.pack("<H", len(padded)) + padded)
        for _ in range(count):
            member.write(payload)
    return file.getvalue()


def _damaged_dataset(seed: int) -> tuple[str, dict[str, bytes]]:
    """Kind of the dataset, and the files that are damaged."""
    random = np.random.default_rng(seed)
    kind = list(FILES)[int(random.integers(len(FILES)))]
    files = FILES[kind]()
    texts = [name for name in files if not name.endswith(".png")] or list(files)
    name = (texts if random.integers(4) else list(files))[int(random.integers(len(texts)))]
    is_text = name.endswith((".txt", ".csv", ".yaml"))
    return kind, {name: _edited(files[name], random) if is_text else mutated(files[name], random)}


def _run_dataset(case: tuple[str, dict[str, bytes]], folder: Path) -> None:
    kind, damaged = case
    for name, data in {**FILES[kind](), **damaged}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    for frame in READERS[kind](folder):
        assert frame.left.pixels.size
        if frame.truth_disparity_px is not None:
            assert frame.truth_disparity_px.dtype == np.float32


def _run_image_file(case: bytes, folder: Path) -> None:
    (folder / "a.png").write_bytes(case)
    with contextlib.suppress(StereoDepthError):
        read_disparity_image(folder / "a.png")
    read_image(folder / "a.png")


def _run_npz(case: bytes, folder: Path) -> None:
    (folder / "a.npz").write_bytes(case)
    assert read_npz(folder / "a.npz").dtype == np.float32


@functools.cache
def _calibrations() -> tuple[tuple[str, bytes], ...]:
    """Files with both cameras, by the end of their names: one of each format."""
    rig, lens = truth("plumb_bob"), truth("equidistant")
    both = opencv_intrinsics(rig) | opencv_extrinsics(rig, rectified=True)
    cameras = [(name, *(getattr(each, matrix) for matrix in "KDRP")) for name, each in _cameras()]
    yaml = "".join(camera_to_yaml(each, name) for name, each in _cameras()[:1])
    texts = [
        *((".yaml", camchain(lens, "equi")), (".yaml", opencv_yaml(both)), (".xml", opencv_xml(both))),
        *((".json", opencv_json(both)), (".json", depthai(rig)), (".yaml", orb_slam(rig, "PinHole"))),
        *((".ini", videre(cameras)), (".yaml", yaml), (".yaml", camodocal(rig, "left", "PINHOLE"))),
    ]
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w:gz") as tar:
        for name, each in _cameras():
            data = camera_to_yaml(each, name).encode()
            member = tarfile.TarInfo(f"{name}.yaml")
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    return (*((suffix, text.encode()) for suffix, text in texts), (".tar.gz", archive.getvalue()))


@functools.cache
def _right_camera() -> str:
    return camera_to_yaml(_sequence().rig.right, "right")


def _cameras() -> tuple[tuple[str, CameraModel], ...]:
    return ("left", _sequence().rig.left), ("right", _sequence().rig.right)


def _damaged_calibration(seed: int) -> tuple[str, bytes]:
    random = np.random.default_rng(seed)
    suffix, data = _calibrations()[int(random.integers(len(_calibrations())))]
    return suffix, mutated(data, random) if suffix == ".tar.gz" else _edited(data, random)


def _run_calibration(case: tuple[str, bytes], folder: Path) -> None:
    """Where the file holds the left camera only, the one of the right camera is beside it."""
    path = folder / f"left{case[0]}"
    path.write_bytes(case[1])
    (folder / "right.yaml").write_text(_right_camera())
    rig = read_rig_files([path], SIZE)
    assert rig.baseline_m > 0


_POSES = (
    b"1 0 0 0 0 1 0 0 0 0 1 0\n0.8 0 0.6 1.5 0 1 0 -0.25 -0.6 0 0.8 30\n",
    b"#timestamp, p_x [m], ...\n1403715273262142976,1,2,3,1,0,0,0\n1403715273272142976,1,2,3,0.8,0,0.6,0,9,9\n",
    b"# t x y z qx qy qz qw\n1403715273.25 1 2 3 0 0 0 1\n1403715273.35 1.5 2 3 0 0.6 0 0.8\n",
)


def _damaged_poses(seed: int) -> bytes:
    random = np.random.default_rng(seed)
    return _edited(_POSES[int(random.integers(len(_POSES)))], random)


def _run_poses(case: bytes, folder: Path) -> None:
    (folder / "poses.txt").write_bytes(case)
    poses = read_poses(folder / "poses.txt")
    assert all(len(keys) in (0, len(poses.poses)) for keys in (poses.stamps_ns, poses.numbers))
    assert all(abs(np.linalg.det(pose.rotation) - 1) < 1e-6 for pose in poses.poses)


# ---- parameters

_PARAMETER_FILE = b"""/**:
  ros__parameters:
    stereo_algorithm: 1
    disparity_range: 96
    uniqueness_ratio: 12.5
    use_color: true
    depth_encoding: "16UC1"
disparity_node:
  ros__parameters: {P1: 200.0, P2: 400.0, speckle_size: 50}
"""


def _lines() -> st.SearchStrategy[str]:
    """Documents of YAML's parts in any order, most of them without what no document may hold."""
    parts = st.sampled_from(
        (*" \n\t-:,[]{}&*!|>'\"#%@`?", "\n  ", "- ", ": ", "a", "&a ", "*a", "<<: *a", "!!set", "---\n", "...\n", "~")
    )
    words = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=5)
    plain = st.lists(st.one_of(parts, parts, words), max_size=20).map("".join)
    return _mostly(plain, st.lists(st.one_of(parts, _TEXTS), max_size=20).map("".join))


def _laughs(levels: int) -> bytes:
    lines = ["a0: &a0 [x, x]", *(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, levels))]
    return "\n".join(lines).encode()


_PARAMETER_FILES = st.one_of(
    _SEEDS.map(lambda seed: _edited(_PARAMETER_FILE, np.random.default_rng(seed))),
    _lines().map(lambda text: text.encode("utf-8", "surrogatepass")),
    _lines().map(lambda text: b"/**:\n  ros__parameters:\n    P1: " + text.encode("utf-8", "surrogatepass")),
)


def _run_parameter_file(case: bytes, folder: Path) -> None:
    (folder / "params.yaml").write_bytes(case)
    pipeline_config(read_params_file(folder / "params.yaml"))


_PARAMETERS = sorted({info.name for config in CONFIGS.values() for info in parameter_infos(config)})
_ASSIGNMENTS = st.lists(
    _mostly(
        st.tuples(st.sampled_from(_PARAMETERS), st.one_of(_lines(), st.integers().map(str))).map(":=".join),
        st.one_of(_TEXTS, st.tuples(st.sampled_from(_PARAMETERS), st.floats().map(str)).map(":=".join)),
    ),
    min_size=1,
    max_size=2,
)


def _run_assignments(case: list[str], _: Path) -> None:
    pipeline_config(parse_assignments(case))


_VALUES = st.one_of(_TEXTS.filter(lambda text: "\0" not in text), st.integers().map(str), st.floats().map(str))
_NAMES = st.sampled_from(
    (
        "info",
        "doctor",
        "rig",
        "process",
        "evaluate",
        "parameters",
        "convert",
        "kitti",
        "calibrate",
        "rectify",
        "fuse",
        "nothing",
    )
)
_OPTIONS = st.sampled_from(
    (
        "--json",
        "--param",
        "-p",
        "--matcher",
        "--left",
        "--start",
        "--duration",
        "--size",
        "--poses",
        "--voxel",
        "--rate",
        "--output",
        "--help",
    )
)
_PLAIN_VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 40), st.integers(), st.floats(), st.text(max_size=8), st.just([[]])
)
_PATTERNS = st.one_of(
    st.fixed_dictionaries({"role": st.sampled_from(["white", "black", "ambient", "unused"])}),
    st.fixed_dictionaries(
        {"role": st.just("gray"), "axis": st.sampled_from(["columns", "rows"]), "bit": st.integers(0, 15)},
        optional={"inverse": st.booleans(), "cell_px": st.integers(1, 16384), "offset_px": st.integers(0, 65536)},
    ),
    st.fixed_dictionaries(
        {
            "role": st.just("phase"),
            "axis": st.sampled_from(["columns", "rows"]),
            "period_px": st.floats(3, 32768),
            "shift_deg": st.sampled_from([0, 120, 240, -90, 1e-9]),
        }
    ),
    st.dictionaries(st.sampled_from(["role", "axis", "bit", "inverse", "period_px", "shift_deg"]), _PLAIN_VALUES),
    _PLAIN_VALUES,
)
_MANIFESTS = st.one_of(
    st.fixed_dictionaries(
        {
            "projector": st.fixed_dictionaries({"width": st.integers(1, 20_000), "height": st.integers(1, 20_000)}),
            "images": st.lists(_PATTERNS, max_size=12),
        }
    ),
    st.fixed_dictionaries({"projector": _PLAIN_VALUES, "images": st.one_of(_PLAIN_VALUES, st.lists(_PATTERNS))}),
    _PLAIN_VALUES,
)


def _run_manifest(case: Any, folder: Path) -> None:
    """A manifest of patterns, and noise in place of their images."""
    path = folder / "patterns.json"
    path.write_text(json.dumps(case))
    sequence = read_manifest(path)
    noise = np.random.default_rng(1).integers(0, 256, (len(sequence), 11, 18), np.uint8)
    seen = decode_patterns(sequence, list(noise))
    for coordinate in (seen.column_px, seen.row_px):
        assert coordinate is None or np.array_equal(np.isfinite(coordinate), seen.reasons == 0)
    assert disparity_from_maps(seen, seen).disparity_px.shape == (11, 18)


_COMMANDS = st.tuples(
    _NAMES, st.lists(st.one_of(_OPTIONS, _VALUES, st.just("a.mcap"), st.just("missing.mcap")), max_size=5)
)


def _run_command(case: tuple[str, list[str]], folder: Path) -> None:
    """In this process: it ends with an exit code, and what it writes to stderr has no traceback."""
    (folder / "a.mcap").write_bytes(_bags()[0][1][:3000])
    out, err = io.TextIOWrapper(io.BytesIO(), "utf-8"), io.TextIOWrapper(io.BytesIO(), "utf-8")
    before, where = sys.argv, Path.cwd()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    sys.argv = ["stereo-depth", case[0], *case[1]]
    try:
        os.chdir(folder)
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.main()
    except SystemExit as ended:
        err.flush()
        said = err.buffer.getvalue().decode()  # type: ignore[attr-defined]
        assert ended.code in (None, 0, 1, 2, 3), ended.code
        assert "Traceback" not in said, said
    finally:
        sys.argv = before
        os.chdir(where)
        for number, handler in handlers.items():
            signal.signal(number, handler)


_HUGE_HEADERS = tuple(
    _npz_of(f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}".encode(), bytes(2**12))
    for descr, shape in (("<f4", "(1099511627776, 8)"), ("|O", "(8, 8)"), ("<f4", "(8,)"), ("<c16", "(8, 8)"))
)
_KNOWN_FILES = (_PARAMETER_FILE, _laughs(30), b"[" * 10_000, b"/**: {ros__parameters: {P1: [{}]}}")
_KNOWN_TEXTS = ("P1:=" + "9" * 5000, ":=", "P1:=&a [*a]", "P1:=- : -T")
_PLAIN_IMAGE = {
    **{"stamp": (1, 2), "frame_id": "left", "height": HEIGHT, "width": WIDTH, "encoding": "mono8"},
    **{"is_bigendian": 0, "step": None, "size": None},
}
_PLAIN_INFO: dict[str, Any] = dict.fromkeys(("count", "model", "size", "binning", "roi", "frame_id", "stamp")) | {
    "numbers": []
}
_PLAIN_DISPARITY = {"image": _PLAIN_IMAGE, "plain": True, "f": None, "t": None, "min_disparity": 0.0}


# Made of numbers, not rendered: rendering compiles kernels, here while tests are collected.
_PNG = cv2.imencode(".png", np.arange(WIDTH * HEIGHT, dtype=np.uint8).reshape(HEIGHT, WIDTH))[1].tobytes()


def _png_of(width: int, height: int) -> bytes:
    data = bytearray(_PNG)
    data[16:24] = struct.pack(">II", width, height)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)


TARGETS: tuple[Target, ...] = (
    Target(
        "image",
        _IMAGES,
        _run_image,
        (
            _PLAIN_IMAGE,
            {**_PLAIN_IMAGE, "stamp": (1, 4 * 10**9)},
            {**_PLAIN_IMAGE, "encoding": "[/]\x1b[2J" * 100_000},
            {**_PLAIN_IMAGE, "height": 2**31, "width": 2**31},
            {**_PLAIN_IMAGE, "height": 2**32 - 1, "width": 1, "step": 0},
        ),
    ),
    Target(
        "compressed image",
        st.tuples(_FORMATS, _mutated_of(_encoded)),
        _run_compressed,
        (("png", _png_of(20_000, 20_000)), ("jpeg", b""), ("png", _PNG[:40]), ("x" * 10**6, b"\xff\xd8\xff")),
    ),
    Target(
        "camera infos",
        st.tuples(_INFOS, _INFOS),
        _run_infos,
        (
            (_PLAIN_INFO, _PLAIN_INFO),
            *(
                (changed, changed)
                for changed in (
                    {**_PLAIN_INFO, "size": (30_000, 30_000)},
                    {**_PLAIN_INFO, "count": 1_000_000},
                    {**_PLAIN_INFO, "model": "x" * 10**6},
                    *(
                        {**_PLAIN_INFO, "numbers": [(name, 0, value)]}
                        for name in "kp"
                        for value in (1e308, np.nan, 5e-324)
                    ),
                )
            ),
        ),
        examples=60,
    ),
    Target("disparity image", _DISPARITIES, _run_disparity, (_PLAIN_DISPARITY,)),
    Target("serialized messages", _SEEDS.map(_damaged_message), _run_serialized, examples=200),
    Target("range sensors", _SEEDS.map(_damaged_sweep), _run_sweep, examples=200),
    Target("poses of range sensors", _SEEDS.map(_damaged_pose), _run_pose, examples=150),
    Target("bags", _SEEDS.map(_damaged_bag), _run_bag, examples=40),
    Target("metadata of bags", _SEEDS.map(_damaged_metadata), _run_metadata, (_laughs(30),), examples=40),
    Target("datasets", _SEEDS.map(_damaged_dataset), _run_dataset, (("kitti", {}),), examples=150),
    Target("calibrations", _SEEDS.map(_damaged_calibration), _run_calibration, (), examples=200),
    Target("poses", _SEEDS.map(_damaged_poses), _run_poses, _POSES, examples=200),
    Target("npz", _SEEDS.map(_damaged_npz), _run_npz, _HUGE_HEADERS),
    Target("image files", _mutated_of(_encoded), _run_image_file, (_png_of(20_000, 20_000), b"P5 60000 60000 255\n")),
    Target(
        "manifests of patterns",
        _MANIFESTS,
        _run_manifest,
        ({"projector": {"width": 1, "height": 1}, "images": []},),
        examples=25,
    ),
    Target("parameter files", _PARAMETER_FILES, _run_parameter_file, _KNOWN_FILES),
    Target("parameters", _ASSIGNMENTS, _run_assignments, tuple([text] for text in _KNOWN_TEXTS)),
    Target("command line", _COMMANDS, _run_command, (("info", ["[red]"]), ("rig", ["~nosuchuser"])), examples=40),
)
