# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stereo pairs of image files by their names."""

from __future__ import annotations

from pathlib import Path

import pytest

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.datasets.image_pairs import find_image_pairs


def touch(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def found(folder: Path, left: str | None = None, right: str | None = None) -> list[tuple[str, str]]:
    """Paths within the folder."""
    pairs = find_image_pairs(folder, left, right).pairs
    return [(left.relative_to(folder).as_posix(), right.relative_to(folder).as_posix()) for left, right in pairs]


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("left/left01.png", "right/right01.png"),
        ("left/cam0_0001.png", "right/cam1_0001.png"),
        ("left/cam1_0001.png", "right/cam0_0001.png"),  # the folder gives the side
        ("left/left_turn.png", "right/left_turn.png"),
        ("left1.png", "right01.png"),
        ("left01.PNG", "right01.png"),
        ("left01.png", "right01.jpg"),
        ("Left/1.png", "Right/1.png"),
        ("bright_left_1.png", "bright_right_1.png"),
        ("left_turn/cam0/1.png", "left_turn/cam1/1.png"),
        ("cam0.png", "cam1.png"),
        ("a/image_0/000007.png", "a/image_1/000007.png"),
        ("image_l/000007.png", "image_r/000007.png"),
    ],
)
def test_names_of_a_pair(tmp_path: Path, left: str, right: str) -> None:
    assert found(touch(tmp_path, left, right)) == [(left, right)]


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("left/image_0.png", "right/image_1.png"),  # frames 0 and 1
        ("left/1.05.png", "right/1.5.png"),  # seconds
        ("left/a/1.png", "right/b/1.png"),
        ("left10.png", "right1.png"),
    ],
)
def test_names_that_are_not_a_pair(tmp_path: Path, left: str, right: str) -> None:
    with pytest.raises(BagError, match="no left image has the number of a right one, such as"):
        find_image_pairs(touch(tmp_path, left, right))


def test_numbers_are_compared_as_numbers_and_order_the_pairs(tmp_path: Path) -> None:
    touch(tmp_path, *(f"left{number}.png" for number in (1, 2, 9, 10)))
    touch(tmp_path, *(f"right{number:03d}.png" for number in (2, 9, 10, 100)))
    pairs = find_image_pairs(tmp_path)
    assert found(tmp_path) == [
        ("left2.png", "right002.png"),
        ("left9.png", "right009.png"),
        ("left10.png", "right010.png"),
    ]
    assert pairs.skipped == [tmp_path / "left1.png", tmp_path / "right100.png"]
    assert pairs.warnings == [
        f"{tmp_path / 'left1.png'}: skipped, it has no right image",
        f"{tmp_path / 'right100.png'}: skipped, it has no left image",
    ]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("left1.png", "left01.png"),
        ("left1.jpg", "left1.png"),
        ("LEFT1.png", "left1.png"),
    ],
)
def test_two_files_of_one_frame_are_refused(tmp_path: Path, one: str, other: str) -> None:
    touch(tmp_path, one, other, other.replace("left", "right"))
    with pytest.raises(BagError) as error:
        find_image_pairs(tmp_path)
    assert one in str(error.value) and other in str(error.value)
    assert "are both the left image of one pair: remove one or rename it" in str(error.value)


def test_equal_names_are_preferred_over_digits_for_cameras(tmp_path: Path) -> None:
    touch(tmp_path, "left_cam0_1.png", "left_cam1_1.png", "right_cam1_1.png")
    assert found(tmp_path) == [("left_cam1_1.png", "right_cam1_1.png")]
    (tmp_path / "right_cam1_1.png").rename(tmp_path / "right_cam2_1.png")
    with pytest.raises(BagError, match="no left image has the number of a right one"):
        find_image_pairs(tmp_path)


def test_a_second_image_of_a_frame_without_a_partner_is_skipped(tmp_path: Path) -> None:
    touch(tmp_path, "left1.png", "left01.png", "left2.png", "right2.png")
    assert found(tmp_path) == [("left2.png", "right2.png")]
    assert len(find_image_pairs(tmp_path).skipped) == 2


def test_other_files_and_masks_are_ignored(tmp_path: Path) -> None:
    touch(
        tmp_path, "left1.png", "right1.png", "left.yaml", "right.yaml", "left1.txt", "mask_left.png", "mask_right.png"
    )
    touch(tmp_path, "masks/left/1.png", "masks/right/1.png", "._left1.png", "._right1.png", "rows.png")
    pairs = find_image_pairs(tmp_path)
    assert found(tmp_path) == [("left1.png", "right1.png")] and not pairs.skipped
    assert pairs.warnings == []


def test_a_name_with_both_sides_is_reported(tmp_path: Path) -> None:
    touch(tmp_path, "left1.png", "right1.png", "left_right_2.png")
    pairs = find_image_pairs(tmp_path)
    assert pairs.skipped == [tmp_path / "left_right_2.png"]
    assert pairs.warnings == [f"{tmp_path / 'left_right_2.png'}: skipped, it names the left and the right camera"]


def test_patterns(tmp_path: Path) -> None:
    touch(tmp_path, "a/x1.png", "a/x2.png", "b/y02.png", "b/y01.png", "b/z1.png", "left1.png", "right1.png")
    assert found(tmp_path, "a/x*.png", "b/y*.png") == [("a/x1.png", "b/y01.png"), ("a/x2.png", "b/y02.png")]
    with pytest.raises(BagError, match=r"1 images such as left1\.png and none of the right camera"):
        find_image_pairs(tmp_path, "left*", "nothing*")


@pytest.mark.parametrize(
    ("left", "right", "names"),
    [
        ("cam*/*.png", None, ["cam1/0001.png", "cam2/0001.png", "cam1/0002.png", "cam2/0002.png"]),
        ("cam*/0001.png", None, ["cam0/0001.png", "cam1/0001.png"]),
        (None, "cam*/0001.png", ["camA/0001.png", "camB/0001.png"]),
        ("img*.png", "img*.png", ["imgL01.png", "imgR01.png", "imgL2.png", "imgR2.png"]),
        ("img*.png", None, ["img_l_1.png", "img_r_1.png"]),
        ("*.png", None, ["rail_Lx1.png", "rail_Rx1.png", "rail_Lx2.png", "rail_Rx2.png"]),
        ("img*L.png", "img*R.png", ["img7L.png", "img7R.png"]),
        ("*_l.png", "*_r.png", ["1_l.png", "1_r.png", "02_l.png", "02_r.png"]),
        ("le*.png", "ri*.png", ["left01.png", "right01.png"]),
        ("a/*", "b/*", ["a/fooL1.png", "b/fooR1.png", "a/fooL2.png", "b/fooR2.png"]),
        (None, None, ["imgL01.png", "imgR01.png", "imgL02.png", "imgR02.png"]),
    ],
)
def test_patterns_with_a_wildcard_for_the_camera(
    tmp_path: Path, left: str | None, right: str | None, names: list[str]
) -> None:
    assert found(touch(tmp_path, *names), left, right) == list(zip(names[::2], names[1::2], strict=True))


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("left*.png", ["left1.png", "left2.png", "left3.png", "right1.png"]),
        ("cam*/*.png", ["cam1/1.png", "cam2/1.png", "cam3/1.png"]),
        ("none*", ["left1.png", "right1.png"]),
    ],
)
def test_one_pattern_that_does_not_match_both_cameras(tmp_path: Path, pattern: str, names: list[str]) -> None:
    with pytest.raises(BagError, match=r"one pattern alone, .* does not match the files of both cameras: give both"):
        find_image_pairs(touch(tmp_path, *names), pattern)
