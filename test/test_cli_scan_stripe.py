# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth scan --kind stripe` and `calibrate-turntable`: outputs, wrong input, a real scan."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import stereo_bags
from command_line import CommandLine, Run
from stripe_scans import STEPS_M, exact_plane, scan_images, scanner, write_scan

from stereo_depth_ros.active.light_stripe.motion import StripeMotion
from stereo_depth_ros.active.light_stripe.plane_file import write_plane
from stereo_depth_ros.active.light_stripe.scanner import StripeScanner
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.safe_yaml import load_yaml
from stereo_depth_ros.core.types import F64, Frame
from stereo_depth_ros.messages.image import image_message

AXIS = ("--linear-axis", "1 0 0")


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("scan", columns=110)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_scan(tmp_path / "scan")


def messages_of(path: Path, topic: str) -> list[Any]:
    """The clouds of a topic."""
    found = stereo_bags.messages_of(path, topic).values()
    return [RosbagsTypes().deserialize(data, "sensor_msgs/msg/PointCloud2") for data in found]


def cloud(message: Any) -> F64:
    """x, y, z, intensity, sigma, (N, 5)."""
    assert [field.name for field in message.fields] == ["x", "y", "z", "intensity", "sigma"]
    return np.frombuffer(message.data, "<f4").reshape(-1, 5).astype(float)


def expected() -> list[tuple[F64, F64]]:
    """Points of each profile in the camera and in the merged frame."""
    motion = StripeMotion("linear", "object", np.array([1.0, 0.0, 0.0]))
    stripes = StripeScanner(exact_plane(), scanner().rig.left, LightStripeConfig(), motion)
    found = []
    for number, (left, _) in enumerate(scan_images()):
        profile = stripes.scan(Frame(left, 0, "", "rgb8"), np.array([STEPS_M[number]]))
        found.append((profile.found.points_m, profile.merged_m))
    return found


def test_a_folder_with_a_table(run: Run, folder: Path) -> None:
    output, ply, image = folder / "o.mcap", folder / "o.ply", folder / "o.png"
    more = ("--export", ply, "--preview", image, "--json", folder / "r.json")
    code, out, err = run(
        folder / "images", "-o", output, "--kind", "stripe", "--laser", folder / "laser.yaml", *AXIS,
        "--motion", folder / "motion.csv", *more,
    )  # fmt: skip
    assert code == 0, err
    profiles, merged = messages_of(output, "/stripe/points2"), messages_of(output, "/stripe/merged")
    assert (len(profiles), len(merged)) == (3, 1)
    for message, (points, _) in zip(profiles, expected(), strict=True):
        np.testing.assert_allclose(cloud(message)[:, :3], points, atol=1e-6)
    together = np.concatenate([points for _, points in expected()])
    np.testing.assert_allclose(cloud(merged[0])[:, :3], together, atol=1e-6)
    vertices = np.frombuffer(ply.read_bytes().partition(b"end_header\n")[2], "<f4").reshape(-1, 5)
    np.testing.assert_array_equal(vertices, cloud(merged[0]).astype("<f4"))
    assert cv2.imread(str(image)).shape[1] > 900
    values = json.loads((folder / "r.json").read_text())
    assert (values["images"], values["points"], values["reasons"]["POINTS"]) == (3, len(together), len(together))
    assert f"{len(together)} of 360 lines" in out
    code, _, err = run(
        folder / "images", "-o", folder / "step.mcap", "--kind", "stripe", "--laser", folder / "laser.yaml", *AXIS,
        "--step", "10",
    )  # fmt: skip
    assert code == 0, err
    np.testing.assert_array_equal(cloud(messages_of(folder / "step.mcap", "/stripe/merged")[0]), cloud(merged[0]))


def write_bag(path: Path) -> Path:
    """Images at 1, 2 and 3 s, and a joint that passes 0, 10 and 20 mm then; it ends before the last image."""
    types = RosbagsTypes()
    joint_state = types.typestore.types["sensor_msgs/msg/JointState"]
    with BagWriter(path) as bag:
        for number, (left, _) in enumerate(scan_images()):
            stamp_ns = (number + 1) * 10**9
            bag.write("/camera/image_raw", image_message(types, left, "rgb8", stamp_ns, "camera"), stamp_ns)
        for stamp_ns, position in ((5 * 10**8, -0.005), (25 * 10**8, 0.015)):
            header = types.Header(stamp=types.Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9), frame_id="")
            names, none = ["other", "stage"], np.empty(0)
            state = joint_state(header, names, np.array([9.0, position]), none, none)
            bag.write("/joint_states", state, stamp_ns)
    return path


