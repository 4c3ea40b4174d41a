# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data types, camera and rig models, pairing and compiled kernels; no ROS, bags or datasets."""
