# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairing: tolerances to the nanosecond, lost and late frames, clocks set back, any interleaving."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pytest

from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.pairing import PairingCounts, StereoPairing

MS = 10**6
EXACT = PairingConfig()
NEAREST = PairingConfig(approximate_sync=True)
Stamps = Sequence[int]


def within(tolerance_s: float, queue_size: int = 5) -> PairingConfig:
    return PairingConfig(approximate_sync=True, approximate_sync_tolerance_seconds=tolerance_s, queue_size=queue_size)


def run(pairing: StereoPairing[int], arrivals: Iterable[tuple[str, int]]) -> list[tuple[int, int]]:
    """Pairs of stamps, for arrivals of ("L" or "R", stamp)."""
    pairs = []
    for side, stamp_ns in arrivals:
        pairs += (pairing.add_left if side == "L" else pairing.add_right)(stamp_ns, stamp_ns)
    return pairs


def interleaved(left: Stamps, right: Stamps, rng: np.random.Generator) -> list[tuple[str, int]]:
    """Both sequences in their order, one into the other at random."""
    sides = rng.permutation(["L"] * len(left) + ["R"] * len(right))
    stamps = {"L": iter(left), "R": iter(right)}
    return [(side, next(stamps[side])) for side in sides]


def by_time(left: Stamps, right: Stamps) -> list[tuple[str, int]]:
    return sorted([("L", s) for s in left] + [("R", s) for s in right], key=lambda arrival: arrival[1])


def test_items_are_returned_as_left_and_right() -> None:
    pairing: StereoPairing[str] = StereoPairing(EXACT)
    assert pairing.add_right(7, "right") == []
    assert (pairing.pending_left, pairing.pending_right) == (0, 1)
    assert pairing.add_left(7, "left") == [("left", "right")]
    assert pairing.counts == PairingCounts(paired=1)
    assert (pairing.pending_left, pairing.pending_right) == (0, 0)


@pytest.mark.parametrize(
    ("config", "difference_ns", "paired"),
    [
        (EXACT, 0, True),
        (EXACT, 1, False),
        (EXACT, -1, False),
        (within(0.003), 3 * MS, True),
        (within(0.003), 3 * MS + 1, False),
        (within(0.003), -3 * MS, True),
        (within(0.003), -3 * MS - 1, False),
        (within(0.003), 0, True),
    ],
)
def test_tolerance_is_inclusive(config: PairingConfig, difference_ns: int, paired: bool) -> None:
    left = [100 * MS, 200 * MS, 300 * MS]
    right = [stamp + difference_ns for stamp in left]
    pairing: StereoPairing[int] = StereoPairing(config)
    pairs = run(pairing, by_time(left, right)) + pairing.flush()
    assert pairs == (list(zip(left, right, strict=True)) if paired else [])


def test_default_of_the_approximate_policy_has_no_limit() -> None:
    pairing: StereoPairing[int] = StereoPairing(NEAREST)
    assert run(pairing, [("L", 0), ("R", 900 * MS), ("L", 2000 * MS)]) == [(0, 900 * MS)]


def test_lost_frames_cost_their_partner_only() -> None:
    period = 33 * MS
    left = [i * period for i in range(20) if i not in (3, 4, 11)]
    right = [i * period for i in range(20) if i not in (0, 11, 15)]
    both = [stamp for stamp in left if stamp in right]
    pairing: StereoPairing[int] = StereoPairing(EXACT)
    assert run(pairing, by_time(left, right)) == [(stamp, stamp) for stamp in both]
    assert pairing.counts == PairingCounts(paired=15, dropped_left=2, dropped_right=2)


@pytest.mark.parametrize("config", [NEAREST, within(0.04)])
def test_a_lost_frame_does_not_shift_all_pairs_after_it(config: PairingConfig) -> None:
    """The tolerance is above a period here: pairing in order of arrival would stay one frame behind."""
    left = [i * 33 * MS for i in range(30) if i != 10]
    right = [i * 33 * MS + 5 * MS for i in range(30)]
    pairing: StereoPairing[int] = StereoPairing(config)
    assert run(pairing, by_time(left, right)) == [(stamp, stamp + 5 * MS) for stamp in left]
    assert pairing.counts.dropped_right == 1


