# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs of a network: which one is the disparity, the confidence and the occlusion, and their values per pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32
from stereo_depth_ros.matching.networks.image_input import ImageInput
from stereo_depth_ros.matching.networks.network import Network, model_error

__all__ = ["MapOutputs", "pixel_map", "probabilities"]

_CONFIDENCE, _OCCLUSION, _DISPARITY = "conf", "occ", "disp"
_ROUNDING = 1e-3  # by which a share may lie outside 0..1


@dataclass(frozen=True)
class MapOutputs:
    """Names of the outputs with one value per pixel; None where the network has none."""

    disparity: str
    confidence: str | None = None
    occlusion: str | None = None

    @classmethod
    def of(cls, network: Network, image: ImageInput) -> MapOutputs:
        """By their names: conf, occ and disp, in this order. Of other outputs the disparity is the only one by shape.

        Args:
            network: the network.
            image: its left image, whose height and width the outputs have.

        Raises:
            ConfigError: several outputs may be the disparity, or none.
        """
        confidence = _named(network.outputs, _CONFIDENCE)
        occlusion = _named([node for node in network.outputs if node not in confidence], _OCCLUSION)
        others = [node for node in network.outputs if node not in confidence and node not in occlusion]
        maps = [node for node in others if _may_be_map(node, image)] if len(others) > 1 else others
        disparities = maps if len(maps) == 1 else _named(maps, _DISPARITY)
        if len(disparities) != 1 or len(confidence) > 1 or len(occlusion) > 1:
            names = [str(node.name) for node in network.outputs]
            raise model_error(
                network.model,
                f"has {len(names)} outputs, {', '.join(names)}, exactly one must have disp in its name, and at most "
                "one each conf and occ",
                1,
                "export the network with one output, or rename it",
            )
        return cls(disparities[0].name, *(nodes[0].name if nodes else None for nodes in (confidence, occlusion)))

    @property
    def names(self) -> list[str]:
        """Those there are, the disparity first."""
        return [name for name in (self.disparity, self.confidence, self.occlusion) if name is not None]


def _named(nodes: Sequence[Any], part: str) -> list[Any]:
    return [node for node in nodes if part in node.name.lower()]


def _may_be_map(node: Any, image: ImageInput) -> bool:
    """Whether an output may have one value per pixel, as far as its declared shape tells."""
    shape = list(node.shape or ())
    if not shape:
        return True  # not declared
    if not 2 <= len(shape) <= 4:
        return False
    if len(shape) == 4 and shape[3] == 1:
        shape = shape[:3]
    sizes = zip(shape[-2:], (image.height, image.width), strict=True)
    fits = all(size == known for size, known in sizes if isinstance(size, int) and known is not None)
    return fits and all(size == 1 for size in shape[:-2] if isinstance(size, int))


def pixel_map(name: str, output: npt.NDArray[Any], size: tuple[int, int], network: Network) -> F32:
    """float32 (H, W) of an output with one value per pixel and any axes of length 1 besides.

    Raises:
        ConfigError: it has another size than its input, ``size``.
    """
    if [length for length in output.shape if length != 1] != [length for length in size if length != 1]:
        raise model_error(
            network.model,
            f"returns for images of {size[1]} x {size[0]} px the output {name!r} of shape {output.shape}, it must have "
            "one value per pixel",
            size,
            "export this output in full size",
        )
    return np.asarray(output, np.float32).reshape(size)


def probabilities(name: str, values: F32, network: Network) -> F32:
    """float32 (H, W) in 0..1, 0 where the network has no number.

    Raises:
        ConfigError: a value is outside 0..1, as without a sigmoid.
    """
    known = np.nan_to_num(values, nan=0.0, posinf=np.inf, neginf=-np.inf)
    low, high = (float(value) for value in (known.min(), known.max()))
    if low < -_ROUNDING or high > 1 + _ROUNDING:
        raise model_error(
            network.model,
            f"returns values of {low:.3g} to {high:.3g} as {name!r}, they must be 0 to 1",
            (0, 1),
            "export it with a sigmoid at its end, or rename it if it is something else",
        )
    limited: F32 = np.clip(known, 0, 1)
    return limited
