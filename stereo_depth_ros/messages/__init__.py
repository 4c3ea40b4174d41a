# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS messages to numpy and back; duck-typed, no ROS import."""
