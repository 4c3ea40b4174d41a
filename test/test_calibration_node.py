# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The calibration node in a live graph: from images of a board to files and to the drivers of the cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from graph_harness import NS_PER_S, Graph
from rendered_boards import FISHEYE, SIZE, SQUARE_M, chessboard_photographs
from sensor_msgs.msg import Image
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.nodes import calibration_node
from stereo_depth_ros.nodes.calibration_node import CalibrationNode
from stereo_depth_ros.nodes.message_types import RclpyTypes

pytestmark = pytest.mark.graph

PARAMETERS = {
    **{"board_size": "7x5", "board_square": SQUARE_M, "lens_model": "equidistant", "max_board_motion": 0.0},
}


@pytest.fixture(scope="module")
def photographs() -> list[tuple[U8, U8]]:
    return list(chessboard_photographs())


def messages(pair: tuple[U8, U8], number: int) -> dict[str, Any]:
    types, stamp_ns = RclpyTypes(), number * NS_PER_S // 10
    return {
        f"{side}/image_raw": image_message(types, pixels, "mono8", stamp_ns, side)
        for side, pixels in zip(("left", "right"), pair, strict=True)
    }


def facts(graph: Graph) -> dict[str, str]:
    return {item.key: item.value for item in graph.status().values}


def show(graph: Graph, pairs: list[tuple[U8, U8]]) -> None:
    """Sends each pair once the one before was examined."""
    for pair in pairs:
        wait_until_examined(graph, pair, examined(graph) + 1)


def wait_until_examined(graph: Graph, pair: tuple[U8, U8], count: int) -> None:
    graph.send(messages(pair, count))
    graph.wait(lambda: examined(graph) == count, f"pair number {count}")


def examined(graph: Graph) -> int:
    """Pairs examined so far."""
    return len(graph.nodes[0].diagnostics._timings_ms.get("detect the board", ()))


def trigger(graph: Graph, name: str) -> tuple[bool, str]:
    answer = graph.call(Trigger, f"/calibration_node/{name}", Trigger.Request())
    return answer.success, answer.message


def test_from_images_to_files_and_drivers(photographs: list[tuple[U8, U8]], tmp_path: Path) -> None:
    with Graph(CalibrationNode, parameters={**PARAMETERS, "calibration_folder": str(tmp_path / "out")}) as graph:
        images = graph.listen("calibration/image", Image)
        show(graph, photographs[:3])
        reported = facts(graph)
        assert reported["views"] == "3"
        assert "show 17 more views of 20" in reported["missing"]
        assert float(reported["coverage size"]) > 0
        assert trigger(graph, "save") == (False, "there is no calibration yet: call ~/calibrate first")
        success, text = trigger(graph, "calibrate")
        assert not success
        assert "3 views so far, at least 5 are needed" in text
        show(graph, [photographs[0]] * 3 + photographs[3:])
        graph.wait(lambda: images, "image of the views")
        assert (images[-1].encoding, images[-1].width) == ("bgr8", SIZE[0])
        success, text = trigger(graph, "calibrate")
        assert success, text
        assert "baseline 11" in text and "to improve" in text
        success, text = trigger(graph, "save")
        assert success and str(tmp_path / "out") in text
        rig = StereoRig.from_yaml(tmp_path / "out" / "left.yaml", tmp_path / "out" / "right.yaml")
        assert rig.baseline_m == pytest.approx(np.linalg.norm(FISHEYE.rig[3:]), abs=1e-3)
        assert cv2.imread(str(tmp_path / "out" / "coverage.png")) is not None
        refused = graph.set_parameter("calibration_folder", str(tmp_path / "elsewhere"), "calibration_node")
        assert not refused.successful and "read-only" in refused.reason.lower()
        assert not graph.set_parameter("overwrite", True, "calibration_node").successful
        saved = (tmp_path / "out" / "left.yaml").stat()
        success, text = trigger(graph, "save")
        assert success and f"written to {tmp_path / 'out' / '2'}" in text
        assert (tmp_path / "out" / "left.yaml").stat() == saved
        assert not (tmp_path / "elsewhere").exists()
        committed = commit(graph)
        assert committed.keys() == {"left", "right"}
        np.testing.assert_array_equal(committed["right"].p, rig.right.P.ravel())
        np.testing.assert_array_equal(committed["left"].k, rig.left.K.ravel())
        assert list(committed["left"].d) == list(rig.left.D)
        assert committed["right"].distortion_model == "equidistant"
        assert "rms" in facts(graph)["calibrated"]


