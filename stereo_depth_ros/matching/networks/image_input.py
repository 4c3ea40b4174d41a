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
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.networks.network import Network, model_error

__all__ = ["NORMALIZATIONS", "ImageInput", "Tensor", "normalization_of"]

Tensor: TypeAlias = npt.NDArray[Any]

_TYPES: dict[str, type[np.generic]] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
}
# Mean and standard deviation of each channel, of gray values of 0 to 255. The images have the same value in all
# channels; a network of one channel gets the mean of the three.
_SHIFT_AND_SCALE: Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "none": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    "unit": ((0.0, 0.0, 0.0), (255.0, 255.0, 255.0)),
    "signed": ((127.5, 127.5, 127.5), (127.5, 127.5, 127.5)),
    "imagenet": ((0.485 * 255, 0.456 * 255, 0.406 * 255), (0.229 * 255, 0.224 * 255, 0.225 * 255)),
}
NORMALIZATIONS = tuple(_SHIFT_AND_SCALE)


def normalization_of(network: Network, given: str) -> str:
    """The normalization: that of the parameter, or with auto that of the metadata, or else none.

    Raises:
        ConfigError: the metadata name one that is not known.
    """
    found = network.metadata.get("normalization", "none") if given == "auto" else given
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
        channels: of each image, 1 or 3.
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
    def of(cls, node: Any, images: int, network: Network, normalization: str) -> ImageInput:
        """From the description by ONNX Runtime.

        Raises:
            ConfigError: it takes no such images.
        """
        sizes = [size if isinstance(size, int) else None for size in node.shape]
        channels = (images, 3 * images)
        if len(sizes) != 4 or sizes[0] not in (None, 1) or sizes[1] not in channels or node.type not in _TYPES:
            expected = f"{', '.join(_TYPES)} of shape (1, {channels[0]} or {channels[1]}, height, width)"
            raise model_error(
                network.model,
                f"has an input {node.name!r} that is {node.type} of shape {node.shape}, it must be {expected}",
                expected,
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
        return cls(node.name, _TYPES[node.type], images, sizes[1] // images, height, width, normalization)

    def size(self, image: U8) -> tuple[int, int]:
        """Height and width of the image within the tensor."""
        return self.height or image.shape[0], self.width or image.shape[1]

    def tensor(self, images: Sequence[U8], multiple: int) -> Tensor:
        """(1, images * channels, H, W) of the input's type.

        Args:
            images: uint8 (H, W), one for each of ``images``, of one size.
            multiple: variable sizes are padded at the right and bottom to a multiple of it, by the border pixels.
        """
        return np.concatenate([self._channels(image, multiple) for image in images], axis=1)

    def _channels(self, image: U8, multiple: int) -> Tensor:
        height, width = self.size(image)
        if image.shape != (height, width):
            image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        below = 0 if self.height else -height % multiple
        beside = 0 if self.width else -width % multiple
        padded = cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE)
        means, deviations = (np.array(values, np.float32) for values in _SHIFT_AND_SCALE[self.normalization])
        if self.channels == 1:
            means, deviations = means.mean(keepdims=True), deviations.mean(keepdims=True)
        if self.normalization == "none":
            repeated: Tensor = np.repeat(padded[None, None], self.channels, axis=1).astype(self.dtype, copy=False)
            return repeated
        normalized = (padded[None, None].astype(np.float32) - means[:, None, None]) / deviations[:, None, None]
        return np.asarray(normalized, self.dtype)
