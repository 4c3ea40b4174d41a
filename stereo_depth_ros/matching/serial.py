# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all matchers have in common: calls take turns, and results share no memory with the buffers of the matcher."""

from __future__ import annotations

import dataclasses
import threading
from abc import ABC, abstractmethod

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.matching.protocol import check_buffer, check_images

__all__ = ["SerialMatcher"]


class SerialMatcher(ABC):
    """A matcher for any number of threads, whose method itself runs in one of them at a time."""

    name: str
    step_px: float

    def __init__(self, config: MatchingConfig) -> None:
        self.config = config
        self._turn = threading.Lock()

    @property
    def support_px(self) -> tuple[int, int]:
        """The matching window, for the methods that have one."""
        return self.config.correlation_window_size, self.config.correlation_window_size

    def match(self, left: U8, right: U8, out: F32 | None = None) -> MatchResult:
        """See :class:`~stereo_depth_ros.matching.protocol.Matcher`."""
        check_images(left, right)
        if out is not None:
            check_buffer(out, left.shape)
        left, right = np.ascontiguousarray(left), np.ascontiguousarray(right)
        with self._turn:
            result = self._match(left, right)
        if out is None:
            return dataclasses.replace(result, support_px=self.support_px)
        # The confidence still to be computed reads the disparities of the method, not what becomes of the caller's.
        out[:] = result.disparity_px
        return dataclasses.replace(result, disparity_px=out, support_px=self.support_px)

    @abstractmethod
    def _match(self, left: U8, right: U8) -> MatchResult:
        """The result in new arrays; buffers may be kept in ``self`` between calls.

        Args:
            left, right: uint8 (H, W), C-contiguous, of one size; whether the search fits is for the method to check.
        """
