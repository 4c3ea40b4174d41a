# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data types: frames and stereo pairs, and the result of matching."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.camera_image import CameraImage
from stereo_depth_ros.core.errors import ImageError

__all__ = ["F32", "F64", "U8", "U16", "Frame", "MatchResult", "Reason", "RectifiedPair", "StereoPair"]

U8: TypeAlias = npt.NDArray[np.uint8]
U16: TypeAlias = npt.NDArray[np.uint16]
F32: TypeAlias = npt.NDArray[np.float32]
F64: TypeAlias = npt.NDArray[np.float64]


_CHANNELS = {"mono8": 1, "rgb8": 3, "bgr8": 3}


def _checked(pixels: npt.NDArray[Any], encoding: str, name: str) -> U8:
    """The pixels as C-contiguous and read-only; ImageError if they do not match the encoding."""
    if not isinstance(encoding, str) or encoding not in _CHANNELS:
        raise ImageError(
            f"encoding = {encoding!r} is not one of {', '.join(_CHANNELS)}",
            subject=name,
            value=encoding,
            limit=tuple(_CHANNELS),
            remedy="name the order of the channels in lower case, as sensor_msgs does",
        )
    shape = "(H, W)" if _CHANNELS[encoding] == 1 else "(H, W, 3)"
    if not isinstance(pixels, np.ndarray) or pixels.dtype != np.uint8:
        found = getattr(pixels, "dtype", type(pixels).__name__)
        raise ImageError(
            f"pixels are {found}, {encoding} takes uint8 {shape}",
            subject=name,
            value=str(found),
            limit="uint8",
            remedy="scale deeper images to 8 bits",
        )
    expected = 2 if _CHANNELS[encoding] == 1 else 3
    if pixels.ndim != expected or pixels.shape[2:] not in ((), (3,)) or not pixels.size:
        color = pixels.ndim == 3 and encoding == "mono8"
        raise ImageError(
            f"pixels have shape {pixels.shape}, {encoding} takes {shape} of at least one pixel",
            subject=name,
            value=pixels.shape,
            limit=shape,
            remedy="name the encoding of color pixels, rgb8 or bgr8" if color else "pass pixels of this shape",
        )
    if pixels.flags.c_contiguous and not pixels.flags.writeable:
        return pixels
    checked = np.ascontiguousarray(pixels).view()
    checked.flags.writeable = False
    return checked


class Reason(enum.IntFlag):
    """Why a pixel has no disparity; bits of the uint8 reason map, 0 where the pixel is valid."""

    VALID = 0
    NO_MATCH = 1  # rejected by the matcher for another reason
    LEFT_RIGHT = 2  # left-right check: the right image prefers another left pixel
    UNIQUENESS = 4  # another disparity has a similar cost, or the confidence is below its limit
    TEXTURE = 8  # not enough texture in the window
    SPECKLE = 16  # small isolated component
    RANGE = 32  # not in front of the cameras, or so far that the error of the depth is above its limit
    BORDER = 64  # the search range or the window leaves the image
    SHADOW = 128  # the projector does not light it


@dataclass(frozen=True, eq=False)
class Frame:
    """One decoded image of one camera.

    Attributes:
        pixels: uint8, C-contiguous and read-only, (H, W) gray or (H, W, 3) color in the order that ``encoding`` names.
            A writeable array is kept as a read-only view, an array of another layout is copied.
        stamp_ns: time of the exposure, integer nanoseconds (the header stamp).
        frame_id: name of the optical frame.
        encoding: "mono8", "rgb8" or "bgr8".
        gray: uint8 (H, W), gray of the camera where it does not come from the colors but from a mosaic or a luma plane;
            None otherwise.
        camera: the image in the encoding of the camera where that has 16 bits, alpha or a mosaic, to be published; None
            where it is ``pixels``.

    Raises:
        ImageError: another dtype, shape or encoding.
    """

    pixels: U8
    stamp_ns: int
    frame_id: str
    encoding: str = "mono8"
    gray: U8 | None = None
    camera: CameraImage | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", _checked(self.pixels, self.encoding, "pixels"))
        if self.gray is None:
            return
        object.__setattr__(self, "gray", _checked(self.gray, "mono8", "gray"))
        if self.gray.shape != self.pixels.shape[:2]:
            raise ImageError(
                f"gray has shape {self.gray.shape}, the pixels have {self.pixels.shape[:2]}",
                subject="gray",
                value=self.gray.shape,
                limit=self.pixels.shape[:2],
                remedy="pass gray of the size of the pixels, or None",
            )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Frame):
            return NotImplemented
        same = (self.stamp_ns, self.frame_id, self.encoding) == (other.stamp_ns, other.frame_id, other.encoding)
        if not same or (self.gray is None) != (other.gray is None):
            return False
        same_gray = self.gray is None or other.gray is None or np.array_equal(self.gray, other.gray)
        return same_gray and self.camera == other.camera and np.array_equal(self.pixels, other.pixels)

    def __reduce__(self) -> tuple[Any, ...]:
        # copies are read-only too
        return type(self), (self.pixels, self.stamp_ns, self.frame_id, self.encoding, self.gray, self.camera)

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True)
class StereoPair:
    """Left and right frame of one exposure, raw or rectified as the stage requires.

    Raises:
        ImageError: not two frames.
    """

    left: Frame
    right: Frame

    def __post_init__(self) -> None:
        for side, frame in (("left", self.left), ("right", self.right)):
            if not isinstance(frame, Frame):
                raise ImageError(
                    f"{side} is {type(frame).__name__}, a pair holds two frames",
                    subject="stereo pair",
                    value=type(frame).__name__,
                    limit="Frame",
                    remedy="create Frame(pixels, stamp_ns, frame_id, encoding)",
                )


