# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Networks with known disparities: a block matcher, and one that returns the left gray value."""

from __future__ import annotations

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

onnx = pytest.importorskip("onnx", reason="builds its networks with onnx")
pytest.importorskip("onnxruntime", reason="runs its networks with onnxruntime")

from onnx import TensorProto, helper  # noqa: E402

from stereo_depth_ros.config import MatchingConfig  # noqa: E402
from stereo_depth_ros.core.errors import ConfigError, ImageError  # noqa: E402
from stereo_depth_ros.core.types import U8, MatchResult, Reason  # noqa: E402
from stereo_depth_ros.matching import create_matcher  # noqa: E402
from stereo_depth_ros.matching.onnx import OnnxMatcher  # noqa: E402

SHIFTS = 24
FREE = (1, 1, "height", "width")


class Network:
    """A graph that grows node by node, and becomes a file.

    Args:
        left, right: shapes of the inputs.
        kind: their element type.
    """

    def __init__(
        self,
        left: Any = FREE,
        right: Any = None,
        kind: int = TensorProto.FLOAT,
        names: tuple[str, ...] = ("left", "right"),
    ) -> None:
        shapes = (left, right or left)[: len(names)]
        self._inputs = [helper.make_tensor_value_info(n, kind, s) for n, s in zip(names, shapes, strict=True)]
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        name = f"n{len(self._nodes)}"
        self._nodes.append(helper.make_node(operator, inputs, [name], **attributes))
        return name

    def constant(self, values: Any, dtype: Any = np.float32) -> str:
        name = f"c{len(self._constants)}"
        self._constants.append(onnx.numpy_helper.from_array(np.array(values, dtype), name))
        return name

    def gray(self, image: str) -> str:
        """(1, 1, H, W) float, the mean of the channels."""
        return self.add("ReduceMean", self.add("Cast", image, to=TensorProto.FLOAT), axes=[1], keepdims=1)

    def save(
        self,
        path: Path,
        outputs: dict[str, str],
        metadata: dict[str, str] | None = None,
        shapes: dict[str, Any] | None = None,
    ) -> str:
        """Writes a file whose outputs, by name, are these nodes; with metadata and with declared shapes."""
        nodes = [*self._nodes, *(helper.make_node("Identity", [node], [name]) for name, node in outputs.items())]
        infos = [helper.make_tensor_value_info(n, TensorProto.FLOAT, (shapes or {}).get(n)) for n in outputs]
        graph = helper.make_graph(nodes, "test", self._inputs, infos, self._constants)
        opset = helper.make_opsetid("", 13)
        model = helper.make_model(graph, opset_imports=[opset], ir_version=8)
        helper.set_model_props(model, metadata or {})
        onnx.save(model, str(path))
        return str(path)


def block_matching(network: Network, left: str = "left", right: str = "right") -> str:
    """(1, 1, H, W): the shift of 0 to 23 px with the least absolute difference over windows of 5 x 5."""
    left, right = network.gray(left), network.gray(right)
    costs = []
    for shift in range(SHIFTS):
        padded = network.add("Pad", right, network.constant([0, 0, 0, shift, 0, 0, 0, 0], np.int64), mode="edge")
        ends = [network.constant([value], np.int64) for value in (0, -shift if shift else 2**31, 3)]
        moved = network.add("Slice", padded, *ends)
        cost = network.add("Abs", network.add("Sub", left, moved))
        costs.append(network.add("AveragePool", cost, kernel_shape=[5, 5], pads=[2, 2, 2, 2]))
    best = network.add("ArgMin", network.add("Concat", *costs, axis=1), axis=1, keepdims=1)
    return network.add("Cast", best, to=TensorProto.FLOAT)


def left_gray(network: Network) -> str:
    """(1, 1, H, W): the gray value of the left image, whatever the right one is."""
    nothing = network.add("Mul", network.gray("right"), network.constant(0))
    return network.add("Add", network.gray("left"), nothing)


def matcher(model: str, **fields: Any) -> OnnxMatcher:
    return OnnxMatcher(MatchingConfig(**{"num_disparities": 32, "onnx_model": model, **fields}))


def shifted_pair(height: int, width: int, shift: int) -> tuple[U8, U8]:
    """Noise with x_right = x_left - shift."""
    wide = np.random.default_rng(3).integers(0, 256, (height, width + 80), dtype=np.uint8)
    return wide[:, 40 : 40 + width], wide[:, 40 + shift : 40 + shift + width]


