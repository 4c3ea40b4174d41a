# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of bags and folders: which captures are of which pattern, what is written, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from scanned import SEQUENCE, errors, pictured, projector_rig, scanner, write_bag, write_manifest

from stereo_depth_ros.active.one_shot.stripes import stripe_pattern
from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.outputs import OUTPUTS
from stereo_depth_ros.synthetic.projection import SyntheticScanner

COUNT = len(SEQUENCE)
ALL = list(range(COUNT))


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line()


def refused(result: tuple[int, str, str], text: str, code: int = 2) -> str:
    """One line of error; that line."""
    exit_code, out, err = result
    assert (exit_code, out) == (code, ""), err
    assert text in err.splitlines()[-1], err
    return err


def disparity(bag: Path, rig: StereoRig) -> F32:
    """The only disparity image of a bag."""
    with BagReader(bag) as reader:
        (message,) = list(reader.messages(["/disparity"]))
        return matched_disparity(reader.deserialize(message), rig)


def write_images(folder: Path, sides: tuple[str, ...] = ("left", "right"), numbers: list[int] | None = None) -> Path:
    """The captures as image files."""
    for number, pattern in enumerate(ALL if numbers is None else numbers):
        for side, image in zip(sides, pictured()[pattern], strict=False):
            (folder / side).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / side / f"{number}.png"), image)
    write_manifest(folder)
    return folder


def save_image(path: Path, pixels: U8) -> None:
    """An RGB image as a file."""
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))


def write_rig(folder: Path, rig: StereoRig) -> list[str]:
    """Calibration files, and the option that names them."""
    for side, camera in (("left", rig.left), ("right", rig.right)):
        write_camera(folder / f"{side}.yaml", camera, side)
    return ["--camera-info", str(folder / "left.yaml"), str(folder / "right.yaml")]


@pytest.fixture
def manifest(tmp_path: Path) -> Path:
    return write_manifest(tmp_path)


def test_a_bag_with_one_capture_of_each_pattern(run: Run, tmp_path: Path, manifest: Path) -> None:
    bag = write_bag(tmp_path / "in.mcap", ALL)
    output, image = tmp_path / "out.mcap", tmp_path / "scan.png"
    code, out, _ = run("scan", bag, "-o", output, "--patterns", manifest, "--preview", image)
    assert code == 0
    assert f"bag written    {output}" in out and f"image written  {image}" in out
    error = errors(disparity(output, scanner().rig))
    assert np.mean(error < 1) > 0.98 and np.median(error) < 0.1
    with BagReader(output) as reader:
        topics = {f"/{row.topic}" for row in OUTPUTS} | {"/left/camera_info", "/right/camera_info"}
        assert {name: info.count for name, info in reader.topics.items()} == dict.fromkeys(topics, 1)
    assert cv2.imread(str(image)).shape[1] > 1000


@pytest.mark.parametrize("kind", ["announced", "changing"])
def test_the_patterns_of_a_longer_bag_are_found(run: Run, tmp_path: Path, manifest: Path, kind: str) -> None:
    """Both ways find the captures of which a bag with one of each has no others."""
    shown = [each for pattern in (1, *ALL, 1) for each in (pattern, pattern, pattern)]
    announced = {3 * (1 + pattern): pattern for pattern in ALL} if kind == "announced" else None
    bag = write_bag(tmp_path / "in.mcap", shown, announced)
    code, out, _ = run("scan", bag, "-o", tmp_path / "out.mcap", "--patterns", manifest, "--json", "-")
    assert code == 0
    (found,) = json.loads(out)["scans"]
    run("scan", write_bag(tmp_path / "one.mcap", ALL), "-o", tmp_path / "1.mcap", "--patterns", manifest)
    one, many = (disparity(tmp_path / name, scanner().rig) for name in ("1.mcap", "out.mcap"))
    np.testing.assert_array_equal(many, one)
    assert found["valid_fraction"] == pytest.approx(np.isfinite(one).mean())


def test_images_of_more_bits_have_one_scale(run: Run, tmp_path: Path, manifest: Path) -> None:
    """The bits of a camera are found from its images: the first black one has fewer than the white ones later."""
    black_first = [1, *ALL[1:], 0]
    sequence = PatternSequence(SEQUENCE.size, tuple(SEQUENCE.patterns[number] for number in (1, *ALL[2:], 0)))
    write_manifest(tmp_path, sequence)
    shown = [*black_first[:1], *black_first[2:]]
    for name, bits in (("8", 8), ("12", 12)):
        bag = write_bag(tmp_path / f"{name}.mcap", shown, bits=bits)
        assert run("scan", bag, "-o", tmp_path / f"{name}-out.mcap", "--patterns", manifest)[0] == 0
    one, other = (disparity(tmp_path / f"{name}-out.mcap", scanner().rig) for name in ("8", "12"))
    assert np.isfinite(other).mean() == pytest.approx(np.isfinite(one).mean(), abs=0.01)
    both = np.isfinite(one) & np.isfinite(other)
    assert np.median(np.abs(one - other)[both]) < 0.02  # 255 levels of 4095 instead of 256


