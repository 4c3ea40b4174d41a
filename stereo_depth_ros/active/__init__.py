# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Active stereo: structured light, one-shot stripes and light stripes, with two cameras or a camera and a projector."""
