# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One-shot color stripes: the projector column of each pixel from a single image."""