def test_steady_cameras_are_paired_without_waiting_for_the_next_frame() -> None:
    pairing: StereoPairing[int] = StereoPairing(within(0.02))
    assert run(pairing, [("L", 0), ("R", 5 * MS)]) == []  # the period is not known yet
    assert run(pairing, [("L", 33 * MS)]) == [(0, 5 * MS)]
    assert run(pairing, [("R", 38 * MS)]) == [(33 * MS, 38 * MS)]
    assert run(pairing, [("L", 66 * MS), ("R", 66 * MS + 16 * MS + MS // 2)]) == [(66 * MS, 82 * MS + MS // 2)]
    assert run(pairing, [("L", 99 * MS), ("R", 99 * MS + 16 * MS + MS // 2 + 1)]) == []


def test_a_lost_frame_does_not_lengthen_the_period() -> None:
    pairing: StereoPairing[int] = StereoPairing(within(0.03))
    assert run(pairing, [("L", 0), ("R", 0), ("L", 33 * MS), ("R", 33 * MS)]) == [(0, 0), (33 * MS, 33 * MS)]
    assert run(pairing, [("L", 99 * MS), ("R", 119 * MS)]) == []  # the next left one is due 13 ms later
    assert run(pairing, [("L", 132 * MS)]) == [(132 * MS, 119 * MS)]


def test_the_closer_of_two_wins_and_the_earlier_at_a_tie() -> None:
    assert run(StereoPairing(NEAREST), [("L", 0), ("R", 10), ("L", 11), ("R", 30)]) == [(11, 10)]
    assert run(StereoPairing(NEAREST), [("L", 0), ("R", 10), ("L", 20), ("R", 50)]) == [(0, 10)]
    assert run(StereoPairing(NEAREST), [("R", 0), ("L", 10), ("R", 19), ("L", 50)]) == [(10, 19)]


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("tolerance_s", [0.0, 2e-9, 7e-9, 1.0])
def test_any_interleaving_gives_the_same_pairs(tolerance_s: float, seed: int) -> None:
    """On irregular stamps; no item twice, order kept, differences within the tolerance, the books add up."""
    rng = np.random.default_rng(seed)
    left, right = (sorted({int(s) for s in rng.integers(0, 200, 60)}) for _ in range(2))
    config = within(tolerance_s, queue_size=1000) if tolerance_s else PairingConfig(queue_size=1000)
    results = []
    for _ in range(8):
        pairing: StereoPairing[int] = StereoPairing(config)
        pairs = run(pairing, interleaved(left, right, rng)) + pairing.flush()
        counts = pairing.counts
        assert counts.paired + counts.dropped_left == len(left)
        assert counts.paired + counts.dropped_right == len(right)
        results.append(pairs)
    assert all(pairs == results[0] for pairs in results)
    assert len(results[0]) > 5
    for of_one_side in zip(*results[0], strict=True):
        assert list(of_one_side) == sorted(set(of_one_side))
    assert max(abs(a - b) for a, b in results[0]) <= round(tolerance_s * 1e9)
    if tolerance_s == 0.0:
        assert [a for a, _ in results[0]] == sorted(set(left) & set(right))


@pytest.mark.parametrize("seed", range(5))
def test_jittered_cameras_with_losses_get_their_own_partner(seed: int) -> None:
    """Differences stay below a quarter of the period, so the true partner is always the closest."""
    rng = np.random.default_rng(seed)
    exposures = np.arange(200) * 50 * MS
    jitter = rng.integers(-6 * MS, 6 * MS, (2, 200))
    kept = rng.random((2, 200)) > 0.1
    stamps = (exposures + jitter).tolist()
    left, right = ([s for s, keep in zip(stamps[e], kept[e], strict=True) if keep] for e in range(2))
    true_pairs = [(stamps[0][i], stamps[1][i]) for i in range(200) if kept[:, i].all()]
    pairing: StereoPairing[int] = StereoPairing(within(0.0125))
    assert run(pairing, by_time(left, right)) + pairing.flush() == true_pairs


def test_what_the_other_side_is_past_is_dropped_at_once() -> None:
    pairing: StereoPairing[int] = StereoPairing(EXACT)
    run(pairing, [("L", 1), ("L", 2), ("L", 3)])
    assert run(pairing, [("R", 3)]) == [(3, 3)]
    assert pairing.counts == PairingCounts(paired=1, dropped_left=2)


def test_full_queue_drops_the_oldest() -> None:
    pairing: StereoPairing[int] = StereoPairing(PairingConfig(queue_size=3))
    run(pairing, [("L", stamp) for stamp in range(10)])
    assert (pairing.pending_left, pairing.counts.dropped_left) == (3, 7)
    assert run(pairing, [("R", 7)]) == [(7, 7)]
    assert run(pairing, [("R", 9)]) == [(9, 9)]


def test_one_side_may_keep_more_than_the_other() -> None:
    pairing: StereoPairing[int] = StereoPairing(PairingConfig(queue_size=3))
    pairing.right_queue_size = 8
    run(pairing, [("R", stamp) for stamp in range(10)])
    assert (pairing.pending_right, pairing.counts.dropped_right) == (8, 2)
    run(pairing, [("L", stamp) for stamp in range(20, 30)])
    assert (pairing.pending_left, pairing.pending_right) == (3, 0)


def test_full_queue_releases_the_pair_that_awaits_a_closer_item() -> None:
    pairing: StereoPairing[int] = StereoPairing(within(1.0, queue_size=2))
    assert run(pairing, [("L", 0), ("R", 10), ("R", 20)]) == []
    assert run(pairing, [("R", 30)]) == [(0, 10)]
    assert (pairing.pending_left, pairing.pending_right) == (0, 2)


def test_flush_releases_the_last_pair_and_drops_the_rest() -> None:
    pairing: StereoPairing[int] = StereoPairing(within(1.0))
    assert run(pairing, [("L", 0), ("R", 10), ("R", 20)]) == []
    assert pairing.flush() == [(0, 10)]
    assert pairing.counts == PairingCounts(paired=1, dropped_right=1)
    assert (pairing.pending_left, pairing.pending_right) == (0, 0)


def test_duplicates_are_ignored() -> None:
    pairing: StereoPairing[int] = StereoPairing(EXACT)
    arrivals = [("L", 1), ("L", 1), ("R", 1), ("R", 1), ("L", 1), ("L", 2), ("L", 3), ("L", 2), ("R", 2), ("R", 3)]
    assert run(pairing, arrivals) == [(1, 1), (2, 2), (3, 3)]
    assert pairing.counts == PairingCounts(paired=3, duplicates=4)


def test_a_late_item_is_paired_while_its_place_is_open() -> None:
    pairing: StereoPairing[int] = StereoPairing(EXACT)
    assert run(pairing, [("R", 1), ("R", 3), ("R", 2), ("L", 1), ("L", 2), ("L", 3)]) == [(1, 1), (2, 2), (3, 3)]
    assert pairing.counts == PairingCounts(paired=3)


@pytest.mark.parametrize("config", [EXACT, NEAREST])
def test_a_late_item_is_never_released_out_of_order(config: PairingConfig) -> None:
    pairing: StereoPairing[int] = StereoPairing(config)
    assert run(pairing, [("L", 5), ("R", 5), ("L", 4), ("R", 4), ("L", 6), ("R", 6)]) == [(5, 5), (6, 6)]
    assert pairing.counts == PairingCounts(paired=2, dropped_left=1, dropped_right=1)


def test_looped_bag_restarts_the_pairing() -> None:
    bag = [(side, i * 100 * MS) for i in range(12) for side in "LR"]
    pairing: StereoPairing[int] = StereoPairing(EXACT)
    assert len(run(pairing, bag + bag + bag)) == 36
    assert pairing.counts == PairingCounts(paired=36, backwards=2)


@pytest.mark.parametrize(("back_ns", "backwards", "pending"), [(1000 * MS, 0, 2), (1000 * MS + 1, 1, 1)])
def test_more_than_one_second_back_is_another_clock(back_ns: int, backwards: int, pending: int) -> None:
    pairing: StereoPairing[int] = StereoPairing(EXACT)
    run(pairing, [("L", 2000 * MS), ("L", 2000 * MS - back_ns)])
    assert (pairing.counts.backwards, pairing.pending_left) == (backwards, pending)


def test_late_items_between_timely_ones_are_no_set_back_clock() -> None:
    arrivals = [(side, stamp) for i in range(10, 30) for stamp in (i * MS, i * MS - 5) for side in "LR"]
    pairing: StereoPairing[int] = StereoPairing(EXACT)
    assert len(run(pairing, arrivals)) == 20
    assert pairing.counts == PairingCounts(paired=20, dropped_left=20, dropped_right=20)


def test_cleared_items_are_counted_as_dropped() -> None:
    pairing: StereoPairing[int] = StereoPairing(within(0.001))
    run(pairing, [("L", 5000 * MS), ("L", 5033 * MS), ("L", 0)])
    assert (pairing.pending_left, pairing.pending_right) == (1, 0)
    assert pairing.counts == PairingCounts(dropped_left=2, backwards=1)


def test_a_clock_set_back_a_little_costs_a_queue_of_frames() -> None:
    """A third of a second back: more late frames in a row than the queue holds cannot be reordering."""
    bag = [(side, i * 33 * MS) for i in range(11) for side in "LR"]
    pairing: StereoPairing[int] = StereoPairing(EXACT)
    pairs = run(pairing, bag + bag)
    assert len(pairs) == 11 + 6
    assert pairing.counts == PairingCounts(paired=17, dropped_left=5, dropped_right=5, backwards=1)
