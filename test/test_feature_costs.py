# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Costs of sgm from a network of features: networks with known features, and the costs by their definition."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="builds its networks with onnx")
pytest.importorskip("onnxruntime", reason="runs its networks with onnxruntime")

from test_onnx import Network, shifted_pair

from stereo_depth_ros.cli.given import given_parameters
from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.costs.features import copy_costs, feature_costs
from stereo_depth_ros.matching.networks.features import FeatureNetwork

RANDOM = np.random.default_rng(9)
HEIGHT, WIDTH = 40, 140


def patches(path: Path, radius: int = 1, shape: Any = (1, 1, "height", "width"), name: str = "image") -> str:
    """A network whose features are the gray values around a pixel, without those of the border: a convolution."""
    side = 2 * radius + 1
    kernels = np.identity(side * side, np.float32).reshape(side * side, 1, side, side)
    network = Network(shape, names=(name,))
    image = name
    if len(shape) == 2:
        image = network.add("Unsqueeze", image, network.constant([0, 1], np.int64))
    found = network.add("Conv", network.gray(image), network.constant(kernels))
    if len(shape) == 2:
        found = network.add("Squeeze", found, network.constant([0], np.int64))
    return network.save(path, {"features": found})


def features_of(model: str, image: U8, **fields: Any) -> F32:
    return FeatureNetwork(MatchingConfig(onnx_model=model, **fields))(image)


