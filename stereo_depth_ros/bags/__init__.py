# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags without ROS: sources, reader, writer, recovery, topics and pairs."""
