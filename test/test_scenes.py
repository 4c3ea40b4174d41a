# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes for evaluation: layouts, masks, and errors."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from evaluation_scenes import FAR_PX, HEIGHT, NEAR_PX, WIDTH, pair, write, write_kitti, write_scene
from stereo_bags import write_odd_bag, write_truth_bag

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.core.errors import BagError, ImageError, TopicError
from stereo_depth_ros.evaluation.bag_scenes import BagScenes
from stereo_depth_ros.evaluation.plausibility import check_plausible
from stereo_depth_ros.evaluation.scenes import Scene, find_scenes, make_scene


def test_scene_needs_no_calibration(tmp_path: Path) -> None:
    left, right, truth_px = pair()
    (source,) = find_scenes(write_scene(tmp_path / "plane"))
    scene = source.load()
    assert source.name == "plane"
    for found, made in ((scene.left, left), (scene.right, right), (scene.truth_px, truth_px)):
        np.testing.assert_array_equal(found, made)
    assert scene.occlusion == "truth" and scene.foreground is None
    assert not scene.visible[:, :FAR_PX].any()  # maps outside of the right image
    assert not scene.visible[30:80, 60 - NEAR_PX + FAR_PX : 60].any()  # behind the near rectangle
    assert scene.visible[30:80, 60:].all() and scene.visible[:30, FAR_PX:].all()


def test_folders_are_searched_two_levels_down_and_scenes_without_truth_skipped(tmp_path: Path) -> None:
    write_scene(tmp_path / "b")
    write_scene(tmp_path / "set" / "a")
    write_scene(tmp_path / "too" / "deep" / "down")
    (write_scene(tmp_path / "blind") / "disp0.pfm").unlink()
    assert [source.name for source in find_scenes(tmp_path)] == ["b", "a"]
    with pytest.raises(
        BagError, match=r"blind: has no scene with truth, .* two levels down: name a folder of Middlebury"
    ):
        find_scenes(tmp_path / "blind")


@pytest.mark.parametrize("name", ["mask0nocc.png", "nonocc.png", "occl.png"])
def test_mask_of_the_scene_is_used(tmp_path: Path, name: str) -> None:
    folder = write_scene(tmp_path)
    mask = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    mask[5:9, 20:40] = 128
    mask[9, 20:40] = 0
    write(folder / name, mask)
    scene = find_scenes(folder)[0].load()
    assert scene.occlusion == "mask"
    assert np.count_nonzero(~scene.visible) == 5 * 20 and not scene.visible[5:10, 20:40].any()


def test_kitti_training_pairs(tmp_path: Path) -> None:
    (source,) = find_scenes(write_kitti(tmp_path / "kitti" / "training").parent)
    scene = source.load()
    assert source.name == "training/000000_10"
    truth_px = pair()[2]
    np.testing.assert_array_equal(scene.truth_px[10:], truth_px[10:])
    assert np.isnan(scene.truth_px[:10]).all()
    assert scene.occlusion == "mask"
    assert scene.visible[10:, FAR_PX:].all() and not scene.visible[:, :FAR_PX].any()
    assert scene.foreground is not None
    np.testing.assert_array_equal(scene.foreground, truth_px == NEAR_PX)


def test_truth_of_a_bag_is_that_of_the_rectified_verged_pair(tmp_path: Path) -> None:
    path = tmp_path / "room.mcap"
    made = write_truth_bag(path, 2)
    scenes = BagScenes(BagSelection(path))
    sources = list(scenes)
    assert len(scenes) == 2 and [source.name for source in sources] == ["room/0000", "room/0001"]
    scene = sources[1].load()
    assert scene.doffs_px == pytest.approx(made.rig.doffs_px, abs=1e-6) and abs(scene.doffs_px) > 1
    known = np.isfinite(scene.truth_px)
    # stored in steps of 1/256 px
    np.testing.assert_allclose(scene.truth_px[known], made[1].truth_disparity_px[known], atol=1 / 512 + 1e-4)
    assert 0.9 < known.mean() <= 1
    check_plausible(scene)


