# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views of a rectified pair: images between the cameras, anaglyphs and other 3D images, stereograms, color maps."""
