# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth view`: every kind of view, of bags and images, and wrong combinations; views of process and replay."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from rendered_views import psnr, rendered_views
from stereo_bags import messages_of

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.messages.image import decode
from stereo_depth_ros.offline.view_frames import BagFrames, pair_frame
from stereo_depth_ros.synthetic.bag import write_synthetic_bag
from stereo_depth_ros.synthetic.sequence import SyntheticSequence
from stereo_depth_ros.views.anaglyph import anaglyph
from stereo_depth_ros.views.color_maps import depth_color, disparity_color
from stereo_depth_ros.views.convergence import converged, subject_disparity
from stereo_depth_ros.views.frame import ViewFrame
from stereo_depth_ros.views.interpolation import interpolate_view
from stereo_depth_ros.views.layouts import arranged
from stereo_depth_ros.views.stereogram import stereogram
from stereo_depth_ros.views.topics import VIEWS

FRAMES = 3
CONFIG = PipelineConfig(matching=MatchingConfig(num_disparities=32))
RANGE = ("--param", "disparity_range:=32")


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("view", columns=100)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("room") / "room.mcap"
    write_synthetic_bag(path, SyntheticSequence(FRAMES, 200, 120))
    return path


@pytest.fixture(scope="module")
def frame(bag: Path) -> ViewFrame:
    """The first one of the bag."""
    return next(iter(BagFrames(BagSelection(bag), CONFIG)))


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Two rectified images."""
    room = rendered_views()
    paths = tmp_path / "l.png", tmp_path / "r.png"
    for path, image in zip(paths, (room.left, room.right), strict=True):
        cv2.imwrite(str(path), image)
    return paths


def read(path: Path) -> U8:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return np.asarray(image, np.uint8)


def shifted(frame: ViewFrame) -> tuple[U8, U8]:
    assert frame.left is not None and frame.right is not None
    return converged(frame.left, frame.right, subject_disparity(frame.disparity_px))


def between(frame: ViewFrame, position: float) -> U8:
    assert frame.left is not None and frame.right is not None
    return interpolate_view(frame.left, frame.right, frame.disparity_px, position)


KINDS: dict[str, tuple[tuple[str, ...], Callable[[ViewFrame], U8]]] = {
    "position": (("--position", "0.25"), lambda f: between(f, 0.25)),
    "anaglyph": (
        ("--anaglyph", "gray", "--filters", "amber-blue"),
        lambda f: anaglyph(*shifted(f), "gray", "amber-blue"),
    ),
    "layout": (("--layout", "cross"), lambda f: arranged(*shifted(f), "cross")),
    "rows": (("--layout", "interlaced"), lambda f: arranged(*shifted(f), "interlaced")),
    "stereogram": (("--stereogram",), lambda f: stereogram(f.disparity_px)),
    "disparity": (("--disparity-color",), lambda f: disparity_color(f.published_px, *f.range_px)),
    "depth": (
        ("--depth-color", "--near", "1", "--far", "9", "--legend"),
        lambda f: depth_color(f.depth_m, 1, 9, legend=True),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_image_of_a_bag(run: Run, bag: Path, tmp_path: Path, frame: ViewFrame, kind: str) -> None:
    options, expected = KINDS[kind]
    code, out, err = run(bag, *options, *RANGE, "-o", tmp_path / "sub" / "view.png")
    assert (code, err) == (0, "")
    np.testing.assert_array_equal(read(tmp_path / "sub" / "view.png"), expected(frame))
    assert "written" in out


def test_convergence_is_shown_and_may_be_given(run: Run, bag: Path, tmp_path: Path, frame: ViewFrame) -> None:
    _, out, _ = run(bag, "--layout", "parallel", *RANGE, "-o", tmp_path / "a.png")
    assert f"at the screen  disparity {subject_disparity(frame.disparity_px)} px" in out
    _, out, _ = run(bag, "--layout", "parallel", "--convergence", "-3.2", *RANGE, "-o", tmp_path / "b.png")
    assert "at the screen  disparity -3 px" in out
    assert frame.left is not None and frame.right is not None
    expected = arranged(*converged(frame.left, frame.right, -3), "parallel")
    np.testing.assert_array_equal(read(tmp_path / "b.png"), expected)


def test_view_of_images_is_near_the_truth(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    code, _, err = run(*pair, "--position", "0.5", *RANGE, "-o", tmp_path / "view.png")
    assert (code, err) == (0, "")
    room = rendered_views()
    blended = cv2.addWeighted(room.left, 0.5, room.right, 0.5, 0)
    found = psnr(read(tmp_path / "view.png"), room.at(0.5))
    # sgm does not see how far the ambiguous checkerboard of the room is; with true disparities it is 38 dB
    assert found > 28 and found > psnr(blended, room.at(0.5)) + 5


def test_raw_images_are_rectified_by_a_calibration(run: Run, tmp_path: Path, bag: Path) -> None:
    """The first pair of the bag as files: the same depth."""
    made = SyntheticSequence(FRAMES, 200, 120)
    for side in ("left", "right"):
        cv2.imwrite(str(tmp_path / f"{side}.png"), getattr(made[0].pair, side).pixels)
        write_camera(tmp_path / f"{side}.yaml", getattr(made.rig, side), side)
    images = tmp_path / "left.png", tmp_path / "right.png"
    files = ("--camera-info", tmp_path / "left.yaml", tmp_path / "right.yaml")
    assert run(*images, *files, "--depth-color", *RANGE, "-o", tmp_path / "files.png")[0] == 0
    assert run(bag, "--depth-color", *RANGE, "-o", tmp_path / "bag.png")[0] == 0
    assert np.abs(read(tmp_path / "files.png").astype(int) - read(tmp_path / "bag.png")).mean() < 0.2


def test_both_images_in_one_file(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "both.png"), np.hstack([read(path) for path in pair]))
    options = ("--anaglyph", "color", *RANGE, "-o")
    assert run(tmp_path / "both.png", "--side-by-side", *options, tmp_path / "one.png")[0] == 0
    assert run(*pair, *options, tmp_path / "two.png")[0] == 0
    np.testing.assert_array_equal(read(tmp_path / "one.png"), read(tmp_path / "two.png"))


def test_texture_of_a_stereogram(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    texture = np.random.default_rng(2).integers(0, 256, (20, 30, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "texture.png"), texture)
    code, *_ = run(*pair, "--stereogram", "--texture", tmp_path / "texture.png", *RANGE, "-o", tmp_path / "s.png")
    room = rendered_views()
    frame = pair_frame(room.left, room.right, None, CONFIG)
    assert code == 0
    np.testing.assert_array_equal(read(tmp_path / "s.png"), stereogram(frame.disparity_px, texture))


@pytest.mark.parametrize("suffix", [".pfm", ".npz"])
def test_disparity_map_alone(run: Run, tmp_path: Path, suffix: str) -> None:
    disparity_px = np.tile(np.linspace(3, 20, 210, dtype=np.float32), (40, 1))
    disparity_px[5:9, 100:110] = np.inf
    path = tmp_path / f"map{suffix}"
    if suffix == ".npz":
        np.savez(path, disparity_px)
    else:
        cv2.imwrite(str(path), disparity_px)
    assert run(path, "--stereogram", "-o", tmp_path / "s.png")[0] == 0
    np.testing.assert_array_equal(read(tmp_path / "s.png"), stereogram(disparity_px))
    assert run(path, "--disparity-color", "-o", tmp_path / "c.png")[0] == 0
    np.testing.assert_array_equal(read(tmp_path / "c.png"), disparity_color(disparity_px, 3, 20))
    (tmp_path / "bad.pfm").write_bytes(b"Pf\n")
    code, _, err = run(tmp_path / "bad.pfm", "--stereogram", "-o", tmp_path / "no.png")
    assert code == 1 and "is not a readable image" in err


def test_wiggle_is_an_animation(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    code, out, _ = run(*pair, "--wiggle", *RANGE, "-o", tmp_path / "w.gif")
    frames = video_frames(tmp_path / "w.gif")
    assert (code, len(frames)) == (0, 8)
    shift_px = int(out.split("disparity ")[1].split()[0])
    left, right = (read(path) for path in pair)
    assert frames[0].shape[1] == left.shape[1] - abs(shift_px)
    first = max(-(shift_px // 2), shift_px - shift_px // 2, 0)
    for frame, image, offset in ((frames[0], left, shift_px // 2), (frames[4], right, shift_px // 2 - shift_px)):
        expected = image[:, first + offset : first + offset + frame.shape[1]]
        assert np.abs(frame[..., 0].astype(int) - expected).mean() < 6
    np.testing.assert_array_equal(frames[1], frames[7])


def test_video_has_a_frame_for_each_pair(run: Run, bag: Path, tmp_path: Path) -> None:
    code, out, err = run(bag, "--disparity-color", *RANGE, "-o", tmp_path / "v.mp4")
    assert (code, err) == (0, "")
    assert f"{FRAMES}, 200x120 px" in out
    video = cv2.VideoCapture(str(tmp_path / "v.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(10)
    frames = video_frames(tmp_path / "v.mp4")
    expected = [disparity_color(f.published_px, *f.range_px) for f in BagFrames(BagSelection(bag), CONFIG)]
    assert len(frames) == FRAMES
    for found, image in zip(frames, expected, strict=True):
        assert np.abs(found.astype(int) - image).mean() < 12  # compressed


def test_pair_that_is_damaged_is_skipped(run: Run, bag: Path, tmp_path: Path) -> None:
    with BagReader(bag) as reader, BagWriter(tmp_path / "damaged.mcap") as writer:
        for number, message in enumerate(reader.messages(["/left/image_raw"])):
            data = message.data[:500] if number == 1 else message.data
            writer.write_raw(message.topic, message.msgtype, data, message.log_time_ns)
        for message in reader.messages({*reader.topics} - {"/left/image_raw"}):
            writer.write_raw(message.topic, message.msgtype, message.data, message.log_time_ns)
    code, _, err = run(tmp_path / "damaged.mcap", "--disparity-color", *RANGE, "-o", tmp_path / "v.mp4")
    assert (code, len(video_frames(tmp_path / "v.mp4"))) == (3, FRAMES - 1)
    assert re.search("warning: pair .* skipped: ", err) and "1 pairs skipped" in err


def test_sweep_moves_from_left_to_right_and_back(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    assert run(*pair, "--sweep", *RANGE, "-o", tmp_path / "v.mp4")[0] == 0
    frames = [frame[..., 0] for frame in video_frames(tmp_path / "v.mp4")]
    left, right = (read(path) for path in pair)
    assert len(frames) == 60
    nearer_left = [psnr(frame, left) > psnr(frame, right) for frame in frames]
    assert nearer_left[0] and nearer_left[-1] and not nearer_left[30]
    assert psnr(frames[30], right) > 25


def video_frames(path: Path) -> list[U8]:
    video, frames = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG), []
    while (found := video.read())[0]:
        frames.append(np.asarray(found[1], np.uint8))
    return frames


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("B -o v.png", "no view is chosen of --position, --sweep, --anaglyph, .*: give one of them"),
        ("B --anaglyph gray --wiggle -o v.png", "--anaglyph, --wiggle are different views: give one of them"),
        ("B --anaglyph blue -o v.png", "anaglyph 'blue' is not one of true, gray.* \\(--anaglyph\\)"),
        ("B --anaglyph gray --filters blue -o v.png", "filters 'blue' is not one of red-cyan.* \\(--filters\\)"),
        ("B --layout above -o v.png", "layout 'above' is not one of parallel.* \\(--layout\\)"),
        (
            "B --position 0.5 --filters red-cyan -o v.png",
            "--filters has no effect with --position: use it with --anaglyph",
        ),
        ("B --stereogram --convergence 3 -o v.png", "--convergence has no effect with --stereogram"),
        (
            "B --disparity-color --near 3 -o v.png",
            "--near has no effect with --disparity-color: use it with --depth-color",
        ),
        ("B --depth-color --near 5 --far 3 -o v.png", "depth_near = 5 m is not below depth_far = 3 m.*(--near, --far)"),
        ("B --wiggle -o v.png", "v.png does not end in .gif, as --wiggle of a bag does: name it v.gif"),
        ("B --sweep -o v.png", "does not end in .mp4"),
        ("B --position 0.5 -o v.jpg", "does not end in .png or .mp4"),
        ("L R --position 0.5 -o v.mp4", "does not end in .png, as --position of images does"),
        ("L R --position 0.5 --start 3 -o v.png", "--start has no effect with images"),
        ("L R --depth-color -o v.png", "--depth-color needs a calibration, images have none: give --camera-info"),
        ("L R --side-by-side --wiggle -o v.gif", "r.png has no effect with --side-by-side, both images are in"),
        (
            "L R --position 0.5 --param queue_size:=3 -o v.png",
            "queue_size has no effect: it is a parameter of the pairing",
        ),
        ("M --position 0.5 -o v.png", "--position needs images, .* is a disparity map: use --stereogram or"),
        ("M --stereogram --matcher bm -o v.png", "--matcher has no effect with a disparity map: leave it out"),
        ("L --position 0.5 -o v.png", "the image of the right camera is missing"),
        ("L R --position 0.5 --param view_position:=1 -o v.png", "view_position has no effect.*: use the options of"),
        ("L R --position 2 -o v.png", "'--position': Input should be less than or equal to 1.5"),
    ],
)
def test_wrong_combinations_are_refused(
    run: Run, bag: Path, pair: tuple[Path, Path], tmp_path: Path, arguments: str, message: str
) -> None:
    paths = {"B": bag, "L": pair[0], "R": pair[1], "M": tmp_path / "map.pfm"}
    words = [paths.get(word, tmp_path / word if word.startswith("v.") else word) for word in arguments.split()]
    code, _, err = run(*words)
    assert code == 2
    assert re.search(message, " ".join(err.split())), err
    assert not [*tmp_path.glob("v.*")]


def test_files_are_protected(run: Run, bag: Path, pair: tuple[Path, Path], tmp_path: Path) -> None:
    code, _, err = run(*pair, "--position", "0.5", "-o", pair[0], "--overwrite")
    assert code == 1 and "would overwrite an input" in err
    (tmp_path / "there.mp4").write_bytes(b"old")
    code, _, err = run(bag, "--disparity-color", "-o", tmp_path / "there.mp4")
    assert code == 1 and "already exists" in err
    assert (tmp_path / "there.mp4").read_bytes() == b"old"
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((60, 100), np.uint8))
    code, _, err = run(pair[0], tmp_path / "small.png", "--position", "0.5", "-o", tmp_path / "v.png")
    assert code == 1 and "(240, 180) and (100, 60)" in err


def decoded_views(path: Path) -> dict[str, dict[int, U8]]:
    types = RosbagsTypes()

    def pixels(data: Any) -> U8:
        return decode(types.deserialize(data, "sensor_msgs/msg/Image"), "view").pixels

    return {topic: {stamp: pixels(data) for stamp, data in messages_of(path, f"/{topic}").items()} for topic in VIEWS}


def test_process_writes_views_where_asked(command_line: CommandLine, bag: Path, tmp_path: Path) -> None:
    process = command_line("process")
    asked = [word for topic in VIEWS for word in ("--view", topic)]
    position = ("--param", "view_position:=0.75")
    assert process(bag, "-o", tmp_path / "with.mcap", *RANGE, *asked, *position)[0] == 0
    found = decoded_views(tmp_path / "with.mcap")
    assert {topic: len(images) for topic, images in found.items()} == dict.fromkeys(VIEWS, FRAMES)
    for frame in BagFrames(BagSelection(bag), CONFIG):
        np.testing.assert_array_equal(found["view/image"][frame.stamp_ns], between(frame, 0.75))
    assert process(bag, "-o", tmp_path / "without.mcap", *RANGE)[0] == 0
    with BagReader(tmp_path / "without.mcap") as reader:
        assert not {f"/{topic}" for topic in VIEWS} & set(reader.topics)
    code, _, err = process(bag, "-o", tmp_path / "no.mcap", *position)
    assert code == 2 and "add --view" in err
    code, _, err = process(bag, "-o", tmp_path / "no.mcap", "--view", "color")
    assert code == 2 and "view color is not one of view/image, anaglyph" in err.replace("'", "")


@pytest.mark.graph
def test_replay_records_the_same_views(command_line: CommandLine, bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    asked = [word for topic in VIEWS for word in ("--view", topic)]
    options = (*RANGE, *asked, "--param", "anaglyph_method:=optimized", "--param", "color_legend:=true")
    assert command_line("process")(bag, "-o", tmp_path / "offline.mcap", *options)[0] == 0
    code, _, err = command_line("replay")(bag, "-o", tmp_path / "live.mcap", *options)
    assert code == 0, err
    offline, live = decoded_views(tmp_path / "offline.mcap"), decoded_views(tmp_path / "live.mcap")
    for topic in VIEWS:
        assert live[topic].keys() == offline[topic].keys() and len(live[topic]) == FRAMES
        for stamp, image in offline[topic].items():
            np.testing.assert_array_equal(live[topic][stamp], image)