@pytest.mark.parametrize("shape", [(1, 1, "height", "width"), (1, 3, "height", "width"), ("height", "width")])
def test_features_of_every_pixel_have_unit_length(tmp_path: Path, shape: Any) -> None:
    image = RANDOM.integers(0, 256, (21, 33), dtype=np.uint8)
    found = features_of(patches(tmp_path / "network.onnx", 1, shape), image)
    gray = (image - image.mean()) / image.std()
    wide = np.pad(gray, 1, mode="edge")
    expected = np.stack([wide[j : j + 21, i : i + 33] for j in range(3) for i in range(3)], axis=1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert (found.dtype, found.shape, found.flags.c_contiguous) == (np.float32, (21, 9, 33), True)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_normalization_is_that_of_the_parameter_if_set(tmp_path: Path) -> None:
    model = patches(tmp_path / "network.onnx", 0)
    image = np.array([[0, 100, 200]], np.uint8).repeat(3, axis=0)
    np.testing.assert_array_equal(np.sign(features_of(model, image))[0, 0], [-1, 0, 1])
    np.testing.assert_array_equal(np.sign(features_of(model, image, onnx_normalization="unit"))[0, 0], [0, 1, 1])


def defined_costs(left: F32, right: F32, max_disparity: int, count: int) -> np.ndarray:
    """(H, W, K): by the definition, one disparity after another; 255 outside the right image."""
    height, _, width = left.shape
    costs = np.full((height, width, count), 255)
    for k in range(count):
        d = max_disparity - k
        for x in range(width):
            if 0 <= x - d < width:
                cosine = (left[:, :, x].astype(np.float64) * right[:, :, x - d]).sum(axis=1)
                costs[:, x, k] = np.clip(np.rint(40 * (1 - cosine)), 0, 62)
    return costs


@pytest.mark.parametrize("max_disparity", [31, 20, -3])
def test_costs_by_their_definition(max_disparity: int) -> None:
    sides = RANDOM.normal(size=(2, 5, 7, 60)).astype(np.float32)
    left, right = sides / np.linalg.norm(sides, axis=2, keepdims=True)
    costs = np.full((5, 60, 32), 99, np.uint8)
    feature_costs(0, 5, left, right, max_disparity, np.float32(40), costs)
    expected = defined_costs(left, right, max_disparity, 32)
    inside = expected != 255
    assert np.abs(costs[inside].astype(int) - expected[inside]).max() <= 1  # rounding of the sums
    assert (costs[inside] == expected[inside]).mean() > 0.99
    assert costs[~inside].max() <= 31
    for y, x in ((0, 3), (4, 59)):
        k = np.flatnonzero(inside[y, x])
        if len(k):
            assert (costs[y, x, : k[0]] == min(costs[y, x, k[0]], 31)).all()
            assert (costs[y, x, k[-1] + 1 :] == min(costs[y, x, k[-1]], 31)).all()


def matched(model: str, left: U8, right: U8, **fields: Any) -> MatchResult:
    return create_matcher("sgm", sgm_cost="onnx", onnx_model=model, disparity_range=32, **fields).match(left, right)


def assert_near(result: MatchResult, shift: int) -> None:
    """Everywhere but near the borders; sub-pixel parts are small."""
    inside = result.disparity_px[6:-6, max(0, shift) + 6 : min(0, shift) - 6]
    assert np.abs(inside - shift).max() < 0.1


@pytest.mark.parametrize(("low", "shift"), [(0, 11), (-20, -6)])
def test_sgm_matches_by_the_features(tmp_path: Path, low: int, shift: int) -> None:
    model = patches(tmp_path / "network.onnx", 2)
    left, right = shifted_pair(HEIGHT, WIDTH, shift)
    result = matched(model, left, right, min_disparity=low, speckle_size=0)
    assert_near(result, shift)
    assert result.support_px == (5, 5)
    assert result.confidence is not None and result.confidence[:, 40:-10].mean() > 0.5
    again = matched(model, left, right, min_disparity=low, speckle_size=0)
    assert again.disparity_px.tobytes() == result.disparity_px.tobytes()


def test_other_features_give_other_disparities(tmp_path: Path) -> None:
    """Features of the squared contrast do not see whether it is inverted, as the census does."""
    network = Network(names=("image",))
    gray = network.add("Sub", network.gray("image"), network.constant(127.5))
    kernels = network.constant(np.identity(25, np.float32).reshape(25, 1, 5, 5))
    model = network.save(tmp_path / "network.onnx", {"f": network.add("Conv", network.add("Mul", gray, gray), kernels)})
    left, right = shifted_pair(HEIGHT, WIDTH, 9)
    fields = {"onnx_normalization": "none", "speckle_size": 0}
    assert_near(matched(model, left, 255 - right, **fields), 9)
    census = create_matcher("sgm", disparity_range=32, speckle_size=0).match(left, 255 - right).disparity_px
    assert np.mean(np.abs(census[:, 40:] - 9) < 0.5) < 0.1


def test_more_disparities_in_a_strip_are_never_taken() -> None:
    costs = RANDOM.integers(0, 63, (6, 8, 16), dtype=np.uint8)
    out = np.zeros((3, 8, 20), np.uint8)
    copy_costs(costs, 2, 5, out)
    np.testing.assert_array_equal(out[..., :16], costs[2:5])
    assert (out[..., 16:] == 255).all()


@pytest.mark.parametrize(
    ("names", "shape", "says"),
    [
        (("left", "right"), (1, 1, "height", "width"), r"has 2 inputs and 1 outputs, a network of features has one"),
        (("image",), (1, 1, 40, 80), r"takes images of 80 x 40 px only, as features it must take any size"),
        (("image",), (1, 2, "h", "w"), r"of shape \(1, 1 or 3, height, width\) or \(height, width\)"),
    ],
)
def test_networks_that_give_no_features(tmp_path: Path, names: tuple[str, ...], shape: Any, says: str) -> None:
    network = Network(shape, names=names)
    total = network.gray(names[0]) if len(names) == 1 else network.add("Add", *names)
    model = network.save(tmp_path / "network.onnx", {"features": total})
    with pytest.raises(ConfigError, match=says):
        create_matcher("sgm", sgm_cost="onnx", onnx_model=model)


def test_features_of_another_size(tmp_path: Path) -> None:
    network = Network(names=("image",))
    half = network.add("MaxPool", "image", kernel_shape=[3, 2], strides=[1, 2])
    model = network.save(tmp_path / "network.onnx", {"features": half})
    with pytest.raises(ConfigError, match=r"for an image of 64 x 64 px features of shape \(1, 62, 32\), they must be"):
        create_matcher("sgm", sgm_cost="onnx", onnx_model=model)


def test_what_does_not_go_together(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"onnx_model is empty, sgm_cost = onnx needs a network"):
        create_matcher("sgm", sgm_cost="onnx")
    model = patches(tmp_path / "network.onnx")
    with pytest.raises(ConfigError, match=r"temporal_window = 3 has no effect on the costs of a network"):
        create_matcher("sgm", sgm_cost="onnx", onnx_model=model, temporal_window=3)
    with pytest.raises(ConfigError, match=r"onnx_model has no effect: the matcher is sgm, which does not use it"):
        given_parameters([f"onnx_model:={model}"], "sgm")
    given_parameters([f"onnx_model:={model}", "sgm_cost:=onnx"], "sgm")
