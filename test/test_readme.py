# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The README is correct: its commands, Python examples, paths, nodes and topics."""

from __future__ import annotations

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from stereo_bags import messages_of

from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.cli import main as cli
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text("utf-8")
# files that a user has, or creates by following the README
USER_FILES = {
    *("out/room.mcap", "out.mcap", "install/setup.bash"),
    *("left.yaml", "right.yaml", "left.png", "right.png"),
}
WORKSPACE = "src/stereo_depth_ros/"
FILE = re.compile(r"[\w~./-]*\w\.(?:bash|md|mcap|png|py|rst|toml|xml|yaml)\b")
FOLDER = re.compile(r"`([\w./-]+)/`")


def blocks(language: str) -> list[str]:
    """The code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def commands(program: str) -> list[list[str]]:
    """Arguments of every call of a program in the shell blocks; && separates calls."""
    lines = [shlex.split(line, comments=True) for block in blocks("bash") for line in block.splitlines()]
    parts = [part.split() for line in lines for part in " ".join(line).split("&&")]
    return [part[1:] for part in parts if part[:1] == [program]]


def spans(text: str) -> list[str]:
    """All text in backticks."""
    return re.findall(r"`([^`]+)`", text)


def table(first_column: str) -> list[list[str]]:
    """The cells of the table with that first column."""
    rows = README[README.index(f"| {first_column} |") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def setup_nodes() -> tuple[str, ...]:
    """NODES of setup.py, which cannot be imported without running the setup."""
    for statement in ast.parse((ROOT / "setup.py").read_text("utf-8")).body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "NODES":
            return tuple(ast.literal_eval(statement.value))
    raise AssertionError("setup.py has no NODES")


@pytest.mark.parametrize("arguments", commands("stereo-depth"), ids=" ".join)
def test_commands_and_their_options_exist(arguments: list[str]) -> None:
    command: Any = typer.main.get_command(cli.app)
    rest = list(arguments)
    while hasattr(command, "list_commands"):
        name, names = rest.pop(0), command.list_commands(None)
        assert name in names, f"{name} is not one of {', '.join(names)}"
        command = command.get_command(None, name)
    command.make_context(name, rest)  # parses without running; rejects unknown options


def test_every_line_of_the_shell_section_was_parsed() -> None:
    section = README.split("## From the shell")[1].split("##")[0]
    assert len(commands("stereo-depth")) == section.count("\nstereo-depth ") >= 5


@pytest.mark.parametrize("target", sorted({arguments[0] for arguments in [*commands("make"), ["bench"]]}))
def test_make_targets_exist(target: str) -> None:
    if shutil.which("make") is None:
        pytest.skip("no make")
    assert f"make {target}" in README
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(
        ["make", "--dry-run", target], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr


def test_ros2_commands_name_nodes_launch_files_and_arguments_that_exist() -> None:
    lines = commands("ros2")
    assert {line[0] for line in lines} == {"launch", "run", "service"}
    for verb, package, name, *arguments in lines:
        if verb == "service":
            assert name.split("/")[1] in setup_nodes()
            continue
        assert package == "stereo_depth_ros"
        if verb == "run":
            assert name in setup_nodes()
        else:
            text = (ROOT / "launch" / name).read_text("utf-8")
            assert all(f'"{argument.partition(":=")[0]}"' in text for argument in arguments)


def test_paths_exist() -> None:
    named = {path for path in FILE.findall(README) if "/" in path or path in USER_FILES}
    named = {path.removeprefix(WORKSPACE) for path in named} - USER_FILES
    folders = {path for path in FOLDER.findall(README) if path != "/"}
    assert {"config/fastdds.xml", "docs/preview.png", "bags/synthetic_room.mcap"} <= named
    assert {"config", "launch", "bags", "benchmarks", "test"} <= folders
    missing = sorted(path for path in named | folders if not (ROOT / path).exists())
    assert not missing


def test_table_of_nodes_has_every_node_once() -> None:
    assert sorted(row[0].strip("`") for row in table("node")) == sorted(setup_nodes())


Topics = dict[str, str]  # type by name, both without package


@pytest.fixture(scope="module")
def live_topics() -> dict[str, tuple[Topics, Topics]]:
    """Subscriptions and publishers of each node while all outputs have subscribers, without those of every node."""
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    from graph_harness import Graph

    from stereo_depth_ros.nodes.calibration_monitor import CalibrationMonitor
    from stereo_depth_ros.nodes.calibration_node import CalibrationNode
    from stereo_depth_ros.nodes.depth_node import DepthNode
    from stereo_depth_ros.nodes.disparity_node import DisparityNode
    from stereo_depth_ros.nodes.feature_node import FeatureNode
    from stereo_depth_ros.nodes.point_cloud_node import PointCloudNode
    from stereo_depth_ros.nodes.rectify_node import RectifyNode
    from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode

    def topics(endpoints: Iterable[Any]) -> Topics:
        found = {end.topic_name.lstrip("/"): end.msg_type.__name__ for end in endpoints}
        return {name: kind for name, kind in found.items() if name not in ("rosout", "parameter_events", "clock")}

    pipeline = (RectifyNode, DisparityNode, PointCloudNode, DepthNode, StereoDepthNode)
    with Graph(*pipeline, FeatureNode, CalibrationMonitor, CalibrationNode, parameters={"auto_correct": True}) as graph:
        kinds = {end.topic_name: end.msg_type for node in graph.nodes for end in node.publishers}
        for topic in kinds.keys() - {"/rosout", "/parameter_events", "/diagnostics"}:
            graph.listen(topic, kinds[topic])
        graph.wait(lambda: all(topics(node.subscriptions) for node in graph.nodes), "subscriptions of every node")
        return {node.get_name(): (topics(node.subscriptions), topics(node.publishers)) for node in graph.nodes}


def named_topics(cell: str) -> set[str]:
    """The topics named in a cell of the table of nodes."""
    topics = set(spans(cell))
    if "both `camera_info`" in cell:
        topics = topics - {"camera_info"} | {"left/camera_info", "right/camera_info"}
    if cell.startswith("all of the above except"):
        rows = table("node")
        above = rows[: next(index for index, row in enumerate(rows) if row[2] == cell)]
        topics = set().union(*(named_topics(row[2]) for row in above)) - topics
    return topics


@pytest.mark.graph
def test_table_of_nodes_names_their_topics(live_topics: dict[str, tuple[Topics, Topics]]) -> None:
    rows = {row[0].strip("`"): row for row in table("node")}
    for node, (subscribed, published) in live_topics.items():
        assert subscribed.keys() == named_topics(rows[node][1]), node
        assert published.keys() - {"diagnostics"} == named_topics(rows[node][2]), node
    assert rows.keys() - live_topics.keys() == {"replay_node"}, "it plays the inputs of the others"


@pytest.mark.graph
def test_table_of_topics_has_every_topic_with_its_type(live_topics: dict[str, tuple[Topics, Topics]]) -> None:
    named: Topics = {}
    for names, types, _ in table("topic"):
        topics = [name.lstrip("/") for name in spans(names)]
        kinds = [kind.rpartition("/")[2] for kind in spans(types) if not kind.startswith("/")]
        named |= dict(zip(topics, kinds if len(kinds) > 1 else kinds * len(topics), strict=True))
    assert named.pop("~/ready") == "Int64", "every node publishes it as soon as it spins, see test_readiness"
    assert named == {name: kind for sides in live_topics.values() for side in sides for name, kind in side.items()}


def run_in(folder: Path, arguments: list[str]) -> subprocess.CompletedProcess[str]:
    """Run `stereo-depth` in a folder with the sample bag at the path used in the README."""
    (folder / "bags").symlink_to(ROOT / "bags")
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = {
        "PYTHONPATH": path,
        "ROS_DOMAIN_ID": str(10 + os.getpid() % 10),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    return subprocess.run(
        [sys.executable, "-m", "stereo_depth_ros.cli.main", *arguments],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=100,
    )


def test_info_of_the_sample_bag(tmp_path: Path) -> None:
    (arguments,) = (line for line in commands("stereo-depth") if line[0] == "info")
    done = run_in(tmp_path, arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].split() == ["usable", "for", "stereo", "depth", "yes"]


@pytest.mark.parametrize(
    "arguments",
    [
        pytest.param(line, id=" ".join(line), marks=[pytest.mark.graph] * (line[0] == "replay"))
        for line in commands("stereo-depth")
        if line[0] in ("process", "replay")
    ],
)
def test_commands_make_depth_of_the_sample_bag(arguments: list[str], tmp_path: Path) -> None:
    if arguments[0] == "replay":
        pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    done = run_in(tmp_path, [*arguments, "--duration", "0.15"])
    assert done.returncode == 0, done.stderr
    assert len(messages_of(tmp_path / "out" / "room.mcap", "/points2")) == 2


def test_python_example_gives_the_attributes_of_its_comments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, _ = blocks("python")
    sequence = SyntheticSequence(1, 320, 200)
    frame = sequence[0]
    write_camera(tmp_path / "left.yaml", sequence.rig.left, "left")
    write_camera(tmp_path / "right.yaml", sequence.rig.right, "right")
    monkeypatch.chdir(tmp_path)
    rectified = Rectifier(sequence.rig).rectify(frame.pair)
    names: dict[str, Any] = {"left": rectified.left, "right": rectified.right, "pair": frame.pair}
    exec(compile(code, "README.md", "exec"), names)
    for name, comment in re.findall(r"^(\w+) = .*-> (.*)$", code, re.MULTILINE):
        promised = re.findall(r"\.(\w+)", comment)
        assert promised and all(hasattr(names[name], attribute) for attribute in promised), name
    assert names["result"].disparity_px.shape == names["result"].reasons.shape == (200, 320)
    assert names["depth"].points().shape == (200, 320, 3)
    depth_m = names["depth"].depth_m
    found = np.isfinite(depth_m)
    assert found.mean() > 0.3
    # an eighth of a pixel of the 6 px that this rig has at 4 m is 2 %
    assert np.median((np.abs(depth_m - frame.truth_depth_m) / frame.truth_depth_m)[found]) < 0.02


def test_python_example_of_the_geometry() -> None:
    _, code = blocks("python")
    sequence = SyntheticSequence(1, 480, 360)
    frame = sequence[0]
    names: dict[str, Any] = {"left": frame.pair.left.pixels, "right": frame.pair.right.pixels, "rig": sequence.rig}
    exec(compile(code, "README.md", "exec"), names)
    assert names["found"].H_left.shape == names["F"].shape == (3, 3)
    assert names["points"].level.unit == "meters"
    depth_m = names["points"].points[:, 2]
    assert np.isfinite(depth_m).mean() > 0.7
    assert 1 < np.nanmedian(depth_m) < 10
