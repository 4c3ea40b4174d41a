# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS nodes, the only package that imports rclpy; they convert, call and publish."""
