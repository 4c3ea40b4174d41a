# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Creation of matchers by name or number."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from typing import Any, TypeAlias

from stereo_depth_ros.config import MatchingConfig, replace_checked
from stereo_depth_ros.config.matchers import MATCHERS, matcher_number
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.matching.protocol import Matcher

__all__ = ["MATCHERS", "Matcher", "create_matcher", "matcher_from_config"]

MatcherClass: TypeAlias = Callable[[MatchingConfig], Matcher]


def create_matcher(name: str | int, config: MatchingConfig | None = None, **fields: Any) -> Matcher:
    """A matcher by name, or by its number in ``stereo_algorithm``.

    Args:
        name: one of ``MATCHERS``; it overrides ``config.stereo_algorithm``.
        config: parameters, None for the defaults.
        fields: parameters that differ from ``config``, by field name or public name (``disparity_range``).

    Raises:
        ConfigError: unknown name or parameter, another type of config, or a value invalid for the config or the method.
    """
    names = list(MATCHERS)
    number = matcher_number(name) if isinstance(name, str) and name in MATCHERS else name
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(names):
        known = ", ".join(f"{text} ({position})" for position, text in enumerate(names))
        raise ConfigError(
            f"unknown matcher {name!r}",
            value=name,
            limit=tuple(names),
            remedy=f"known are {known}",
            settings=("matcher",),
        )
    if config is not None and not hasattr(config, "stereo_algorithm"):
        raise ConfigError(
            f"config is {type(config).__name__}, a matcher takes MatchingConfig",
            value=type(config).__name__,
            limit="MatchingConfig",
            remedy="pass PipelineConfig.matching, or the parameters by name",
        )
    changes = {**fields, "stereo_algorithm": number}
    return _matcher_class(names[number])(replace_checked(config or MatchingConfig(), changes))


def matcher_from_config(config: MatchingConfig) -> Matcher:
    """The matcher of ``config.stereo_algorithm``; ConfigError for parameters that are invalid for the method."""
    return create_matcher(config.stereo_algorithm, config)


@functools.cache
def _matcher_class(name: str) -> MatcherClass:
    module, _, class_name = MATCHERS[name].location.partition(":")
    matcher: MatcherClass = getattr(importlib.import_module(f"stereo_depth_ros.matching.{module}"), class_name)
    return matcher
