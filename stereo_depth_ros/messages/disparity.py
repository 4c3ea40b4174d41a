# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""stereo_msgs/DisparityImage to and from disparities; defines the published convention.

Internally, a disparity is d = x_left - x_right. Published is d - (cx_left - cx_right), so that Z = f T / d also holds
for verged cameras; min_disparity and max_disparity are shifted accordingly, and an invalid pixel is
``min_disparity - 1`` of the message.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, Frame, MatchResult
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.messages.types import MessageTypes, make_header

__all__ = [
    "disparity_message",
    "match_message",
    "matched_disparity",
    "published_disparity",
    "published_triangulation",
    "valid_window",
]

_F32 = "float32[:, ::1]"


def disparity_message(
    types: MessageTypes,
    disparity_px: F32,
    rig: StereoRig,
    *,
    min_disparity: float,
    max_disparity: float,
    step_px: float,
    stamp_ns: int,
    frame_id: str,
    support_px: tuple[int, int] = (1, 1),
    payload: tuple[Any, Any] | None = None,
) -> Any:
    """A DisparityImage.

    Args:
        types: the message classes.
        disparity_px: float32 (H, W), x_left - x_right, NaN where invalid.
        rig: the rectified cameras.
        min_disparity, max_disparity: first and last whole disparity searched, pixels, before the shift.
        step_px: resolution of the disparities.
        stamp_ns, frame_id: header, that of the left image.
        support_px: width and height of the matcher's support, for the valid window.
        payload: a reused ``types.payload(4 * H * W)``, or None for a new one.
    """
    height, width = disparity_px.shape
    data, view = payload or types.payload(disparity_px.nbytes)
    published = view.view(np.float32).reshape(height, width)
    doffs = np.float32(rig.doffs_px)
    # The same float32 subtraction as for the pixels, so that a pixel at the minimum is not below it.
    shifted_min = np.float32(min_disparity) - doffs
    run_bands(_publish, height, disparity_px, doffs, shifted_min - np.float32(1), published)
    header = make_header(types, stamp_ns, frame_id)
    x, y, window_width, window_height = valid_window(width, height, min_disparity, max_disparity, support_px)
    return types.DisparityImage(
        header=header,
        image=types.Image(
            header=header, height=height, width=width, encoding="32FC1", is_bigendian=0, step=4 * width, data=data
        ),
        f=rig.f_px,
        t=rig.baseline_m,
        valid_window=types.RegionOfInterest(
            x_offset=x, y_offset=y, width=window_width, height=window_height, do_rectify=False
        ),
        min_disparity=float(shifted_min),
        max_disparity=max_disparity - rig.doffs_px,
        delta_d=step_px,
    )


