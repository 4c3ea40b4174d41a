# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stereo camera for the fault injection: a process whose stamps tell which of many known images they belong to.

It takes commands on stdin, one in a line: ``source N``, ``rate HZ``, ``clock SECONDS`` (a step). Before it publishes a
pair it writes its stamp and the time of the monotonic clock, both in nanoseconds, to stdout.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import os
import sys
import threading
import time
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image

from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.nodes.message_types import RclpyTypes
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

__all__ = ["FRAMES", "SOURCES", "Source", "infos_of", "key_of", "pair_of"]

SIZES = ((200, 120), (160, 120), (240, 160))
ENCODINGS = ("mono8", "bgr8", "mono16", "bayer_rggb8")
CALIBRATIONS = 3
FRAMES = 4
KEYS = 1000  # the last three digits of a stamp


class Source(NamedTuple):
    """What a camera sends until it is changed."""

    size: tuple[int, int]
    encoding: str
    calibration: int


SOURCES = tuple(itertools.starmap(Source, itertools.product(SIZES, ENCODINGS, range(CALIBRATIONS))))


def key_of(stamp_ns: int) -> tuple[Source, int]:
    """Source and number of the frame that a stamp belongs to."""
    source, frame = divmod(stamp_ns % KEYS, FRAMES)
    return SOURCES[source], frame


@functools.cache
def _sequence(size: tuple[int, int]) -> SyntheticSequence:
    return SyntheticSequence(frames=FRAMES, width=size[0], height=size[1], rate_hz=1.0)


@functools.cache
def _rig(size: tuple[int, int], calibration: int) -> StereoRig:
    """The true calibration, one with another baseline, one with other distortions."""
    rig = _sequence(size).rig
    P = rig.right.P.copy()
    P[0, 3] *= 1 + 0.25 * (calibration == 1)
    share = 0.5 if calibration == 2 else 1.0
    left, right = (dataclasses.replace(camera, D=share * camera.D) for camera in (rig.left, rig.right))
    return StereoRig(left, dataclasses.replace(right, P=P))


def infos_of(source: Source, stamp_ns: int) -> tuple[Any, Any]:
    """Both camera infos."""
    rig = _rig(source.size, source.calibration)
    left, right = (camera_info_message(RclpyTypes(), camera, stamp_ns) for camera in (rig.left, rig.right))
    return left, right


def pair_of(source: Source, frame: int, stamp_ns: int) -> tuple[Any, Any]:
    """Both images."""
    images = _images(source.size, source.encoding, frame)
    for image in images:
        image.header.stamp.sec, image.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return images


@functools.cache
def _images(size: tuple[int, int], encoding: str, frame: int) -> tuple[Any, Any]:
    types, pair = RclpyTypes(), _sequence(size)[frame].pair
    left, right = (_image(types, side.pixels, encoding, side.frame_id) for side in (pair.left, pair.right))
    return left, right


def _image(types: RclpyTypes, gray: Any, encoding: str, frame_id: str) -> Any:
    pixels = gray
    if encoding == "bgr8":
        pixels = np.stack([gray, 255 - gray, gray // 2], axis=-1)
    elif encoding == "mono16":
        pixels = gray.astype(np.uint16) * 257
        pixels[0, 0] = 65535  # a bit depth of 16 from the first one on
    message = image_message(types, pixels, "mono8" if encoding.startswith("bayer") else encoding, 0, frame_id)
    message.encoding = encoding
    return message


class Camera:
    """Publishes pairs of the current source at the current rate, each camera info before its image."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._node = rclpy.create_node(f"camera_{os.getpid()}")
        images = QoSProfile(
            depth=options.depth,
            reliability=ReliabilityPolicy.BEST_EFFORT if options.best_effort else ReliabilityPolicy.RELIABLE,
        )
        infos = QoSProfile(
            depth=options.depth,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if options.latched else DurabilityPolicy.VOLATILE,
        )
        self._publishers = [
            self._node.create_publisher(kind, f"{side}/{name}", qos)
            for kind, name, qos in ((CameraInfo, "camera_info", infos), (Image, "image_raw", images))
            for side in ("left", "right")
        ]
        self._source, self._rate_hz, self._clock_ns = options.source, options.rate, int(1e9 * options.clock)

    def obey(self) -> None:
        """Take commands until stdin ends; then end."""
        for line in sys.stdin:
            command, value = line.split()
            if command == "source":
                self._source = int(value)
            elif command == "rate":
                self._rate_hz = float(value)
            elif command == "clock":
                self._clock_ns += int(1e9 * float(value))
        os._exit(0)

    def run(self) -> None:
        """Publish until the end of the process."""
        for frame in itertools.cycle(range(FRAMES)):
            source, now_ns = self._source, time.monotonic_ns()
            stamp_ns = (now_ns + self._clock_ns) // KEYS * KEYS + source * FRAMES + frame
            messages = (*infos_of(SOURCES[source], stamp_ns), *pair_of(SOURCES[source], frame, stamp_ns))
            print(stamp_ns, time.monotonic_ns(), flush=True)
            for publisher, message in zip(self._publishers, messages, strict=True):
                publisher.publish(message)
            time.sleep(max(0.0, 1 / self._rate_hz - (time.monotonic_ns() - now_ns) / 1e9))


def main() -> None:
    """Run the camera."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", type=int, default=0)
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--clock", type=float, default=0.0, help="ahead of the monotonic clock, seconds")
    parser.add_argument("--depth", type=int, default=10)
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument("--latched", action="store_true")
    rclpy.init()
    camera = Camera(parser.parse_args())
    threading.Thread(target=camera.obey, daemon=True).start()
    camera.run()


if __name__ == "__main__":
    main()
