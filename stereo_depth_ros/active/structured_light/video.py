# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Patterns as a video, each shown for the same time, for a projector that plays files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from stereo_depth_ros.core.errors import ConfigError, OutputError
from stereo_depth_ros.core.types import U8

__all__ = ["MAX_SECONDS", "mp4_video"]

MAX_SECONDS = 60.0  # of a pattern
_LEAST_SECONDS = 0.01
_LEAST_RATE_HZ = 10.0  # players take slower videos for damaged ones


def mp4_video(patterns: Iterable[U8], seconds: float) -> bytes:
    """An MP4 file (MPEG-4 part 2), whose gray levels are within a few of those of the patterns.

    Args:
        patterns: uint8 (h, w) gray or (h, w, 3) RGB, of one size. An odd width or height is made even by repeating the
            last column or row.
        seconds: for which each pattern is shown.

    Raises:
        ConfigError: a time out of range.
        OutputError: OpenCV cannot write videos.
    """
    if not _LEAST_SECONDS <= seconds <= MAX_SECONDS:
        raise ConfigError(
            f"seconds = {seconds:g} is not {_LEAST_SECONDS:g} to {MAX_SECONDS:g}",
            value=seconds,
            limit=(_LEAST_SECONDS, MAX_SECONDS),
            remedy="set a time in this range",
            settings=("seconds",),
        )
    rate_hz = max(_LEAST_RATE_HZ, 1.0 / seconds)
    repeated = max(1, round(seconds * rate_hz))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "patterns.mp4"
        writer: cv2.VideoWriter | None = None
        for pattern in patterns:
            frame = _frame(pattern)
            if writer is None:
                size = (frame.shape[1], frame.shape[0])
                writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, size)
            for _ in range(repeated):
                writer.write(frame)
        if writer is not None:
            writer.release()
        if not path.is_file():
            raise OutputError(
                "this OpenCV cannot write MP4 videos",
                value=cv2.__version__,
                remedy="install one with FFmpeg, such as opencv-python-headless, or write no video",
                settings=("video",),
            )
        return path.read_bytes()


def _frame(pattern: U8) -> U8:
    """uint8 (H, W, 3) BGR of even width and height."""
    even = [(0, size % 2) for size in pattern.shape[:2]]
    if pattern.ndim == 2:
        return np.asarray(cv2.cvtColor(np.pad(pattern, even, "edge"), cv2.COLOR_GRAY2BGR), np.uint8)
    return np.ascontiguousarray(np.pad(pattern, [*even, (0, 0)], "edge")[..., ::-1])
