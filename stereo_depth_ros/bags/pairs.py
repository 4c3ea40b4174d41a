# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stereo pairs of a bag as serialized messages."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, TypeVar

from stereo_depth_ros.bags.file_infos import file_infos
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagMessage, BagReader
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.bags.stereo_topics import CameraImages, bag_topics, info_topics
from stereo_depth_ros.bags.topics import INFO_TYPE, StereoTopics
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.calibration_history import CalibrationHistory
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import BagError, ConfigError, MessageError, StereoDepthError, TopicError
from stereo_depth_ros.core.pairing import PairingCounts, StereoPairing
from stereo_depth_ros.core.rig import Rig, StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.core.unpaired import Arrival, cause_of_duplicates, cause_of_loss, unset_stamps
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.cdr import cdr_stamp_ns, with_stamp, without_stamp
from stereo_depth_ros.messages.image import decode_pair, image_size

__all__ = ["BagPairs", "BagSelection", "PerCalibration", "SerializedPair"]

T = TypeVar("T")
_ARRIVALS = 1000  # of the last images, by which a loss is explained


@dataclass(frozen=True)
class BagSelection:
    """Which part of a bag is read.

    Attributes:
        path: the bag.
        left, right: image topics; None finds them.
        start_seconds: where to begin, seconds after the first message of the bag.
        duration_seconds: how much to read, seconds; 0 reads to the end.
        side_by_side: both images are in one topic, ``left`` or ``right``, the left one in the left half.
        camera_files: calibration files that are read instead of the camera infos of the bag; see
            :func:`read_rig_files`.
    """

    path: Path
    left: str | None = None
    right: str | None = None
    start_seconds: float = 0.0
    duration_seconds: float = 0.0
    side_by_side: bool = False
    camera_files: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        for name in ("start_seconds", "duration_seconds"):
            value = getattr(self, name)
            if not 0 <= value <= 1e9:
                raise ConfigError(
                    f"{name} = {value} is outside 0..1e9 s",
                    value=value,
                    limit="0..1e9 s",
                    remedy="set seconds from the beginning of the bag",
                    settings=(name,),
                )


@dataclass(frozen=True)
class SerializedPair:
    """Left and right image of one pair with their camera infos, all as CDR bytes.

    Attributes:
        stamp_ns, right_stamp_ns: header stamps of the two images.
        left, right: images; Image or CompressedImage.
        left_info, right_info: CameraInfo with the stamp of its image.
        info_topics: topics of the camera infos, for error messages.
    """

    stamp_ns: int
    right_stamp_ns: int
    left: bytes
    right: bytes
    left_info: bytes
    right_info: bytes
    info_topics: tuple[str, str] = ("left", "right")

    def shifted(self, shift_ns: int) -> SerializedPair:
        """The same pair with all stamps later by ``shift_ns``."""
        if not shift_ns:
            return self
        stamp_ns, right_stamp_ns = self.stamp_ns + shift_ns, self.right_stamp_ns + shift_ns
        return SerializedPair(
            stamp_ns,
            right_stamp_ns,
            with_stamp(self.left, stamp_ns),
            with_stamp(self.right, right_stamp_ns),
            with_stamp(self.left_info, stamp_ns),
            with_stamp(self.right_info, right_stamp_ns),
            self.info_topics,
        )

    def images(
        self, types: RosbagsTypes, image_type: str, rig: Rig | None = None, depth: BitDepth | None = None
    ) -> StereoPair:
        """Both images, decoded.

        Args:
            types: deserializes the messages.
            image_type: message type of the images, :attr:`StereoTopics.image_type`.
            rig: the cameras; None does not check the sizes.
            depth: of the 16-bit images of the bag so far, grows with the pair; None is that of this pair alone.

        Raises:
            MessageError: a message that is damaged, or whose encoding is not supported.
            CalibrationError: an image has another size than the rig; nothing is decoded.
        """
        return decode_pair(*self.messages(types, image_type, rig), ("left image", "right image"), depth)

    def messages(self, types: RosbagsTypes, image_type: str, rig: Rig | None = None) -> tuple[Any, Any]:
        """Both images, not decoded; arguments and errors are those of :meth:`images`."""
        left, right = (types.deserialize(image, image_type) for image in (self.left, self.right))
        if rig is not None:
            for message, topic in zip((left, right), rig.topics, strict=True):
                rig.check_image(*image_size(message, f"{topic} image"), topic)
        return left, right

    @property
    def calibration(self) -> tuple[bytes, bytes]:
        """Camera infos without their stamps: equal for all pairs of one rig."""
        return without_stamp(self.left_info), without_stamp(self.right_info)

    def rig(self, types: RosbagsTypes) -> StereoRig:
        """The rig of the two camera infos.

        Args:
            types: deserializes the messages.

        Raises:
            MessageError: a message that is damaged.
            CalibrationError: camera infos that are not those of a rectified rig.
        """
        left, right = (types.deserialize(info, INFO_TYPE) for info in (self.left_info, self.right_info))
        return StereoRig.from_infos(left, right, self.info_topics)


