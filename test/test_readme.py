# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The documents for users are correct: commands and Python examples run as they are written, what they name exists."""

from __future__ import annotations

import functools
import json
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from command_line import CommandLine, Run
from documents import BLOCKS, DOCUMENTS, ROOT, Block, Call, make_inputs, output_after, read, setup_value
from ros_domain import own_number
from scanned import write_manifest
from stripe_scans import exact_plane, scanner
from test_config import WIDER
from test_dependencies import ROSDEP_KEYS

from stereo_depth_ros.active.light_stripe.plane_file import write_plane
from stereo_depth_ros.active.structured_light.decoding import check_sequence
from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.cli import main as cli
from stereo_depth_ros.config import CONFIGS, ParameterInfo, parameter_infos
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

README = read("README.md")
LAUNCH = ROOT / "launch" / "stereo_depth.launch.py"
PARAMETERS: Mapping[str, ParameterInfo] = {
    info.name: info for config in CONFIGS.values() for info in parameter_infos(config)
}
# Calls that no test makes as they are written, by how they begin: why, and what is tested of them.
NOT_RUN = {
    "make ": "minutes, and downloads; the targets exist and `make --dry-run` accepts them",
    "cd ": "a workspace of ROS; test_packaging builds one",
    "rosdep install": "changes the system; test_dependencies compares the keys of package.xml with setup.py",
    "git clone": "downloads; the address is a placeholder",
    "pip install --break-system-packages": "changes the system; the packages are those of setup.py",
    "colcon build": "a workspace of ROS; test_packaging builds one",
    "source ": "of a workspace or environment; the tests run in such an environment",
    "ros2 launch": "`launch` needs ROS 2; the arguments are declared, and test_launch_file runs the launch file",
    "ros2 param set": "needs a running node; the parameter exists, accepts the value and may be changed while running",
    "stereo-depth doctor --live": "needs cameras; the options exist, and test_doctor_live examines a graph",
    "python benchmarks/": "minutes, and real data; the options exist",
}
NAMED_PATH = re.compile(r"`((?:\w+/)+(?:[\w.]+\.(?:py|md|yaml|xml|mcap))?)`")
# These need a graph.
GRAPH = ("ros2 run", "ros2 service call", "stereo-depth replay", "stereo-depth demo")


def spans(text: str) -> list[str]:
    """All text in backticks."""
    return re.findall(r"`([^`]+)`", text)


