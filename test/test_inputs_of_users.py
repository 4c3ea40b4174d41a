# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags as drivers, simulators and recorders make them: all commands use one, or refuse it with one cause and remedy."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_kinds import write_kind
from command_line import CommandLine
from stereo_bags import PARAMETERS

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.types import RectifiedPair, StereoPair
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

TYPES, MADE = RosbagsTypes(), SyntheticSequence(2, 320, 240)
OPTIONS = tuple(f"--param={name}:={value}" for name, value in PARAMETERS.items())
COMMANDS = ("info", "doctor", "process", "replay")


@functools.cache
def frames() -> list[tuple[StereoPair, RectifiedPair]]:
    rectifier = Rectifier(MADE.rig)
    return [(frame.pair, rectifier.rectify(frame.pair)) for frame in MADE]


@dataclass(frozen=True)
class Bag:
    """How a bag differs from raw images with their camera infos in /left and /right.

    Attributes:
        image, info: topics, with * for left and right; an empty one is left out.
        rectified: the images are.
        change_info: of a side and its camera info.
        change_image: of the samples of an image.
        encoding: of these.
        right_late_ns: how much later the right images are.
        stamp: whether the images have one.
        joint: both images side by side in this topic.
    """

    image: str = "/*/image_raw"
    info: str = "/*/camera_info"
    rectified: bool = False
    change_info: Callable[[str, Any], Any] = lambda side, info: info
    change_image: Callable[[Any], Any] = lambda pixels: pixels
    encoding: str = "mono8"
    right_late_ns: int = 0
    stamp: bool = True
    joint: str = ""

    def write(self, bag: BagWriter) -> None:
        for pair, rectified in frames():
            images = {"left": pair.left.pixels, "right": pair.right.pixels}
            if self.rectified:
                images = {"left": rectified.left, "right": rectified.right}
            for side, camera in (("left", MADE.rig.left), ("right", MADE.rig.right)):
                stamp_ns = pair.left.stamp_ns + (self.right_late_ns if side == "right" else 0)
                info = self.change_info(side, camera_info_message(TYPES, camera, stamp_ns))
                if self.info:
                    bag.write(self.info.replace("*", side), info, stamp_ns)
                if not self.joint:
                    self._write(bag, self.image.replace("*", side), images[side], stamp_ns, camera.frame_id)
            if self.joint:
                self._write(bag, self.joint, np.concatenate([*images.values()], axis=1), pair.left.stamp_ns, "both")

    def _write(self, bag: BagWriter, topic: str, pixels: Any, stamp_ns: int, frame_id: str) -> None:
        changed = self.change_image(pixels)
        message = image_message(TYPES, changed, self.encoding, stamp_ns if self.stamp else 0, frame_id)
        bag.write(topic, message, stamp_ns)


def changed(**fields: Any) -> Callable[[str, Any], Any]:
    return lambda side, info: replace(info, **fields)


def only_p(side: str, info: Any) -> Any:
    nothing: Mapping[str, Any] = {"k": np.zeros(9), "r": np.zeros(9), "d": np.zeros(0), "distortion_model": ""}
    return replace(info, **nothing)


def plumb_bob_8(side: str, info: Any) -> Any:
    return replace(info, d=np.concatenate([info.d, np.zeros(3)]))


def same_p(side: str, info: Any) -> Any:
    p = info.p.copy()
    p[3] = -float(MADE.rig.f_px) * MADE.rig.baseline_m
    return replace(info, p=p)


