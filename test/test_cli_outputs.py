# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs of the commands: inputs and earlier results are kept, and write errors are reported in one line."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from evaluation_scenes import write_scene
from ros_domain import own_number
from stereo_bags import PARAMETERS, messages_of, sequence, write_truth_bag

from stereo_depth_ros.calibration.calibration_files import write_camera

PARAM_ARGUMENTS = [text for name, value in PARAMETERS.items() for text in ("--param", f"{name}:={value}")]
STEREO_DEPTH = [sys.executable, "-m", "stereo_depth_ros.cli.main"]


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("outputs") / "in.mcap"
    write_truth_bag(path, 2)
    return path


@pytest.fixture
def bag(whole: Path, tmp_path: Path) -> Path:
    """A copy of the bag that a test may overwrite."""
    return Path(shutil.copy(whole, tmp_path / "in.mcap"))


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    """The same bag as a rosbag2 folder."""
    path = tmp_path / "rec"
    path.mkdir()
    shutil.copy(whole, path / "rec_0.mcap")
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [rec_0.mcap]}\n")
    return path


def write_pair(folder: Path) -> None:
    """A raw pair and its calibration."""
    made = sequence(1)
    pair, rig = made[0].pair, made.rig
    for side, image, camera in (("left", pair.left, rig.left), ("right", pair.right, rig.right)):
        cv2.imwrite(str(folder / f"{side}.png"), image.pixels)
        write_camera(folder / f"{side}.yaml", camera, side)


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def refused(result: tuple[int, str, str], text: str) -> None:
    """Exit code 1 and one line."""
    code, out, err = result
    assert (code, out) == (1, ""), err
    assert err.startswith("error: ") and err.count("\n") == 1, err
    assert text in err


READ = "would overwrite an input: write to another file"


@pytest.mark.parametrize("command", ["process", "replay"])
@pytest.mark.parametrize("more", [(), ("--overwrite",)])
def test_no_file_of_a_recording_is_an_output(run: Run, folder: Path, command: str, more: tuple[str, ...]) -> None:
    (folder.parent / "soft.mcap").symlink_to(folder / "rec_0.mcap")
    (folder.parent / "hard.mcap").hardlink_to(folder / "rec_0.mcap")
    before = contents(folder.parent)
    for output in (folder / "rec_0.mcap", folder.parent / "soft.mcap", folder.parent / "hard.mcap"):
        refused(run(command, folder, "-o", output, *more), READ)
    for report in (folder / "rec_0.mcap", folder / "metadata.yaml"):
        refused(run(command, folder, "-o", folder.parent / "o.mcap", "--json", report, *more), READ)
    assert contents(folder.parent) == before


def test_a_bag_with_an_odd_name_is_read_and_kept(run: Run, bag: Path, tmp_path: Path) -> None:
    """A temporary name never is that of an input."""
    source = bag.rename(tmp_path / "x.partial.mcap")
    before = source.read_bytes()
    code, _, err = run("process", source, "-o", tmp_path / "x.mcap", *PARAM_ARGUMENTS)
    assert code == 0, err
    assert source.read_bytes() == before
    assert len(messages_of(tmp_path / "x.mcap", "/disparity")) == 2


def test_parameter_files_are_kept(run: Run, bag: Path, tmp_path: Path) -> None:
    params = tmp_path / "p.yaml"
    params.write_text("/**:\n  ros__parameters: {disparity_range: 32}\n")
    arguments = ("process", bag, "-o", tmp_path / "o.mcap", "--params-file", params, "--json", params, "--overwrite")
    refused(run(*arguments), READ)
    assert "disparity_range" in params.read_text()