class PerCalibration(Generic[T]):
    """What is built for the rig of a pair; kept until a camera info changes.

    Args:
        types: deserializes the camera infos.
        build: builds it; raises what :meth:`of` raises, besides the errors of :meth:`SerializedPair.rig`.
    """

    def __init__(self, types: RosbagsTypes, build: Callable[[StereoRig], T]) -> None:
        self._types = types
        self._build = build
        self._last: tuple[tuple[bytes, bytes], T] | None = None

    def of(self, pair: SerializedPair, image_type: str) -> T:
        """That of the pair, whose images are of ``image_type``; their sizes are checked before it is built.

        Raises:
            MessageError: as :meth:`SerializedPair.images`.
            CalibrationError: as :meth:`SerializedPair.images`, or no rig.
        """
        calibration = pair.calibration
        if self._last is None or self._last[0] != calibration:
            rig = pair.rig(self._types)
            pair.messages(self._types, image_type, rig)
            self._last = calibration, self._build(rig)
        return self._last[1]


class BagPairs:
    """An open stereo bag.

    The camera infos of a pair are those that apply to its stamps, see :class:`CalibrationHistory`, or the first ones of
    the bag, with the stamps of its images: camera infos that a driver published only once serve the whole bag. Where
    the topic names state that the images are rectified, the camera infos become those of rectified images, so that
    nothing is rectified twice. Images side by side are split here: the pairs have two raw images.

    Args:
        selection: bag, topics and part of it.
        pairing: parameters of the pairing by stamp.
        reader: of the bag, where it is open already; whoever opened it closes it.

    Attributes:
        topics: topics that are read.
        count: images of the left camera in the part that is read, by its share of the time of the bag: about as many
            pairs are read at most.
        part: which part that is, in words; empty for the whole bag.
        rectified_info: topic of the left camera infos where the images of the bag are rectified; None for raw images,
            and with calibration files.
        unpaired_left, unpaired_right: images without a partner; final when :meth:`pairs` is exhausted.
        losses: why most images are in no pair, and what was left out, a sentence each; final as those.
        unset: the error of stamps that are not set, where they are why there is one pair at most; final as those.

    Raises:
        BagError, TopicError: no bag, no stereo pair in it, or no camera infos.
        ConfigError: the part begins after the end of the bag.
        CalibrationError, MessageError: calibration files that are not those of its images.
    """

    def __init__(self, selection: BagSelection, pairing: PairingConfig, reader: BagReader | None = None) -> None:
        self._selection = selection
        self._pairing_config = pairing
        self._types = RosbagsTypes()
        self._owns_reader = reader is None
        self._reader = reader or BagReader(selection.path)
        self._file_infos: dict[str, bytes] = {}
        try:
            self.topics, self._info_topics = self._find_topics()
            share, self.part = self._part()
        except StereoDepthError:
            self.close()
            raise
        self._images = CameraImages(self._reader, self.topics)
        from_bag = self.topics.rectified and not selection.camera_files
        self.rectified_info = self.topics.left_info if from_bag else None
        self._unsplit: list[MessageError] = []
        self.count = math.ceil(share * self._reader.topics[self.topics.left_image].count)
        self.unpaired_left = self.unpaired_right = 0
        self.losses: tuple[str, ...] = ()
        self.unset: TopicError | None = None

    @property
    def path(self) -> Path:
        """The bag."""
        return self._selection.path

    @property
    def warning(self) -> str:
        """What of the bag could not be read so far; empty where nothing is missing, final as :attr:`losses`."""
        return self._reader.warning

    def pairs(self) -> Iterator[SerializedPair]:
        """The pairs in the order of their stamps.

        Raises:
            BagError: the bag is damaged where it is read.
        """
        pairing: StereoPairing[bytes] = StereoPairing(self._pairing_config)
        arrivals: deque[Arrival] = deque(maxlen=_ARRIVALS)
        self._unsplit = []
        calibrated = _CalibratedPairs(self._first_infos(), self._info_topics, self._pairing_config.queue_size)
        stamped = StampedMessages()
        for stamp_ns, message in stamped.read(self._messages()):
            if message.topic in self._info_topics:
                yield from calibrated.add_info(message.topic, self._info_of_images(message))
                continue
            for side, image in self._images_of(message):
                arrivals.append((side, stamp_ns))
                for left, right in (pairing.add_left, pairing.add_right)[side](stamp_ns, image):
                    yield from calibrated.add_pair(left, right)
        for left, right in pairing.flush():
            yield from calibrated.add_pair(left, right)
        yield from calibrated.flush()
        self.unpaired_left, self.unpaired_right = pairing.counts.dropped_left, pairing.counts.dropped_right
        self.losses = (*self._losses(pairing.counts, arrivals), *([str(stamped.error)] if stamped.error else []))

    def close(self) -> None:
        """Close the bag, unless it was open before."""
        if self._owns_reader:
            self._reader.close()

    def __enter__(self) -> BagPairs:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _images_of(self, message: BagMessage) -> Iterator[tuple[int, bytes]]:
        """Side and bytes of the images in a message; none of one that cannot be split, see :attr:`losses`."""
        try:
            yield from self._images.of(message)
        except MessageError as error:
            self._unsplit.append(error)

    def _losses(self, counts: PairingCounts, arrivals: Sequence[Arrival]) -> Iterator[str]:
        names = (self.topics.left_image, self.topics.right_image)
        if self._unsplit:
            yield f"{len(self._unsplit)} images left out, {self._unsplit[0]}"
        if error := unset_stamps(arrivals, names):
            self.unset = error if counts.paired <= 1 else None
            yield str(error)
            return
        if max(counts.dropped_left, counts.dropped_right) > counts.paired:
            yield str(cause_of_loss(arrivals, names, self._pairing_config))
        if counts.duplicates:
            yield f"{counts.duplicates} images left out, {cause_of_duplicates(names)}"

    def _part(self) -> tuple[float, str]:
        """The share of the bag's time that is read, and the part in words."""
        start_s, duration_s = self._selection.start_seconds, self._selection.duration_seconds
        length_s = (self._reader.end_ns - self._reader.start_ns) / 1e9
        if start_s > length_s:
            raise ConfigError(
                f"start at {start_s:g} s is beyond the end, the bag is {length_s:.3f} s long",
                subject=str(self._selection.path),
                value=start_s,
                limit=length_s,
                remedy="begin earlier",
                settings=("start_seconds",),
            )
        if not start_s and not duration_s:
            return 1.0, ""
        end_s = min(start_s + duration_s, length_s) if duration_s else length_s
        share = (end_s - start_s) / length_s if length_s else 1.0
        return share, f"from {start_s:g} to {end_s:.3f} s of {length_s:.3f} s"

    def _find_topics(self) -> tuple[StereoTopics, tuple[str, str]]:
        chosen = self._selection
        topics = bag_topics(self._reader, chosen.left, chosen.right, side_by_side=chosen.side_by_side)
        if chosen.camera_files:
            found = file_infos(self._reader, topics, chosen.camera_files)
            self._file_infos = dict(zip(found.rig.topics, found.messages(self._types), strict=True))
            return found.topics, found.rig.topics
        return topics, info_topics(self._reader, topics)

    def _first_infos(self) -> dict[str, bytes]:
        if self._file_infos:
            return self._file_infos
        infos = {}
        for topic in self._info_topics:
            stamped = StampedMessages()
            _, first = next(stamped.read(self._reader.messages([topic])), (0, None))
            if first is None:
                raise stamped.error or BagError(
                    f"{topic} has no messages",
                    subject=str(self._selection.path),
                    value=topic,
                    remedy="record the camera infos too, or give calibration files",
                    settings=("camera_info",),
                )
            infos[topic] = self._info_of_images(first)
        return infos

    def _info_of_images(self, message: BagMessage) -> bytes:
        """The camera info of the images; without distortion and rotation where they are already rectified."""
        if not self.topics.rectified:
            return message.data
        camera = camera_from_info(self._reader.deserialize(message), message.topic).rectified()
        return self._types.serialize(camera_info_message(self._types, camera, cdr_stamp_ns(message.data)))

    def _messages(self) -> Iterator[BagMessage]:
        start_ns = self._reader.start_ns + round(1e9 * self._selection.start_seconds)
        duration_ns = round(1e9 * self._selection.duration_seconds)
        wanted = [*self._images.names, *(() if self._file_infos else self._info_topics)]
        first_ns = start_ns if self._selection.start_seconds else None
        return self._reader.messages(wanted, first_ns, start_ns + duration_ns if duration_ns else None)