def test_a_bag_with_a_joint(run: Run, folder: Path) -> None:
    bag, laser = write_bag(folder / "in.mcap"), ("--laser", folder / "laser.yaml")
    code, _, err = run(
        bag, "-o", folder / "o.mcap", "--kind", "stripe", *laser, *AXIS, "--motion-topic", "/joint_states",
        "--joint", "stage",
    )  # fmt: skip
    assert code == 0, err
    assert "1 images were left out, the motion is not known at their time" in err
    merged = messages_of(folder / "o.mcap", "/stripe/merged")[0]
    np.testing.assert_allclose(
        cloud(merged)[:, :3], np.concatenate([points for _, points in expected()[:2]]), atol=1e-6
    )
    assert (merged.header.frame_id, merged.header.stamp.sec) == ("camera", 2)
    for more, text in (
        (("--motion-topic", "/joint_states", "--joint", "arm"), "/joint_states holds no joint 'arm'"),
        (
            ("--motion-topic", "/camera/image_raw"),
            "/camera/image_raw is not a topic of motions; the bag has /joint_states",
        ),
        (("--left", "/joint_states", "--step", "1"), "/joint_states is not a topic of images"),
    ):
        code, _, err = run(bag, "-o", folder / "b.mcap", "--kind", "stripe", *laser, *AXIS, *more)
        assert (code, text in err, err.count("\n")) == (1, True, 1), err
        assert not (folder / "b.mcap").exists()


def test_two_cameras(run: Run, folder: Path) -> None:
    for number, pair in enumerate(scan_images()):
        for side, image in zip(("left", "right"), pair, strict=True):
            (folder / "pairs").mkdir(exist_ok=True)
            cv2.imwrite(str(folder / "pairs" / f"{side}{number}.png"), image[..., ::-1])
    rig = scanner().rig
    write_camera(folder / "left.yaml", rig.left, "left")
    write_camera(folder / "right.yaml", rig.right, "right")
    cameras = ("--camera-info", folder / "left.yaml", folder / "right.yaml")
    code, _, err = run(
        folder / "pairs", "-o", folder / "o.mcap", "--kind", "stripe", *cameras, "--laser", folder / "laser.yaml",
        "--step", "10", *AXIS,
    )  # fmt: skip
    assert code == 0, err
    points = cloud(messages_of(folder / "o.mcap", "/stripe/merged")[0])[:, :3]
    assert len(points) > 200
    code, _, err = run(folder / "pairs", "-o", folder / "s.mcap", "--kind", "stripe", *cameras)
    assert code == 0, err
    (first, *_) = messages_of(folder / "s.mcap", "/stripe/points2")
    with BagWriter(folder / "in.mcap") as bag:
        for number, pair in enumerate(scan_images()):
            for side, image, camera in zip(("left", "right"), pair, (rig.left, rig.right), strict=True):
                stamp_ns = number * 10**8
                message = image_message(RosbagsTypes(), image, "rgb8", stamp_ns, camera.frame_id)
                bag.write(f"/{side}/image_raw", message, stamp_ns)
    code, _, err = run(folder / "in.mcap", "-o", folder / "b.mcap", "--kind", "stripe", *cameras)
    assert code == 0, err
    same = messages_of(folder / "b.mcap", "/stripe/points2")
    assert len(same) == 3
    np.testing.assert_array_equal(cloud(same[0]), cloud(first))
    assert np.median(cloud(first)[:, 2]) == pytest.approx(np.median(points[:, 2]), abs=0.03)