@pytest.mark.parametrize("command", ["info", "doctor", "rig", "evaluate"])
@pytest.mark.parametrize("more", [(), ("--overwrite",)])
def test_no_report_replaces_the_bag(run: Run, bag: Path, command: str, more: tuple[str, ...]) -> None:
    before = bag.read_bytes()
    matcher = ("--matcher", "bm") if command == "evaluate" else ()
    refused(run(command, bag, *matcher, "--json", bag, *more), READ)
    if command == "evaluate":
        refused(run(command, bag, *matcher, "--csv", bag, *more), READ)
    if command == "rig":
        refused(run(command, bag, "--plot", bag, *more), READ)
    assert bag.read_bytes() == before


def test_an_output_that_exists_stays_without_overwrite(run: Run, bag: Path, tmp_path: Path) -> None:
    old = tmp_path / "old"
    old.write_text("precious")
    bag_out = tmp_path / "old.mcap"
    bag_out.write_text("precious")
    for command in ("process", "replay"):
        remedy = "remove it, write to another file, or allow overwriting (--overwrite)"
        refused(run(command, bag, "-o", bag_out), f"old.mcap: already exists: {remedy}")
        refused(run(command, bag, "-o", tmp_path / "o.mcap", "--json", old), "old: already exists")
    for arguments in (
        ("info", bag, "--json", old),
        ("doctor", bag, "--json", old),
        ("rig", bag, "--json", old),
        ("rig", bag, "--plot", old),
        ("evaluate", bag, "--matcher", "bm", "--json", old),
        ("evaluate", bag, "--matcher", "bm", "--csv", old),
        ("parameters", "--json", old),
        ("synthesize", bag_out, "--frames", "1"),
    ):
        refused(run(*arguments), "--overwrite")
    assert old.read_text() == bag_out.read_text() == "precious"
    assert not (tmp_path / "o.mcap").exists()


def test_overwrite_replaces(run: Run, bag: Path, tmp_path: Path) -> None:
    report, output = tmp_path / "r.json", tmp_path / "o.mcap"
    for command in (
        ("process", bag, "-o", output, *PARAM_ARGUMENTS),
        ("info", bag),
        ("rig", bag),
        ("parameters",),
        ("doctor", bag),
    ):
        report.write_text("old")
        output.write_text("old")
        code, _, err = run(*command, "--json", report, "--overwrite")
        assert code == 0, err
        assert json.loads(report.read_text())
    run("process", bag, "-o", output, *PARAM_ARGUMENTS, "--overwrite")
    assert len(messages_of(output, "/disparity")) == 2


def test_a_demo_is_not_replaced_without_overwrite(run: Run, tmp_path: Path) -> None:
    for name in ("demo.mcap", "demo.png"):
        (tmp_path / name).write_text("old")
        refused(run("demo", "--output-dir", tmp_path), f"{name}: already exists")
        assert (tmp_path / name).read_text() == "old"
        (tmp_path / name).unlink()
    assert "demo --overwrite" in (Path(__file__).resolve().parents[1] / "Makefile").read_text()


@pytest.mark.parametrize("more", [(), ("--overwrite",)])
def test_rectify_keeps_its_images_and_its_calibration(run: Run, tmp_path: Path, more: tuple[str, ...]) -> None:
    write_pair(tmp_path)
    (tmp_path / "l.png").hardlink_to(tmp_path / "left.png")
    (tmp_path / "r.png").hardlink_to(tmp_path / "right.png")
    before = contents(tmp_path)
    pair = (tmp_path / "left.png", tmp_path / "right.png")
    refused(run("rectify", *pair, "--rig", tmp_path, "-o", tmp_path, *more), READ)
    method = ("--rig", tmp_path / "left.yaml", "--method", "textbook")
    refused(run("rectify", *pair, *method, "-o", tmp_path / "out", "--json", tmp_path / "right.yaml", *more), READ)
    assert contents(tmp_path) == before
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "rows.png").write_text("old")
    result = run("rectify", *pair, "--rig", tmp_path, "-o", tmp_path / "out", *more)
    if more:
        assert result[0] == 0, result
    else:
        refused(
            result, "rows.png: already exists: remove it, write to another file, or allow overwriting (--overwrite)"
        )
        assert contents(tmp_path / "out") == {tmp_path / "out" / "rows.png": b"old"}


