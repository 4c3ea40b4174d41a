# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the outputs that are written; without what builds them, which options need not import."""

from __future__ import annotations

from collections.abc import Sequence

from stereo_depth_ros.config.more_topics import MORE_TOPICS
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.quoted import quoted

__all__ = ["DEFAULT_OUTPUTS", "OUTPUT_NAMES", "OUTPUT_TOPICS", "output_topics"]

# Relative to the namespace; outputs.py has how each is built
OUTPUT_TOPICS = (
    "disparity",
    "depth/image_rect",
    "depth/camera_info",
    "points2",
    "left/image_rect",
    "left/image_rect_color",
    "right/image_rect",
)

OUTPUT_NAMES = {
    "disparity": ("disparity",),
    "depth": ("depth/image_rect", "depth/camera_info"),
    "rect": ("left/image_rect_color",),
    "points": ("points2",),
    "all": OUTPUT_TOPICS,
}
DEFAULT_OUTPUTS = ("disparity", "depth", "rect")


def output_topics(texts: Sequence[str]) -> tuple[str, ...]:
    """The topics of names of outputs, each once, in the order of publishing.

    Args:
        texts: names of ``OUTPUT_NAMES``, or topics, separated by commas.

    Raises:
        ConfigError: another name.
    """
    wanted: set[str] = set()
    known = (*OUTPUT_TOPICS, *MORE_TOPICS)
    for name in (part.strip() for text in texts for part in text.split(",")):
        topics = OUTPUT_NAMES.get(name, (name,))
        if not {*topics} <= {*known}:
            choices = (*OUTPUT_NAMES, *(topic for topic in known if topic not in OUTPUT_NAMES))
            raise ConfigError(
                f"output {quoted(name)} is not one of {', '.join(choices)}",
                value=name,
                limit=choices,
                remedy="use one of them",
                settings=("outputs",),
            )
        wanted.update(topics)
    return tuple(topic for topic in known if topic in wanted)
