# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the matchers: concurrent calls are serialized, and results own their memory."""

from __future__ import annotations

import dataclasses
import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.matching.protocol import Images, check_buffer, check_images

__all__ = ["SerialMatcher"]


class SerialMatcher(ABC):
    """A thread-safe matcher whose method runs in one thread at a time."""

    name: str
    step_px: float
    uses_one_core = False
    pair_count = 1
    engine = ""

    def __init__(self, config: MatchingConfig) -> None:
        self.config = config
        self._turn = threading.Lock()

    @property
    def takes_prior(self) -> bool:
        """See :class:`Matcher`."""
        return MATCHERS[self.name].takes_prior

    @property
    def support_px(self) -> tuple[int, int]:
        """See :class:`Matcher`; the matching window, unless a method overrides it."""
        return self.config.correlation_window_size, self.config.correlation_window_size

    def match(
        self,
        left: U8,
        right: U8,
        out: F32 | None = None,
        earlier: Sequence[Images] = (),
        prior: DisparityPrior | None = None,
    ) -> MatchResult:
        """See :class:`~stereo_depth_ros.matching.protocol.Matcher`."""
        check_images(left, right)
        if out is not None:
            check_buffer(out, left.shape)
        if prior is not None:
            self._check_prior(prior, left)
        before = list(earlier)[1 - self.pair_count :] if self.pair_count > 1 else []
        for pair in before:
            _check_earlier(pair, left)
        with self._turn:
            result = self._match_pairs([_contiguous(pair) for pair in (*before, (left, right))], prior)
        if out is None:
            return dataclasses.replace(result, support_px=self.support_px)
        # A confidence computed later reads the disparities of the method, not the buffer of the caller.
        out[:] = result.disparity_px
        return dataclasses.replace(result, disparity_px=out, support_px=self.support_px)

    def _match_pairs(self, pairs: Sequence[Images], prior: DisparityPrior | None) -> MatchResult:
        """As :meth:`_match`, of the last of one to ``pair_count`` pairs; a method of single pairs matches it alone.

        The prior is None where ``takes_prior`` is false.
        """
        return self._match(*pairs[-1])

    def _check_prior(self, prior: DisparityPrior, left: U8) -> None:
        if not self.takes_prior:
            raise ConfigError(
                f"{self.name} takes no prior",
                value=self.name,
                remedy="use a matcher that does, such as sgm, or match without",
                settings=("stereo_algorithm",),
            )
        if prior.disparity_px.shape != left.shape:
            raise ImageError(
                f"the prior is {prior.disparity_px.shape}, the left image is {left.shape}",
                value=prior.disparity_px.shape,
                limit=left.shape,
                remedy="project the points of the sensor into the rectified left image",
            )

    @abstractmethod
    def _match(self, left: U8, right: U8) -> MatchResult:
        """The result in new arrays; scratch buffers may be kept in ``self`` between calls.

        Args:
            left, right: uint8 (H, W), C-contiguous, of one size; the method checks whether the search range fits.
        """


def _contiguous(pair: Images) -> Images:
    return np.ascontiguousarray(pair[0]), np.ascontiguousarray(pair[1])


def _check_earlier(pair: Images, newest: U8) -> None:
    check_images(*pair)
    if pair[0].shape != newest.shape:
        raise ImageError(
            f"an earlier pair is {pair[0].shape}, the newest is {newest.shape}",
            value=pair[0].shape,
            limit=newest.shape,
            remedy="match pairs of one size together",
        )