class _CalibratedPairs:
    """Gives pairs their camera infos; a pair waits for those of its stamps, which may follow it in the bag.

    Args:
        first: camera info of each topic that applies before others are added.
        topics: of the camera infos, left and right.
        queue_size: pairs that wait at most.
    """

    def __init__(self, first: Mapping[str, bytes], topics: tuple[str, str], queue_size: int) -> None:
        self._topics = topics
        self._queue_size = queue_size
        self._history: CalibrationHistory[bytes] = CalibrationHistory()
        self._waiting: deque[tuple[bytes, bytes]] = deque()
        for topic in dict.fromkeys(topics):
            self._add(topic, first[topic])

    def add_info(self, topic: str, info: bytes) -> Iterator[SerializedPair]:
        """Add a camera info; the pairs that need not wait any longer."""
        sides = [side for side, name in enumerate(self._topics) if name == topic]
        if any(cdr_stamp_ns(info) <= (self._history.last_ns(side) or 0) for side in sides):
            yield from self.flush()  # where stamps do not tell, it applies from here on
        self._add(topic, info)
        yield from self._release()

    def add_pair(self, left: bytes, right: bytes) -> Iterator[SerializedPair]:
        """Add both images of a pair; the pairs that need not wait."""
        self._waiting.append((left, right))
        yield from self._release()

    def flush(self) -> Iterator[SerializedPair]:
        """The pairs that wait."""
        while self._waiting:
            yield self._calibrated(self._waiting.popleft())

    def _release(self) -> Iterator[SerializedPair]:
        while self._waiting and (
            len(self._waiting) > self._queue_size or not self._history.lacks(_stamps_ns(self._waiting[0]))
        ):
            yield self._calibrated(self._waiting.popleft())

    def _add(self, topic: str, info: bytes) -> None:
        for side, name in enumerate(self._topics):
            if name == topic:
                self._history.add(side, cdr_stamp_ns(info), without_stamp(info), info)

    def _calibrated(self, pair: tuple[bytes, bytes]) -> SerializedPair:
        stamps_ns = _stamps_ns(pair)
        left_info, right_info = map(with_stamp, self._history.at(stamps_ns), stamps_ns)
        return SerializedPair(*stamps_ns, *pair, left_info, right_info, self._topics)


def _stamps_ns(pair: tuple[bytes, bytes]) -> tuple[int, int]:
    return cdr_stamp_ns(pair[0]), cdr_stamp_ns(pair[1])