RECTIFIED_INFO = Bag(info="/*/camera_info", image="/*/image_rect", rectified=True, change_info=only_p)
USED: Mapping[str, tuple[Bag, ...]] = {
    "raw and rectified images in one namespace": (
        Bag(image="/*/image_raw_color", info="/*/camera_info_raw"),
        replace(RECTIFIED_INFO, image="/*/image_rect_color"),
    ),
    "raw images beside camera infos of rectified ones": (
        Bag(image="/*/image_raw_color", info="/*/unused/camera_info"),
        replace(RECTIFIED_INFO, image="/*/image_rect_color"),
    ),
    "rectified images, camera infos with P only": (RECTIFIED_INFO,),
    "plumb_bob with 8 coefficients": (Bag(change_info=plumb_bob_8),),
    "12 bits in mono16": (Bag(change_image=lambda pixels: pixels.astype(np.uint16) * 16, encoding="mono16"),),
}
# With the cause and the remedy that every command states.
REFUSED: Mapping[str, tuple[Bag, str, str]] = {
    "not calibrated": (
        Bag(change_info=changed(width=0, height=0, k=np.zeros(9), p=np.zeros(12), d=np.zeros(0))),
        "not calibrated, the size is 0x0, K and P are all zero",
        "calibrate both cameras together, and load the calibration in the driver",
    ),
    "no camera infos": (Bag(info=""), "belongs to /left/image_raw", "record the camera infos too"),
    "both images in one topic": (
        Bag(joint="/stereo/image_raw"),
        "/stereo/image_raw looks like both images side by side, 640x240 where the camera infos are for 320x240",
        "read both from it (--side-by-side)",
    ),
    "the baseline in both camera infos": (
        Bag(change_info=same_p),
        "both camera infos carry the baseline",
        "set P[0,3] of the left camera to 0, it belongs to the right camera only",
    ),
    "stamps of 0": (
        Bag(stamp=False),
        "0, which means not set",
        "let the driver stamp its images with the time of exposure",
    ),
    "right images 17 ms later": (
        Bag(right_late_ns=17_000_000),
        "17.000 ms apart",
        "set approximate_sync and an approximate_sync_tolerance_seconds above 0.017000",
    ),
}


def write(path: Path, *parts: Bag) -> Path:
    with BagWriter(path) as bag:
        for part in parts:
            part.write(bag)
    return path


@pytest.fixture
def say(command_line: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Exit code and all output by command; `replay` up to the start of its nodes."""

    def started(*arguments: object, **_: object) -> None:
        raise SystemExit(0)

    monkeypatch.setattr("stereo_depth_ros.nodes.live_replay.GraphProcesses", started)
    monkeypatch.setattr("stereo_depth_ros.nodes.live_replay.prepare_process", lambda: None)

    def run(path: Path, *options: str, commands: tuple[str, ...] = COMMANDS) -> dict[str, Any]:
        found = {}
        for command in commands:
            output = ("-o", tmp_path / f"{command}.mcap", *OPTIONS) if command in ("process", "replay") else ()
            code, out, err = command_line(command, columns=1000)(path, *output, *options)
            found[command] = code, " ".join((out + err).split())
        return found

    return run


@pytest.mark.parametrize("kind", USED)
def test_all_commands_use_it(kind: str, tmp_path: Path, say: Callable[..., dict[str, Any]]) -> None:
    for command, (code, text) in say(write(tmp_path / "in.mcap", *USED[kind])).items():
        assert code == 0, (command, text)
        if command == "process":
            assert float(text.partition("valid pixels ")[2].split()[0]) > 80, text
            assert "warning" not in text or " are used, since " in text


@pytest.mark.parametrize("kind", ["messages compressed, .mcap", "mcap of ros1", "foxglove, protobuf"])
def test_all_commands_use_files_of_this_kind(kind: str, tmp_path: Path, say: Callable[..., dict[str, Any]]) -> None:
    (tmp_path / "kind").mkdir()
    path = write_kind(kind, write(tmp_path / "in.mcap", Bag()), tmp_path / "kind")
    for command, (code, text) in say(path).items():
        assert code == 0, (command, text)


def test_all_commands_use_both_images_of_one_topic(tmp_path: Path, say: Callable[..., dict[str, Any]]) -> None:
    path = write(tmp_path / "in.mcap", Bag(joint="/stereo/image_raw"))
    for command, (code, text) in say(path, "--side-by-side").items():
        assert code == 0, (command, text)


def test_all_commands_use_images_side_by_side_with_calibration_files(
    tmp_path: Path, say: Callable[..., dict[str, Any]]
) -> None:
    path, files = write(tmp_path / "in.mcap", Bag(joint="/stereo/image_raw", info="")), []
    for side, camera in (("left", MADE.rig.left), ("right", MADE.rig.right)):
        files.append(str(tmp_path / f"{side}.yaml"))
        write_camera(tmp_path / f"{side}.yaml", camera, side)
    for command, (code, text) in say(path, "--side-by-side", "--camera-info", *files).items():
        assert code == 0, (command, text)


@pytest.mark.parametrize("kind", REFUSED)
def test_all_commands_refuse_it_with_cause_and_remedy(
    kind: str, tmp_path: Path, say: Callable[..., dict[str, Any]]
) -> None:
    bag, cause, remedy = REFUSED[kind]
    said = say(write(tmp_path / "in.mcap", bag))
    for command, (code, text) in said.items():
        assert code in (1, 3) and cause in text and remedy in text, (command, code, text)
    assert said["process"] == said["replay"]
