# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Structured light: sequences of patterns, and the projector pixel that each camera pixel sees."""
