# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The log of a node: names from messages are shown without control characters."""

from __future__ import annotations

from rclpy.impl.rcutils_logger import RcutilsLogger

from stereo_depth_ros.core.printable import printable

__all__ = ["log_error", "log_fatal", "log_info", "log_warning"]


def log_info(logger: RcutilsLogger, text: str) -> None:
    """Log for information."""
    logger.info(_lines(text))


def log_warning(logger: RcutilsLogger, text: str) -> None:
    """Log a warning."""
    logger.warning(_lines(text))


def log_error(logger: RcutilsLogger, text: str) -> None:
    """Log an error."""
    logger.error(_lines(text))


def log_fatal(logger: RcutilsLogger, text: str) -> None:
    """Log why the node ends."""
    logger.fatal(_lines(text))


def _lines(text: str) -> str:
    """The lines of the text; a traceback has several."""
    return "\n".join(map(printable, text.split("\n")))