def test_bags_without_truth_or_pairs_are_refused(tmp_path: Path) -> None:
    write_odd_bag(tmp_path / "odd.mcap", 1)
    with pytest.raises(TopicError, match=r"odd\.mcap: has no /truth/disparity, it has .*/cam0/image.*synthesize"):
        BagScenes(BagSelection(tmp_path / "odd.mcap"))
    with pytest.raises(BagError, match="does not exist"):
        BagScenes(BagSelection(tmp_path / "none.mcap"))


def test_sizes_must_agree() -> None:
    left, right, truth_px = pair()
    with pytest.raises(ImageError, match=r"sizes differ: left 170x96, right 170x96, truth 85x48: .* one resolution"):
        make_scene(left, right, truth_px[::2, ::2].copy())
    with pytest.raises(ImageError, match=r"left 170x96, right 169x96"):
        make_scene(left, right[:, 1:], truth_px)
    with pytest.raises(ImageError, match=r"occlusion mask 170x95"):
        make_scene(left, right, truth_px, visible=np.ones((HEIGHT - 1, WIDTH), np.bool_))
    with pytest.raises(ImageError, match=r"object map 160x96"):
        make_scene(left, right, truth_px, foreground=np.ones((HEIGHT, 160), np.bool_))
    with pytest.raises(ImageError, match="no pixel has a true disparity"):
        make_scene(left, right, np.full_like(truth_px, np.nan))


def test_damaged_truth_is_refused(tmp_path: Path) -> None:
    left, right, _ = pair()
    write(tmp_path / "a_left.png", left)
    write(tmp_path / "a_right.png", right)
    (tmp_path / "a_disp.npz").write_bytes(b"PK damaged")
    with pytest.raises(BagError, match=r"a_disp\.npz: is not a readable array of disparities"):
        find_scenes(tmp_path)[0].load()


def changed(scene: Scene, **parts: object) -> Scene:
    return dataclasses.replace(scene, **parts)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(*pair())


def test_plausible_scene_passes(scene: Scene) -> None:
    check_plausible(scene)
    check_plausible(changed(scene, truth_px=scene.truth_px + np.float32(0.6)))  # rounded, or of another pixel center


@pytest.mark.parametrize("scale", [-1, 1 / 256, 1 / 16, 1 / 3, 0.5, 2, 4, 16, 256])
def test_truth_of_another_scale_is_refused(scene: Scene, scale: float) -> None:
    with pytest.raises(
        ImageError, match=r"scale of the truth looks wrong, it is about .*: check the gray levels per pixel"
    ) as error:
        check_plausible(changed(scene, truth_px=scene.truth_px * np.float32(scale)))
    assert f"about {error.value.value:.3g} times" in error.value.problem
    assert error.value.value == pytest.approx(
        scale, rel=0.05
    )  # matches are in steps of 1/16 px, the far plane is at 6 px


def test_swapped_cameras_are_refused(scene: Scene) -> None:
    with pytest.raises(ImageError, match=r"cameras look swapped: .*: exchange the left and the right images$"):
        check_plausible(changed(scene, left=scene.right, right=scene.left))


def test_images_without_texture_pass(scene: Scene) -> None:
    gray = np.full_like(scene.left, 90)
    check_plausible(changed(scene, left=gray, right=gray))
    small = make_scene(*(part[:40, :60] for part in pair()))
    check_plausible(small)


@pytest.mark.real_data
@pytest.mark.parametrize("place", ["middlebury2001/tsukuba", "middlebury2006/Plastic", "eth3d/terrace"])
def test_real_scenes_pass_and_wrong_ones_are_refused(stereo_data: Path, place: str) -> None:
    scene = find_scenes(stereo_data / place)[0].load()
    check_plausible(scene)
    with pytest.raises(ImageError, match="cameras look swapped"):
        check_plausible(changed(scene, left=scene.right, right=scene.left))
    for scale in (1 / 16, 1 / 3, 2, 8):
        with pytest.raises(ImageError, match="scale of the truth looks wrong"):
            check_plausible(changed(scene, truth_px=scene.truth_px * np.float32(scale)))
