# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small stereo bags for tests, from a synthetic sequence."""

from __future__ import annotations

import functools
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.cdr import cdr_stamp_ns, with_stamp
from stereo_depth_ros.messages.image import compressed_message, image_message
from stereo_depth_ros.synthetic.bag import write_synthetic_bag
from stereo_depth_ros.synthetic.sequence import SyntheticFrame, SyntheticSequence

WIDTH, HEIGHT = 200, 150
PARAMETERS = {"disparity_range": 32, "speckle_size": 20}


class _RenderedOnce(SyntheticSequence):
    """A frame depends on its index only."""

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return super().__getitem__(index)
        return _frame(range(len(self))[index])


@functools.cache
def _frame(index: int) -> SyntheticFrame:
    frame = SyntheticSequence(index + 1, WIDTH, HEIGHT)[index]
    for image in (frame.pair.left, frame.pair.right):
        image.pixels.flags.writeable = False
    return frame


@functools.cache
def sequence(frames: int) -> SyntheticSequence:
    """Frames every 100 ms; their images are read-only, as the tests share them."""
    return _RenderedOnce(frames, WIDTH, HEIGHT)


def write_truth_bag(path: Path, frames: int) -> SyntheticSequence:
    """Raw pairs and their truth."""
    made = sequence(frames)
    write_synthetic_bag(path, made)
    return made


def write_odd_bag(
    path: Path, frames: int, *, compressed: bool = False, without_right: Collection[int] = (), right_late_ns: int = 0
) -> None:
    """Other topic names, one camera info for the whole bag, images without a partner, late right images."""
    made, types = sequence(frames), RosbagsTypes()
    name = "image/compressed" if compressed else "image"
    with BagWriter(path) as bag:
        for side, camera in (("cam0", made.rig.left), ("cam1", made.rig.right)):
            bag.write(f"/{side}/camera_info", camera_info_message(types, camera, 0), made.stamp_ns(0))
        for index, frame in enumerate(made):
            for side, image in (("cam0", frame.pair.left), ("cam1", frame.pair.right)):
                if side == "cam1" and index in without_right:
                    continue
                stamp_ns = image.stamp_ns + (right_late_ns if side == "cam1" else 0)
                if compressed:
                    message = compressed_message(types, image.pixels, "mono8", "png", stamp_ns, image.frame_id)
                else:
                    message = image_message(types, image.pixels, "mono8", stamp_ns, image.frame_id)
                bag.write(f"/{side}/{name}", message, image.stamp_ns)


def later(path: Path, target: Path, seconds: int) -> Path:
    """The same bag with all stamps later by so many seconds, so that running nodes accept them as new."""
    with BagReader(path) as reader, BagWriter(target, compression="none", chunk_size=100_000) as writer:
        for message in reader.messages():
            stamp_ns = cdr_stamp_ns(message.data) + seconds * 10**9
            log_time_ns = message.log_time_ns + seconds * 10**9
            writer.write_raw(message.topic, message.msgtype, with_stamp(message.data, stamp_ns), log_time_ns)
    return target


def compressed_folder(path: Path, folder: Path, plugin: StoragePlugin) -> Path:
    """The same bag as rosbag2 records it with compression of whole files: NAME.mcap.zstd or NAME.db3.zstd."""
    writer = Writer(folder, version=9, storage_plugin=plugin)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    typestore = RosbagsTypes().typestore
    with BagReader(path) as reader, writer:
        connections = {
            topic: writer.add_connection(topic, info.msgtype, typestore=typestore)
            for topic, info in reader.topics.items()
        }
        for message in reader.messages():
            writer.write(connections[message.topic], message.log_time_ns, message.data)
    return folder


def cut(path: Path, target: Path, share: float) -> Path:
    """The first part of a file."""
    data = path.read_bytes()
    target.write_bytes(data[: int(share * len(data))])
    return target


def messages_of(path: Path, topic: str) -> dict[int, bytes]:
    """CDR bytes by stamp; fails where a stamp occurs twice."""
    with BagReader(path) as reader:
        found = [(cdr_stamp_ns(message.data), message.data) for message in reader.messages([topic])]
    assert len(dict(found)) == len(found), f"a stamp occurs twice on {topic}"
    return dict(found)


def median_relative_depth_error(path: Path, made: SyntheticSequence) -> float:
    """Error of the depth images of a bag against the truth of the sequence at the same stamps."""
    errors = []
    truths = {made.stamp_ns(index): made[index].truth_depth_m for index in range(len(made))}
    with BagReader(path) as reader:
        for message in reader.messages(["/depth/image_rect"]):
            image = reader.deserialize(message)
            assert image.encoding == "32FC1"
            depth_m = image.data.view(np.float32).reshape(image.height, image.width)
            truth_m = truths[cdr_stamp_ns(message.data)]
            errors.append((np.abs(depth_m - truth_m) / truth_m)[np.isfinite(depth_m)])
    return float(np.median(np.concatenate(errors)))
