# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the doctor, one file per subject; each check is a function that returns findings."""
