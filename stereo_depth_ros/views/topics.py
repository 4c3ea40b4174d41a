# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table of the views that are published as images: topic, what it needs, and how it is drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from stereo_depth_ros.config import ViewConfig
from stereo_depth_ros.config.view_topics import VIEW_TOPICS
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.messages.types import MessageTypes
from stereo_depth_ros.views.anaglyph import anaglyph
from stereo_depth_ros.views.color_maps import depth_color, disparity_color
from stereo_depth_ros.views.convergence import Convergence, converged
from stereo_depth_ros.views.frame import ViewFrame
from stereo_depth_ros.views.interpolation import interpolate_view

__all__ = ["VIEWS", "View", "ViewImages", "ViewMessages"]


class ViewImages:
    """Draws the views of a stream of frames.

    Attributes:
        screen_px: disparity at the screen in the last converged image.
    """

    def __init__(self) -> None:
        self._convergence = Convergence()
        self.screen_px = 0

    def restart(self) -> None:
        """A new stream begins."""
        self._convergence.restart()

    def interpolated(self, frame: ViewFrame, config: ViewConfig) -> U8:
        """The image of a camera between both."""
        left, right = _images(frame)
        return interpolate_view(left, right, frame.disparity_px, config.view_position)

    def anaglyph(self, frame: ViewFrame, config: ViewConfig) -> U8:
        """The anaglyph of the converged images."""
        return anaglyph(*self.converged(frame, config), config.anaglyph_method, config.anaglyph_filters)

    def disparity_color(self, frame: ViewFrame, config: ViewConfig) -> U8:
        """Published disparities as colors, over the range that was searched."""
        return disparity_color(frame.published_px, *frame.range_px, legend=config.color_legend)

    def depth_color(self, frame: ViewFrame, config: ViewConfig) -> U8:
        """Depth as colors."""
        return depth_color(frame.depth_m, config.depth_near, config.depth_far, legend=config.color_legend)

    def converged(self, frame: ViewFrame, config: ViewConfig) -> tuple[U8, U8]:
        """Both images with the subject at the screen."""
        return converged(*_images(frame), self.shift_px(frame, config))

    def shift_px(self, frame: ViewFrame, config: ViewConfig) -> int:
        """The disparity that lies at the screen."""
        followed = self._convergence.follow(frame.disparity_px) if config.auto_convergence else None
        self.screen_px = round(config.convergence) if followed is None else followed
        return self.screen_px


def _images(frame: ViewFrame) -> tuple[U8, U8]:
    assert frame.left is not None and frame.right is not None  # needs_images of the view
    return frame.left, frame.right


class View(NamedTuple):
    """A view that is published.

    Attributes:
        needs_images: beside the disparities.
        draw: the image, uint8 (H, W) or (H, W, 3) BGR.
    """

    needs_images: bool
    draw: Callable[[ViewImages, ViewFrame, ViewConfig], U8]


# By topic, relative to the namespace
VIEWS: Mapping[str, View] = dict(
    zip(
        VIEW_TOPICS,
        (
            View(True, ViewImages.interpolated),
            View(True, ViewImages.anaglyph),
            View(False, ViewImages.disparity_color),
            View(False, ViewImages.depth_color),
        ),
        strict=True,
    )
)


class ViewMessages:
    """Builds the messages of the views of a stream; a message is valid until the next of its topic is built."""

    def __init__(self, types: MessageTypes) -> None:
        self._types = types
        self._pool = PayloadPool(types)
        self._images = ViewImages()
        self.restart = self._images.restart

    def build(self, topic: str, frame: ViewFrame, config: ViewConfig) -> Any:
        """The Image of a view: mono8 or bgr8, with stamp and frame_id of the left image."""
        pixels = VIEWS[topic].draw(self._images, frame, config)
        encoding = "mono8" if pixels.ndim == 2 else "bgr8"
        payload = self._pool.get(topic, pixels.nbytes)
        return image_message(self._types, pixels, encoding, frame.stamp_ns, frame.frame_id, payload)
