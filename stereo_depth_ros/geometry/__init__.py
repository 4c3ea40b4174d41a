# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two-view geometry: what two images say about the cameras that took them, and about the scene."""
