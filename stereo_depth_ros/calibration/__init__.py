# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of a stereo rig, and whether it is still right; no ROS."""
