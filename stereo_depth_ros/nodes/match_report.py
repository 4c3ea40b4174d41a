# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How many pixels of the last pair have a disparity, and why the others have none, for /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping

from stereo_depth_ros.core.types import MatchResult
from stereo_depth_ros.nodes.diagnostics import NodeDiagnostics

__all__ = ["MatchReport"]


class MatchReport:
    """Shares of the pixels of the last result, by reason; counted only when diagnostics are published.

    Args:
        diagnostics: of the node.
    """

    def __init__(self, diagnostics: NodeDiagnostics) -> None:
        self._last: MatchResult | None = None
        diagnostics.watch_facts(self._facts)

    def note(self, match: MatchResult) -> None:
        """A new result, which does not change afterwards."""
        self._last = match

    def _facts(self) -> Mapping[str, str]:
        match = self._last
        if match is None:
            return {}
        size = match.reasons.size
        counts = {f"no disparity, {reason}": count for reason, count in match.reason_counts().items()}
        by_confidence, by_error = match.beyond_limits
        counts |= {"no disparity, below min_confidence": by_confidence, "no disparity, depth error": by_error}
        shares = {name: f"{100 * count / size:.2f} %" for name, count in counts.items() if count}
        return {"with a disparity": f"{100 * match.valid_fraction:.2f} %", **shares}
