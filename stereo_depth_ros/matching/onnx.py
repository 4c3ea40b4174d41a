# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matching by a user-supplied neural network: two images in, a disparity map out."""

from __future__ import annotations

import functools
import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.matching.local_consistency import local_consistency
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair, check_search
from stereo_depth_ros.matching.serial import SerialMatcher

__all__ = ["OnnxMatcher"]

INPUT_TYPES: dict[str, type[np.generic]] = {"tensor(float)": np.float32, "tensor(uint8)": np.uint8}
PAD_MULTIPLE = 32  # padding of variable sizes: networks downsample up to five times by 2


class OnnxMatcher(SerialMatcher):
    """The network in the file ``onnx_model``, run by ONNX Runtime on the CPU.

    It has two inputs (1, C, H, W) of 1 or 3 channels with gray values of 0 to 255 as float32 or uint8; any scaling or
    normalization must be part of the network. The left image is the input with "left" in its name, or else the first.
    Of several outputs the disparity is the one with "disp" in its name: (1, 1, H, W), (1, H, W) or (H, W), positive, in
    pixels of the input, one per pixel.

    - Fixed width or height: the images are resized to it; disparities are scaled back and sampled from the nearest
      pixel, because interpolation across an edge lies on neither surface.
    - Variable width or height: the images are padded at the right and bottom to a multiple of 32.
    - ``min_disparity``: the images are shifted by it, so that 0 for the network is the smallest disparity.

    Disparities that leave the right image are BORDER; those that are not finite or outside the search range are
    NO_MATCH. The confidence is local consistency. ``support_px`` is (1, 1), as the receptive field is not known.
    """

    name = "onnx"
    step_px = 1 / X16_STEPS
    support_px = (1, 1)  # the receptive field is not known

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if ONNX Runtime or the file is missing, or inputs or outputs do not match."""
        check_search(config)
        super().__init__(config)
        self._session = _open(config.onnx_model)
        self._left, self._right = _inputs(self._session.get_inputs(), config.onnx_model)
        self._output = _disparity_output(self._session.get_outputs(), config.onnx_model)

    def _match(self, left: U8, right: U8) -> MatchResult:
        check_pair(left, right, self)
        first = self.config.min_disparity
        wider = max(0, -first)
        ours = cv2.copyMakeBorder(left, 0, 0, wider, 0, cv2.BORDER_REPLICATE)
        theirs = cv2.copyMakeBorder(right, 0, 0, max(0, first), wider, cv2.BORDER_REPLICATE)[:, : ours.shape[1]]
        found = self._run(self._left.tensor(ours), self._right.tensor(theirs))
        height, width = self._left.size(ours)
        found = found[:height, :width] * np.float32(ours.shape[1] / width)
        if found.shape != ours.shape:
            found = cv2.resize(found, ours.shape[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
        disparity_px = found[:, wider:] + np.float32(first)
        reasons = _reasons(disparity_px, self.config)
        disparity_px[reasons != 0] = np.nan
        return MatchResult(disparity_px, reasons, self.step_px, functools.partial(local_consistency, disparity_px))

    def _run(self, left: Any, right: Any) -> F32:
        """The disparities of two tensors, float32, of their height and width."""
        model, size = self.config.onnx_model, left.shape[2:]
        try:
            (output,) = self._session.run([self._output], {self._left.name: left, self._right.name: right})
        except Exception as error:  # ONNX Runtime has no common base class of its errors
            raise _model_error(
                model,
                f"fails on inputs of shape {left.shape}: {error}",
                left.shape,
                "export it for images of this size, or of any size",
            ) from error
        if output.shape[-2:] != size or output.size != size[0] * size[1]:
            raise _model_error(
                model,
                f"returns for inputs of shape {left.shape} the output {self._output!r} of shape {output.shape}, "
                "it must have one disparity per pixel",
                size,
                "export its disparity of full size",
            )
        return np.asarray(output, np.float32).reshape(size)


@dataclass(frozen=True)
class _Input:
    """An image input of the network; height and width are None if variable."""

    name: str
    dtype: type[np.generic]
    channels: int
    height: int | None
    width: int | None

    @classmethod
    def of(cls, node: Any, model: str) -> _Input:
        """From the description by ONNX Runtime; ConfigError if it does not take an image."""
        sizes = [size if isinstance(size, int) else None for size in node.shape]
        if len(sizes) != 4 or sizes[0] not in (None, 1) or sizes[1] not in (1, 3) or node.type not in INPUT_TYPES:
            expected = f"{' or '.join(INPUT_TYPES)} of shape (1, 1 or 3, height, width)"
            raise _model_error(
                model,
                f"has an input {node.name!r} that is {node.type} of shape {node.shape}, it must be {expected}",
                expected,
                "export the network so",
            )
        return cls(node.name, INPUT_TYPES[node.type], sizes[1], *sizes[2:])

    def size(self, image: U8) -> tuple[int, int]:
        """Height and width of the image within the tensor."""
        return self.height or image.shape[0], self.width or image.shape[1]

    def tensor(self, image: U8) -> Any:
        """(1, C, H, W) of a gray image (H, W)."""
        height, width = self.size(image)
        if image.shape != (height, width):
            image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        below = 0 if self.height else -height % PAD_MULTIPLE
        beside = 0 if self.width else -width % PAD_MULTIPLE
        padded = cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE)
        return np.repeat(padded[None, None], self.channels, axis=1).astype(self.dtype, copy=False)


def _open(model: str) -> Any:
    """The inference session of a file; cached, as parameters are checked by opening it."""
    if not model:
        raise ConfigError(
            "onnx_model is empty, the matcher onnx needs a network",
            value=model,
            remedy="set it to the path of an .onnx file",
            settings=("onnx_model",),
        )
    if not Path(model).is_file():
        raise _model_error(
            model, "is not a file", "an .onnx file", f"correct the path, relative ones begin at {Path.cwd()}"
        )
    status = Path(model).stat()
    return _session(model, status.st_mtime_ns, status.st_size)


@functools.lru_cache(maxsize=2)
def _session(model: str, _mtime_ns: int, _size: int) -> Any:
    try:
        runtime = importlib.import_module("onnxruntime")
    except ImportError as error:
        raise ConfigError(
            f"the matcher onnx needs onnxruntime, which cannot be imported ({error})", remedy="pip install onnxruntime"
        ) from error
    options = runtime.SessionOptions()
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # fatal only: errors are raised as exceptions
    try:
        return runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime has no common base class of its errors
        raise _model_error(
            model, f"is not a network that can be run: {error}", "an ONNX network", "export it again"
        ) from error


def _model_error(model: str, problem: str, limit: object, remedy: str) -> ConfigError:
    return ConfigError(
        f"onnx_model = {model!r} {problem}", value=model, limit=limit, remedy=remedy, settings=("onnx_model",)
    )


def _inputs(nodes: list[Any], model: str) -> tuple[_Input, _Input]:
    """The left and the right input."""
    if len(nodes) != 2:
        names = ", ".join(node.name for node in nodes)
        raise _model_error(
            model,
            f"has {len(nodes)} input(s), {names}, it must have 2, the left and the right image",
            2,
            "export the network so",
        )
    first, second = (_Input.of(node, model) for node in nodes)
    exchanged = "right" in first.name.lower() and "left" in second.name.lower()
    return (second, first) if exchanged else (first, second)


def _disparity_output(nodes: list[Any], model: str) -> str:
    """The name of the output that is the disparity."""
    names = [str(node.name) for node in nodes]
    disparities = names if len(names) == 1 else [name for name in names if "disp" in name.lower()]
    if len(disparities) != 1:
        raise _model_error(
            model,
            f"has {len(names)} outputs, {', '.join(names)}, exactly one must have disp in its name",
            1,
            "export the network with one output, or rename it",
        )
    return disparities[0]


def _reasons(disparity_px: F32, config: MatchingConfig) -> U8:
    """uint8 (H, W): reasons against disparities of the network."""
    columns = np.arange(disparity_px.shape[1])
    searched = (disparity_px >= config.min_disparity) & (disparity_px <= config.max_disparity)
    outside = (disparity_px > columns) | (disparity_px < columns - columns[-1])
    outside |= (columns < config.min_disparity) | (columns - config.max_disparity > columns[-1])
    reasons = np.where(searched, 0, Reason.NO_MATCH) | np.where(outside, Reason.BORDER, 0)
    return reasons.astype(np.uint8)
