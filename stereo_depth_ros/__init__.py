# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stereo depth for ROS 2: rectification, disparity, depth and point clouds."""
