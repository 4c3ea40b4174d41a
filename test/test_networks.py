# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What networks take and return besides the plain case of test_onnx.py: layouts, normalization, metadata, providers."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

onnx = pytest.importorskip("onnx", reason="builds its networks with onnx")
runtime = pytest.importorskip("onnxruntime", reason="runs its networks with onnxruntime")

from command_line import CommandLine  # noqa: E402
from onnx import TensorProto  # noqa: E402
from stereo_bags import write_truth_bag  # noqa: E402
from test_onnx import Network, assert_shift, block_matching, left_gray, matcher, shifted_pair  # noqa: E402

from stereo_depth_ros.core.errors import ConfigError  # noqa: E402
from stereo_depth_ros.core.types import U8, Reason  # noqa: E402
from stereo_depth_ros.matching.networks import network as networks  # noqa: E402

COLOR = (1, 3, "height", "width")
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet, of gray values of 0 to 1


def levels(height: int = 20, width: int = 300) -> U8:
    """Random gray values."""
    return np.random.default_rng(5).integers(0, 256, (height, width), dtype=np.uint8)


def channel(network: Network, index: int, shape: Any = COLOR) -> str:
    """60 + 20 times a channel of the left image as the network gets it: (1, 1, H, W), positive after normalization."""
    ends = [network.constant([value], np.int64) for value in (index, index + 1, 1)]
    left = network.add("Slice", network.add("Cast", "left", to=TensorProto.FLOAT), *ends)
    nothing = network.add("Mul", network.gray("right"), network.constant(0))
    scaled = network.add("Add", network.add("Mul", left, network.constant(20)), network.constant(60))
    return network.add("Add", scaled, nothing)


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("normalization", ["unit", "signed", "imagenet"])
def test_normalization(tmp_path: Path, normalization: str, index: int) -> None:
    network = Network(COLOR)
    model = network.save(tmp_path / "network.onnx", {"output": channel(network, index)})
    gray = levels()
    found = matcher(model, onnx_normalization=normalization, num_disparities=128).match(gray, gray).disparity_px
    unit = gray / 255.0
    seen = {"unit": unit, "signed": 2 * unit - 1, "imagenet": (unit - MEAN[index]) / DEVIATION[index]}[normalization]
    np.testing.assert_allclose(found[:, 128:], (60 + 20 * seen)[:, 128:], atol=1e-4)


def test_normalization_of_one_channel_is_the_mean_of_the_three(tmp_path: Path) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": channel(network, 0)})
    gray = levels()
    found = matcher(model, onnx_normalization="imagenet", num_disparities=128).match(gray, gray).disparity_px
    seen = (gray / 255.0 - np.mean(MEAN)) / np.mean(DEVIATION)
    np.testing.assert_allclose(found[:, 128:], (60 + 20 * seen)[:, 128:], atol=1e-4)


def test_metadata_of_the_file_unless_a_parameter_is_set(tmp_path: Path) -> None:
    network = Network(COLOR)
    metadata = {"normalization": "unit", "disparity_scale": "0.5"}
    model = network.save(tmp_path / "network.onnx", {"output": channel(network, 1)}, metadata)
    gray = levels()
    inside = np.s_[:, 128:]

    def found(**parameters: Any) -> Any:
        return matcher(model, num_disparities=128, **parameters).match(gray, gray).disparity_px[inside]

    np.testing.assert_allclose(found(), 0.5 * (60 + 20 * (gray[inside] / 255.0)), atol=1e-4)
    parameters = {"onnx_normalization": "signed", "onnx_scale": 1.5}
    np.testing.assert_allclose(found(**parameters), 1.5 * (60 + 20 * (gray[inside] / 127.5 - 1)), atol=1e-4)


@pytest.mark.parametrize(
    ("metadata", "says"),
    [
        ({"normalization": "vgg"}, r"has 'vgg' as its normalization in the metadata, it must be none, unit, signed"),
        ({"disparity_scale": "one"}, r"has 'one' as its disparity_scale in the metadata, it must be a number"),
        ({"size_multiple": "0"}, r"has '0' as its size_multiple in the metadata, it must be a number of 1 to 512"),
        ({"max_disparity": "inf"}, r"has 'inf' as its max_disparity in the metadata"),
    ],
)
def test_wrong_metadata(tmp_path: Path, metadata: dict[str, str], says: str) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": left_gray(network)}, metadata)
    with pytest.raises(ConfigError, match=says):
        matcher(model)


def test_uint8_takes_no_normalization(tmp_path: Path) -> None:
    network = Network(kind=TensorProto.UINT8)
    model = network.save(tmp_path / "network.onnx", {"output": left_gray(network)})
    with pytest.raises(ConfigError, match=r"onnx_normalization = unit, but the input 'left' .* is uint8"):
        matcher(model, onnx_normalization="unit")


