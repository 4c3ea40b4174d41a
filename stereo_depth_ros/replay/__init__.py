# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags through a live graph: the plan and the processes; the nodes' part is in nodes/replay."""
