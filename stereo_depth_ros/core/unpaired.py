# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Why messages of two sides have no partner, by their stamps in the order of arrival, and what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.pairing import PairingLimits

__all__ = [
    "STAMP_REMEDY",
    "Arrival",
    "cause_of_duplicates",
    "cause_of_loss",
    "stamp_offset_ns",
    "taken_together",
    "unset_stamps",
]

Arrival: TypeAlias = tuple[int, int]  # side, 0 is left and 1 right, and stamp in ns
STAMP_REMEDY = "let the driver stamp its images with the time of exposure"


def cause_of_loss(
    arrivals: Sequence[Arrival], names: tuple[str, str], limits: PairingLimits, right_queue_size: int = 0
) -> TopicError:
    """The most likely cause and its remedy.

    Args:
        arrivals: the last ones of both sides, in order.
        names: topics of the sides.
        limits: of the pairing.
        right_queue_size: of the pairing, where the right side keeps more than the left one.
    """
    left, right = _stamps(arrivals, 0), _stamps(arrivals, 1)
    both = " and ".join(names)
    if not (left.size and right.size):
        return TopicError(f"only one of {both} arrives", remedy="start the other one, or remap")
    queue_sizes = limits.queue_size, max(limits.queue_size, right_queue_size)
    if error := unset_stamps(arrivals, names) or _lag(arrivals, names, queue_sizes, limits.tolerance_ns or 0):
        return error
    offset_ns, limit_ns = stamp_offset_ns(left, right), limits.tolerance_ns
    if offset_ns is None or limit_ns is None or abs(offset_ns) <= limit_ns:
        problem = f"of {both}, messages of one have no partner"
        return TopicError(problem, remedy="publish both at one rate, and see what was lost")
    return TopicError(
        f"stamps of {both} are {abs(offset_ns) / 1e6:.3f} ms apart, the tolerance is {limit_ns / 1e6:g} ms",
        value=offset_ns,
        limit=limit_ns,
        remedy=_remedy_of_offset(offset_ns),
        settings=("approximate_sync", "approximate_sync_tolerance_seconds"),
    )


def cause_of_duplicates(names: tuple[str, str]) -> TopicError:
    """What is wrong where messages have the stamp of another one of their side."""
    return TopicError(
        f"messages of {' or '.join(names)} have the stamp of one before, and only the first is used",
        remedy="look for a second publisher, or a clock that stands still",
    )


def unset_stamps(arrivals: Sequence[Arrival], names: tuple[str, str]) -> TopicError | None:
    """What is wrong where all stamps of a side are 0, and more than the first one; else None."""
    sides = (_stamps(arrivals, 0), _stamps(arrivals, 1))
    unset = {name: stamps.size for name, stamps in zip(names, sides, strict=True) if stamps.size and not stamps.any()}
    if max(unset.values(), default=0) < 2:
        return None
    problem = f"the stamps of {' and '.join(unset)} are 0, which means not set, and images cannot be paired"
    return TopicError(problem, value=0, remedy=STAMP_REMEDY)


def taken_together(offset_ns: int) -> str:
    """What to do about stamps so far apart where the cameras are synchronized and only their stamps are not."""
    text = f"stamps are {abs(offset_ns) / 1e6:.3f} ms apart"
    return f"{text}: if the images were taken together, {_remedy_of_offset(offset_ns)}"


def stamp_offset_ns(
    left_ns: Sequence[int] | npt.NDArray[np.int64], right_ns: Sequence[int] | npt.NDArray[np.int64]
) -> int | None:
    """How much later the right stamps are, whatever is lost of either side.

    Returns:
        Median over all stamps that are the nearest of each other, nanoseconds; None where none of them are within half
        a period, because what is further away is another frame.
    """
    left, right = (np.unique(np.asarray(stamps, np.int64)) for stamps in (left_ns, right_ns))
    if not (left.size and right.size):
        return None
    of_left, of_right = _nearest(left, right), _nearest(right, left)
    mutual = np.flatnonzero(of_right[of_left] == np.arange(left.size))
    offsets = right[of_left[mutual]] - left[mutual]
    intervals = [int(np.median(np.diff(stamps))) for stamps in (left, right) if stamps.size > 1]
    if intervals:
        offsets = offsets[2 * np.abs(offsets) <= min(intervals)]
    return int(np.median(offsets)) if offsets.size else None


def _remedy_of_offset(offset_ns: int) -> str:
    """The parameters that pair stamps so far apart."""
    return f"set approximate_sync and an approximate_sync_tolerance_seconds above {abs(offset_ns) / 1e9:.6f}"


def _stamps(arrivals: Sequence[Arrival], side: int) -> npt.NDArray[np.int64]:
    return np.array([stamp for arrived, stamp in arrivals if arrived == side], np.int64)


def _nearest(stamps: npt.NDArray[np.int64], others: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """For each of the stamps the index of the nearest of the others; both ascend."""
    after = np.searchsorted(others, stamps).clip(max=others.size - 1)
    before = (after - 1).clip(min=0)
    nearest: npt.NDArray[np.int64] = np.where(stamps - others[before] < np.abs(others[after] - stamps), before, after)
    return nearest


def _lag(
    arrivals: Sequence[Arrival], names: tuple[str, str], queue_sizes: tuple[int, int], tolerance_ns: int
) -> TopicError | None:
    """What is wrong where a side arrives when the queue has dropped its partners already; else None."""
    for late, name in enumerate(names):
        lags, kept = _lags(arrivals, late, tolerance_ns), queue_sizes[1 - late]
        if not lags or np.median([messages for messages, _ in lags]) < kept:
            continue
        messages, most = int(np.median([messages for messages, _ in lags])), max(messages for messages, _ in lags)
        ms = np.median([time_ns for _, time_ns in lags]) / 1e6
        return TopicError(
            f"{name} arrives {messages} messages ({ms:.0f} ms) after those of {names[1 - late]} with its stamps, and "
            f"queue_size keeps {kept}",
            value=messages,
            limit=kept,
            remedy=f"set queue_size to {most + 1} or more, or find what delays it",
            settings=("queue_size",),
        )
    return None


def _lags(arrivals: Sequence[Arrival], late: int, tolerance_ns: int) -> list[tuple[int, int]]:
    """Of each message whose partner came first: messages of the other side after it, and the time they span, ns."""
    lags: list[tuple[int, int]] = []
    others = _stamps(arrivals, 1 - late)
    arrived = 0  # of the others
    for side, stamp in arrivals:
        if side != late:
            arrived += 1
        elif arrived:
            at = int(np.abs(others[:arrived] - stamp).argmin())
            if abs(others[at] - stamp) <= tolerance_ns:
                lags.append((arrived - 1 - at, int(others[arrived - 1] - others[at])))
    return lags