def assert_shift(result: MatchResult, shift: int, margin: int = 2) -> None:
    """Everywhere but where windows of the network leave an image: there it sees the replicated border."""
    inside = result.disparity_px[margin:-margin, max(0, shift) + margin : min(0, shift) - margin]
    assert inside.size > 1000
    np.testing.assert_array_equal(inside, shift)


@pytest.mark.parametrize("kind", [TensorProto.FLOAT, TensorProto.UINT8])
@pytest.mark.parametrize(
    ("shape", "squeezed"),
    [
        (FREE, []),
        ((1, 3, "height", "width"), [1]),
        (("batch", 1, None, None), [0, 1]),
        ((1, 3, 51, 131), [0]),
        ((1, 1, 51, "width"), []),
    ],
)
def test_input_layouts_and_output_shapes(tmp_path: Path, kind: int, shape: Any, squeezed: list[int]) -> None:
    network = Network(shape, kind=kind)
    found = block_matching(network)
    if squeezed:
        found = network.add("Squeeze", found, network.constant(squeezed, np.int64))
    model = network.save(tmp_path / "network.onnx", {"output": found})
    result = matcher(model).match(*shifted_pair(51, 131, 9))
    assert (result.disparity_px.dtype, result.reasons.dtype) == (np.float32, np.uint8)
    assert (result.disparity_px.shape, result.reasons.shape) == ((51, 131), (51, 131))
    np.testing.assert_array_equal(result.reasons == 0, np.isfinite(result.disparity_px))
    assert_shift(result, 9)
    assert result.confidence is not None and not result.confidence[result.reasons != 0].any()


@pytest.mark.parametrize(("low", "shift"), [(-16, -5), (-7, 3), (4, 21)])
def test_min_disparity_shifts_the_images(tmp_path: Path, low: int, shift: int) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": block_matching(network)})
    result = matcher(model, min_disparity=low).match(*shifted_pair(40, 140, shift))
    assert_shift(result, shift)


@pytest.mark.parametrize("names", [("left", "right"), ("Right_Image", "image_left"), ("a", "b")])
def test_left_input_is_found_by_name_or_is_first(tmp_path: Path, names: tuple[str, str]) -> None:
    network = Network(names=names)
    ours, theirs = sorted(names, key=lambda name: "right" in name.lower())
    model = network.save(tmp_path / "network.onnx", {"output": block_matching(network, ours, theirs)})
    result = matcher(model).match(*shifted_pair(40, 140, 6))
    assert_shift(result, 6)


def test_variable_sizes_are_padded(tmp_path: Path) -> None:
    """Pooled by 32 and enlarged again, the sizes agree only if they are multiples of 32."""
    network = Network()
    pooled = network.add("MaxPool", network.gray("left"), kernel_shape=[32, 32], strides=[32, 32])
    scales = network.constant([1, 1, 32, 32])
    enlarged = network.add("Resize", pooled, "", scales, mode="nearest")
    unchanged = network.add("Mul", enlarged, network.constant(0))
    found = network.add("Add", block_matching(network), unchanged)
    model = network.save(tmp_path / "network.onnx", {"output": found})
    result = matcher(model).match(*shifted_pair(51, 131, 9))
    assert_shift(result, 9)


def test_fixed_size_scales_images_and_disparities(tmp_path: Path) -> None:
    """Half the width and a third of the height: blocks of 3 x 2 px keep their gray values, which are disparities."""
    network = Network((1, 1, 20, 60))
    model = network.save(tmp_path / "network.onnx", {"output": left_gray(network)})
    small = np.random.default_rng(0).integers(0, 15, (20, 60), dtype=np.uint8)
    left = np.repeat(np.repeat(small, 3, axis=0), 2, axis=1)
    result = matcher(model).match(left, left)
    inside = np.s_[:, 30:]
    np.testing.assert_array_equal(result.disparity_px[inside], 2 * left[inside].astype(np.float32))


