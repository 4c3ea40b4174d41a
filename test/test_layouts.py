# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Both images side by side and interlaced."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.views.layouts import arranged


def test_layouts() -> None:
    left, right = np.arange(12, dtype=np.uint8).reshape(4, 3), np.arange(100, 112, dtype=np.uint8).reshape(4, 3)
    np.testing.assert_array_equal(arranged(left, right, "parallel")[1], [3, 4, 5, 103, 104, 105])
    np.testing.assert_array_equal(arranged(left, right, "cross")[1], [103, 104, 105, 3, 4, 5])
    np.testing.assert_array_equal(arranged(left, right, "interlaced")[:, 0], [0, 103, 6, 109])
    np.testing.assert_array_equal(left[:, 0], [0, 3, 6, 9])


def test_wrong_input_is_named() -> None:
    image = np.zeros((4, 3), np.uint8)
    with pytest.raises(ConfigError, match="layout 'above' is not one of parallel, cross, interlaced"):
        arranged(image, image, "above")
    with pytest.raises(ImageError, match="differ in shape"):
        arranged(image, image[:2], "cross")
