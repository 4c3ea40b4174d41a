# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The documents for users: their code blocks, shell commands and links, and what the commands read."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import known_projector
import numpy as np
from camera_file_texts import camchain, truth
from evaluation_scenes import HEIGHT, WIDTH, write_scene
from focal_stacks import write_distances, write_stack
from known_projector import BESIDE
from light_stripe_images import board_camera, write_boards
from posed_bags import write_drive, write_kitti
from rendered_boards import SIZE, KnownRig, chessboard_points, chessboard_print, poses
from rendered_turntable import rendering_camera, write_table
from sheet_views import write_toy
from stripe_scans import exact_plane, scanner, write_scan
from test_datasets import make_euroc, make_kitti
from test_kitti_lidar import sequence as make_kitti_with_sweeps

from stereo_depth_ros.active.light_stripe.plane_file import write_plane
from stereo_depth_ros.active.structured_light.manifest import MANIFEST, manifest_text
from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.calibration.projection import project
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.offline.pairs import read_pairs

__all__ = ["BLOCKS", "DOCUMENTS", "ROOT", "Block", "Call", "make_inputs", "output_after", "read", "setup_value"]

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = ("README.md", *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md"))), "CONTRIBUTING.md")
SAMPLE_BAG = "bags/synthetic_room.mcap"
SQUARE_M, PRINT_CELL_PX, FINE = 0.025, 40, 3
RIG = KnownRig(
    "plumb_bob",
    np.array([311.0, 316.0, 205.0, 144.0, 0, 0, 0, 0, 0]),
    np.array([322.0, 319.0, 192.0, 153.0, 0, 0, 0, 0, 0]),
    np.array([0.01, -0.03, 0.008, -0.11, 0.003, 0.002]),
)


def read(document: str) -> str:
    """The text of a document, by its path in the repository."""
    return (ROOT / document).read_text("utf-8")


@dataclass(frozen=True)
class Call:
    """One call of a program in a shell block: the words of the command line."""

    words: tuple[str, ...]

    def __str__(self) -> str:
        return " ".join(self.words)


@dataclass(frozen=True)
class Block:
    """A code block: document, line of its first line, language and text."""

    document: str
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.document}:{self.line}"

    @property
    def calls(self) -> list[Call]:
        """Every call of a program; && separates calls, # begins a comment."""
        found = []
        for line in self.text.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            ends = [-1, *(index for index, word in enumerate(words) if word == "&&"), len(words)]
            found += [Call(tuple(words[first + 1 : end])) for first, end in pairwise(ends)]
        return [call for call in found if call.words]


def _blocks(document: str) -> list[Block]:
    text = read(document)
    return [
        Block(document, text.count("\n", 0, match.start(2)) + 1, match[1], match[2])
        for match in re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    ]


BLOCKS = [block for document in DOCUMENTS for block in _blocks(document)]


def output_after(block: Block) -> list[str]:
    """The lines of the text block that follows, the output of the block; `...` stands for lines that are left out."""
    position = BLOCKS.index(block) + 1
    if position < len(BLOCKS) and BLOCKS[position].language == "text" and BLOCKS[position].document == block.document:
        return [line for line in BLOCKS[position].text.splitlines() if line != "..."]
    return []


def _write_short_bag(path: Path) -> None:
    """The first two pairs of the sample bag."""
    with BagReader(ROOT / SAMPLE_BAG) as bag, BagWriter(path) as writer:
        for message in bag.messages(None, bag.start_ns, bag.start_ns + 150_000_000):
            writer.write_raw(message.topic, message.msgtype, message.data, message.log_time_ns)


def _write_board_images(folder: Path) -> None:
    """Six pairs of a chessboard of 9x6 inner corners, by lenses without distortion."""
    board_m, (print_, origin) = chessboard_points(9, 6, SQUARE_M), chessboard_print(9, 6)
    height, width = print_.shape
    ends = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    ends_m = np.column_stack((SQUARE_M * (ends / PRINT_CELL_PX + origin), np.zeros(4)))
    for number, pose in enumerate(poses(6, board_m, RIG, seed=3)):
        for side, camera, at in (("left", RIG.left, pose), ("right", RIG.right, RIG.second(pose))):
            seen_px = FINE * (project(RIG.model, camera, at, ends_m).image_px + 0.5)
            view = cv2.getPerspectiveTransform(ends.astype(np.float32), seen_px.astype(np.float32))
            size = (FINE * SIZE[0], FINE * SIZE[1])
            fine = cv2.warpPerspective(print_, view, size, borderMode=cv2.BORDER_CONSTANT, borderValue=110)
            _write_image(folder / side / f"{number}.png", cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA))


