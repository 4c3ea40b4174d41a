# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is read of a bag, and whether any pair of it can be processed, before anything is computed or started."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import BagError, StereoDepthError
from stereo_depth_ros.diagnosis.stereo_choice import choose_topics
from stereo_depth_ros.messages.cdr import stamp_text

__all__ = ["no_pair_error", "open_selection", "skipped_text"]

_ENOUGH = 2  # pairs that can be processed: where no image has a stamp there is one


def open_selection(
    selection: BagSelection, pairing: PairingConfig, reader: BagReader | None = None
) -> tuple[BagSelection, str]:
    """The selection of :func:`choose_topics`, some pair of which can be processed.

    Args:
        selection: bag, topics and part of it.
        pairing: parameters of the pairing by stamp.
        reader: of the bag, where it is open already; it stays open.

    Returns:
        The selection, and a sentence where the topics that are best by name are not used; else an empty one.

    Raises:
        BagError, TopicError: no readable stereo bag, stamps that are not set, or no pair that can be processed.
        ConfigError: the part begins after the end of the bag.
    """
    chosen, note = choose_topics(selection, pairing, reader)
    types, depth, refused, good = RosbagsTypes(), BitDepth(), dict[str, str](), 0
    rigs = PerCalibration(types, lambda rig: rig)
    with BagPairs(chosen, pairing, reader) as pairs:
        image_type = pairs.topics.image_type
        for pair in pairs.pairs():
            try:
                pair.images(types, image_type, rigs.of(pair, image_type), depth)
            except StereoDepthError as error:
                refused.setdefault(type(error).__name__, skipped_text(pair.stamp_ns, error))
            else:
                good += 1
            if good == _ENOUGH:
                return chosen, note
        if pairs.unset is not None:
            raise pairs.unset.about(chosen.path)
        if not good:
            raise no_pair_error(pairs, chosen.path, refused.values())
    return chosen, note


def skipped_text(stamp_ns: int, error: StereoDepthError) -> str:
    """Which pair is skipped, and why."""
    return f"pair {stamp_text(stamp_ns)} skipped: {error}"


def no_pair_error(pairs: BagPairs, path: Path, refused: Iterable[str]) -> BagError:
    """No pair of a bag can be processed: why pairs are refused, or why there are none."""
    reasons = "; ".join((*refused, *pairs.losses)) or (
        f"there are none {pairs.part}" if pairs.part else "it holds no pairs of the given pairing"
    )
    return BagError(
        f"no pair could be processed: {reasons}",
        subject=str(path),
        value=0,
        remedy="examine the bag with the doctor",
    )