def padded_width(network: Network) -> str:
    """The width of the tensor less 100, at each pixel."""
    shape = network.add("Cast", network.add("Shape", "left"), to=TensorProto.FLOAT)
    width = network.add("Gather", shape, network.constant(3, np.int64))
    nothing = network.add("Mul", left_gray(network), network.constant(0))
    return network.add("Add", nothing, network.add("Sub", width, network.constant(100)))


@pytest.mark.parametrize(
    ("multiple", "metadata", "width"), [(0, {}, 160), (16, {}, 144), (0, {"size_multiple": "48"}, 144), (7, {}, 133)]
)
def test_padding(tmp_path: Path, multiple: int, metadata: dict[str, str], width: int) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": padded_width(network)}, metadata)
    gray = levels(50, 130)
    result = matcher(model, onnx_multiple=multiple, num_disparities=96).match(gray, gray)
    assert (result.disparity_px[:, 96:] == width - 100).all()


def test_padding_is_increased_until_the_network_runs(tmp_path: Path) -> None:
    """Pooled by 64 and enlarged again, the sizes agree only if they are multiples of 64."""
    network = Network()
    pooled = network.add("MaxPool", network.gray("left"), kernel_shape=[64, 64], strides=[64, 64])
    enlarged = network.add("Resize", pooled, "", network.constant([1, 1, 64, 64]), mode="nearest")
    whole = network.add("Add", padded_width(network), network.add("Mul", enlarged, network.constant(0)))
    model = network.save(tmp_path / "network.onnx", {"output": whole})
    own = matcher(model, num_disparities=96)
    gray = levels(70, 150)
    for _ in range(2):
        assert (own.match(gray, gray).disparity_px[:, 96:] == 192 - 100).all()
    with pytest.raises(ConfigError, match=r"fails on inputs of shape \(1, 1, 96, 160\)"):
        matcher(model, onnx_multiple=32).match(gray, gray)


@pytest.mark.parametrize(("factor", "scale"), [(1.0, 0.0), (-1.0, 0.0), (-1.0, -1.0), (1 / 140, 140.0), (-8.0, -0.125)])
def test_scale_and_sign(tmp_path: Path, factor: float, scale: float) -> None:
    network = Network()
    scaled = network.add("Mul", block_matching(network), network.constant(factor))
    model = network.save(tmp_path / "network.onnx", {"output": scaled})
    result = matcher(model, onnx_scale=scale).match(*shifted_pair(40, 140, 7))
    np.testing.assert_allclose(result.disparity_px[2:-2, 9:-2], 7, atol=1e-4)


def test_offset_is_added(tmp_path: Path) -> None:
    network = Network()
    biased = network.add("Add", block_matching(network), network.constant(0.625))
    model = network.save(tmp_path / "network.onnx", {"output": biased})
    assert_shift(matcher(model, onnx_offset=-0.625).match(*shifted_pair(40, 140, 7)), 7)


@pytest.mark.parametrize("channels", [2, 6])
def test_one_input_for_both_images(tmp_path: Path, channels: int) -> None:
    network = Network((1, channels, "height", "width"), names=("images",))
    sides = []
    for begin, end in ((0, channels // 2), (channels // 2, channels)):
        ends = [network.constant([value], np.int64) for value in (begin, end, 1)]
        sides.append(network.add("Slice", "images", *ends))
    model = network.save(tmp_path / "network.onnx", {"output": block_matching(network, *sides)})
    assert_shift(matcher(model).match(*shifted_pair(40, 140, 6)), 6)


def test_half_precision_and_pixels_before_channels(tmp_path: Path) -> None:
    network = Network(kind=TensorProto.FLOAT16)
    behind = network.add("Transpose", block_matching(network), perm=[0, 2, 3, 1])
    model = network.save(tmp_path / "network.onnx", {"output": behind})
    assert_shift(matcher(model).match(*shifted_pair(40, 140, 6)), 6)


def test_inputs_of_two_sizes(tmp_path: Path) -> None:
    network = Network((1, 1, 40, 80), (1, 1, 40, 96))
    whole = network.add("ReduceMean", "right", keepdims=1)
    model = network.save(tmp_path / "network.onnx", {"output": network.add("Add", "left", whole)})
    with pytest.raises(ConfigError, match=r"'left' is 40 x 80 and 'right' is 40 x 96 px"):
        matcher(model)


def shares(network: Network, low: float = 0.0, high: float = 1.0) -> str:
    """Gray values of the right image from low to high."""
    unit = network.add("Mul", network.gray("right"), network.constant((high - low) / 255))
    return network.add("Add", unit, network.constant(low))


def test_confidence_of_the_network(tmp_path: Path) -> None:
    network = Network()
    outputs = {"disp_confidence": shares(network), "disp": block_matching(network)}
    model = network.save(tmp_path / "network.onnx", outputs)
    left, right = shifted_pair(51, 140, 6)
    result = matcher(model).match(left, right)
    assert_shift(result, 6)
    assert result.confidence is not None
    expected = np.where(result.reasons == 0, right.astype(np.float32) / 255, 0)
    np.testing.assert_allclose(result.confidence, expected, atol=1e-6)


def test_occluded_pixels_are_rejected_and_less_certain_ones_trusted_less(tmp_path: Path) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"Occlusion": shares(network), "disp": block_matching(network)})
    left, right = shifted_pair(51, 140, 6)
    result = matcher(model).match(left, right)
    occlusion = right.astype(np.float32) / 255
    inside = np.s_[2:-2, 40:-10]
    expected = np.where(occlusion > 0.5, Reason.LEFT_RIGHT, 0)
    np.testing.assert_array_equal(result.reasons[inside], expected[inside])
    assert np.isnan(result.disparity_px[result.reasons != 0]).all()
    confidence = result.confidence
    assert confidence is not None
    assert (confidence[inside] <= 1 - occlusion[inside] + 1e-6).all()
    assert confidence[result.reasons != 0].max() == 0 < confidence[inside].max()


