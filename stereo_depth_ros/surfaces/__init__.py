# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Range images as surfaces: meshes, normals, registration, fusion, and their files."""
