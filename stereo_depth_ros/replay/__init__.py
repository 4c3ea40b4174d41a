# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whole bags through the path, live or offline, and what came of it; without ROS."""
