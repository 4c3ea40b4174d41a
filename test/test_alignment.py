# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Alignment of many views: graphs of known poses with errors of known covariance."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from rendered_corner import motion

from stereo_depth_ros.core.errors import RegistrationError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.surfaces.alignment import WORLD, RelativePose, align
from stereo_depth_ros.surfaces.registration import moved_by

# A turn around an axis in five views, not in equal steps.
TRUTH = [
    motion((4, 72 * n + 3 * n * n % 7, -2 * n), (0.4 * np.sin(1.2 * n), 0.1 * n, 0.5 * np.cos(1.3 * n)))
    for n in range(5)
]
RING = [(n, (n + 1) % 5) for n in range(5)]


def error_of(found: Pose, truth: Pose) -> F64:
    apart = found @ truth.inverse()
    return np.concatenate((np.asarray(cv2.Rodrigues(apart.rotation)[0]).ravel(), apart.translation_m))


def relative(first: int, second: int, rng: np.random.Generator | None = None, scale: float = 1.0) -> RelativePose:
    """The true pose between two views, with an error of a covariance that is not the same in all directions."""
    start = Pose.identity() if first == WORLD else TRUTH[first]
    mixed = np.random.default_rng(10 * first + second + 20).normal(0, 1, (6, 6))
    root = scale * np.diag([0.002, 0.004, 0.001, 0.003, 0.002, 0.001]) @ (np.identity(6) + 0.2 * mixed)
    noise = root @ rng.normal(0, 1, 6) if rng else np.zeros(6)
    return RelativePose(first, second, moved_by(start.inverse() @ TRUTH[second], noise), root @ root.T)


def test_exact_relative_poses_give_exact_poses() -> None:
    found = align(5, [relative(*pair) for pair in (*RING, (0, 2), (3, 1))])
    for pose, truth in zip(found.poses, TRUTH, strict=True):
        assert np.abs(error_of(pose, TRUTH[0].inverse() @ truth)).max() < 1e-7
    assert found.distances.max() < 1e-4 and not found.covariances[0].any()


def test_the_world_may_be_known() -> None:
    found = align(5, [relative(2, 1), relative(2, 3), relative(3, 4), relative(0, 4), relative(WORLD, 3)])
    for pose, truth in zip(found.poses, TRUTH, strict=True):
        assert np.abs(error_of(pose, truth)).max() < 1e-7


@pytest.mark.parametrize("world", [False, True])
def test_covariances_are_those_of_the_errors(world: bool) -> None:
    rng, squares, apart = np.random.default_rng(4), [], []
    edges = [*RING, (0, 2), (3, 1)] + ([(WORLD, n) for n in range(5)] if world else [])
    for _ in range(60):
        found = align(5, [relative(*pair, rng) for pair in edges])
        root = Pose.identity() if world else TRUTH[0].inverse()
        for n in range(0 if world else 1, 5):
            error = error_of(found.poses[n], root @ TRUTH[n])
            squares.append(error @ np.linalg.solve(found.covariances[n], error))
        apart.append(np.sum(np.square(found.distances)))
    assert np.mean(squares) == pytest.approx(6, rel=0.15)
    free = 6 * (len(edges) - 5 + (not world))
    assert np.mean(apart) == pytest.approx(free, rel=0.1)  # chi squared of what the loops have to spare


def test_a_loop_that_closes_makes_the_chain_more_accurate() -> None:
    rng = np.random.default_rng(8)
    squared = np.zeros(2)
    for _ in range(40):
        edges = [relative(*pair, rng) for pair in RING]
        for number, used in enumerate((edges[:4], edges)):
            found = align(5, used)
            squared[number] += np.sum(np.square(error_of(found.poses[4], TRUTH[0].inverse() @ TRUTH[4])[3:]))
    assert squared[1] < 0.5 * squared[0]


def test_a_wrong_relative_pose_shows_and_has_little_weight() -> None:
    rng = np.random.default_rng(5)
    edges = [relative(*pair, rng) for pair in (*RING, (0, 2), (3, 1), (1, 4))]
    edges[4] = RelativePose(4, 0, moved_by(edges[4].pose, np.array([0.2, 0, 0, 0, 0.1, 0])), edges[4].covariance)
    found = align(5, edges)
    assert np.argmax(found.distances) == 4 and found.distances[4] > 20
    for pose, truth in zip(found.poses, TRUTH, strict=True):
        assert np.abs(error_of(pose, TRUTH[0].inverse() @ truth)).max() < 0.03


def test_views_that_are_not_connected_are_refused() -> None:
    with pytest.raises(RegistrationError, match="2 of 5 views are not connected with the others, the first is view 3"):
        align(5, [relative(0, 1), relative(1, 2), relative(3, 4)])


def test_one_view_is_the_world() -> None:
    assert np.array_equal(align(1, []).poses[0].matrix, np.identity(4))
