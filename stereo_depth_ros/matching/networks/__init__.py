# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Neural networks in ONNX files: opening them, their images, their outputs."""
