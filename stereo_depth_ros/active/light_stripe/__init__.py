# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Light stripe scanning: stripe extraction, light plane, motion of stripe or object, one or two cameras."""
