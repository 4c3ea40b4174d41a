# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes for evaluation: rectified pairs with true disparities, found in folders of datasets."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import BagError, ImageError
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.datasets.image_files import list_images, read_disparity_image, read_image
from stereo_depth_ros.datasets.kitti import read_truth
from stereo_depth_ros.datasets.middlebury_scene import MiddleburyScene
from stereo_depth_ros.datasets.truth_folders import TruthPair, truth_pairs
from stereo_depth_ros.evaluation.occlusion import visible_pixels
from stereo_depth_ros.matching.protocol import Images

__all__ = ["Scene", "SceneSet", "SceneSource", "find_scenes", "make_scene"]

Mask: TypeAlias = npt.NDArray[np.bool_]

# left, right, truth of all pixels, truth of those that both cameras see: KITTI 2015 and 2012
_KITTI_LAYOUTS = (
    ("image_2", "image_3", "disp_occ_0", "disp_noc_0"),
    ("image_0", "image_1", "disp_occ", "disp_noc"),
    ("colored_0", "colored_1", "disp_occ", "disp_noc"),
)


@dataclass(frozen=True)
class Scene:
    """One rectified pair with its true disparities.

    Attributes:
        left, right: uint8 (H, W), gray.
        truth_px: float32 (H, W), x_left - x_right in pixels, NaN where unknown.
        visible: bool (H, W), true where both cameras see the point; undefined where the truth is unknown.
        occlusion: source of ``visible``: "mask" (of the dataset) or "truth" (computed from ``truth_px``).
        foreground: bool (H, W), true on the objects of the KITTI object map; None without one.
        doffs_px: cx_left - cx_right in pixels, the disparity at infinity; 0 where it is unknown.
        earlier: the pairs before this one of a sequence, the oldest first, for matchers of several pairs.
        prior: disparities that another sensor expects in the left image; None without one.
    """

    left: U8
    right: U8
    truth_px: F32
    visible: Mask
    occlusion: str
    foreground: Mask | None = None
    doffs_px: float = 0.0
    earlier: Sequence[Images] = ()
    prior: DisparityPrior | None = None


@dataclass(frozen=True)
class SceneSource:
    """A scene that is read on demand; ``load`` raises StereoDepthError where it cannot be read.

    Attributes:
        name: name of the scene.
        load: reads the scene.
        files: the files that ``load`` reads, if they are those of this scene only.
    """

    name: str
    load: Callable[[], Scene]
    files: tuple[Path, ...] = ()


class SceneSet(Protocol):
    """Scenes of one folder or bag; the length is an upper bound of their number."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[SceneSource]: ...


def make_scene(
    left: U8,
    right: U8,
    truth_px: F32,
    visible: Mask | None = None,
    foreground: Mask | None = None,
    doffs_px: float = 0.0,
    earlier: Sequence[Images] = (),
) -> Scene:
    """A scene of parts of one size; without ``visible`` it is computed from the truth.

    The arguments are those of :class:`Scene`.

    Raises:
        ImageError: sizes that differ, or no pixel with truth.
    """
    parts: dict[str, npt.NDArray[Any] | None] = {}
    parts |= {"left": left, "right": right, "truth": truth_px, "occlusion mask": visible, "object map": foreground}
    sizes = {part: f"{pixels.shape[1]}x{pixels.shape[0]}" for part, pixels in parts.items() if pixels is not None}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{part} {size}" for part, size in sizes.items())
        raise ImageError(f"sizes differ: {listed}", value=sizes, remedy="use images and truth of one resolution")
    if not np.isfinite(truth_px).any():
        raise ImageError("no pixel has a true disparity", value=0, remedy="copy the file with the truth again")
    occlusion = "truth" if visible is None else "mask"
    visible = visible_pixels(truth_px) if visible is None else visible
    return Scene(left, right, truth_px, visible, occlusion, foreground, doffs_px, earlier)


def find_scenes(folder: Path) -> list[SceneSource]:
    """The scenes with truth in a folder of a dataset, or in its folders one or two levels down.

    These are Middlebury scenes of 2001 to 2021, ETH3D two-view scenes, training pairs of KITTI stereo, and pairs of
    DrivingStereo, Sintel stereo and TartanAir.

    Raises:
        BagError: no scenes with truth.
    """
    if found := _scenes_of(folder):
        return found
    for pattern in ("*", "*/*"):
        found += [scene for path in sorted(folder.glob(pattern)) if path.is_dir() for scene in _scenes_of(path)]
    if not found:
        raise BagError(
            "has no scene with truth, neither have its folders one and two levels down",
            subject=str(folder),
            value=0,
            remedy="name a folder of Middlebury, ETH3D, KITTI stereo (training), DrivingStereo, Sintel stereo or "
            "TartanAir with its disparities or depth, or a bag with /truth/disparity",
        )
    return found


def _scenes_of(folder: Path) -> list[SceneSource]:
    """The scenes of this folder alone."""
    for left, right, truth, visible in _KITTI_LAYOUTS:
        if (folder / truth).is_dir() and (folder / left).is_dir():
            folders = (folder / left, folder / right, folder / truth, folder / visible)
            return [
                SceneSource(
                    f"{folder.resolve().name}/{path.stem}",
                    partial(_load_kitti, folders, path.name),
                    tuple(each / path.name for each in (*folders, _objects(folders))),
                )
                for path in list_images(folder / truth)
            ]
    if pairs := truth_pairs(folder):
        name = folder.resolve().name
        return [
            SceneSource(
                f"{name}/{pair.name}", partial(_load_pair, pair), (pair.left, pair.right, pair.truth, *pair.hidden)
            )
            for pair in pairs
        ]
    try:
        scene = MiddleburyScene(folder)
    except BagError:
        return []
    if not scene.truth_path:
        return []
    return [SceneSource(folder.resolve().name, partial(_load_middlebury, scene), tuple(scene.files))]


def _load_middlebury(scene: MiddleburyScene) -> Scene:
    truth_px = scene.truth()
    assert truth_px is not None  # only scenes with truth are listed
    return make_scene(_gray(scene.left_path), _gray(scene.right_path), truth_px, scene.visible())


def _load_pair(pair: TruthPair) -> Scene:
    masks = [np.equal(_gray(path), 0) for path in pair.hidden]
    visible = np.logical_and.reduce(masks) if masks else None
    return make_scene(_gray(pair.left), _gray(pair.right), pair.read(pair.truth), visible)


def _load_kitti(folders: tuple[Path, Path, Path, Path], name: str) -> Scene:
    left, right, truth, visible = folders
    objects = _objects(folders) / name
    return make_scene(
        _gray(left / name),
        _gray(right / name),
        read_truth(truth / name),
        np.isfinite(read_truth(visible / name)) if (visible / name).exists() else None,
        np.greater(read_disparity_image(objects), 0) if objects.exists() else None,
    )


def _objects(folders: tuple[Path, Path, Path, Path]) -> Path:
    return folders[2].parent / "obj_map"


def _gray(path: Path) -> U8:
    pixels = read_image(path)
    return pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)
