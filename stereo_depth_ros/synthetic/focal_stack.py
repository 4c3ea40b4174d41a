# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Synthetic focal stacks: a slanted plane and a box before it, blurred by a thin lens, with exact truth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32, F64, Frame

__all__ = ["FocalStack", "focal_stack"]

_FINER = 2  # rendered at this many times the resolution
_PIXEL_BLUR = 0.45 * _FINER  # of the pixels of the sensor
_RADIUS_STEP = 0.25 * _FINER
_PLAIN = 0.16  # width of the part without texture, of the image


@dataclass(frozen=True, eq=False)
class FocalStack:
    """Images of one scene at several focus distances, and what is true of the image without breathing.

    Attributes:
        frames: uint8 (H, W, 3) BGR images.
        distances_m: float64 (N,), their focus distances, meters.
        depth_m: float32 (H, W), in the frame of the image with the largest magnification.
        textured: bool (H, W), where the scene has texture, there too.
        scales: float64 (N,), magnification of each image, 1 for the largest.
    """

    frames: list[Frame]
    distances_m: F64
    depth_m: F32
    textured: npt.NDArray[np.bool_]
    scales: F64


def focal_stack(
    width: int,
    height: int,
    distances_m: F64,
    *,
    near_m: float,
    far_m: float,
    blur_px_m: float = 12.0,
    breathing: float = 0.0,
    noise: float = 1.0,
    seed: int = 0,
) -> FocalStack:
    """Renders a stack.

    The plane is at ``far_m`` at the top and at ``near_m`` at the bottom, 1 / Z being linear in the row as it is for a
    plane; the box is at one depth between. A strip at the left has no texture. A point is a disk of the radius
    ``blur_px_m`` |1 / Z - 1 / distance|, px. Light that passes an edge in depth is not treated exactly.

    Args:
        width, height: of the images, px.
        distances_m: float64 (N,), focus distances, meters.
        near_m, far_m: range of the scene, meters.
        blur_px_m: aperture radius times the distance of the sensor, px m.
        breathing: how much larger the image with the nearest focus is than the one with the farthest; above -1.
        noise: standard deviation, gray levels.
        seed: of texture and noise.
    """
    rng = np.random.default_rng(seed)
    w, h = _FINER * width, _FINER * height
    inverse = np.broadcast_to(np.linspace(1 / far_m, 1 / near_m, h, dtype=np.float32)[:, None], (h, w)).copy()
    inverse[h // 4 : h // 2, w // 2 : 4 * w // 5] = 0.35 / far_m + 0.65 / near_m
    textured = np.ones((h, w), bool)
    textured[:, : round(_PLAIN * w)] = False
    texture = _texture(rng, w, h)
    texture[~textured] = texture.mean(axis=(0, 1))
    positions = 1 / np.asarray(distances_m, np.float64)
    radii = [_FINER * blur_px_m * np.abs(inverse - np.float32(position)) for position in positions]
    blurred = _blurred(texture, max(float(each.max()) for each in radii))
    near = (positions - positions.min()) / np.ptp(positions)
    scales = (1 + breathing * near) / max(1 + breathing, 1.0)
    frames = []
    for number, (radius, scale) in enumerate(zip(radii, scales, strict=True)):
        sharp = _of_radius(blurred, radius)
        image = _resized(cv2.GaussianBlur(sharp, (0, 0), _PIXEL_BLUR), width, height, float(scale))
        noisy = image + rng.normal(0, noise, image.shape)
        pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        frames.append(Frame(pixels, number * 100_000_000, "camera_optical_frame", "bgr8"))
    depth_m = np.reciprocal(_resized(inverse, width, height, 1.0))
    kept = _resized(textured.astype(np.float32), width, height, 1.0) > 0.999
    return FocalStack(frames, np.asarray(distances_m, np.float64), depth_m, kept, scales)


def _texture(rng: np.random.Generator, width: int, height: int) -> F32:
    """Gray levels of several scales with some color."""
    total = np.zeros((height, width), np.float32)
    for scale in (2, 4, 8, 16):
        size = -(-width // scale), -(-height // scale)
        noise = rng.uniform(-1, 1, size[::-1]).astype(np.float32)
        total += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    color = np.array([0.9, 1.0, 1.1], np.float32)
    return np.asarray(128 + 32 * total[..., None] * color, np.float32)


def _blurred(texture: F32, largest_px: float) -> list[F32]:
    """The texture blurred by disks of radii of equal steps."""
    levels = [texture]
    while len(levels) * _RADIUS_STEP < largest_px + _RADIUS_STEP:
        radius = len(levels) * _RADIUS_STEP
        reach = int(np.ceil(radius)) + 1
        x = np.arange(-reach, reach + 1)
        disk = np.clip(radius + 0.5 - np.hypot(x, x[:, None]), 0, 1)
        kernel = (disk / disk.sum()).astype(np.float32)
        levels.append(np.asarray(cv2.filter2D(texture, -1, kernel, borderType=cv2.BORDER_REFLECT_101), np.float32))
    return levels


def _of_radius(levels: list[F32], radius: F32) -> F32:
    """Each pixel by its own radius, linear between two levels."""
    place = radius / np.float32(_RADIUS_STEP)
    total = np.zeros_like(levels[0])
    for number, level in enumerate(levels):
        share = np.maximum(0, 1 - np.abs(place - np.float32(number)))
        if share.any():
            total += share[..., None] * level
    return total


def _resized(image: F32, width: int, height: int, scale: float) -> F32:
    """The image at the resolution of the sensor, magnified about its center."""
    factor = _FINER / scale
    matrix = np.array(
        [
            [factor, 0, (_FINER * width - 1) / 2 - factor * (width - 1) / 2],
            [0, factor, (_FINER * height - 1) / 2 - factor * (height - 1) / 2],
        ]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(image, matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REFLECT_101), np.float32
    )
