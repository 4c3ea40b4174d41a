# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Synthetic stereo sequences: a ray-cast room, a moving rig of two verged cameras with distortion, exact truth."""

from stereo_depth_ros.synthetic.scene import Cylinder, Rectangle, Scene, Sphere, Texture, room_scene
from stereo_depth_ros.synthetic.sequence import SyntheticFrame, SyntheticSequence

__all__ = ["Cylinder", "Rectangle", "Scene", "Sphere", "SyntheticFrame", "SyntheticSequence", "Texture", "room_scene"]
