# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two-view geometry: correspondences, epipolar geometry, rectification, triangulation and reconstruction."""
