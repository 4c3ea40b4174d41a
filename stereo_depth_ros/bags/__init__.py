# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags without ROS: reader of whole, cut and damaged files, writer, stereo topics and pairs."""
