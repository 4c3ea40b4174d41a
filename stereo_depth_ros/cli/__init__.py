# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command line `stereo-depth`; the only place that prints or exits."""