@pytest.mark.parametrize("more", [(), ("--overwrite",)])
def test_calibrate_keeps_its_images_and_an_earlier_result(run: Run, tmp_path: Path, more: tuple[str, ...]) -> None:
    for name in ("left1.png", "right1.png"):
        cv2.imwrite(str(tmp_path / name), np.full((48, 64), 99, np.uint8))
    before = contents(tmp_path)
    board = ("--size", "9x6", "--square", "0.025")
    refused(run("calibrate", tmp_path, *board, "-o", tmp_path / "o", "--json", tmp_path / "left1.png", *more), READ)
    assert contents(tmp_path) == before
    for name in ("left.yaml", "right.yaml", "calibration.json", "calibration.txt", "coverage.png"):
        (tmp_path / "o").mkdir()
        (tmp_path / "o" / name).write_text("old")
        text = "no board of 9x6" if more else f"{name}: already exists"
        refused(run("calibrate", tmp_path, *board, "-o", tmp_path / "o", *more), text)
        assert contents(tmp_path / "o") == {tmp_path / "o" / name: b"old"}
        shutil.rmtree(tmp_path / "o")


def test_evaluate_keeps_the_truth_and_earlier_plots(run: Run, whole: Path, tmp_path: Path) -> None:
    scene = tmp_path / "one"
    write_scene(scene)
    before = contents(tmp_path)
    small = ("--matcher", "bm", "--param", "correlation_window_size:=9")
    for name in ("im0.png", "disp0.pfm"):
        for option in ("--json", "--csv"):
            refused(run("evaluate", scene, *small, option, scene / name, "--overwrite"), READ)
    assert contents(tmp_path) == before
    plots = tmp_path / "plots"
    plots.mkdir()
    for place, name in ((scene, "one_bm.png"), (scene, "one_bm_confidence.png"), (whole, "in_0001_bm.png")):
        (plots / name).write_text("old")
        refused(run("evaluate", place, *small, "--plots", plots), f"{name}: already exists")
        assert contents(plots) == {plots / name: b"old"}
        code, _, err = run("evaluate", place, *small, "--plots", plots, "--overwrite")
        assert code == 0, err
        assert cv2.imread(str(plots / "one_bm.png" if place == scene else plots / name)) is not None
        shutil.rmtree(plots)
        plots.mkdir()


def test_convert_keeps_the_dataset(run: Run, tmp_path: Path) -> None:
    write_pair(tmp_path)
    (tmp_path / "left.yaml").rename(tmp_path / "left.mcap")
    before = contents(tmp_path)
    files = ("--camera-info", tmp_path / "left.mcap", "--camera-info", tmp_path / "right.yaml")
    refused(run("convert", "images", tmp_path, tmp_path / "left.mcap", *files, "--overwrite"), READ)
    (tmp_path / "o.mcap").symlink_to("left.png")
    refused(run("convert", "images", tmp_path, tmp_path / "o.mcap", *files), READ)
    (tmp_path / "o.mcap").unlink()
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "target", ["none/r.json", "file/r.json", "."], ids=["folder is missing", "folder is a file", "is a folder"]
)
@pytest.mark.parametrize("command", ["process", "replay", "info", "doctor", "rig", "parameters", "demo"])
def test_unwritable_report_is_reported_before_the_work(
    run: Run, bag: Path, tmp_path: Path, command: str, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for work in ("process.process_bag", "info.inspect_bag", "replay.run_live", "demo.run_live"):
        monkeypatch.setattr(f"stereo_depth_ros.cli.{work}", lambda *_, **__: pytest.fail("the work was done"))
    (tmp_path / "file").write_text("")
    places: dict[str, tuple[object, ...]] = {"parameters": (), "demo": ("--output-dir", tmp_path / "d")}
    arguments = places.get(command, (bag, "-o", tmp_path / "o.mcap") if command in ("process", "replay") else (bag,))
    refused(run(command, *arguments, "--json", tmp_path / target), "cannot be written")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "in.mcap"]


