# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor: what is wrong with a stereo setup, and what to do about it."""