def published_disparity(msg: Any, topic: str = "disparity") -> F32:
    """The disparities of a DisparityImage as published, with Z = f T / d.

    Returns:
        float32 (H, W), NaN where invalid (below the message's min_disparity, or not finite).

    Raises:
        MessageError: another encoding than 32FC1, a payload that is too short, f or T that are not positive.
    """
    image = msg.image
    if image.encoding != "32FC1":
        raise MessageError(
            f"encoding {quoted(image.encoding)}, a DisparityImage holds 32FC1",
            subject=topic,
            value=image.encoding,
            limit="32FC1",
            remedy="publish float32",
        )
    if image.width == 0 or image.height == 0 or image.step < 4 * image.width or image.step % 4:
        raise MessageError(
            f"step {image.step} with {image.width}x{image.height} pixels, it is at least 4 x width and a multiple "
            "of 4, and no side is 0",
            subject=topic,
            value=(image.step, image.width, image.height),
            limit=4 * image.width,
            remedy="fill in width, height and step",
        )
    if len(image.data) < image.step * image.height:
        raise MessageError(
            f"{len(image.data)} bytes, step x height is {image.step * image.height}",
            subject=topic,
            value=len(image.data),
            limit=image.step * image.height,
            remedy="the payload is truncated",
        )
    if not (msg.f > 0 and msg.t > 0):
        raise MessageError(
            f"f = {msg.f}, T = {msg.t}, both must be positive (pixels, meters)",
            subject=topic,
            value=(msg.f, msg.t),
            limit=0,
            remedy="calibrate",
        )
    dtype = np.dtype(">f4" if image.is_bigendian else "<f4")
    rows = np.frombuffer(image.data, dtype, image.step // 4 * image.height).reshape(image.height, -1)[:, : image.width]
    published = np.ascontiguousarray(rows, np.float32)
    disparity_px = np.empty_like(published)
    run_bands(_receive, image.height, published, np.float32(msg.min_disparity), disparity_px)
    return disparity_px


def matched_disparity(msg: Any, rig: StereoRig, topic: str = "disparity") -> F32:
    """The disparities of a DisparityImage in the convention of the matchers: x_left - x_right of the rectified images.

    Returns:
        float32 (H, W), NaN where invalid.

    Raises:
        MessageError: as :func:`published_disparity`.
    """
    return published_disparity(msg, topic) + np.float32(rig.doffs_px)


def published_triangulation(msg: Any, rig: StereoRig, topic: str = "disparity") -> Triangulation:
    """Triangulation of published disparities: that of the rig without the offset, which is already subtracted.

    Raises:
        MessageError: size, f or T of the message are not those of the camera infos.
    """
    remedy = "subscribe to the camera infos of these disparities"
    size, expected = (msg.image.width, msg.image.height), (rig.width, rig.height)
    if size != expected:
        raise MessageError(
            f"the disparities are {size[0]}x{size[1]}, the camera infos are for {expected[0]}x{expected[1]}",
            subject=topic,
            value=size,
            limit=expected,
            remedy=remedy,
        )
    if abs(msg.f - rig.f_px) > 1e-3 * rig.f_px or abs(msg.t - rig.baseline_m) > 1e-3 * rig.baseline_m:
        raise MessageError(
            f"f = {msg.f:g} px, T = {msg.t:g} m, the camera infos have {rig.f_px:g} px, {rig.baseline_m:g} m "
            "(limit 0.1 %)",
            subject=topic,
            value=(msg.f, msg.t),
            limit=(rig.f_px, rig.baseline_m),
            remedy=remedy,
        )
    return dataclasses.replace(Triangulation.from_rig(rig), doffs_px=0.0)


def valid_window(
    width: int, height: int, min_disparity: float, max_disparity: float, support_px: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Region with every disparity searched and the whole support inside both images: x, y, width, height in px."""
    beside, above = support_px[0] // 2, support_px[1] // 2
    left = min(width, max(0, int(np.ceil(max_disparity))) + beside)
    right = width - beside + min(0, int(np.floor(min_disparity)))
    top = min(height, above)
    return left, top, max(0, right - left), max(0, height - above - top)


@compiled(f"void(int64, int64, {_F32}, float32, float32, {_F32})")
def _publish(first: int, last: int, disparity_px: F32, doffs: np.float32, invalid: np.float32, published: F32) -> None:
    for y in range(first, last):
        for x in range(disparity_px.shape[1]):
            d = disparity_px[y, x]
            published[y, x] = invalid if np.isnan(d) else d - doffs


@compiled(f"void(int64, int64, Array(float32, 2, 'C', readonly=True), float32, {_F32})")
def _receive(first: int, last: int, published: F32, minimum: np.float32, disparity_px: F32) -> None:
    for y in range(first, last):
        for x in range(published.shape[1]):
            d = published[y, x]
            disparity_px[y, x] = d if minimum <= d < np.float32(np.inf) else np.float32(np.nan)


def match_message(
    types: MessageTypes, pool: PayloadPool, match: MatchResult, config: MatchingConfig, rig: StereoRig, left: Frame
) -> Any:
    """The DisparityImage of a match, with the header of the left frame."""
    return disparity_message(
        types,
        match.disparity_px,
        rig,
        min_disparity=config.min_disparity,
        max_disparity=config.max_disparity,
        step_px=match.step_px,
        stamp_ns=left.stamp_ns,
        frame_id=left.frame_id,
        support_px=match.support_px,
        payload=pool.get("disparity", match.disparity_px.nbytes),
    )
