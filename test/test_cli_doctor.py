# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth doctor` on bags: output, JSON, exit codes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import CommandLine, Run
from stereo_bags import cut

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.image import compressed_message, image_message
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.stages.rectification import Rectifier

SAMPLE = Path(__file__).resolve().parents[1] / "bags" / "synthetic_room.mcap"
TYPES = RosbagsTypes()


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("doctor", columns=250)


def variant(path: Path, change: Callable[[str, Any], tuple[str, Any] | None], frames: int = 2) -> Path:
    """The first frames of the sample bag; each topic and message changed, or dropped where None is returned."""
    with BagReader(SAMPLE) as reader, BagWriter(path, compression="lz4", chunk_size=100_000) as writer:
        end_ns = reader.start_ns + round((frames - 0.5) * 1e8)
        for message in reader.messages(end_ns=end_ns):
            changed = change(message.topic, reader.deserialize(message))
            if changed is not None and message.topic != "/truth/disparity":
                writer.write(*changed, message.log_time_ns)
    return path


def findings(run: Run, *arguments: object) -> tuple[int, dict[str, dict[str, Any]]]:
    code, out, _ = run(*arguments, "--json", "-")
    return code, {finding["check"]: finding for finding in json.loads(out)["findings"]}


def test_the_sample_bag_is_healthy_in_table_and_json(run: Run, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    code, out, err = run(SAMPLE, "--json", report)
    assert (code, err) == (0, "")
    values = json.loads(report.read_text())
    assert (values["level"], values["healthy"], values["pairs_examined"]) == ("ok", True, 6)
    assert values["topics"]["right"] == {"image": "/right/image_raw", "camera_info": "/right/camera_info"}
    assert {finding["level"] for finding in values["findings"]} == {"ok"}
    rows = next(finding for finding in values["findings"] if finding["check"] == "rows")
    assert rows["value"] in out and rows["limit"] in out
    assert "what to do" not in out
    assert out.splitlines()[0].split(maxsplit=1) == ["verdict", values["verdict"]]
    assert "search    --param min_disparity:=0 --param disparity_range:=48" in out


def test_a_fault_has_its_remedy_in_the_table_and_exit_code_1(run: Run, tmp_path: Path) -> None:
    def millimeters(topic: str, message: Any) -> tuple[str, Any]:
        if topic == "/right/camera_info":
            message = replace(message, p=np.where(np.arange(12) == 3, 1000 * message.p, message.p))
        return topic, message

    code, out, err = run(variant(tmp_path / "mm.mcap", millimeters))
    assert (code, err) == (1, "")
    assert "error" in out and "120.054 m is outside" in out
    assert "what to do" in out
    assert "written in millimeters: multiply P[0,3] of the right camera by 0.001" in out
    assert "not usable; baseline" in out.splitlines()[0]
    assert out.index("verdict") < out.index("what to do") < out.index("120.054 m is outside")


def test_warnings_are_exit_code_0(run: Run, tmp_path: Path) -> None:
    def wide(topic: str, message: Any) -> tuple[str, Any]:
        if topic == "/right/camera_info":
            message = replace(message, p=np.where(np.arange(12) == 3, 20 * message.p, message.p))
        return topic, message

    code, out, _ = run(variant(tmp_path / "wide.mcap", wide, frames=1))
    assert code == 0
    assert "warning" in out and "usable, could be better; baseline" in out


def test_skipped_checks_are_exit_code_3(run: Run, tmp_path: Path) -> None:
    """Images of a ramp: neither black nor empty, but without features."""

    def smooth(topic: str, message: Any) -> tuple[str, Any]:
        if topic.endswith("image_raw"):
            ramp = np.add.outer(np.arange(480), np.arange(640)) // (8 if topic.startswith("/left") else 7)
            message = replace(message, data=ramp.astype(np.uint8).ravel())
        return topic, message

    code, found = findings(run, variant(tmp_path / "smooth.mcap", smooth, frames=1))
    assert code == 3
    assert found["rows"]["level"] == "skipped"
    assert "something with texture" in found["rows"]["remedy"]


def test_swapped_image_topics(run: Run, tmp_path: Path) -> None:
    other = {"/left/image_raw": "/right/image_raw", "/right/image_raw": "/left/image_raw"}
    bag = variant(tmp_path / "swapped.mcap", lambda topic, message: (other.get(topic, topic), message), frames=1)
    code, found = findings(run, bag)
    assert code == 1
    assert found["order of the cameras"]["remedy"] == "exchange the image topics of left and right"


def test_a_bag_without_camera_infos(run: Run, tmp_path: Path) -> None:
    images_only = variant(
        tmp_path / "bare.mcap", lambda topic, message: (topic, message) if "image" in topic else None, frames=1
    )
    code, found = findings(run, images_only)
    assert code == 1
    assert found["left camera info"]["value"] == "none belongs to /left/image_raw"
    assert found["rows before rectification"]["figures"]["median_px"] > 2
    assert found["rows"]["level"] == "skipped"


def test_rectified_images(run: Run, tmp_path: Path) -> None:
    infos: dict[str, Any] = {}
    with BagReader(SAMPLE) as reader:
        for message in reader.messages(["/left/camera_info", "/right/camera_info"]):
            infos[message.topic] = reader.deserialize(message)
    cameras = [camera_from_info(info) for info in infos.values()]
    rectifier = Rectifier(StereoRig(*cameras))

    def rectified(topic: str, message: Any) -> tuple[str, Any]:
        if not topic.endswith("image_raw"):
            return topic, message
        rectify = rectifier.rectify_left if topic.startswith("/left") else rectifier.rectify_right
        pixels = rectify(message.data.reshape(480, 640))
        header = message.header
        return topic.replace("image_raw", "image_rect"), image_message(
            TYPES, pixels, "mono8", stamp_ns(header), header.frame_id
        )

    code, found = findings(run, variant(tmp_path / "rect.mcap", rectified, frames=1))
    assert code == 0
    assert found["rows"]["figures"]["median_px"] < 0.1
    assert "rows before rectification" not in found


def test_compressed_images_whose_right_camera_is_late(run: Run, tmp_path: Path) -> None:
    def compressed(topic: str, message: Any) -> tuple[str, Any]:
        if not topic.endswith("image_raw"):
            return topic, message
        late_ns = 4_000_000 if topic.startswith("/right") else 0
        pixels, header = message.data.reshape(480, 640), message.header
        packed = compressed_message(TYPES, pixels, "mono8", "jpeg", stamp_ns(header) + late_ns, header.frame_id)
        return f"{topic}/compressed", packed

    code, found = findings(run, variant(tmp_path / "late.mcap", compressed, frames=2))
    assert code == 1
    assert found["pairs"]["settings"] == {"approximate_sync": True, "approximate_sync_tolerance_seconds": 0.005}
    out = run(tmp_path / "late.mcap")[1]
    assert "(--param approximate_sync:=true --param approximate_sync_tolerance_seconds:=0.005)" in out
    assert found["rows"]["level"] == "ok"


def test_images_that_cannot_be_decoded(run: Run, tmp_path: Path) -> None:
    def odd(topic: str, message: Any) -> tuple[str, Any]:
        return topic, replace(message, encoding="magic") if topic == "/left/image_raw" else message

    code, found = findings(run, variant(tmp_path / "odd.mcap", odd, frames=2))
    assert code == 1
    assert "encoding = 'magic' is not supported" in found["images of /left/image_raw"]["value"]
    assert found["images"]["level"] == "skipped"


def test_a_bag_that_is_cut_is_examined_up_to_there(run: Run, tmp_path: Path) -> None:
    whole = variant(tmp_path / "whole.mcap", lambda topic, message: (topic, message), frames=3)
    code, found = findings(run, cut(whole, tmp_path / "cut.mcap", 0.8))
    assert code == 0
    assert found["bag"]["level"] == "warning"
    assert "is cut in the middle" in found["bag"]["value"]


def test_nothing_to_examine_is_one_line(run: Run, tmp_path: Path) -> None:
    code, out, err = run(tmp_path / "none.mcap")
    assert (code, out) == (1, "") and "none.mcap: does not exist" in err and err.count("\n") == 1
    lonely = variant(
        tmp_path / "lonely.mcap", lambda topic, message: (topic, message) if topic == "/left/image_raw" else None
    )
    code, out, err = run(lonely)
    assert (code, out) == (1, "") and "no stereo pair among the image topics" in err and err.count("\n") == 1


def test_wrong_usage_is_exit_code_2(run: Run) -> None:
    assert run()[0] == 2
    code, _, err = run(SAMPLE, "--live")
    assert code == 2 and "give a BAG, or --live" in err
    assert run("--live", "--seconds", "0")[0] == 2


def test_help_has_examples_and_exit_codes(run: Run) -> None:
    code, out, _ = run("--help")
    assert code == 0
    assert "stereo-depth doctor drive.mcap" in out and "Exit codes" in out