def table(first_column: str, text: str = README) -> list[list[str]]:
    """The cells of the table with that first column."""
    rows = text[text.index(f"| {first_column} |") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def begins(call: Call, starts: Iterable[str]) -> str | None:
    """The one of ``starts`` with which a call begins."""
    return next((start for start in starts if f"{call} ".startswith(start)), None)


CALLS = [(block, call) for block in BLOCKS if block.language == "bash" for call in block.calls]


def calls(start: str) -> list[Any]:
    """Parameters of a test: all calls in the documents that begin so."""
    return [pytest.param(call, id=f"{block}: {call}") for block, call in CALLS if begins(call, [start])]


def shell_blocks(graph: bool) -> list[Any]:
    """Parameters of a test: all shell blocks with calls of `stereo-depth` that are run, with or without a graph."""
    found = []
    for block in BLOCKS:
        run = [call for call in block.calls if begins(call, ["stereo-depth "]) and not begins(call, NOT_RUN)]
        if block.language == "bash" and run and any(begins(call, GRAPH) for call in run) == graph:
            found.append(pytest.param(block, run, id=str(block)))
    return found


@pytest.fixture
def own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ROS domain of these tests, on this machine only."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(10 + own_number(10)))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def test_every_block_is_shell_python_json_or_output() -> None:
    """Any other language would not be tested."""
    assert {block.language for block in BLOCKS} == {"bash", "json", "python", "text"}
    fences = sum(read(document).count("```") for document in DOCUMENTS)
    assert fences == 2 * len(BLOCKS)


def test_every_call_is_run_or_listed_with_the_reason() -> None:
    run = ("stereo-depth ", "ros2 run ", "ros2 service call ")
    assert not [f"{block}: {call}" for block, call in CALLS if not begins(call, (*NOT_RUN, *run))]
    unused = [start for start in NOT_RUN if not any(begins(call, [start]) for _, call in CALLS)]
    assert not unused, f"not in any document: {unused}"


@pytest.mark.parametrize(("block", "run_calls"), shell_blocks(graph=False))
def test_commands_run_from_the_top_of_a_block_to_its_end(
    block: Block, run_calls: list[Call], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command_line: CommandLine
) -> None:
    run_block(block, run_calls, tmp_path, monkeypatch, command_line(columns=130))


@pytest.mark.graph
@pytest.mark.parametrize(("block", "run_calls"), shell_blocks(graph=True))
def test_commands_with_a_graph_run_too(
    block: Block,
    run_calls: list[Call],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command_line: CommandLine,
    own_domain: None,
) -> None:
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    run_block(block, run_calls, tmp_path, monkeypatch, command_line(columns=130))


def run_block(block: Block, run_calls: list[Call], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    expected = output_after(block)
    make_inputs(tmp_path, block.text, whole_bag=bool(expected))
    monkeypatch.chdir(tmp_path)
    printed = ""
    for call in run_calls:
        code, out, err = run(*call.words[1:])
        assert code == 0, f"{call}: {err}"
        printed += out
        if "-o" in call.words:
            assert_made(tmp_path / call.words[call.words.index("-o") + 1])
    lines = iter([line.rstrip() for line in printed.splitlines()])
    assert not [line for line in expected if line not in lines], printed  # in this order


def assert_made(output: Path) -> None:
    """A bag has the depth of every pair, or profiles of a scan; a folder or a file is not empty."""
    if output.suffix == ".mcap":
        with BagReader(output) as bag:
            topics = bag.topics
        if "/stripe/merged" in topics:
            assert topics["/stripe/points2"].count >= 2
            return
        if "/focus/index" in topics:
            assert topics["/focus/index"].count == 1
            return
        images = topics.get("/left/image_rect", topics.get("/left/image_rect_color"))
        assert images is not None and images.count >= 1
        made = [topics[topic].count for topic in ("/disparity", "/depth/image_rect", "/points2") if topic in topics]
        assert len(made) >= 2 and set(made) == {images.count}
    else:
        assert any(output.iterdir()) if output.is_dir() else output.stat().st_size > 0


@pytest.mark.parametrize("call", calls("stereo-depth doctor --live"))
def test_options_of_commands_that_are_not_run_exist(call: Call) -> None:
    name, *options = call.words[1:]
    command: Any = typer.main.get_command(cli.app)
    command.get_command(None, name).make_context(name, options)  # parses without running; rejects unknown options


@pytest.mark.parametrize(
    "document",
    [name for name in DOCUMENTS if any(block.document == name and block.language == "python" for block in BLOCKS)],
)
def test_python_examples_run_and_give_the_attributes_of_their_comments(
    document: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The blocks of a document one after the other, in one namespace that is empty at the beginning."""
    examples = [block for block in BLOCKS if block.document == document and block.language == "python"]
    make_inputs(tmp_path, "".join(block.text for block in examples))
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in examples:
        exec(compile(block.text, str(block), "exec"), names)
        assert capsys.readouterr().out.splitlines() == output_after(block)
        promises = re.findall(r"^(\w+) = .*-> (.*)$", block.text, re.MULTILINE)
        assert len(promises) == block.text.count("->")
        for name, comment in promises:
            promised = re.findall(r"\.(\w+)", comment)
            assert promised and all(hasattr(names[name], attribute) for attribute in promised), name
    check_results(names)


@functools.cache
def true_depth_m() -> F32:
    """Of the first pair of the sample bag."""
    return SyntheticSequence()[0].truth_depth_m


def check_results(names: Mapping[str, Any]) -> None:
    """What the examples compute of the first pair of the sample bag."""
    if "result" in names:
        depth_m, truth_m = names["result"].depth_m, true_depth_m()
        assert depth_m.shape == names["result"].points().shape[:2] == (480, 640)
        found = np.isfinite(depth_m)
        assert found.mean() > 0.9
        # a sixteenth of a pixel of the 13 px that this rig has at 4 m is 0.5 %
        assert np.median((np.abs(depth_m - truth_m) / truth_m)[found]) < 0.005
    if "match" in names:
        assert names["match"].disparity_px.shape == names["match"].reasons.shape == (480, 640)
        np.testing.assert_array_equal(names["match"].disparity_px[found], names["result"].disparity.disparity_px[found])
    if "alone" in names:
        kept = np.isfinite(names["last"].disparity.disparity_px)
        np.testing.assert_array_equal(names["alone"].disparity_px[kept], names["last"].disparity.disparity_px[kept])
        assert kept.mean() > 0.5
    if "from_projector" in names:
        assert names["from_projector"].disparity_px.shape == (120, 160)
        assert np.isfinite(names["from_projector"].disparity_px).mean() > 0.35
    if "scan" in names:
        errors_px = np.abs(names["scan"].disparity_px - names["scanner"].truth().disparity_px)
        assert np.nanmedian(errors_px) < 0.05
    if "focused" in names:
        found = np.isfinite(names["focused"].depth_m)
        assert found.mean() > 0.5
        assert np.median(np.abs(names["focused"].depth_m - names["stack"].depth_m)[found]) < 0.006
    if "columns" in names:
        assert names["columns"].column_px.shape == (240, 320)
        assert (names["columns"].reasons == 0).mean() > 0.5
    if "points" in names:
        assert names["found"].H_left.shape == names["F"].shape == (3, 3)
        assert names["points"].level.unit == "meters"
        depth_m = names["points"].points[:, 2]
        assert np.isfinite(depth_m).mean() > 0.7
        assert 1 < np.nanmedian(depth_m) < 10


def test_python_examples_are_found() -> None:
    assert {block.document for block in BLOCKS if block.language == "python"} == {
        "README.md",
        "docs/focus.md",
        "docs/geometry.md",
        "docs/one_shot.md",
        "docs/projector.md",
        "docs/range_sensor.md",
        "docs/python.md",
        "docs/space_time.md",
        "docs/structured_light.md",
        "docs/surfaces.md",
        "docs/views.md",
    }


def test_json_is_a_manifest_of_patterns_that_can_be_decoded() -> None:
    blocks = [block for block in BLOCKS if block.language == "json"]
    assert [block.document for block in blocks] == ["docs/structured_light.md"]
    for block in blocks:
        check_sequence(PatternSequence.from_json(json.loads(block.text)))


# What the documents state that a target runs
RECIPES = {
    "demo": "stereo-depth demo",
    "test": "-m pytest",
    "lint": "ruff check",
    "config": "tools/documentation.py",
    "bench": "benchmarks/graph.py",
    "venv": "",
}


def test_make_targets_of_the_documents_are_tested() -> None:
    assert {call.words[1] for _, call in CALLS if call.words[0] == "make"} | {"bench"} == RECIPES.keys()
    assert "`make bench`" in read("docs/benchmarks.md")


@pytest.mark.parametrize("target", RECIPES)
def test_make_targets_run_what_the_documents_state(target: str) -> None:
    if shutil.which("make") is None:
        pytest.skip("no make")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(
        ["make", "--dry-run", target], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert RECIPES[target] in done.stdout


@pytest.mark.parametrize("call", calls("pip install"))
def test_packages_to_install_are_those_of_the_setup_that_rosdep_lacks(call: Call) -> None:
    without_key = {name for name, key in ROSDEP_KEYS.items() if not key}
    assert sorted(call.words[3:]) == sorted(without_key - {"shellingham"})  # which comes with typer


@pytest.mark.parametrize("call", calls("ros2 launch"))
def test_launch_files_and_their_arguments_exist(call: Call) -> None:
    package, name, *arguments = call.words[2:]
    assert (package, name) == ("stereo_depth_ros", LAUNCH.name)
    assert arguments and {argument.partition(":=")[0] for argument in arguments} <= launch_arguments()


def launch_arguments() -> set[str]:
    """All arguments of the launch file."""
    rows = read("docs/parameters.md").split("<!-- launch:begin -->")[1].splitlines()
    return {row.split("`")[1] for row in rows if row.startswith("| `")} | set(PARAMETERS)


def test_what_differs_from_stereo_image_proc() -> None:
    document = "docs/stereo_image_proc.md"
    assert {name for row in cells(document)[2:] for name in spans(row[0])} == {*WIDER, "prefilter_size"}
    (same,) = re.findall(r"^- Launch arguments: (.*?)^- ", read(document), re.DOTALL | re.MULTILINE)
    assert {"namespace", "left_namespace", "use_color"} <= set(spans(same)) <= launch_arguments()


@pytest.mark.parametrize("call", calls("ros2 param set"))
def test_parameters_that_are_set_can_be_changed(call: Call) -> None:
    node, name, value = call.words[3:]
    assert node.lstrip("/") in setup_value("NODES")
    info = PARAMETERS[name]
    assert info.run_time
    info.check(info.type(value))


@pytest.mark.graph
@pytest.mark.parametrize("call", calls("ros2 run"))
def test_nodes_start_with_these_arguments(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    from graph_harness import NodeProcess

    package, node, *arguments = call.words[2:]
    assert package == "stereo_depth_ros" and node in setup_value("NODES")
    make_inputs(tmp_path, str(call))
    (tmp_path / "src").mkdir()  # of a workspace
    (tmp_path / "src" / package).symlink_to(ROOT)
    monkeypatch.chdir(tmp_path)
    process = NodeProcess(node, arguments, tmp_path)
    try:
        process.wait_ready()
        process.signal(signal.SIGINT)
        assert process.exit_code() == 0, process.text
    finally:
        process.kill()


@pytest.mark.graph
def test_services_that_are_called_exist() -> None:
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    from graph_harness import Graph
    from std_srvs.srv import Trigger

    from stereo_depth_ros.nodes.calibration_node import CalibrationNode

    called = [call.words[3:] for _, call in CALLS if begins(call, ["ros2 service call"])]
    assert len(called) == 3
    with Graph(CalibrationNode) as graph:
        for service, kind in called:
            assert kind == "std_srvs/srv/Trigger"
            answer = graph.call(Trigger, service, Trigger.Request())
            assert not answer.success and answer.message, "there are no views yet"


@pytest.mark.parametrize("call", calls("python benchmarks/"))
def test_options_of_the_benchmarks_exist(
    call: Call, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program, *arguments = call.words[1:]
    if "import rclpy" in read(program):
        pytest.importorskip("rclpy", reason="this benchmark starts nodes")
    monkeypatch.setattr(sys, "argv", [program, "--help"])
    monkeypatch.syspath_prepend((ROOT / program).parent)  # as python does
    monkeypatch.setattr(os, "environ", {**os.environ, "STEREO_DEPTH_MALLOPT": "0"})
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / program), run_name="__main__")
    assert ended.value.code == 0
    options = [argument for argument in arguments if argument.startswith("--")]
    help_text = capsys.readouterr().out
    assert options and all(f"{option} " in help_text for option in options)


def links(document: str) -> list[str]:
    """Paths that a document links, or shows as images."""
    return [path for path in re.findall(r"\]\(([^)]+)\)", read(document)) if "://" not in path]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_links_and_paths_exist(document: str) -> None:
    named = {(ROOT / document).parent / path.partition("#")[0] for path in links(document)}
    if document != "CONTRIBUTING.md" and "ARCHITECTURE" not in document:  # see test_documentation
        named |= {ROOT / path for path in NAMED_PATH.findall(read(document))}
    assert named
    assert not sorted(str(path) for path in named if not path.exists())


def test_the_readme_names_the_folders_of_the_repository() -> None:
    named = {path.rstrip("/") for path in NAMED_PATH.findall(README)}
    assert {"config", "launch", "bags", "benchmarks", "tools", "test"} <= named
    assert "docs/preview.png" in links("README.md") and "bags/synthetic_room.mcap" in README


def test_the_readme_links_every_page() -> None:
    assert {*DOCUMENTS, "bags/README.md"} - {"README.md"} <= set(links("README.md"))


@pytest.mark.parametrize("document", DOCUMENTS)
def test_a_document_begins_with_its_title_and_a_sentence_on_what_it_is_for(document: str) -> None:
    title, empty, first = read(document).splitlines()[:3]
    assert title.startswith("# ") and not empty
    assert re.match(r"[A-Z].*\w", first)


def test_the_readme_is_short_and_its_image_small() -> None:
    assert len(README.splitlines()) <= 200
    assert (ROOT / "docs" / "preview.png").stat().st_size < 400_000


def cells(document: str) -> list[list[str]]:
    """The cells of all rows of all tables."""
    rows = [line.strip("|").split(" | ") for line in read(document).splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows]


def test_measurements_in_the_readme_are_those_of_the_benchmarks() -> None:
    rows = {(row[0], row[1]): row for row in cells("docs/benchmarks.md") if len(row) > 1}
    accuracy = {row[0]: row for key, row in rows.items() if "density" not in key and len(row) == 8}
    expected = {
        "`sgm`, the default": ("`sgm`, `default`", "`sgm`, fused"),
        "`sgm`, `fill_holes`": ("`sgm`, `default`, `fill_holes`", None),
        "`sgm`, quality `best`": ("`sgm`, `best`", None),
        "OpenCV's BM; `bm`": ("BM; `bm`", "`bm`, fused"),
        "OpenCV's SGBM; `sgbm`": ("SGBM, five paths; `sgbm`", "`sgbm`, fused"),
    }
    found = table("matcher")
    assert [row[0] for row in found] == list(expected)
    for row, (matcher, shape) in zip(found, expected.values(), strict=True):
        _, density, _, _, above_2, holes, small, large = accuracy[matcher]
        graph = rows["640x480 / 64", shape] if shape else None
        assert row[1:] == [density, above_2, holes, small, large, *((graph[3], graph[6]) if graph else ("", ""))]


def test_table_of_nodes_has_every_node_once() -> None:
    assert sorted(row[0].strip("`") for row in table("node")) == sorted(setup_value("NODES"))


Topics = dict[str, str]  # type by name, both without package


@pytest.fixture(scope="module")
def live_topics(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Topics, Topics]]:
    """Subscriptions and publishers of each node while all outputs have subscribers, without those of every node."""
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    from graph_harness import Graph

    from stereo_depth_ros.nodes.calibration_monitor import CalibrationMonitor
    from stereo_depth_ros.nodes.calibration_node import CalibrationNode
    from stereo_depth_ros.nodes.depth_node import DepthNode
    from stereo_depth_ros.nodes.disparity_node import DisparityNode
    from stereo_depth_ros.nodes.feature_node import FeatureNode
    from stereo_depth_ros.nodes.light_stripe_node import LightStripeNode
    from stereo_depth_ros.nodes.point_cloud_node import PointCloudNode
    from stereo_depth_ros.nodes.rectify_node import RectifyNode
    from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode
    from stereo_depth_ros.nodes.structured_light_node import StructuredLightNode
    from stereo_depth_ros.nodes.view_node import ViewNode

    def topics(endpoints: Iterable[Any]) -> Topics:
        found = {end.topic_name.lstrip("/"): end.msg_type.__name__ for end in endpoints}
        return {name: kind for name, kind in found.items() if name not in ("rosout", "parameter_events", "clock")}

    pipeline = (RectifyNode, DisparityNode, PointCloudNode, DepthNode, StereoDepthNode)
    others = (FeatureNode, ViewNode, CalibrationMonitor, CalibrationNode)
    with Graph(*pipeline, *others, parameters={"auto_correct": True, "range_sensor": "/range"}) as graph:
        kinds = {end.topic_name: end.msg_type for node in graph.nodes for end in node.publishers}
        for topic in kinds.keys() - {"/rosout", "/parameter_events", "/diagnostics"}:
            graph.listen(topic, kinds[topic])
        graph.wait(lambda: all(topics(node.subscriptions) for node in graph.nodes), "subscriptions of every node")
        found = {node.get_name(): (topics(node.subscriptions), topics(node.publishers)) for node in graph.nodes}
    write_plane(laser := tmp_path_factory.mktemp("laser") / "laser.yaml", exact_plane(), scanner().rig.left)
    write_manifest(folder := tmp_path_factory.mktemp("patterns"))
    patterns = {"patterns": str(folder / "patterns.json"), "pattern_signal": "topic"}
    with Graph(StructuredLightNode, parameters=patterns) as graph:
        (node,) = graph.nodes
        found[node.get_name()] = topics(node.subscriptions), topics(node.publishers)
    for motion in ("linear", "pose"):
        with Graph(LightStripeNode, parameters={"laser_file": str(laser), "stripe_motion": motion}) as graph:
            (node,) = graph.nodes
            subscribed, published = found.get(node.get_name(), ({}, {}))
            found[node.get_name()] = subscribed | topics(node.subscriptions), published | topics(node.publishers)
    return found


def named_topics(cell: str) -> set[str]:
    """The topics named in a cell of the table of nodes."""
    cell, _, added = cell.partition("; also ")
    topics = set(spans(cell))
    if "both `camera_info`" in cell:
        topics = topics - {"camera_info"} | {"left/camera_info", "right/camera_info"}
    if cell.startswith("all of the above except"):
        rows = table("node")
        above = rows[: next(index for index, row in enumerate(rows) if row[2].startswith(cell))]
        topics = set().union(*(named_topics(row[2]) for row in above)) - topics
    return topics | set(spans(added))


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
    for names, types, _ in table("topic", read("docs/topics.md")):
        topics = [name.lstrip("/") for name in spans(names)]
        kinds = [kind.rpartition("/")[2] for kind in spans(types) if not kind.startswith("/")]
        named |= dict(zip(topics, kinds if len(kinds) > 1 else kinds * len(topics), strict=True))
    assert named.pop("~/ready") == "Int64", "every node publishes it as soon as it spins, see test_readiness"
    assert named == {name: kind for sides in live_topics.values() for side in sides for name, kind in side.items()}
