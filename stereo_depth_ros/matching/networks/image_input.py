# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gray images as the input of a network: its layout, normalization and padding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.matching.networks.network import Network, model_error

__all__ = ["NORMALIZATIONS", "ImageInput", "Tensor", "normalization_of"]

Tensor: TypeAlias = npt.NDArray[Any]

_TYPES: dict[str, type[np.generic]] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
}
# What is subtracted from the gray values of 0 to 255 of each channel, and what they are then divided by. The images
# have the same value in all channels; a network of one channel gets the mean of the three.
_SHIFT_AND_SCALE: Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "none": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    "unit": ((0.0, 0.0, 0.0), (255.0, 255.0, 255.0)),
    "signed": ((127.5, 127.5, 127.5), (127.5, 127.5, 127.5)),
    "imagenet": ((0.485 * 255, 0.456 * 255, 0.406 * 255), (0.229 * 255, 0.224 * 255, 0.225 * 255)),
}
_STANDARD = "standard"  # mean and standard deviation of each image
NORMALIZATIONS = (*_SHIFT_AND_SCALE, _STANDARD)
_FLAT = 1e-3  # standard deviation of an image without contrast, which is not raised above this


def normalization_of(network: Network, given: str, default: str = "none") -> str:
    """The normalization: that of the parameter, or with auto that of the metadata, or else the default.

    Raises:
        ConfigError: the metadata name one that is not known.
    """
    found = network.metadata.get("normalization", default) if given == "auto" else given
    if found not in NORMALIZATIONS:
        raise model_error(
            network.model,
            f"has {found!r} as its normalization in the metadata, it must be {', '.join(NORMALIZATIONS)}",
            NORMALIZATIONS,
            "correct its metadata",
        )
    return found


@dataclass(frozen=True)
class ImageInput:
    """An input of a network, of ``images`` gray images in successive channels.

    Attributes:
        name: of the input.
        dtype: of its elements.
        images: 1, or 2 where the left and the right image share the input.
        channels: of each image, 1 or 3; 0 where the input is (H, W).
        height, width: px, None if variable.
        normalization: one of ``NORMALIZATIONS``.
    """

    name: str
    dtype: type[np.generic]
    images: int
    channels: int
    height: int | None
    width: int | None
    normalization: str

    @classmethod
    def of(cls, node: Any, images: int, network: Network, normalization: str, *, flat: bool = False) -> ImageInput:
        """From the description by ONNX Runtime.

        Args:
            node: the description.
            images: the number of images.
            network: of the input.
            normalization: one of ``NORMALIZATIONS``.
            flat: an input (H, W) is allowed too.

        Raises:
            ConfigError: it takes no such images.
        """
        sizes = [size if isinstance(size, int) else None for size in node.shape]
        if flat and len(sizes) == 2:
            sizes = [1, 0, *sizes]
        channels = (images, 3 * images, *((0,) if flat else ()))
        found = sizes[1] if len(sizes) == 4 and sizes[0] in (None, 1) else None
        if found is None or found not in channels or node.type not in _TYPES:
            shape = f"(1, {channels[0]} or {channels[1]}, height, width){' or (height, width)' * flat}"
            raise model_error(
                network.model,
                f"has an input {node.name!r} that is {node.type} of shape {node.shape}, it must be "
                f"{', '.join(_TYPES)} of shape {shape}",
                shape,
                "export the network so",
            )
        if node.type == "tensor(uint8)" and normalization != "none":
            raise ConfigError(
                f"onnx_normalization = {normalization}, but the input {node.name!r} of {network.model!r} is uint8, "
                "which holds gray values of 0 to 255 only",
                value=normalization,
                limit="none",
                remedy="set it to none, or export the network with inputs of float32",
                settings=("onnx_normalization",),
            )
        height, width = sizes[2:]
        return cls(node.name, _TYPES[node.type], images, found // images, height, width, normalization)

    def size(self, image: U8) -> tuple[int, int]:
        """Height and width of the image within the tensor."""
        return self.height or image.shape[0], self.width or image.shape[1]

    def tensor(self, images: Sequence[U8], multiple: int, border: int = 0) -> Tensor:
        """(1, images * channels, H, W) or (H, W) of the input's type.

        Args:
            images: uint8 (H, W), one for each of ``images``, of one size.
            multiple: variable sizes are padded at the right and bottom to a multiple of it, by the border pixels.
            border: before that they are enlarged by it on all sides, px.
        """
        layers = np.concatenate([self._channels(image, multiple, border) for image in images])
        return (layers[None] if self.channels else layers[0]).astype(self.dtype, copy=False)

    def _channels(self, image: U8, multiple: int, border: int) -> Tensor:
        height, width = self.size(image)
        if image.shape != (height, width):
            image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        below = 0 if self.height else -(height + 2 * border) % multiple
        beside = 0 if self.width else -(width + 2 * border) % multiple
        sides = (border, border + below, border, border + beside)
        return np.stack([cv2.copyMakeBorder(layer, *sides, cv2.BORDER_REPLICATE) for layer in self._normalized(image)])

    def _normalized(self, image: U8) -> Sequence[Tensor]:
        """The channels, uint8 or float32 (H, W) each."""
        count = self.channels or 1
        if self.normalization == "none":
            return [image] * count
        gray: F32 = image.astype(np.float32)
        if self.normalization == _STANDARD:
            mean, deviation = float(gray.mean(dtype=np.float64)), float(gray.std(dtype=np.float64))
            return [(gray - np.float32(mean)) / np.float32(max(deviation, _FLAT))] * count
        shifts, scales = (np.array(values, np.float32) for values in _SHIFT_AND_SCALE[self.normalization])
        if count == 1:
            shifts, scales = shifts.mean(keepdims=True), scales.mean(keepdims=True)
        return [(gray - shift) / scale for shift, scale in zip(shifts, scales, strict=True)]
