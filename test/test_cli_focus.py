# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth focus`: outputs of folders and bags, tables of distances, wrong input."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CommandLine, Run
from focal_stacks import FIRST_M, IMAGES, LAST_M, stack, write_stack

from stereo_depth_ros.active.focus.distances import (
    even_distances,
    read_focus_table,
    table_order,
    thin_lens_distance,
)
from stereo_depth_ros.active.focus.stack import depth_from_focus
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_yaml import camera_to_yaml
from stereo_depth_ros.core.errors import BagError, ConfigError, ImageError
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.plots.preview import preview

RANGE = ("--near", LAST_M, "--far", FIRST_M, "--order", "far-to-near")


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line("focus", columns=110)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_stack(tmp_path / "stack")


def camera(width: int = 160) -> CameraModel:
    K = np.array([[150.0, 0, 81], [0, 145, 58], [0, 0, 1]])
    return CameraModel(width, 120, "plumb_bob", K, np.zeros(5), np.identity(3), np.column_stack([K, np.zeros(3)]))


def test_the_thin_lens() -> None:
    # 1/50 = 1/200 + 1/v has v = 66.67 mm; at v = 50 mm the lens is focused at infinity
    np.testing.assert_allclose(thin_lens_distance(np.array([0.2 / 3, 0.05]), 0.05), [0.2, math.inf])
    with pytest.raises(ConfigError, match="49 mm behind the lens and the focal length is 50 mm"):
        thin_lens_distance(np.array([0.06, 0.049]), 0.05)


def test_even_steps() -> None:
    np.testing.assert_allclose(even_distances(0.5, math.inf, 3), [0.5, 1, math.inf])
    np.testing.assert_allclose(even_distances(1, 4, 4, "distance", "far-to-near"), [4, 3, 2, 1])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((2, 1, 5), "2 m and the farthest 1 m are not a range"),
        ((0, 1, 5), "0 m and the farthest 1 m"),
        ((math.nan, 1, 5), "nan m"),
        ((1, math.inf, 5, "distance"), "the farthest focus is infinite"),
        ((1, 2, 5, "linear"), "law 'linear' is not one of inverse, distance"),
        ((1, 2, 5, "inverse", "up"), "order 'up' is not one of near-to-far, far-to-near"),
    ],
)
def test_ends_that_are_not_a_range(arguments: tuple[float, float, int], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        even_distances(*arguments)


@pytest.mark.parametrize(
    ("text", "focal_length_m", "expected"),
    [
        ("image,distance_m\na.png,0.5\nb.png,inf\n", None, {"a.png": 0.5, "b.png": math.inf}),
        ("# phone\nImage, Distance_mm\na.png, 500\n", None, {"a.png": 0.5}),
        ("image,diopters\na.png,0\nb.png,4\n", None, {"a.png": math.inf, "b.png": 0.25}),
        ("stamp_s,sensor_mm\n1.5,60\n", 0.05, {"1.5": 0.3}),
    ],
)
def test_tables(tmp_path: Path, text: str, focal_length_m: float | None, expected: dict[str, float]) -> None:
    (tmp_path / "t.csv").write_text(text)
    assert read_focus_table(tmp_path / "t.csv", focal_length_m) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("text", "focal_length_m", "error", "problem"),
    [
        ("", None, BagError, "not a table of focus distances"),
        ("image,focus\na,1\n", None, BagError, "not a table of focus distances"),
        ("image,distance_m\n", None, BagError, "not a table of focus distances"),
        ("image,distance_m\na,near\n", None, BagError, "row 2 holds what is not a number"),
        ("image,distance_m\na\n", None, BagError, "row 2 holds what is not a number"),
        ("image,distance_m\na,-1\n", None, BagError, "row 2 holds '-1'"),
        ("image,distance_m\na,nan\n", None, BagError, "row 2 holds 'nan'"),
        ("image,sensor_mm\na,inf\n", 0.05, BagError, "row 2 holds 'inf'"),
        ("image,distance_m\na,1\na,2\n", None, BagError, "row 3 names 'a' again"),
        ("stamp_s,distance_m\na,1\n", None, BagError, "row 2 holds what is not a number"),
        ("image,sensor_mm\na,60\n", None, ConfigError, "the focal length is not given"),
        ("image,distance_m\na,60\n", 0.05, ConfigError, "the focal length has no effect"),
    ],
)
def test_wrong_tables(
    tmp_path: Path, text: str, focal_length_m: float | None, error: type[Exception], problem: str
) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(error, match=problem):
        read_focus_table(tmp_path / "t.csv", focal_length_m)


