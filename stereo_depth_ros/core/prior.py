# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Prior of the disparities of a pair: what another sensor says about some pixels, before the pair is matched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32

__all__ = ["DisparityPrior"]


@dataclass(frozen=True, eq=False)
class DisparityPrior:
    """Disparities that are expected at some pixels of the left rectified image, and how exactly.

    Attributes:
        disparity_px: float32 (H, W), x_left - x_right in pixels, NaN where nothing is expected.
        sigma_px: float32 (H, W), their standard deviation, px, from 0; of no meaning where the disparity is NaN.

    Raises:
        ImageError: not two float32 arrays (H, W) of one shape, or a standard deviation that is negative or not finite.
    """

    disparity_px: F32
    sigma_px: F32

    def __post_init__(self) -> None:
        shapes = {}
        for name in ("disparity_px", "sigma_px"):
            values = getattr(self, name)
            if not isinstance(values, np.ndarray) or values.dtype != np.float32 or values.ndim != 2:
                found = f"{values.dtype} of shape {values.shape}" if isinstance(values, np.ndarray) else type(values)
                raise ImageError(
                    f"{name} is {found}, a prior has float32 (H, W)",
                    subject="prior",
                    value=str(found),
                    limit="float32 (H, W)",
                    remedy="pass a map of the size of the left image, NaN where nothing is expected",
                )
            shapes[name] = values.shape
            object.__setattr__(self, name, np.ascontiguousarray(values))
        if shapes["disparity_px"] != shapes["sigma_px"]:
            raise ImageError(
                f"disparities have shape {shapes['disparity_px']}, standard deviations {shapes['sigma_px']}",
                subject="prior",
                value=shapes["sigma_px"],
                limit=shapes["disparity_px"],
                remedy="pass a standard deviation for each disparity",
            )
        sigmas = self.sigma_px[self.known]
        if not (np.isfinite(sigmas) & (sigmas >= 0)).all():
            wrong = float(sigmas[~(np.isfinite(sigmas) & (sigmas >= 0))][0])
            raise ImageError(
                f"a standard deviation is {wrong:g} px, below 0 or not finite",
                subject="prior",
                value=wrong,
                limit=0.0,
                remedy="leave out points of unknown accuracy",
            )

    @property
    def known(self) -> np.ndarray:
        """bool (H, W), the pixels at which a disparity is expected."""
        return np.asarray(np.isfinite(self.disparity_px))