def test_wrong_input_is_one_line(run: Run, folder: Path) -> None:
    start = (folder / "images", "-o", folder / "o.mcap", "--kind", "stripe")
    laser = ("--laser", folder / "laser.yaml")
    write_plane(folder / "small.yaml", exact_plane(), replace(scanner().rig.left, width=64, height=48))
    (folder / "poses.csv").write_text("image,x,y,z,qx,qy,qz,qw\nother.png,0,0,0,0,0,0,1\n")
    for more, text in (
        ((), "neither --laser nor --camera-info is given"),
        (("--laser", folder / "no.yaml"), "no.yaml"),
        ((*laser, "--step", "1"), "--step needs an axis"),
        ((*laser, *AXIS), "the axis of a motion is given, but not the motion"),
        (
            (*laser, *AXIS, "--step", "1", "--motion", folder / "motion.csv"),
            "contradict each other",
        ),
        ((*laser, "--linear-axis", "up", "--step", "1"), "linear_axis = 'up' is not a direction"),
        ((*laser, "--motion", folder / "motion.csv"), "the motion is a position, and its axis is not given"),
        ((*laser, "--motion", folder / "poses.csv"), "the motion is not known for any of 3 images"),
        ((*laser, "--motion-topic", "/j"), "--motion-topic has no effect with a folder"),
        ((*laser, "--moving", "head"), "moving 'head' is not one of object, sensor, plane"),
        ((*laser, "--settle", "2"), "--settle has no effect with --kind stripe"),
        ((*laser, "--param", "stripe_contrast:=250"), "none of 3 images gives a point (no stripe 360)"),
        (
            ("--laser", folder / "small.yaml"),
            "the light plane was calibrated with images of 64x48",
        ),
        ((*laser, "--ambient", folder / "no.png"), "no.png"),
        ((*laser, "--preview", folder / "o.jpg"), "does not end in .png"),
    ):
        code, _, err = run(*start, *more)
        assert code in (1, 2), text
        assert text in err, err
        assert err.count("\n") == 1, err
    assert not (folder / "o.mcap").exists()
    code, _, err = run(folder / "images", "-o", folder / "o.mcap", *laser)
    assert (code, "--laser has no effect with --kind patterns" in err) == (2, True)


@pytest.mark.real_data
def test_a_real_scan_on_a_turntable_closes(command_line: CommandLine, stereo_data: Path, tmp_path: Path) -> None:
    """Light plane, axis and scan by the commands: the table is flat and level with its markers, the object a solid."""
    data = stereo_data / "active" / "c_laser_turntable_srv"
    laser, axis = tmp_path / "laser.yaml", tmp_path / "turntable.yaml"
    board = ("--size", "8x6", "--square", "0.04", "--param", "stripe_channel:=green_excess")
    camera = ("--camera", data / "calibration4.yaml")
    code, _, err = command_line("calibrate-laser")(data / "laser_boards", *board, *camera, "-o", laser)
    assert code == 0, err
    tables = [data / "table" / f"step_num_table{number}.jpg" for number in (1, 81, 161, 241)]
    code, _, err = command_line("calibrate-turntable")(
        *tables, "--laser", laser, "--marker", "0.03", "--step", "90", "-o", axis
    )
    assert code == 0, err
    code, _, err = command_line("scan")(
        data / "scan", "-o", tmp_path / "o.mcap", "--kind", "stripe", "--laser", laser, "--turntable", axis,
        "--step", "18", "--param", "stripe_max_depth:=0.5", "--param", "max_axis_distance:=0.11",
        "--json", tmp_path / "r.json",
    )  # fmt: skip
    assert code == 0, err
    assert json.loads((tmp_path / "r.json").read_text())["profiles"] == 19
    points = cloud(messages_of(tmp_path / "o.mcap", "/stripe/merged")[0])[:, :3]
    values = load_yaml(axis.read_text())["turntable"]
    point, up = np.array(values["point_m"]), np.array(values["axis"])
    height = (points - point) @ up
    across = points - point - height[:, None] * up
    right = np.cross(up, [0.0, 0.0, 1.0])
    angle = np.arctan2(across @ np.cross(up, right), across @ right)
    radius = np.linalg.norm(across, axis=1)
    table = (radius > 0.07) & (np.abs(height) < 0.01)
    assert float(np.median(np.abs(height[table]))) < 0.005
    for sector in np.linspace(-2.8, 2.8, 7):  # level all around
        near = table & (np.abs(np.angle(np.exp(1j * (angle - sector)))) < 0.45)
        assert abs(float(np.median(height[near]) - np.median(height[table]))) < 0.0015
    block = (height > 0.01) & (height < 0.035) & (radius < 0.07)
    sectors = np.unique(np.floor((angle[block] + np.pi) / (2 * np.pi) * 12))
    assert len(sectors) == 12  # sides all around
    assert 0.02 < float(np.percentile(radius[block], 20)) < float(np.percentile(radius[block], 99)) < 0.062