def test_a_table_that_does_not_match_the_images() -> None:
    table = {"a": 1.0, "b": 2.0}
    assert table_order(table, ["b", "a"], [0, 0], Path("t.csv")).tolist() == [2.0, 1.0]
    with pytest.raises(ImageError, match="does not match the 3 images, no row for: c"):
        table_order(table, ["a", "b", "c"], [0, 0, 0], Path("t.csv"))
    with pytest.raises(ImageError, match="does not match the 1 images, rows without an image: b"):
        table_order(table, ["a"], [0], Path("t.csv"))
    assert table_order({"2.0": 7.0, "1.5": 6.0}, [], [1_500_000_000, 2_000_400_000], Path("t.csv")).tolist() == [6, 7]
    with pytest.raises(ImageError, match=r"no row for: 3\.000"):
        table_order({"2.0": 7.0}, [], [2_000_000_000, 3_000_000_000], Path("t.csv"))


def test_outputs_of_a_folder(run: Run, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "camera.yaml").write_text(camera_to_yaml(camera(), "camera"))
    files = [tmp_path / f"{name}.png" for name in ("depth", "sharp", "preview")]
    more = ("--depth-image", files[0], "--all-in-focus", files[1], "--preview", files[2], "--json", tmp_path / "o.json")
    more = (*more, "--export", tmp_path / "surface.npz")
    arguments = (folder, "-o", tmp_path / "o.mcap", *RANGE, "--camera", tmp_path / "camera.yaml", *more)
    code, out, err = run(*arguments)
    assert code == 0, err
    made = stack()
    expected = depth_from_focus(made.frames, made.distances_m)
    depth_m = expected.depth_m
    assert depth_m is not None
    with BagReader(tmp_path / "o.mcap") as reader:
        found = {each.topic: reader.deserialize(each) for each in reader.messages([*reader.topics])}
    assert {*found} == {
        *("/focus/image_rect_color", "/focus/index", "/focus/index_sigma", "/focus/reasons"),
        *("/depth/image_rect", "/depth/sigma", "/depth/camera_info", "/points2"),
    }
    stored = np.asarray(found["/depth/image_rect"].data).view(np.float32).reshape(120, 160)
    np.testing.assert_array_equal(stored, depth_m)
    K = np.asarray(
        found["/depth/camera_info"].k if hasattr(found["/depth/camera_info"], "k") else found["/depth/camera_info"].K
    )
    assert K.reshape(3, 3)[0, 2] == 81
    cloud = np.asarray(found["/points2"].data).view(np.float32).reshape(120, 160, -1)[..., :3]
    y, x = 70, 100
    np.testing.assert_allclose(cloud[y, x], depth_m[y, x] * np.array([(x - 81) / 150, (y - 58) / 145, 1]), rtol=1e-5)
    np.testing.assert_array_equal(np.isnan(cloud[..., 2]), expected.reasons != 0)
    with np.load(tmp_path / "surface.npz") as surface:
        np.testing.assert_array_equal(surface["depth_m"], depth_m)
        np.testing.assert_array_equal(surface["sigma_m"], expected.sigma_m)
        assert surface["K"].tolist() == [[150, 0, 81], [0, 145, 58], [0, 0, 1]]
        np.testing.assert_array_equal(surface["color"], expected.all_in_focus[..., ::-1])  # the images are BGR
    depth_mm = cv2.imread(str(files[0]), cv2.IMREAD_UNCHANGED)
    assert depth_mm.dtype == np.uint16
    np.testing.assert_array_equal(depth_mm == 0, expected.reasons != 0)
    assert depth_mm[y, x] == round(1e3 * float(depth_m[y, x]))
    np.testing.assert_array_equal(cv2.imread(str(files[1])), expected.all_in_focus)
    shown = preview(expected.all_in_focus, depth_m, "stack", "all in focus")
    np.testing.assert_array_equal(cv2.imread(str(files[2])), shown)
    values = json.loads((tmp_path / "o.json").read_text())
    assert [each["name"] for each in values["images"]] == [f"focus{8 + k}.png" for k in range(IMAGES)]
    assert values["images"][0]["distance_m"] == pytest.approx(FIRST_M)
    assert values["reasons"] == expected.reason_counts()
    assert values["median_depth_m"] == pytest.approx(float(np.nanmedian(depth_m)))
    assert "placed on focus19.png" in out
    code, _, err = run(*arguments)
    assert (code, "already exists" in err) == (1, True)
    assert run(*arguments, "--overwrite")[0] == 0


def test_a_table_gives_the_order_and_the_distances(run: Run, folder: Path, tmp_path: Path) -> None:
    distances = stack().distances_m
    names = [f"focus{8 + k}.png" for k in range(IMAGES)]
    for number, name in enumerate(names):  # names without numbers
        (folder / name).rename(folder / f"{'nopqrabcdefg'[number]}.png")
    rows = [f"{'nopqrabcdefg'[k]}.png,{1000 * distances[k]}" for k in (5, 3, 0, 1, 2, 4, *range(6, IMAGES))]
    (tmp_path / "t.csv").write_text("\n".join(["image,distance_mm", *rows]))
    code, _, err = run(folder, "-o", tmp_path / "o.mcap", "--table", tmp_path / "t.csv", "--json", tmp_path / "o.json")
    assert code == 0, err
    values = json.loads((tmp_path / "o.json").read_text())
    assert [each["distance_m"] for each in values["images"]] == pytest.approx(distances.tolist())
    assert [each["name"][0] for each in values["images"]] == [*"nopqrabcdefg"]
    code, _, err = run(folder, "-o", tmp_path / "p.mcap")
    assert (code, "the order of the images is unknown, a.png has no number" in err) == (2, True)


