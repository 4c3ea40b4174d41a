# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags without ROS: reader, writer, recovery of cut files, stereo topics and pairs."""
