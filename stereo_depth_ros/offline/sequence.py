# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pairs of a bag or of a dataset, in order, each computed on demand by the pipeline of its rig."""

from __future__ import annotations

import bisect
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration, SerializedPair
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import CameraOrderError, StereoDepthError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.datasets.posed import PosedDataset
from stereo_depth_ros.diagnosis.opening import no_pair_error, open_selection
from stereo_depth_ros.messages.cdr import cdr_stamp_ns
from stereo_depth_ros.offline.examined_pipelines import ExaminedPipelines
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.surfaces.range_image import RangeImage

__all__ = ["BagSequence", "DatasetSequence", "Sequence", "SequencePair", "SequenceView"]


@dataclass(frozen=True)
class SequencePair:
    """A pair that is computed on demand.

    Attributes:
        number: finds that of its frame, by which files without times have a row for it.
        stamp_ns: of the left image, integer nanoseconds.
        read: its images.
    """

    number: Callable[[], int]
    stamp_ns: int
    read: Callable[[], SequenceView]


@dataclass(frozen=True)
class SequenceView:
    """The images of a pair, or of a range camera.

    Attributes:
        frame_id: of the left image.
        rig: of the pair; None where there is one camera, without lens distortion.
        compute: its depth.
    """

    frame_id: str
    rig: StereoRig | None
    compute: Callable[[], RangeImage]


class Sequence(Protocol):
    """Pairs in order; the length is about as many as there are at most.

    Attributes:
        files: all files that are read.
        warnings: a sentence each; final when all pairs have been read.
        fault: the first one that the first pairs of a rig show; None where they show none.
    """

    @property
    def files(self) -> list[Path]: ...

    @property
    def warnings(self) -> list[str]: ...

    @property
    def fault(self) -> StereoDepthError | None: ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[SequencePair]: ...


class BagSequence:
    """The pairs of a bag, see :class:`Sequence`.

    Frames are numbered by all left images of the bag, which are read for it when the first number is asked for.

    Args:
        selection: bag, topics and part of it.
        config: parameters of all stages.

    Raises:
        BagError, TopicError: no readable stereo bag, or no pair that can be processed.
    """

    def __init__(self, selection: BagSelection, config: PipelineConfig) -> None:
        self._config = config
        self._selection, choice = open_selection(selection, config.pairing)
        self._pipelines = ExaminedPipelines(config)
        self._warnings = [choice] if choice else []
        with BagPairs(self._selection, config.pairing) as pairs:
            self._count, self._left_topic = pairs.count, pairs.topics.left_image

    @property
    def files(self) -> list[Path]:
        """All files that are read."""
        return bag_files(self._selection.path)

    @property
    def warnings(self) -> list[str]:
        """A sentence each."""
        return self._warnings

    @property
    def fault(self) -> StereoDepthError | None:
        """What the first pairs show."""
        self._pipelines.finish()
        return self._pipelines.fault

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[SequencePair]:
        types, depth, is_empty = RosbagsTypes(), BitDepth(), True
        rigs = PerCalibration(types, lambda rig: rig)
        with BagPairs(self._selection, self._config.pairing) as pairs:
            image_type = pairs.topics.image_type

            def reader(pair: SerializedPair) -> Callable[[], SequenceView]:
                def read() -> SequenceView:
                    rig = rigs.of(pair, image_type)
                    return _view(pair.images(types, image_type, rig, depth), rig, self._compute)

                return read

            for pair in pairs.pairs():
                is_empty = False
                number = functools.partial(self._number, pair.stamp_ns)
                yield SequencePair(number, pair.stamp_ns, reader(pair))
            self._warnings += [*([pairs.warning] if pairs.warning else []), *pairs.losses]
            if is_empty:
                raise no_pair_error(pairs, self._selection.path, [])

    def _number(self, stamp_ns: int) -> int:
        return bisect.bisect_left(self._stamps, stamp_ns)

    @functools.cached_property
    def _stamps(self) -> list[int]:
        """Of all left images of the bag, ascending, integer nanoseconds."""
        with BagReader(self._selection.path) as reader:
            return sorted(cdr_stamp_ns(message.data) for message in reader.messages([self._left_topic]))

    def _compute(self, pair: StereoPair, rig: StereoRig) -> StereoResult:
        try:
            return self._pipelines.compute(pair, rig)
        except CameraOrderError as error:
            raise error.about(self._selection.path) from error


class DatasetSequence:
    """The pairs of a dataset, see :class:`Sequence`.

    Args:
        posed: the dataset.
        config: parameters of all stages.
    """

    def __init__(self, posed: PosedDataset, config: PipelineConfig) -> None:
        self._posed = posed
        self._pipelines = ExaminedPipelines(config)

    @property
    def files(self) -> list[Path]:
        """All files that are read."""
        return self._posed.dataset.files

    @property
    def warnings(self) -> list[str]:
        """A sentence each."""
        skipped = int(getattr(self._posed.dataset, "skipped", 0))
        return [f"{skipped} images have no partner, or pairs another calibration, and are left out"] * bool(skipped)

    @property
    def fault(self) -> StereoDepthError | None:
        """What the first pairs show."""
        self._pipelines.finish()
        return self._pipelines.fault

    def __len__(self) -> int:
        return len(self._posed.dataset)

    def __iter__(self) -> Iterator[SequencePair]:
        rig = self._posed.dataset.rig
        for number, frame in zip(self._posed.numbers, self._posed.dataset, strict=True):
            pair = StereoPair(frame.left, frame.right)
            read = functools.partial(_view, pair, rig, self._pipelines.compute)
            yield SequencePair(functools.partial(int, number), frame.left.stamp_ns, read)


def _view(pair: StereoPair, rig: StereoRig, compute: Callable[[StereoPair, StereoRig], StereoResult]) -> SequenceView:
    return SequenceView(pair.left.frame_id, rig, lambda: RangeImage.of(compute(pair, rig)))
