# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matching by a user-supplied neural network: two images in, a disparity map out."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.matching.local_consistency import local_consistency
from stereo_depth_ros.matching.networks.image_input import ImageInput, Tensor, normalization_of
from stereo_depth_ros.matching.networks.network import Network, model_error, open_network
from stereo_depth_ros.matching.networks.outputs import MapOutputs, pixel_map, probabilities
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair, check_search
from stereo_depth_ros.matching.serial import SerialMatcher

__all__ = ["OnnxMatcher"]

PAD_MULTIPLES = (32, 64, 128)  # tried where none is given: most networks downsample up to five times by 2
OCCLUDED = 0.5  # probability above which a pixel is taken as occluded


class OnnxMatcher(SerialMatcher):
    """The network in the file ``onnx_model``, run by ONNX Runtime with the execution provider ``onnx_provider``.

    It has two inputs (1, C, H, W) of 1 or 3 channels, or one of 2 or 6 with the left image first, as float32, float16
    or uint8. The left image is the input with "left" in its name, or else the first. Gray values of 0 to 255 are
    normalized by ``onnx_normalization``.

    Outputs have one value per pixel, (1, 1, H, W), (1, H, W), (1, H, W, 1) or (H, W). Of several the disparity has
    "disp" in its name or is the only one of that shape; "conf" is the confidence of each pixel and "occ" the
    probability that it is occluded, both 0 to 1. The disparity is multiplied by ``onnx_scale``, with 0 by 1 or, where
    its mean is negative, by -1; ``onnx_offset`` is added.

    - Fixed width or height: the images are resized to it; disparities are scaled back and sampled from the nearest
      pixel, because interpolation across an edge lies on neither surface.
    - Variable width or height: the images are padded at the right and bottom to a multiple of ``onnx_multiple``; with
      0, of 32, or where the network fails, of 64 or 128.
    - ``min_disparity``: the images are shifted by it, so that 0 for the network is the smallest disparity.

    The metadata of the file may have normalization, disparity_scale, size_multiple and max_disparity, the largest
    disparity that the network finds, px; parameters that are set take precedence.

    Disparities that leave the right image are BORDER; those that are not finite or outside the search range are
    NO_MATCH; occluded pixels are LEFT_RIGHT. The confidence is that of the network, or else local consistency, times
    the probability of not being occluded. ``support_px`` is (1, 1), as the receptive field is not known.
    """

    name = "onnx"
    step_px = 1 / X16_STEPS
    support_px = (1, 1)  # the receptive field is not known

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if ONNX Runtime or the file is missing, or inputs or outputs do not match."""
        check_search(config)
        super().__init__(config)
        network = open_network(config.onnx_model, config.onnx_provider, "the matcher onnx")
        self._network = network
        self.engine = f"{network.provider} by ONNX Runtime"
        self._pair = _PairInput.of(network, normalization_of(network, config.onnx_normalization))
        self._outputs = MapOutputs.of(network, self._pair.left)
        self._scale = config.onnx_scale or network.number("disparity_scale")
        given = config.onnx_multiple or int(network.number("size_multiple", 1, 512) or 0)
        self._multiples = (given,) if given else PAD_MULTIPLES
        self._found_multiples: dict[tuple[int, ...], int] = {}  # by the size of the images, where several are tried
        if not self._pair.left.width:
            self._check_range(1.0)

    def _match(self, left: U8, right: U8) -> MatchResult:
        check_pair(left, right, self)
        first = self.config.min_disparity
        wider = max(0, -first)
        ours = cv2.copyMakeBorder(left, 0, 0, wider, 0, cv2.BORDER_REPLICATE)
        theirs = cv2.copyMakeBorder(right, 0, 0, max(0, first), wider, cv2.BORDER_REPLICATE)[:, : ours.shape[1]]
        shrunk = ours.shape[1] / self._pair.left.size(ours)[1]
        self._check_range(shrunk)
        maps = {name: values[:, wider:] for name, values in self._maps(ours, theirs).items()}
        disparity_px = maps[self._outputs.disparity]
        disparity_px = disparity_px * np.float32(self._scale or _sign(disparity_px))
        disparity_px = disparity_px * np.float32(shrunk) + np.float32(first + self.config.onnx_offset)
        reasons = _reasons(disparity_px, self.config)
        visible, confidence = self._shares(maps)
        if visible is not None:
            reasons |= np.where(visible < 1 - OCCLUDED, Reason.LEFT_RIGHT, 0).astype(np.uint8)
        disparity_px[reasons != 0] = np.nan
        source = functools.partial(local_consistency, disparity_px, visible) if confidence is None else confidence
        return MatchResult(disparity_px, reasons, self.step_px, source)

    def _shares(self, maps: dict[str, F32]) -> tuple[F32 | None, F32 | None]:
        """Probability that a pixel is visible in both images, and its confidence, where the network has them."""
        occlusion, confidence = (
            probabilities(name, np.ascontiguousarray(maps[name]), self._network) if name else None
            for name in (self._outputs.occlusion, self._outputs.confidence)
        )
        visible = None if occlusion is None else 1 - occlusion
        if confidence is not None and visible is not None:
            confidence = confidence * visible
        return visible, confidence

    def _maps(self, left: U8, right: U8) -> dict[str, F32]:
        """The outputs by name, float32 of the size of the images."""
        found = self._run(left, right)
        height, width = self._pair.left.size(left)
        maps = {name: values[:height, :width] for name, values in found.items()}
        if (height, width) == left.shape:
            return maps
        whole = left.shape[::-1]
        return {n: cv2.resize(m, whole, interpolation=cv2.INTER_NEAREST_EXACT) for n, m in maps.items()}

    def _run(self, left: U8, right: U8) -> dict[str, F32]:
        """The outputs by name, with the padding that the network takes."""
        known = self._found_multiples.get(left.shape)
        first_error = None
        for multiple in self._multiples if known is None else (known,):
            try:
                found = self._run_padded(self._pair.tensors(left, right, multiple))
            except ConfigError as error:
                first_error = first_error or error
            else:
                self._found_multiples[left.shape] = multiple
                return found
        assert first_error is not None
        raise first_error

    def _run_padded(self, tensors: dict[str, Tensor]) -> dict[str, F32]:
        names = self._outputs.names
        height, width = next(iter(tensors.values())).shape[2:]
        values = self._network.run(names, tensors)
        maps = zip(names, values, strict=True)
        return {name: pixel_map(name, value, (height, width), self._network) for name, value in maps}

    def _check_range(self, shrunk: float) -> None:
        """Raise ConfigError if the search range is larger than that of the network, with images shrunk by a factor."""
        largest = self._network.number("max_disparity", 1, 4096)
        searched = self.config.num_disparities - 1
        if largest is None or searched <= largest * shrunk:
            return
        limit = int(largest * shrunk + 1) // 16 * 16
        raise ConfigError(
            f"disparity_range = {self.config.num_disparities} is above that of the network "
            f"{self._network.model!r}, which finds disparities of up to {largest * shrunk:.0f} px",
            value=self.config.num_disparities,
            limit=limit,
            remedy=f"use {limit} or less" if limit >= 32 else "use a network for larger disparities",
            settings=("disparity_range",),
        )


@dataclass(frozen=True)
class _PairInput:
    """The inputs for the left and the right image; one for both where they share it."""

    left: ImageInput
    right: ImageInput | None

    @classmethod
    def of(cls, network: Network, normalization: str) -> _PairInput:
        """From the inputs of a network; ConfigError if they do not take a pair."""
        nodes = network.inputs
        if len(nodes) == 1 and len(nodes[0].shape) == 4 and nodes[0].shape[1] in (2, 6):
            return cls(ImageInput.of(nodes[0], 2, network, normalization), None)
        if len(nodes) != 2:
            names = ", ".join(node.name for node in nodes)
            raise model_error(
                network.model,
                f"has {len(nodes)} input(s), {names}, it must have 2, the left and the right image, or one for both "
                "of 2 or 6 channels",
                2,
                "export the network so",
            )
        first, second = (ImageInput.of(node, 1, network, normalization) for node in nodes)
        if (first.height, first.width) != (second.height, second.width):
            sizes = [f"{item.name!r} is {item.height or 'any'} x {item.width or 'any'}" for item in (first, second)]
            raise model_error(
                network.model,
                f"has inputs of two sizes, height x width: {' and '.join(sizes)} px",
                "one size",
                "export the network with one size",
            )
        exchanged = "right" in first.name.lower() and "left" in second.name.lower()
        return cls(second, first) if exchanged else cls(first, second)

    def tensors(self, left: U8, right: U8, multiple: int) -> dict[str, Tensor]:
        """By the names of the inputs, see :meth:`ImageInput.tensor`."""
        if self.right is None:
            return {self.left.name: self.left.tensor((left, right), multiple)}
        sides: Sequence[tuple[ImageInput, U8]] = ((self.left, left), (self.right, right))
        return {side.name: side.tensor((image,), multiple) for side, image in sides}


def _sign(disparity: F32) -> int:
    """-1 where the mean of the finite values is negative, as of networks that return the optical flow along x."""
    finite = disparity[np.isfinite(disparity)]
    return -1 if finite.size and float(finite.mean(dtype=np.float64)) < 0 else 1


def _reasons(disparity_px: F32, config: MatchingConfig) -> U8:
    """uint8 (H, W): reasons against disparities of the network."""
    columns = np.arange(disparity_px.shape[1])
    searched = (disparity_px >= config.min_disparity) & (disparity_px <= config.max_disparity)
    outside = (disparity_px > columns) | (disparity_px < columns - columns[-1])
    outside |= (columns < config.min_disparity) | (columns - config.max_disparity > columns[-1])
    reasons = np.where(searched, 0, Reason.NO_MATCH) | np.where(outside, Reason.BORDER, 0)
    return reasons.astype(np.uint8)