def commit(graph: Graph, refusing: str = "") -> dict[str, Any]:
    """What two drivers receive. They run in a thread of their own: the node waits for them in its service."""
    import threading

    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    taken: dict[str, Any] = {}

    def take(side: str) -> Any:
        def answer(request: Any, response: Any) -> Any:
            taken[side] = request.camera_info
            response.success, response.status_message = side != refusing, "read-only" if side == refusing else ""
            return response

        return answer

    drivers = rclpy.create_node("drivers", use_global_arguments=False)
    for side in ("left", "right"):
        drivers.create_service(SetCameraInfo, f"{side}/set_camera_info", take(side))
    executor = SingleThreadedExecutor()
    executor.add_node(drivers)
    done = threading.Event()

    def spin() -> None:
        while not done.is_set():
            executor.spin_once(timeout_sec=0.05)

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        success, text = trigger(graph, "commit")
        if refusing:
            assert not success
            assert f"/{refusing}/set_camera_info: refused, read-only" in text
            assert ("left driver has already accepted its new CameraInfo" in text) == (refusing == "right")
        else:
            assert (success, text) == (True, "both drivers have accepted their camera infos")
    finally:
        done.set()
        thread.join()
        executor.shutdown()
        drivers.destroy_node()
    return taken


def test_commit_without_drivers(photographs: list[tuple[U8, U8]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration_node, "COMMIT_TIMEOUT_S", 0.3)
    with Graph(CalibrationNode, parameters=PARAMETERS) as graph:
        show(graph, photographs)
        assert trigger(graph, "calibrate")[0]
        success, text = trigger(graph, "commit")
        assert not success
        assert "/left/set_camera_info: no service within 0.3 s, nothing was committed: start the camera driver" in text


def test_nothing_is_committed_unless_both_drivers_are_there(
    photographs: list[tuple[U8, U8]], monkeypatch: pytest.MonkeyPatch
) -> None:
    import rclpy

    monkeypatch.setattr(calibration_node, "COMMIT_TIMEOUT_S", 0.5)
    with Graph(CalibrationNode, parameters=PARAMETERS) as graph:
        show(graph, photographs)
        assert trigger(graph, "calibrate")[0]
        taken: list[Any] = []
        driver = rclpy.create_node("left_driver", use_global_arguments=False)
        driver.create_service(SetCameraInfo, "left/set_camera_info", lambda request, _: taken.append(request))
        success, text = trigger(graph, "commit")
        rclpy.spin_once(driver, timeout_sec=0.2)
        driver.destroy_node()
        assert not success
        assert "/right/set_camera_info: no service within 0.5 s" in text and "nothing was committed" in text
        assert not taken


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_driver_that_refuses(photographs: list[tuple[U8, U8]], side: str) -> None:
    with Graph(CalibrationNode, parameters=PARAMETERS) as graph:
        show(graph, photographs)
        assert trigger(graph, "calibrate")[0]
        assert ("right" in commit(graph, refusing=side)) == (side == "right")


def test_motion_limit_changes_at_run_time(photographs: list[tuple[U8, U8]]) -> None:
    with Graph(CalibrationNode, parameters={**PARAMETERS, "max_board_motion": 2.0}) as graph:
        show(graph, photographs[:1])
        assert facts(graph)["newest pair"].startswith("the board moves")
        assert graph.set_parameter("max_board_motion", 0.0, "calibration_node").successful
        show(graph, photographs[1:2])
        assert facts(graph)["newest pair"] == "taken"


def test_a_folder_that_cannot_be_written(photographs: list[tuple[U8, U8]], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    parameters = {**PARAMETERS, "calibration_folder": str(tmp_path / "file")}
    with Graph(CalibrationNode, parameters=parameters) as graph:
        show(graph, photographs)
        assert trigger(graph, "calibrate")[0]
        success, text = trigger(graph, "save")
        assert not success
        assert "cannot be written" in text and "choose a writable folder" in text


def test_faults_of_images_are_reported(photographs: list[tuple[U8, U8]]) -> None:
    with Graph(CalibrationNode, parameters=PARAMETERS) as graph:
        left, right = photographs[0]
        show(graph, [(left, right)])
        graph.send(messages((left, right[:-4]), 9))
        graph.wait_error(r"right image: 400x296, previous images 400x300")
        show_nothing = np.full_like(left, 70)
        graph.send(messages((show_nothing, show_nothing), 10))
        graph.wait(lambda: facts(graph)["newest pair"].startswith("no board is detected"), "word of an empty image")


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"board_size": "9by6"}, "board size '9by6' is not columns x rows"),
        ({"board": "circles"}, "board = 'circles' is not one of"),
        ({"board_square": 25.0}, r"board_square = 25\.0 is outside"),
        ({"lens_model": "fisheye"}, "lens_model = 'fisheye' is not one of"),
        ({"calibration_folder": "~nosuchuser/x"}, "calibration_folder = '~nosuchuser/x' is not the path of a folder"),
    ],
)
def test_boards_that_cannot_be_end_the_start(parameters: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        Graph(CalibrationNode, parameters=parameters)


def test_a_node_that_could_not_start_is_destroyed() -> None:
    """As the rclpy of ROS 2 Kilted does when it shuts down."""
    node = CalibrationNode.__new__(CalibrationNode)
    with Graph(parameters={"board": "circles"}):
        with pytest.raises(ConfigError, match="board = 'circles'"):
            node.__init__()
        node.destroy_node()
