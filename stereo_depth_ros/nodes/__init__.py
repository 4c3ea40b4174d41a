# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS nodes, the only package that imports rclpy; they convert, call and publish."""

import sys

# `python -m stereo_depth_ros.nodes.NODE` imports this package before it knows the file of the node.
if sys.argv[:1] == ["-m"]:
    from stereo_depth_ros.nodes.start import end_at_once

    end_at_once()