def _write_board_poses(folder: Path) -> None:
    """Four poses of a board under a Gray code."""
    sequence = PatternSequence.of_kind("gray", BESIDE.projector_size, rows=True)
    for number, pose in enumerate(known_projector.poses(BESIDE, 4, seed=6)):
        for place, image in enumerate(BESIDE.captures(pose, sequence)):
            _write_image(folder / f"{number}" / f"{place}.png", image)
    (folder / MANIFEST).write_text(manifest_text(sequence))


def _write_image(path: Path, image: U8) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def _write_pair(left: Path, right: Path) -> None:
    """The first raw pair of the sample bag."""
    pair, _ = next(read_pairs(ROOT / SAMPLE_BAG))
    _write_image(left, pair.left.pixels)
    _write_image(right, pair.right.pixels)


def _write_calibration(folder: Path) -> None:
    """That of the sample bag."""
    folder.mkdir(exist_ok=True)
    _, rig = next(read_pairs(ROOT / SAMPLE_BAG))
    for side, camera in (("left", rig.left), ("right", rig.right)):
        write_camera(folder / f"{side}.yaml", camera, side)


def _write_middlebury(folder: Path) -> None:
    write_scene(folder)
    camera = f"[150 0 {WIDTH / 2}; 0 150 {HEIGHT / 2}; 0 0 1]"
    text = f"cam0={camera}\ncam1={camera}\ndoffs=0\nbaseline=193\nwidth={WIDTH}\nheight={HEIGHT}\nndisp=32\n"
    (folder / "calib.txt").write_text(text)


def _write_image_pairs(folder: Path) -> None:
    _write_pair(folder / "left" / "0.png", folder / "right" / "0.png")
    _write_calibration(folder)


def _write_network(path: Path) -> None:
    """Its disparities are a fifth of the gray values."""
    from test_onnx import Network, left_gray  # which needs onnx

    network = Network()
    network.save(path, {"disparity": network.add("Mul", left_gray(network), network.constant(0.2))})


def _write_feature_network(path: Path) -> None:
    """Its features are the gray values around each pixel."""
    from test_feature_costs import patches

    patches(path, 1)


def _camera_beside(path: Path) -> CameraModel:
    """The camera of the images that are there."""
    return board_camera() if (path.parent / "laser_boards").exists() else rendering_camera()


# What the documents name and a user has: how the tests make it, smaller. The path is that of the name.
INPUTS: Mapping[str, Callable[[Path], object]] = {
    SAMPLE_BAG: _write_short_bag,
    "board_images": _write_board_images,
    "board_poses": _write_board_poses,
    "calibration": _write_calibration,
    "camchain.yaml": lambda path: path.write_text(camchain(truth("plumb_bob"), "radtan")),
    "left.png": lambda path: _write_pair(path, path.with_name("right.png")),
    "Motorcycle": _write_middlebury,
    "kitti_odometry": make_kitti,
    "kitti_drive": make_kitti_with_sweeps,
    "MH_01_easy": make_euroc,
    "image_pairs": _write_image_pairs,
    "sequence_07": write_kitti,
    "robot.mcap": write_drive,
    "toy_views": write_toy,
    "laser_boards": write_boards,
    "laser.yaml": lambda path: write_plane(path, exact_plane(), scanner().rig.left),
    "scan_images": lambda path: write_scan(path.parent / "scan").joinpath("images").rename(path),
    "table": write_table,
    "focal_stack": write_stack,
    "distances.csv": write_distances,
    "network.onnx": _write_network,
    "features.onnx": _write_feature_network,
    "camera.yaml": lambda path: write_camera(path, _camera_beside(path), "camera"),
}


def make_inputs(folder: Path, text: str, *, whole_bag: bool = False) -> None:
    """What a text names, unless a command of it writes it (-o), in a folder that stands for the repository.

    Args:
        folder: where it is made.
        text: of a code block.
        whole_bag: the sample bag itself in place of its first two pairs.
    """
    for part in ("config", "benchmarks"):
        (folder / part).symlink_to(ROOT / part)
    (folder / "bags").mkdir()
    read_text = re.sub(r"-o \S+", "", text)
    for name, make in INPUTS.items():
        if name == SAMPLE_BAG and whole_bag:
            (folder / name).symlink_to(ROOT / name)
        elif re.search(rf"(?<![\w/.-]){re.escape(name)}\b", read_text):
            make(folder / name)


def setup_value(name: str) -> list[str]:
    """A list of setup.py, which cannot be imported without running the setup: an assignment or an argument."""
    for node in ast.walk(ast.parse((ROOT / "setup.py").read_text("utf-8"))):
        named = isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name
        if named or (isinstance(node, ast.keyword) and node.arg == name):
            return list(ast.literal_eval(node.value))  # type: ignore[attr-defined]
    raise AssertionError(f"setup.py has no {name}")