@pytest.mark.parametrize("low", [0, -12])
def test_fixed_size_finds_the_shift(tmp_path: Path, low: int) -> None:
    network = Network((1, 1, 64, (144 - low) * 2 // 3))
    model = network.save(tmp_path / "network.onnx", {"output": block_matching(network)})
    left, right = (cv2.GaussianBlur(image, (0, 0), 2) for image in shifted_pair(90, 144, 12))
    result = matcher(model, min_disparity=low).match(left, right)
    # 12 px are 8 px of the network, 16 where its search begins at -12. Half its window is 2 of its pixels, 4 of
    # these, and the blur reaches 6 further.
    assert_shift(result, 12, margin=10)


def reference(gray: U8, low: int) -> tuple[np.ndarray, np.ndarray]:
    """Disparities and reasons of a network that returns sqrt(gray - 10), pixel by pixel."""
    height, width = gray.shape
    disparity, reasons = np.full(gray.shape, np.nan, np.float32), np.zeros(gray.shape, np.uint8)
    for y in range(height):
        for x in range(width):
            d = np.sqrt(float(gray[y, x]) - 10) + low if gray[y, x] >= 10 else np.nan
            if not low <= d <= low + 31:
                reasons[y, x] |= Reason.NO_MATCH
            if x - d < 0 or x - d > width - 1 or x - low < 0 or x - (low + 31) > width - 1:
                reasons[y, x] |= Reason.BORDER
            if not reasons[y, x]:
                disparity[y, x] = d
    return disparity, reasons


@pytest.mark.parametrize("low", [0, 5, -12, -50])
def test_reasons(tmp_path: Path, low: int) -> None:
    network = Network()
    shifted = network.add("Sub", left_gray(network), network.constant(10))
    long = network.add("Mul", network.add("Sqrt", shifted), network.constant(1))
    model = network.save(tmp_path / "network.onnx", {"output": long})
    gray = np.random.default_rng(8).integers(0, 256, (37, 110), dtype=np.uint8)
    out = np.full(gray.shape, 7, np.float32)
    result = matcher(model, min_disparity=low).match(gray, gray, out)
    disparity, reasons = reference(gray, low)
    assert result.disparity_px is out
    np.testing.assert_array_equal(result.reasons, reasons)
    np.testing.assert_allclose(out, disparity, rtol=1e-6, atol=1e-5)
    assert {0, Reason.NO_MATCH, Reason.BORDER} <= set(np.unique(reasons))


def test_disparities_beyond_the_range_are_no_match(tmp_path: Path) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": left_gray(network)})
    gray = np.tile(np.array([30, 31, 32, 90], np.uint8), (40, 40))
    result = matcher(model).match(gray, gray)
    np.testing.assert_array_equal(result.reasons[:, 90:], np.tile([0, 0, 1, 1], (40, 18))[:, 2:])


def test_disparity_among_several_outputs(tmp_path: Path) -> None:
    network = Network()
    found = block_matching(network)
    other = network.add("Neg", found)
    model = network.save(tmp_path / "network.onnx", {"features": other, "Disparity_full": found})
    assert_shift(matcher(model).match(*shifted_pair(40, 140, 6)), 6)


def test_same_input_same_bytes_in_any_memory(tmp_path: Path) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": block_matching(network)})
    left, right = shifted_pair(50, 140, 7)
    by_name = create_matcher("onnx", disparity_range=32, onnx_model=model)
    assert (by_name.name, by_name.step_px) == ("onnx", 1 / 16)
    expected = by_name.match(left, right)
    frozen = np.frombuffer(left.tobytes(), np.uint8).reshape(left.shape)
    for _ in range(2):
        result = by_name.match(frozen, right.copy())
        assert result.disparity_px.tobytes() == expected.disparity_px.tobytes()
        assert result.reasons.tobytes() == expected.reasons.tobytes()


def test_two_threads_and_a_reused_buffer(tmp_path: Path) -> None:
    network = Network()
    shared = matcher(network.save(tmp_path / "network.onnx", {"output": block_matching(network)}))
    pairs = [shifted_pair(50, 140, 7), shifted_pair(50, 140, 12)]
    expected = [shared.match(*pair) for pair in pairs]
    out = np.empty((50, 140), np.float32)
    first = shared.match(*pairs[0], out)
    shared.match(*pairs[1], out)
    np.testing.assert_array_equal(first.confidence, expected[0].confidence)

    def work(thread: int) -> bool:
        found = [shared.match(*pairs[thread]).disparity_px.tobytes() for _ in range(10)]
        return found == [expected[thread].disparity_px.tobytes()] * 10

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(work, range(2))) == [True, True]


def test_a_network_is_opened_once_and_again_when_its_file_changes(tmp_path: Path) -> None:
    model = tmp_path / "model.onnx"
    network = Network()
    network.save(model, {"disparity": block_matching(network)})
    checked, used = matcher(str(model)), matcher(str(model), min_disparity=3)
    assert used._network is checked._network, "the one that the parameters were checked with"
    os.utime(model, ns=(1, 1))
    assert matcher(str(model))._network is not checked._network


def test_missing_model_or_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"onnx_model is empty.*set it to the path of an \.onnx file"):
        create_matcher("onnx")
    with pytest.raises(ConfigError, match=r"onnx_model = '.*none\.onnx' is not a file: correct the path"):
        matcher(str(tmp_path / "none.onnx"))
    with pytest.raises(ConfigError, match=r"is not a file"):
        matcher(str(tmp_path))
    (tmp_path / "text.onnx").write_text("not a network")
    with pytest.raises(ConfigError, match=r"text\.onnx' is not an ONNX file: .*: export it again"):
        matcher(str(tmp_path / "text.onnx"))