def test_both_multiply_to_the_confidence_and_follow_a_fixed_size(tmp_path: Path) -> None:
    network = Network((1, 1, 40, 70))
    halved = network.add("Mul", shares(network), network.constant(0.4))
    outputs = {"occ": halved, "conf": shares(network, 0.2, 0.9), "disp": network.gray("left")}
    model = network.save(tmp_path / "network.onnx", outputs)
    small = np.random.default_rng(2).integers(0, 15, (40, 70), dtype=np.uint8)
    other = np.random.default_rng(3).integers(0, 256, (40, 70), dtype=np.uint8)
    left, right = (np.repeat(np.repeat(image, 3, axis=0), 2, axis=1) for image in (small, other))
    result = matcher(model).match(left, right)
    assert result.confidence is not None
    unit = right / 255.0
    expected = np.where(result.reasons == 0, (0.2 + 0.7 * unit) * (1 - 0.4 * unit), 0)
    np.testing.assert_allclose(result.confidence, expected, atol=1e-5)
    assert (result.confidence > 0).mean() > 0.5


def test_values_that_are_no_probabilities(tmp_path: Path) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"conf": shares(network, -3, 8), "disp": block_matching(network)})
    with pytest.raises(ConfigError, match=r"returns values of -3 to [78].* as 'conf', they must be 0 to 1: .*sigmoid"):
        matcher(model).match(*shifted_pair(51, 140, 6))


def test_disparity_is_found_by_its_shape(tmp_path: Path) -> None:
    network = Network()
    found = block_matching(network)
    outputs = {"features": network.add("Concat", found, found, axis=1), "out": found, "summary": found}
    shapes = {"features": (1, 2, "height", "width"), "out": (1, 1, "height", "width"), "summary": (1,)}
    outputs["summary"] = network.add("Reshape", network.add("ReduceMax", found, keepdims=0), network.constant([1], int))
    model = network.save(tmp_path / "network.onnx", outputs, shapes=shapes)
    assert_shift(matcher(model).match(*shifted_pair(40, 140, 6)), 6)


@pytest.mark.parametrize("name", ["cuda", "tensorrt", "openvino"])
def test_provider_that_is_not_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": left_gray(network)})
    monkeypatch.setattr(runtime, "get_available_providers", lambda: ["CPUExecutionProvider"])
    with pytest.raises(ConfigError, match=rf"onnx_provider = {name} is not in .* which has cpu: use one of these") as e:
        matcher(model, onnx_provider=name)
    assert (e.value.limit, e.value.settings) == (("cpu",), ("onnx_provider",))


