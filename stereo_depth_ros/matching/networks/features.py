# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Features of each pixel by a network, whose products are matching costs."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.matching.networks.image_input import ImageInput, normalization_of
from stereo_depth_ros.matching.networks.network import Network, model_error, open_network

__all__ = ["FeatureNetwork"]

_PROBED_PX = 64  # height and width of the image that the shape of the output is found with


class FeatureNetwork:
    """The network in ``onnx_model`` as features, such as those of Zbontar and LeCun (2016), "fast architecture".

    It has one input, a gray image (H, W) or (1, 1 or 3, H, W), and one output, features (F, h, w) or (1, F, h, w), of
    the size of the image or smaller by a border that is the same on all sides, as of convolutions without padding. With
    ``onnx_normalization`` auto and nothing in the metadata, images are normalized by their own mean and deviation.

    Attributes:
        engine: what runs it, for the log.
        border_px: of the image, on all sides, without features; images are enlarged by it.
    """

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if the file is not such a network."""
        network = open_network(config.onnx_model, config.onnx_provider, "sgm_cost = onnx")
        self.engine = f"{network.provider} by ONNX Runtime"
        self._network = network
        if len(network.inputs) != 1 or len(network.outputs) != 1:
            counts = f"{len(network.inputs)} inputs and {len(network.outputs)} outputs"
            raise model_error(
                network.model,
                f"has {counts}, a network of features has one each, an image and its features",
                (1, 1),
                "use a network of features, or the matcher onnx for one that returns disparities",
            )
        normalization = normalization_of(network, config.onnx_normalization, "standard")
        self._input = ImageInput.of(network.inputs[0], 1, network, normalization, flat=True)
        if self._input.height or self._input.width:
            raise model_error(
                network.model,
                f"takes images of {self._input.width or 'any'} x {self._input.height or 'any'} px only, as features "
                "it must take any size",
                "any size",
                "export it with a variable height and width",
            )
        self._output = network.outputs[0].name
        self._multiple = config.onnx_multiple or int(network.number("size_multiple", 1, 512) or 1)
        self.border_px = self._border()

    def __call__(self, image: U8) -> F32:
        """Features of unit length, float32 (H, F, W), C-contiguous; of length 0 where the network returns 0.

        Raises:
            ConfigError: the network fails on an image of this size.
        """
        height, width = image.shape
        found = self._run(image, self.border_px)[:, :height, :width]
        if found.shape[1:] != image.shape:
            raise _shape_error(self._network, found.shape, image.shape)
        length = np.sqrt(np.square(found).sum(axis=0, keepdims=True))
        features: F32 = np.ascontiguousarray((found / np.maximum(length, np.float32(1e-12))).transpose(1, 0, 2))
        return np.nan_to_num(features, copy=False)

    def _border(self) -> int:
        size = -(-_PROBED_PX // self._multiple) * self._multiple
        found = self._run(np.zeros((size, size), np.uint8), 0)
        rows, columns = size - found.shape[1], size - found.shape[2]
        if rows != columns or rows < 0 or rows % 2:
            raise _shape_error(self._network, found.shape, (size, size))
        return int(rows // 2)

    def _run(self, image: U8, border: int) -> F32:
        """float32 (F, h, w)."""
        tensor = self._input.tensor((image,), self._multiple, border)
        (found,) = self._network.run([self._output], {self._input.name: tensor})
        features = found[0] if found.ndim == 4 and len(found) == 1 else found
        if features.ndim != 3:
            raise _shape_error(self._network, found.shape, image.shape)
        return np.asarray(features, np.float32)


def _shape_error(network: Network, found: tuple[int, ...], size: tuple[int, ...]) -> Exception:
    return model_error(
        network.model,
        f"returns for an image of {size[1]} x {size[0]} px features of shape {found}, they must be (F, height, width), "
        "of every pixel but those of a border that is the same on all sides",
        size,
        "export it with features of full size",
    )
