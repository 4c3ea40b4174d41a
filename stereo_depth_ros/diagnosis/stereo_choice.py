# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which stereo topics of a bag are used: the best by name, or others where only their first pairs fit."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from itertools import islice

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.stereo_topics import bag_candidates
from stereo_depth_ros.bags.topics import StereoTopics
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import StereoDepthError, TopicError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.diagnosis.first_pairs import ALWAYS, LAST, FirstPairs
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["CHOICE_REMEDY", "choose_topics"]

CHOICE_REMEDY = "record the camera infos that belong to the others, or name the topics"


def choose_topics(
    selection: BagSelection, pairing: PairingConfig | None = None, reader: BagReader | None = None
) -> tuple[BagSelection, str]:
    """The selection with the names of its image topics, where the bag leaves a choice.

    Without a choice the selection is returned as it is. The topics that are best by name are used unless their first
    pairs show that they do not fit: camera infos that are not calibrated or those of other images, another image size,
    rows that differ. Then another pair of the same cameras that fits is used, such as rectified images instead of
    raw ones. Where none fits, the best by name is used, so that its fault is reported.

    Args:
        selection: the bag, and the part of it that is examined.
        pairing: parameters of the pairing by stamp; None is the default.
        reader: of the bag, where it is open already; it stays open.

    Returns:
        The selection, and a sentence where the best by name is not used; else an empty one.

    Raises:
        BagError: not a readable bag.
    """
    with BagReader(selection.path) if reader is None else nullcontext(reader) as bag:
        try:
            found = bag_candidates(bag, selection.left, selection.right, side_by_side=selection.side_by_side)
        except TopicError:  # whoever reads the bag reports it
            return selection, ""
    best = found[0]
    others = [topics for topics in found[1:] if topics.certainty == best.certainty]
    if not others:
        return selection, ""
    fault = _fault(_named(selection, best), pairing)
    if isinstance(fault, StereoDepthError):
        for topics in others:
            alone = [each.rank for each in others].count(topics.rank) == 1
            if alone and _fault(_named(selection, topics), pairing) is True:
                return _named(selection, topics), _note(topics, best, fault)
    return _named(selection, best), ""


def _named(selection: BagSelection, topics: StereoTopics) -> BagSelection:
    return replace(selection, left=topics.left_image, right=topics.right_image)


def _note(used: StereoTopics, best: StereoTopics, fault: StereoDepthError) -> str:
    names = [" and ".join(dict.fromkeys((t.left_image, t.right_image))) for t in (used, best)]
    subject = f"{fault.subject}: " if fault.subject else ""
    return f"{names[0]} are used, since {names[1]} do not fit their camera infos: {subject}{fault.problem}"


def _fault(selection: BagSelection, pairing: PairingConfig | None) -> StereoDepthError | bool:
    """What is wrong with the first pairs; else whether they are right, False where they show too little."""
    types, depth, rectified_depth = RosbagsTypes(), BitDepth(), BitDepth()
    examined, first, errors = PerCalibration(types, _examination), None, list[StereoDepthError]()
    try:
        with BagPairs(selection, pairing or PairingConfig()) as pairs:
            image_type = pairs.topics.image_type
            for pair in islice(pairs.pairs(), LAST):
                try:
                    rectifier, first = examined.of(pair, image_type)
                    if not first.due:
                        first.skip()
                        continue
                    images = pair.images(types, image_type, rectifier.rig, depth)
                except StereoDepthError as error:  # of this pair, perhaps
                    errors.append(error)
                    if len(errors) == ALWAYS:
                        return error
                    continue
                rectified = rectifier.rectify(images, rectified_depth)
                fault = first.look(images, rectified.left, rectified.right)
                if fault is not None or first.decided:
                    return fault or True
    except StereoDepthError as error:  # no camera infos, or the cameras are swapped
        return error
    if first is None or first.fits is None:
        return errors[0] if errors else False
    return first.finish() or bool(first.fits)


def _examination(rig: StereoRig) -> tuple[Rectifier, FirstPairs]:
    rectifier = Rectifier(rig)
    return rectifier, FirstPairs(rig, rectifier.shown)