def test_provider_that_does_not_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """ONNX Runtime leaves it out, or raises; with auto the next one takes over."""
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": block_matching(network)})
    asked = []

    def session(path: str, options: Any, providers: list[str], **_: Any) -> Any:
        asked.append(providers[0])
        if providers[0].startswith("OpenVINO"):
            raise RuntimeError("no device")
        return runtime.InferenceSession(path, options, providers=["CPUExecutionProvider"])

    there = ["CUDAExecutionProvider", "OpenVINOExecutionProvider", "CPUExecutionProvider"]
    fake = ModuleType("onnxruntime")
    vars(fake).update(
        InferenceSession=session, SessionOptions=runtime.SessionOptions, get_available_providers=lambda: there
    )
    networks._network.cache_clear()
    monkeypatch.setitem(sys.modules, "onnxruntime", fake)
    try:
        automatic = matcher(model)
        assert (asked, automatic.engine) == (there, "cpu by ONNX Runtime")
        assert_shift(automatic.match(*shifted_pair(40, 140, 6)), 6)
        with pytest.raises(
            ConfigError, match=r"onnx_provider = cuda is in the installed onnxruntime but does not start"
        ):
            matcher(model, onnx_provider="cuda")
    finally:
        networks._network.cache_clear()


def test_search_beyond_the_network(tmp_path: Path) -> None:
    metadata = {"max_disparity": "63"}
    network = Network()
    model = network.save(tmp_path / "any.onnx", {"output": block_matching(network)}, metadata)
    matcher(model, num_disparities=64)
    with pytest.raises(ConfigError, match=r"disparity_range = 80 is above .* up to 63 px: use 64 or less"):
        matcher(model, num_disparities=80)
    network = Network((1, 1, 40, 100))
    model = network.save(tmp_path / "fixed.onnx", {"output": block_matching(network)}, metadata)
    matcher(model, num_disparities=128).match(*shifted_pair(80, 204, 6))  # 63 of its px are 128 of these
    with pytest.raises(ConfigError, match=r"disparity_range = 144 is above .* up to 129 px: use 128 or less"):
        matcher(model, num_disparities=144).match(*shifted_pair(80, 204, 6))


def changed(path: Path, change: Any) -> str:
    """A network that ran, in a file that is changed after that."""
    network = Network()
    model = onnx.load(network.save(path, {"disparity": left_gray(network)}))
    change(model)
    onnx.save(model, str(path))
    return str(path)


def test_versions_and_operators_that_onnxruntime_lacks(tmp_path: Path) -> None:
    """In one line, without what only the authors of ONNX Runtime understand."""

    def later(model: Any) -> None:
        model.ir_version = 99

    def unknown(model: Any) -> None:
        model.graph.node[-1].op_type = "Unheard"

    for change, says in ((later, "Unsupported model IR version: 99"), (unknown, "Unheard")):
        with pytest.raises(
            ConfigError, match=f"is not a network that can be run: .*{says}.*: export it again"
        ) as error:
            matcher(changed(tmp_path / "network.onnx", change))
        assert str(error.value).count("network.onnx") == 1 and "::" not in str(error.value)


@pytest.mark.parametrize("data", [b"", b"\x08\x07\x12", bytes(range(256)) * 9])
def test_files_that_hold_no_network(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "network.onnx"
    path.write_bytes(data)
    with pytest.raises(ConfigError, match=r"network\.onnx' is not an ONNX file: "):
        matcher(str(path))


def test_output_that_is_not_a_number(tmp_path: Path) -> None:
    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": left_gray(network)})
    loaded = onnx.load(model)
    loaded.graph.node[-1].CopyFrom(onnx.helper.make_node("Equal", ["left", "right"], ["output"]))
    loaded.graph.output[0].type.tensor_type.elem_type = TensorProto.BOOL
    onnx.save(loaded, model)
    with pytest.raises(ConfigError, match=r"has an output 'output' of bool: export it as float32"):
        matcher(model).match(*shifted_pair(51, 140, 6))


def test_the_log_says_what_runs_the_network(tmp_path: Path, command_line: CommandLine) -> None:
    """That of process."""
    network = Network()
    model = network.save(
        tmp_path / "network.onnx", {"output": network.add("Mul", left_gray(network), network.constant(0.1))}
    )
    write_truth_bag(tmp_path / "in.mcap", 1)
    run = command_line("process")
    options = ["--matcher", "onnx", "--param", f"onnx_model:={model}", "--param", "disparity_range:=32"]
    code, _, err = run(tmp_path / "in.mcap", "-o", tmp_path / "out.mcap", *options)
    assert (code, "matcher onnx: cpu by ONNX Runtime" in err) == (0, True), err


@pytest.mark.graph
def test_the_log_of_a_node_says_what_runs_the_network(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="graph tests need ROS 2")
    from graph_harness import Graph

    from stereo_depth_ros.nodes.disparity_node import DisparityNode

    network = Network()
    model = network.save(tmp_path / "network.onnx", {"output": left_gray(network)})
    with Graph(DisparityNode, parameters={"stereo_algorithm": 10, "onnx_model": model}) as graph:
        assert "matcher onnx (cpu by ONNX Runtime)" in graph.nodes[0].readiness()[1]