def test_a_bag_and_only_the_order(run: Run, tmp_path: Path) -> None:
    types = RosbagsTypes()
    with BagWriter(tmp_path / "in.mcap") as bag:
        for frame in stack().frames:
            message = image_message(types, np.asarray(frame.pixels), "bgr8", 10**12 + frame.stamp_ns, "lens")
            bag.write("/camera/image_raw", message, 10**12 + frame.stamp_ns)
    code, out, err = run(tmp_path / "in.mcap", "-o", tmp_path / "o.mcap", "--preview", tmp_path / "p.png")
    assert code == 0, err
    assert "images" in out and "mm" not in out
    with BagReader(tmp_path / "o.mcap") as reader:
        found = {each.topic: reader.deserialize(each) for each in reader.messages([*reader.topics])}
    assert {*found} == {"/focus/image_rect_color", "/focus/index", "/focus/index_sigma", "/focus/reasons"}
    index = np.asarray(found["/focus/index"].data).view(np.float32).reshape(120, 160)
    np.testing.assert_array_equal(index, depth_from_focus(stack().frames).index)
    assert found["/focus/index"].header.frame_id == "lens"
    assert found["/focus/index"].header.stamp.sec == 1001  # of the image with the smallest field of view
    code, _, err = run(tmp_path / "in.mcap", "-o", tmp_path / "q.mcap", "--topic", "/other")
    assert (code, "/other is not a topic of images; the bag has /camera/image_raw" in err) == (1, True)


def test_wrong_input_is_one_line(run: Run, folder: Path, tmp_path: Path) -> None:
    output = ("-o", tmp_path / "o.mcap")
    (tmp_path / "camera.yaml").write_text(camera_to_yaml(camera(320), "camera"))
    (tmp_path / "t.csv").write_text("image,distance_m\nfocus8.png,1\n")
    one = tmp_path / "one"
    one.mkdir()
    cv2.imwrite(str(one / "1.png"), stack().frames[0].pixels)
    (tmp_path / "mixed").mkdir()
    for number, width in enumerate((160, 160, 158)):
        cv2.imwrite(str(tmp_path / "mixed" / f"{number}.png"), stack().frames[number].pixels[:, :width])
    table = ("--table", tmp_path / "t.csv")
    for arguments, text in (
        ((tmp_path / "absent", *output), "absent: does not exist: name a folder of images"),
        ((folder / "focus8.png", *output), "is neither a bag nor a folder of images"),
        ((one, *output), "1 image, a focal stack has at least 3"),
        ((tmp_path / "mixed", *output), "2.png: is 158x120 bgr8, and 0.png is 160x120 bgr8"),
        ((folder, *output, *RANGE[:4]), "the order of the focus is unknown"),
        ((folder, *output, "--near", 1), "--near is given without --far"),
        ((folder, *output, "--far", 1), "--far is given without --near"),
        ((folder, *output, "--near", 2, "--far", 1, *RANGE[4:]), "are not a range"),
        ((folder, *output, *RANGE[4:]), "--order has no effect without --near and --far"),
        ((folder, *output, *table), "the table does not match the 12 images, no row for: focus9.png"),
        ((folder, *output, *table, "--near", 1), "--near has no effect with --table"),
        ((folder, *output, "--focal-length", 50), "--focal-length has no effect without --table"),
        ((folder, *output, "--topic", "/x"), "--topic has no effect with a folder"),
        ((folder, *output, "--depth-image", tmp_path / "d.png"), "--depth-image needs the focus distances"),
        ((folder, *output, *RANGE, "--depth-image", tmp_path / "d.tif"), "does not end in .png"),
        ((folder, *output, "--export", tmp_path / "s.glb"), "--export needs the focus distances"),
        ((folder, *output, *RANGE, "--export", tmp_path / "s.glb"), "--export needs the camera"),
        ((folder, *output, "--window", 4), "window 4 is not an odd number"),
        ((folder, *output, *RANGE, "--camera", tmp_path / "camera.yaml"), "the calibration is of 320x120"),
        ((folder, "-o", tmp_path / "o.bag"), "does not end in .mcap"),
        ((folder, *output, "--preview", folder / "focus8.png", "--overwrite"), "would overwrite an input"),
    ):
        code, _, err = run(*arguments)
        assert code in (1, 2), text
        assert text in err, err
        assert err.count("\n") == 1, err
    assert not (tmp_path / "o.mcap").exists()
