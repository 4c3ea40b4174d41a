# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The diagnosis of a stereo setup: all findings, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.diagnosis.survey import StereoSetup

__all__ = ["Diagnosis"]

_ROOT_CAUSES = ("two cameras", "order of the cameras")  # named first in the verdict


@dataclass(frozen=True)
class Diagnosis:
    """All findings, in the order from the cameras to depth."""

    setup: StereoSetup
    findings: Sequence[Finding] = field(default_factory=tuple)

    @property
    def level(self) -> Level:
        """The worst level of all findings."""
        return max((finding.level for finding in self.findings), default=Level.SKIPPED)

    @property
    def verdict(self) -> str:
        """One line."""
        worst = [finding for finding in self.findings if finding.level is self.level]
        worst.sort(key=lambda finding: finding.check not in _ROOT_CAUSES)
        names = ", ".join(finding.check for finding in self.findings if finding.level is Level.SKIPPED)
        skipped = f"; skipped: {names}" if names else ""
        if self.level <= Level.SKIPPED:
            return f"no fault found{skipped}" if skipped else f"healthy; {self._facts()}"
        cause = f"{worst[0].check}: {worst[0].remedy or worst[0].value}"
        more = f" (and {len(worst) - 1} more)" if len(worst) > 1 else ""
        if self.level is Level.ERROR:
            return f"not usable; {cause}{more}"
        return f"usable, could be better; {cause}{more}{skipped}"

    @property
    def skipped(self) -> bool:
        """A check was skipped."""
        return any(finding.level is Level.SKIPPED for finding in self.findings)

    @property
    def search(self) -> Mapping[str, bool | int | float]:
        """Values of the parameters that make the matchers search what the features show; empty where not known."""
        return next((finding.settings for finding in self.findings if finding.check == "disparities"), {})

    def _facts(self) -> str:
        baseline, rows, depths = (self._figures(c) for c in ("baseline", "rows", "depths of the features"))
        facts = [f"baseline {baseline['baseline_m']:.4g} m"] if baseline else []
        facts += [f"rows agree to {rows['median_px']:.2f} px"] if rows else []
        facts += [f"features from {depths['near_m']:.2f} to {depths['far_m']:.2f} m"] if depths else []
        return ", ".join(facts)

    def _figures(self, check: str) -> Mapping[str, float | None]:
        return next((finding.figures for finding in self.findings if finding.check == check), {})

    def to_json(self) -> dict[str, Any]:
        """For JSON: the verdict, the topics, and a dict for each finding."""
        sides = {"left": self.setup.left, "right": self.setup.right}
        return {
            "source": self.setup.source,
            "level": self.level.name.lower(),
            "healthy": self.level is Level.OK,
            "verdict": self.verdict,
            "search": dict(self.search),
            "topics": {side: {"image": r.image_topic, "camera_info": r.info_topic} for side, r in sides.items()},
            "pairs_examined": len(self.setup.pairs),
            "findings": [finding.to_json() for finding in self.findings],
        }
