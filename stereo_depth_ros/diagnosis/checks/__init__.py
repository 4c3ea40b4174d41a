# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the doctor looks at, a file a subject; each check is a function that returns findings."""
