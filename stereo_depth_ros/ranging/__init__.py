# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Points of a range sensor beside the cameras, and what the left rectified camera sees of them; without ROS."""
