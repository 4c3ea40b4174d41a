# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The light stripe node in a live graph: profiles and the merged cloud, byte for byte those of the command."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graph_harness import NS_PER_S, Graph
from stereo_bags import messages_of
from stripe_scans import STEPS_M, scan_images, scanner, write_scan

from stereo_depth_ros.active.light_stripe.motion import StripeMotion
from stereo_depth_ros.active.light_stripe.plane_file import read_plane
from stereo_depth_ros.active.light_stripe.scanner import StripeScanner
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.types import F64, Frame
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.nodes.light_stripe_node import LightStripeNode
from stereo_depth_ros.nodes.message_types import RclpyTypes
from stereo_depth_ros.offline.stripe_scan import scan_stripes

geometry_msgs = pytest.importorskip("geometry_msgs.msg", reason="graph tests need ROS 2")
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from sensor_msgs.msg import JointState, PointCloud2  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

pytestmark = pytest.mark.graph

PROFILES, MERGED = "stripe/points2", "stripe/merged"
LINEAR = {"stripe_motion": "linear", "linear_axis": "1 0 0", "motion_joint": "stage"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scan(tmp_path_factory.mktemp("stripe") / "scan")


@functools.cache
def types() -> RclpyTypes:
    return RclpyTypes()


def info(stamp_ns: int = NS_PER_S) -> Any:
    return camera_info_message(types(), scanner().rig.left, stamp_ns)


def image(number: int) -> Any:
    """Left image at 1, 2 or 3 s."""
    return image_message(types(), scan_images()[number][0], "rgb8", (number + 1) * NS_PER_S, "laser_camera")


def joint(seconds: float, position: float) -> JointState:
    state = JointState(name=["wheel", "stage"], position=[7.0, position])
    state.header.stamp = types().Time(sec=int(seconds), nanosec=round(1e9 * (seconds % 1)))
    return state


def xyz(message: Any) -> F64:
    return np.frombuffer(message.data, "<f4").reshape(-1, 5)[:, :3].astype(float)


def merge(graph: Graph) -> tuple[bool, str]:
    response = graph.call(Trigger, "/light_stripe_node/merge", Trigger.Request())
    return response.success, response.message


def test_profiles_wait_for_the_motion_and_equal_those_of_the_command(folder: Path, tmp_path: Path) -> None:
    with Graph(LightStripeNode, parameters={"laser_file": str(folder / "laser.yaml"), **LINEAR}) as graph:
        profiles = graph.listen(PROFILES, PointCloud2)
        graph.send({"camera_info": info(), "joint_states": joint(0.5, -0.005)})
        graph.send({"image_raw": image(0)})
        graph.spin(0.3)
        assert not profiles  # the motion at 1 s is not known yet
        graph.send({"joint_states": joint(2.5, 0.015)})
        graph.wait(lambda: len(profiles) == 1, "profile after the motion")
        graph.send({"image_raw": image(1)})
        graph.wait(lambda: len(profiles) == 2, "second profile")
        success, text = merge(graph)
        assert success, text
        late = graph._node.create_subscription(  # latched
            PointCloud2, MERGED, (merged := []).append, QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        )
        graph.wait(lambda: merged, "latched merged cloud")
        graph._node.destroy_subscription(late)
        assert f"{merged[0].width} points of 2 profiles published on /{MERGED}" == text
        lines = graph.counter("lines POINTS")
        assert lines == merged[0].width == sum(profile.width for profile in profiles)
        assert graph.counter("lines NO_STRIPE") > 0
        assert graph.counter("profiles") == 2
        assert any(item.key == "scan p50 ms" for item in graph.status().values)
        forgotten = graph.call(Trigger, "/light_stripe_node/restart", Trigger.Request())
        assert forgotten.message == "2 profiles forgotten"
        assert merge(graph) == (False, "no profile has been scanned: publish images first")
    plane, camera = read_plane(folder / "laser.yaml")
    motion = StripeMotion("linear", "object", np.array([1.0, 0.0, 0.0]))
    frames = [Frame(scan_images()[n][0], (n + 1) * NS_PER_S, "laser_camera", "rgb8") for n in range(2)]
    captures = [(str(n), functools.partial(lambda frame: frame, frame)) for n, frame in enumerate(frames)]
    scan_stripes(
        captures,
        StripeScanner(plane, camera, LightStripeConfig(), motion),
        lambda name, stamp_ns, number: np.array([-0.005 + 0.01 * (stamp_ns / 1e9 - 0.5)]),
        tmp_path / "o.mcap",
    )
    offline = [*messages_of(tmp_path / "o.mcap", f"/{PROFILES}").values()]
    whole = messages_of(tmp_path / "o.mcap", f"/{MERGED}").values()
    read = functools.partial(deserialize_message, message_type=PointCloud2)
    assert [*profiles, *merged] == [*map(read, offline), *map(read, whole)]
    shift = np.median(xyz(merged[0])[profiles[0].width :] - xyz(profiles[1]), axis=0)
    np.testing.assert_allclose(shift, [-STEPS_M[1], 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("motion", "topics"), [("none", set()), ("linear", {"joint_states"}), ("pose", {"motion/pose"})]
)
def test_topics_and_services_are_those_of_the_interface(folder: Path, motion: str, topics: set[str]) -> None:
    parameters = {"laser_file": str(folder / "laser.yaml"), "stripe_motion": motion}
    with Graph(LightStripeNode, parameters=parameters) as graph:
        (node,) = graph.nodes
        subscribed = {f"/{topic}" for topic in {"image_raw", "camera_info"} | topics}
        found = {end.topic_name: end.msg_type.__name__ for end in node.subscriptions}
        assert {f"/{topic}": kind.rpartition("/")[2] for topic, kind in node.interface.inputs.items()}.items() >= {
            name: kind for name, kind in found.items() if name in subscribed
        }.items()
        assert subscribed <= found.keys()
        assert len([name for name in found if name in ("/joint_states", "/motion/pose")]) == len(topics)
        assert {"/stripe/points2", "/stripe/merged"} <= {end.topic_name for end in node.publishers}


def test_poses_and_a_still_scene(folder: Path) -> None:
    with Graph(
        LightStripeNode,
        parameters={"laser_file": str(folder / "laser.yaml"), "stripe_motion": "pose", "moving": "sensor"},
    ) as graph:
        profiles = graph.listen(PROFILES, PointCloud2)
        pose = geometry_msgs.PoseStamped()
        pose.header.stamp.sec, pose.header.frame_id = 1, "base"
        pose.pose.position.z = 2.0
        pose.pose.orientation.x, pose.pose.orientation.w = 1.0, 0.0  # half a turn about x
        graph.send({"camera_info": info(), "motion/pose": pose, "image_raw": image(0)})
        graph.wait(lambda: profiles, "profile")
        merged = graph.listen(MERGED, PointCloud2)
        assert merge(graph)[0]
        graph.wait(lambda: merged, "merged cloud")
        assert (merged[0].header.frame_id, profiles[0].header.frame_id) == ("base", "laser_camera")
        np.testing.assert_allclose(xyz(merged[0]), xyz(profiles[0]) * [1, -1, -1] + [0, 0, 2], atol=1e-6)
    with Graph(LightStripeNode, parameters={"laser_file": str(folder / "laser.yaml")}) as graph:
        profiles = graph.listen(PROFILES, PointCloud2)
        graph.send({"image_raw": image(1), "camera_info": info()})
        graph.wait(lambda: profiles, "profile without a motion")
        assert graph.set_parameter("stripe_contrast", 250.0, "light_stripe_node").successful
        graph.send({"image_raw": image(2)})
        graph.wait(lambda: len(profiles) == 2, "profile without points")
        assert (profiles[0].width > 50, profiles[1].width) == (True, 0)


def test_bad_messages_are_reported_and_survived(folder: Path) -> None:
    with Graph(LightStripeNode, parameters={"laser_file": str(folder / "laser.yaml"), **LINEAR}) as graph:
        profiles = graph.listen(PROFILES, PointCloud2)
        other = camera_info_message(types(), scanner().rig.right, NS_PER_S)
        graph.send({"camera_info": other})
        graph.wait_error("/camera_info: the camera is 160x120.*, the light plane was calibrated with 160x120")
        graph.send({"camera_info": info(), "joint_states": joint(1.0, float("nan"))})
        graph.wait_error("/joint_states: holds .nan., which is not finite")
        graph.send({"joint_states": JointState(name=["arm"], position=[1.0])})
        small = image_message(types(), np.zeros((12, 16), np.uint8), "mono8", NS_PER_S, "camera")
        graph.send({"joint_states": joint(1.5, 0.0)})
        graph.send({"image_raw": small, "joint_states": joint(3.5, 0.0)})
        graph.wait(lambda: graph.counter("images before the first motion") == 1, "image before the motion")
        small.header.stamp.sec = 2
        graph.send({"image_raw": small})
        graph.wait_error("the image is 16x12, the light plane was calibrated with images of 160x120")
        graph.send({"image_raw": image(1)})
        graph.wait(lambda: profiles, "profile after bad messages")
        assert graph.counter("joint states without the joint") == 1


def test_images_are_dropped_while_no_motion_comes(folder: Path) -> None:
    parameters = {"laser_file": str(folder / "laser.yaml"), "queue_size": 1, **LINEAR}
    with Graph(LightStripeNode, parameters=parameters) as graph:
        name, node = "images dropped while their motion or camera info was awaited", graph.nodes[0]
        for number in range(3):
            graph.send({"image_raw": image(number)})
            graph.wait(lambda: len(node._waiting) + node.diagnostics.counters[name] > number, "image")  # noqa: B023
        assert graph.counter(name) == 2


@pytest.mark.parametrize(
    ("parameters", "error", "text"),
    [
        ({}, ConfigError, "laser_file is empty"),
        ({"laser_file": "/absent.yaml"}, CalibrationError, r"/absent\.yaml"),
        ({"laser_file": "", "stripe_motion": "round"}, ConfigError, "stripe_motion = 'round' is not one of"),
        ({"laser_file": "FILE", "stripe_motion": "turntable"}, ConfigError, "turntable_file is empty"),
        ({"laser_file": "FILE", "stripe_motion": "linear", "linear_axis": "up"}, ConfigError, "is not a direction"),
    ],
)
def test_a_node_that_cannot_scan_does_not_start(
    folder: Path, parameters: dict[str, Any], error: type[Exception], text: str
) -> None:
    given = {key: str(folder / "laser.yaml") if value == "FILE" else value for key, value in parameters.items()}
    with pytest.raises(error, match=text):
        Graph(LightStripeNode, parameters={key: value for key, value in given.items() if value != ""})