@dataclass(frozen=True, eq=False)
class RectifiedPair:
    """A rectified pair: a point has the same row in both images. Arrays are C-contiguous and read-only.

    Attributes:
        left, right: uint8 (H, W), gray, input of the matcher.
        left_color: uint8 (H, W) or (H, W, 3), the rectified pixels of the left frame.
        color_encoding: encoding of ``left_color``: "mono8", "rgb8" or "bgr8".
        left_16, right_16: uint16 (H, W), gray with all its bits where the camera has 16, of which ``left`` and
            ``right`` are scaled; None otherwise.

    Raises:
        ImageError: another dtype, shape or encoding, or different sizes.
    """

    left: U8
    right: U8
    left_color: U8
    color_encoding: str
    left_16: U16 | None = None
    right_16: U16 | None = None

    def __post_init__(self) -> None:
        is_gray = self.left_color is self.left
        for name, encoding in (("left", "mono8"), ("right", "mono8"), ("left_color", self.color_encoding)):
            object.__setattr__(self, name, _checked(getattr(self, name), encoding, name))
        if is_gray:  # keep one array for both
            object.__setattr__(self, "left_color", self.left)
        sizes = {name: getattr(self, name).shape[:2] for name in ("left", "right", "left_color")}
        if len(set(sizes.values())) > 1:
            raise ImageError(
                f"sizes differ: {', '.join(f'{name} {size[1]}x{size[0]}' for name, size in sizes.items())}",
                subject="rectified pair",
                value=sizes,
                limit="one size",
                remedy="rectify both images with one rig",
            )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RectifiedPair):
            return NotImplemented
        names = ("left", "right", "left_color", "left_16", "right_16")
        same = all(np.array_equal(getattr(self, n), getattr(other, n)) for n in names)
        return same and self.color_encoding == other.color_encoding

    def __reduce__(self) -> tuple[Any, ...]:
        # copies are read-only too
        return type(self), (
            self.left,
            self.right,
            self.left_color,
            self.color_encoding,
            self.left_16,
            self.right_16,
        )

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class MatchResult:
    """Result of a matcher, or of the disparity stage, which rejects more pixels.

    Later calls do not change it, unless the caller reuses a buffer passed for ``disparity_px``; the confidence remains
    unchanged even then. Without such a buffer, read the confidence before writing into the arrays.

    Attributes:
        disparity_px: float32 (H, W), x_left - x_right in pixels, NaN where invalid.
        reasons: uint8 (H, W), bits of :class:`Reason`, 0 exactly where ``disparity_px`` is finite.
        step_px: resolution of the disparities, px (1/16 for OpenCV's matchers).
        support_px: width and height, odd, px, of the window that a matching cost is computed from.
        confidence_source: the confidence, or a function that computes it on demand; None if the method has none.
        sigma_px: float32 (H, W), standard deviation of each disparity, px, NaN where invalid; None if the method does
            not estimate it.
        beyond_limits: how many pixels were rejected by their confidence (UNIQUENESS), and by the error of their depth
            (RANGE).
    """

    disparity_px: F32
    reasons: U8
    step_px: float
    confidence_source: F32 | Callable[[], F32] | None = None
    support_px: tuple[int, int] = (1, 1)
    sigma_px: F32 | None = None
    beyond_limits: tuple[int, int] = (0, 0)

    @cached_property
    def confidence(self) -> F32 | None:
        """Confidence of each disparity, float32 (H, W) in [0, 1], 0 where the pixel is invalid or was filled.

        Computed on first access from the disparities of this result. Pixels rejected by the disparity stage have 0, and
        to local consistency they are holes. A confidence given as an array is otherwise unchanged.
        """
        source = self.confidence_source
        confidence = source() if callable(source) else source
        return None if confidence is None else np.where(self.reasons == 0, confidence, np.float32(0))

    @property
    def valid_fraction(self) -> float:
        """Fraction of pixels with a disparity, 0..1."""
        return float(np.count_nonzero(self.reasons == 0)) / self.reasons.size

    def reason_counts(self) -> dict[str, int]:
        """Number of pixels per reason name (a pixel may have several)."""
        counts = np.bincount(self.reasons.ravel(), minlength=256)
        values = np.arange(256)
        return {str(r.name): int(counts[(values & r.value) != 0].sum()) for r in Reason if r.value}
