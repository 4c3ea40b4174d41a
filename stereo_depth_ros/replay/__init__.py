# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of a bag through a live graph: its options and the node processes; the ROS side is in nodes/replay."""
