# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Projectors as inverse cameras: their calibration by a board, and depth from one camera and a projector."""
