# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Core data types, the camera and rig model, pairing and compiled kernels; no ROS, no files of datasets or bags."""
