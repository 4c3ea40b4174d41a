# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the outputs that are recorded only if they are asked for."""

from __future__ import annotations

from collections.abc import Sequence

from stereo_depth_ros.core.errors import ConfigError

__all__ = ["MORE_TOPICS", "check_more_topics"]

MORE_TOPICS = (
    "right/image_rect_color",
    "confidence",
    "confidence_mono8",
    "reasons_color",
    "error_disparity",
    "error_depth",
)


def check_more_topics(topics: Sequence[str]) -> tuple[str, ...]:
    """The topics, each once; ConfigError for one that is not in ``MORE_TOPICS``."""
    for topic in topics:
        if topic not in MORE_TOPICS:
            raise ConfigError(
                f"--also {topic}: there is no such output",
                value=topic,
                limit=MORE_TOPICS,
                remedy=f"use one of {', '.join(MORE_TOPICS)}",
            )
    return tuple(dict.fromkeys(topics))
