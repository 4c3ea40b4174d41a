# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Depth from focus: depth and an all-in-focus image from images of one camera at several focus distances."""
