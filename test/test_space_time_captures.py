# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Space-time stereo of rendered and real captures: random light, a vase under stripes, and a wall under speckles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros import Frame, PipelineConfig, StereoPair, StereoPipeline
from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.datasets.images import ImagesDataset
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.projection import ScannerTruth, SyntheticScanner

Mask = npt.NDArray[np.bool_]


@pytest.fixture(scope="module")
def scan() -> tuple[SyntheticScanner, list[StereoPair], ScannerTruth]:
    """Raw captures of sixteen random patterns."""
    scanner, rng = SyntheticScanner(200, 150, (128, 96), seed=5), np.random.default_rng(2)
    pairs = []
    for number in range(16):
        images = scanner.capture(rng.integers(0, 2, (96, 128), np.uint8) * 255)
        cameras = scanner.rig.left, scanner.rig.right
        frames = [Frame(pixels, number, camera.frame_id) for pixels, camera in zip(images, cameras, strict=True)]
        pairs.append(StereoPair(*frames))
    return scanner, pairs, scanner.truth()


@pytest.mark.parametrize("name", ["spacetime", "sgm"])
def test_under_random_light_more_pairs_give_more_and_better_disparities(
    name: str, scan: tuple[SyntheticScanner, list[StereoPair], ScannerTruth]
) -> None:
    scanner, pairs, truth = scan
    seen = truth.lit & ~truth.occluded & (truth.disparity_px < 47)
    share, error = [], []
    for count in (1, 4, 16):
        fields = {"num_disparities": 48, "spacetime_window": 5, "temporal_window": count}
        pipeline = StereoPipeline(PipelineConfig(matching=create_matcher(name, **fields).config), scanner.rig)
        for pair in pairs[-count:]:
            prepared = pipeline.prepare(pair)
        found = pipeline.match(prepared).disparity.disparity_px
        wrong = np.abs(found - truth.disparity_px)[seen]
        share.append((wrong <= 1).mean())  # a hole is wrong
        error.append(np.median(wrong[wrong <= 1]))
    assert share[0] < share[1] < share[2]
    assert share[2] > 0.85
    assert error[2] < error[0]


def vase(stereo_data: Path, folder: Path, rows: slice) -> list[tuple[U8, U8]]:
    """Rows of the rectified pairs. The right images are narrower, and their rows are 2 px above those of the left."""
    source = stereo_data / "structured_light/spacetime_vase"
    if not source.is_dir():
        pytest.skip("no such images")
    # D = d + 614.25 is the disparity of the uncropped images: cx_left - cx_right = -614.25
    rig = StereoRig.from_rectified(2113.121, 2113.121, -608.754, 5.496, 271.078, 0.241016, (623, 512))
    K = rig.right.K - np.array([[0, 0, 0], [0, 0, 2], [0, 0, 0]])
    files = [folder / "left.yaml", folder / "right.yaml"]
    write_camera(files[0], rig.left, "left")
    write_camera(files[1], replace(rig.right, width=553, K=K), "right")
    dataset = ImagesDataset(source, files)
    assert (len(dataset), dataset.rig.width, dataset.rig.doffs_px) == (32, 623, pytest.approx(-614.25))
    rectifier = Rectifier(dataset.rig)
    pairs = [rectifier.rectify(StereoPair(frame.left, frame.right)) for frame in list(dataset)[-16:]]
    return [(pair.left[rows], pair.right[rows]) for pair in pairs]


def noise_px(disparity_px: F32, on: Mask) -> dict[tuple[int, int], float]:
    """Of patches of 15 x 15 px, half of them valid: 1.4826 times the median absolute residual to a quadric."""
    v, u = np.mgrid[-7:8, -7:8] / 7
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(-1, 6)
    noises = {}
    for y in range(0, on.shape[0] - 14, 15):
        for x in range(0, on.shape[1] - 14, 15):
            patch = disparity_px[y : y + 15, x : x + 15].ravel().astype(float)
            valid = np.isfinite(patch)
            if on[y : y + 15, x : x + 15].all() and valid.mean() > 0.5:
                for _ in range(3):
                    error = np.abs(terms @ np.linalg.lstsq(terms[valid], patch[valid], rcond=None)[0] - patch)
                    scale = 1.4826 * float(np.nanmedian(error))
                    valid = error <= 3 * scale + 1e-6
                noises[y, x] = scale
    return noises


@pytest.mark.real_data
def test_a_vase_under_changing_stripes(stereo_data: Path, tmp_path: Path) -> None:
    """The object is where the light changes, whatever the result; all disparities are searched, -106..245."""
    pairs = vase(stereo_data, tmp_path, slice(235, 295))
    lit = np.std([left for left, _ in pairs], axis=0) > 3
    on = cv2.morphologyEx(lit.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8)) > 0

    def match(name: str, count: int, **fields: Any) -> MatchResult:
        search = {"min_disparity": -106, "num_disparities": 352, "spacetime_window": 5}
        matcher = create_matcher(name, **search, temporal_window=count, **fields)
        return matcher.match(*pairs[-1], earlier=pairs[:-1])

    found, single = match("spacetime", 16), match("spacetime", 1)
    assert (found.reasons == 0)[on].mean() >= 0.9
    assert (single.reasons == 0)[on].mean() < 0.5
    for count in (1, 16):
        sgm = match("sgm", count).disparity_px
        both = on & np.isfinite(sgm) & np.isfinite(found.disparity_px)
        assert both.sum() > 0.3 * on.sum()
        assert (np.abs(sgm - found.disparity_px)[both] <= 1).mean() >= 0.9
    unchecked = match("spacetime", 1, uniqueness_ratio=0.0, speckle_size=0)  # else it keeps the best pixels alone
    slanted = match("spacetime", 8, slanted_windows=True)
    before, *after = (noise_px(of.disparity_px, on) for of in (unchecked, found, slanted))
    for noises in after:
        places = before.keys() & noises.keys()
        assert len(places) > 8
        assert np.median([noises[at] for at in places]) <= np.median([before[at] for at in places]) / 3


@pytest.mark.real_data
def test_speckles_of_low_contrast_are_matched_as_densely_as_by_opencv_with_equalized_images(stereo_data: Path) -> None:
    files = [stereo_data / "active/e_active_speckle_d415" / f"image{number}.png" for number in (0, 1)]
    if not files[0].exists():
        pytest.skip("no such images")
    left, right = (np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)[240:360] for path in files)
    equalize = cv2.createCLAHE(2.0, (8, 8)).apply
    sgbm = cv2.StereoSGBM.create(0, 128, 7, 8 * 49, 32 * 49, 1, 0, 10, 100, 2)
    reference = sgbm.compute(equalize(left), equalize(right)) / np.float32(16)
    found = create_matcher("sgm", num_disparities=128).match(left, right)
    both = (found.reasons == 0) & (reference >= 0)
    assert found.valid_fraction >= (reference >= 0).mean()
    assert (np.abs(found.disparity_px - reference)[both] <= 1).mean() > 0.97
    assert 38 < np.nanpercentile(found.disparity_px, 5) < np.nanpercentile(found.disparity_px, 95) < 62
