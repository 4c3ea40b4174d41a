# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the doctor is given and what it gives: a stereo setup, and all findings with the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.diagnosis.finding import Finding

__all__ = ["PAIRS_LOOKED_AT", "CameraRecord", "StereoSetup"]

PAIRS_LOOKED_AT = 6  # from all over the recording: a few hundred features each, half a second each


@dataclass(frozen=True)
class CameraRecord:
    """What came from one camera.

    Attributes:
        image_topic, info_topic: names; info_topic is None where there is none.
        stamps_ns: header stamps of all images, in the order in which they came.
        infos: the different sensor_msgs/CameraInfo that came, of any message family, the first one first.
    """

    image_topic: str
    info_topic: str | None = None
    stamps_ns: Sequence[int] = ()
    infos: Sequence[Any] = ()


@dataclass(frozen=True)
class StereoSetup:
    """What there is to examine.

    Attributes:
        source: the bag, or the graph.
        left, right: what came from the cameras.
        pairs: a few pairs, from all over the recording.
        rectified: the names of the topics say that the images are rectified already.
        findings: what went wrong while it was gathered.
        silent: what is known of topics on which nothing came.
    """

    source: str
    left: CameraRecord
    right: CameraRecord
    pairs: Sequence[StereoPair] = ()
    rectified: bool = False
    findings: Sequence[Finding] = ()
    silent: Mapping[str, str] = field(default_factory=dict)
