# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the matchers: concurrent calls are serialized, and results own their memory."""

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
    """A thread-safe matcher whose method runs in one thread at a time."""

    name: str
    step_px: float
    uses_one_core = False

    def __init__(self, config: MatchingConfig) -> None:
        self.config = config
        self._turn = threading.Lock()

    @property
    def support_px(self) -> tuple[int, int]:
        """See :class:`Matcher`; the matching window, unless a method overrides it."""
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
        # A confidence computed later reads the disparities of the method, not the buffer of the caller.
        out[:] = result.disparity_px
        return dataclasses.replace(result, disparity_px=out, support_px=self.support_px)

    @abstractmethod
    def _match(self, left: U8, right: U8) -> MatchResult:
        """The result in new arrays; scratch buffers may be kept in ``self`` between calls.

        Args:
            left, right: uint8 (H, W), C-contiguous, of one size; the method checks whether the search range fits.
        """