def test_a_failed_process_keeps_the_earlier_result(run: Run, bag: Path, tmp_path: Path) -> None:
    output = tmp_path / "good.mcap"
    output.write_text("good")
    code, _, _ = run("process", bag, "-o", output, "--start", "50", "--overwrite")
    assert code == 2
    assert output.read_text() == "good"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["good.mcap", "in.mcap"]


@pytest.mark.graph
def test_a_failed_replay_keeps_the_earlier_result(
    run: Run, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(20 + 5 * own_number(10) + 4))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    output = tmp_path / "good.mcap"
    output.write_text("good")
    code, _, err = run("replay", bag, "-o", output, "--start", "50", "--overwrite", *PARAM_ARGUMENTS)
    assert code == 2
    assert "start at 50 s is beyond the end, the bag is 0.100 s long: begin earlier (--start)" in err
    assert output.read_text() == "good"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["good.mcap", "in.mcap"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_nothing_behind(tmp_path: Path, number: int) -> None:
    command = [*STEREO_DEPTH, "synthesize", str(tmp_path / "o.mcap"), "--frames", "100000"]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
        try:
            end = time.monotonic() + 60
            while not any(tmp_path.iterdir()) and time.monotonic() < end:
                time.sleep(0.02)
            assert process.poll() is None
            assert [path.suffix for path in tmp_path.iterdir()] == [".partial"]
            process.send_signal(number)
            _, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode != 0
    assert b"Traceback" not in err
    assert list(tmp_path.iterdir()) == []
    assert process.returncode == 130
    assert err.decode().splitlines()[-1] == f"interrupted: incomplete {tmp_path / 'o.mcap'} removed"


LIBRARY_THAT_WRITES = """
import os, sys
from stereo_depth_ros.cli import main, output, parameters
def show(*arguments, **options):
    os.write(1, b"from C++ before\\n")
    output.show(*arguments, **options)
    os.write(1, b"from C++ after\\n")
parameters.show = show
sys.argv = ["stereo-depth", "parameters", "--json", "-"]
main.main()
"""


def test_what_a_library_writes_to_descriptor_1_goes_to_stderr() -> None:
    done = subprocess.run([sys.executable, "-c", LIBRARY_THAT_WRITES], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    assert done.stderr == "from C++ before\nfrom C++ after\n"


SMALL = ("--frames", "2", "--width", "160", "--height", "120")  # of a pair 38 kB


def limit_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))


def test_a_full_disk_is_one_line(tmp_path: Path, whole: Path) -> None:
    (tmp_path / "good.mcap").write_text("good")
    commands = (
        ["synthesize", str(tmp_path / "good.mcap"), *SMALL, "--overwrite"],
        ["process", str(whole), "-o", str(tmp_path / "good.mcap"), "--overwrite", *PARAM_ARGUMENTS],
        ["info", str(whole), "--json", "/dev/full"],
    )
    for arguments in commands:
        done = subprocess.run(
            [*STEREO_DEPTH, *arguments], capture_output=True, text=True, timeout=120, preexec_fn=limit_files
        )
        # a slow machine shows progress before
        lines = [line for line in done.stderr.splitlines(keepends=True) if not re.match(r"\w+: \d+ of \d+", line)]
        refused((done.returncode, done.stdout, "".join(lines)), "free space on the disk")
        assert [path.name for path in tmp_path.iterdir()] == ["good.mcap"]
        assert (tmp_path / "good.mcap").read_text() == "good"


@pytest.mark.parametrize("text", ["parameters", "parameters --json -", "info --help"])
def test_full_stdout_is_one_line_and_closed_stdout_is_silent(text: str) -> None:
    command = [*STEREO_DEPTH, *text.split()]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    refused((done.returncode, "", done.stderr), "the disk is full: free space on the disk")
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        done = subprocess.run(command, stdout=closed, stderr=subprocess.PIPE, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (1, "")