def test_missing_onnxruntime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": left_gray(network)})
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match=r"matcher onnx needs onnxruntime.*pip install onnxruntime"):
        matcher(model)


def test_wrong_number_of_inputs(tmp_path: Path) -> None:
    network = Network(names=("image",))
    model = network.save(tmp_path / "network.onnx", {"output": network.gray("image")})
    with pytest.raises(ConfigError, match=r"has 1 input\(s\), image, it must have 2, the left and the right image"):
        matcher(model)


@pytest.mark.parametrize(
    ("shape", "kind", "says"),
    [
        ((1, 2, 40, 80), TensorProto.FLOAT, r"tensor\(float\) of shape \[1, 2, 40, 80\]"),
        ((2, 1, 40, 80), TensorProto.FLOAT, r"tensor\(float\) of shape \[2, 1, 40, 80\]"),
        ((1, "channels", 40, 80), TensorProto.FLOAT, r"tensor\(float\) of shape \[1, 'channels', 40, 80\]"),
        ((3, 40, 80), TensorProto.FLOAT, r"tensor\(float\) of shape \[3, 40, 80\]"),
        (FREE, TensorProto.DOUBLE, r"tensor\(double\) of shape \[1, 1, 'height', 'width'\]"),
    ],
)
def test_inputs_that_do_not_take_an_image(tmp_path: Path, shape: Any, kind: int, says: str) -> None:
    network = Network(shape, kind=kind)
    total = network.add("Cast", network.add("Add", "left", "right"), to=TensorProto.FLOAT)
    model = network.save(tmp_path / "network.onnx", {"output": total})
    with pytest.raises(
        ConfigError, match=rf"input 'left' that is {says}, it must be .* of shape \(1, 1 or 3, height, width\)"
    ):
        matcher(model)


@pytest.mark.parametrize("names", [("first", "second"), ("disp_coarse", "disp_fine")])
def test_ambiguous_outputs(tmp_path: Path, names: tuple[str, str]) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", dict.fromkeys(names, left_gray(network)))
    with pytest.raises(ConfigError, match=rf"has 2 outputs, {names[0]}, {names[1]}, exactly one must have disp"):
        matcher(model)


def test_output_of_another_size(tmp_path: Path) -> None:
    network = Network()
    half = network.add("MaxPool", left_gray(network), kernel_shape=[2, 2], strides=[2, 2])
    twice = network.add("Concat", left_gray(network), left_gray(network), axis=1)
    for found, shape in ((half, r"\(1, 1, 32, 64\)"), (twice, r"\(1, 2, 64, 128\)")):
        model = network.save(tmp_path / "network.onnx", {"output": found})
        with pytest.raises(
            ConfigError,
            match=rf"images of 128 x 64 px the output 'output' of shape {shape}, it must have one value per",
        ):
            matcher(model).match(*shifted_pair(50, 100, 3))


def test_network_that_fails(tmp_path: Path) -> None:
    network = Network()
    fixed = network.add("Add", left_gray(network), network.constant(np.zeros((1, 1, 96, 32))))
    model = network.save(tmp_path / "network.onnx", {"output": fixed})
    with pytest.raises(
        ConfigError, match=r"fails on inputs of shape \(1, 1, 64, 128\): (?s:.*)export it for images of this"
    ):
        matcher(model).match(*shifted_pair(50, 100, 3))


def test_refused_search_and_images(tmp_path: Path) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": left_gray(network)})
    with pytest.raises(ConfigError, match=r"disparities 2032\.\.2063 are searched"):
        matcher(model, min_disparity=2032)
    good = np.zeros((60, 120), np.uint8)
    with pytest.raises(ImageError, match=r"left image is \(60, 120\), right image is \(60, 121\)"):
        matcher(model).match(good, np.zeros((60, 121), np.uint8))
    with pytest.raises(ImageError, match=r"disparity buffer is float64"):
        matcher(model).match(good, good, np.zeros((60, 120)))  # type: ignore[arg-type]
