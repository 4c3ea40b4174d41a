# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of stereo rigs, and monitoring and correction of a calibration; without ROS."""
