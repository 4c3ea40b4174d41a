# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of the views that are published as images; without what draws them, which options need not import."""

from __future__ import annotations

from collections.abc import Sequence

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.quoted import quoted

__all__ = ["VIEW_TOPICS", "check_views"]

# Relative to the namespace; views/topics.py has how each is drawn
VIEW_TOPICS = ("view/image", "anaglyph", "disparity_color", "depth_color")


def check_views(topics: Sequence[str]) -> tuple[str, ...]:
    """The topics, if all of them are views.

    Raises:
        ConfigError: an unknown one, or one that is there twice.
    """
    for topic in topics:
        if topic not in VIEW_TOPICS:
            raise ConfigError(
                f"view {quoted(topic)} is not one of {', '.join(VIEW_TOPICS)}",
                value=topic,
                limit=VIEW_TOPICS,
                remedy="use one of them",
                settings=("view",),
            )
    if len(set(topics)) < len(topics):
        raise ConfigError(f"a view is named twice in {', '.join(topics)}", value=tuple(topics), remedy="name each once")
    return tuple(topics)
