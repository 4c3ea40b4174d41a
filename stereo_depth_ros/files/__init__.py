# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files: outputs that appear complete or not at all, and the data files of the package."""
