# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses refined by the surface fused before: errors of given poses shrink, what is not determined keeps its pose."""

from __future__ import annotations

import cv2
import numpy as np
from range_views import ball, box, looking_at, nearest, plane, view

from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.offline.refinement import PoseRefinement
from stereo_depth_ros.surfaces.volume import SurfaceVolume


def test_errors_of_poses_shrink() -> None:
    scene = nearest(ball((-0.3, 0.1, 1.2), 0.25), box((0.1, -0.3, 1.0), (0.4, 0.2, 1.3)), plane(2, 1.7), plane(1, 0.45))
    volume, random = SurfaceVolume(0.02), np.random.default_rng(4)
    refinement, errors = PoseRefinement(volume), []
    for number in range(5):
        pose = looking_at((0.06 * number - 0.1, 0.02 * number, 0.0), (0.0, 0.0, 1.3))
        image = view(scene, pose, 0.003, number)
        off = Pose(np.asarray(cv2.Rodrigues(random.normal(0, 0.006, 3))[0]), random.normal(0, 0.008, 3))
        given = off @ pose if number else pose
        used = refinement(image, given)
        volume.integrate(image, used)
        errors.append([np.linalg.norm(each.translation_m - pose.translation_m) for each in (given, used)])
    before, after = np.array(errors)[1:].T
    assert np.median(before) > 0.008 and after.max() < 0.003
    assert (refinement.refined, refinement.kept) == (4, 0)
    assert "4, moved by" in refinement.text and refinement.to_json() == {"refined": 4, "refinement_kept": 0}


def test_a_wall_does_not_determine_a_pose() -> None:
    volume = SurfaceVolume(0.02)
    refinement = PoseRefinement(volume)
    for number in range(2):
        pose = Pose(np.identity(3), np.array([0.02 * number, 0.0, 0.0]))
        image = view(plane(2, 1.0), pose, 0.003, number)
        assert refinement(image, pose).translation_m[0] == 0.02 * number
        volume.integrate(image, pose)
    assert (refinement.refined, refinement.kept) == (0, 1) and "do not determine" in refinement.text