def test_several_scans_of_one_bag(run: Run, tmp_path: Path, manifest: Path) -> None:
    bag = write_bag(tmp_path / "in.mcap", [*ALL, *ALL])
    code, out, err = run(
        "scan", bag, "-o", tmp_path / "out.mcap", "--patterns", manifest, "--settle", "0", "--json", "-"
    )
    assert code == 0
    assert len(json.loads(out)["scans"]) == 2
    assert f"2 scans in {bag}" in err


def test_a_folder_gives_what_the_bag_gives(run: Run, tmp_path: Path, manifest: Path) -> None:
    folder = write_images(tmp_path / "captures")
    code, _, err = run("scan", folder, "-o", tmp_path / "f.mcap", *write_rig(tmp_path, scanner().rig))
    assert code == 0, err
    run("scan", write_bag(tmp_path / "in.mcap", ALL), "-o", tmp_path / "b.mcap", "--patterns", manifest)
    one, other = (disparity(tmp_path / name, scanner().rig) for name in ("f.mcap", "b.mcap"))
    np.testing.assert_allclose(one, other, atol=1e-3)


def test_one_camera_and_a_projector(run: Run, tmp_path: Path) -> None:
    folder = write_images(tmp_path / "captures", ("",))
    rig = projector_rig()
    code, out, err = run(
        "scan", folder, "-o", tmp_path / "o.mcap", "--projector", *write_rig(tmp_path, rig), "--json", "-"
    )
    assert code == 0, err
    (found,) = json.loads(out)["scans"]
    assert found["valid_fraction"] > 0.4
    assert 0.7 < found["median_depth_m"] < 1.5


def test_color_stripes(run: Run, tmp_path: Path) -> None:
    pattern = stripe_pattern((256, 192), stripe_px=4)
    own = SyntheticScanner(240, 180, (256, 192))
    save_image(tmp_path / "stripes.png", pattern)
    for side, image in zip(("left", "right"), own.capture(pattern), strict=True):
        save_image(tmp_path / "captures" / f"{side}.png", image)
    options = ("--patterns", tmp_path / "stripes.png", *write_rig(tmp_path, own.rig))
    code, _, err = run("scan", tmp_path / "captures", "-o", tmp_path / "o.mcap", *options)
    assert code == 0, err
    found = disparity(tmp_path / "o.mcap", own.rig)
    error = np.abs(found - own.truth().disparity_px)[np.isfinite(found)]
    assert np.isfinite(found).mean() > 0.25
    assert np.mean(error < 1) > 0.95 and np.median(error) < 0.2


def test_what_is_missing_is_named(run: Run, tmp_path: Path, manifest: Path) -> None:
    options = ("-o", tmp_path / "o.mcap", "--patterns", manifest)
    without = write_bag(tmp_path / "without.mcap", [*ALL[:5], *ALL[6:]])
    err = refused(run("scan", without, *options), f"{COUNT - 1} images, the sequence has {COUNT} patterns", code=1)
    assert f"6 ({SEQUENCE.patterns[5]})" in err and "is probably missing" in err
    announced = write_bag(tmp_path / "announced.mcap", ALL, {n: n for n in ALL if n not in (4, 7)})
    err = refused(run("scan", announced, *options, "--settle", "0"), "the images of patterns are missing", code=1)
    assert f"4 ({SEQUENCE.patterns[4]}), 7 ({SEQUENCE.patterns[7]})" in err
    exchanged = write_bag(tmp_path / "exchanged.mcap", [*ALL[:5], 7, 6, 5, *ALL[8:]])
    refused(run("scan", exchanged, *options), "capture every pattern once, or correct the manifest", code=1)
    assert not (tmp_path / "o.mcap").exists()


def test_inputs_that_are_none_are_refused(run: Run, tmp_path: Path, manifest: Path) -> None:
    options = ("-o", tmp_path / "o.mcap")
    bag, folder = write_bag(tmp_path / "in.mcap", ALL), write_images(tmp_path / "captures")
    refused(run("scan", bag, *options), "no manifest of the patterns is given")
    refused(run("scan", folder, *options), "no calibration of both cameras is given", code=1)
    refused(run("scan", tmp_path / "missing", *options, "--patterns", manifest), "missing", code=1)
    refused(run("scan", bag, "-o", bag, "--overwrite", "--patterns", manifest), "would overwrite an input", code=1)
    (tmp_path / "patterns.json").write_text("{")
    refused(run("scan", bag, *options, "--patterns", manifest), "is not JSON", code=1)
    manifest.write_text('{"projector": {"width": 64, "height": 48}, "images": [{"role": "white"}]}')
    refused(run("scan", bag, *options, "--patterns", manifest), f"{manifest}: no image has the role gray or phase")
    assert not (tmp_path / "o.mcap").exists()
