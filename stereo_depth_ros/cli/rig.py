# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth rig`: computes the fields of view, depth range, depth errors and disparity range of a rig."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from stereo_depth_ros.cli.camera_info import ImageSize, parse_size
from stereo_depth_ros.cli.given import given_parameters, refuse_ignored, require_png
from stereo_depth_ros.cli.options import Json, Left, Overwrite, Params, ParamsFile, Right, new_app
from stereo_depth_ros.cli.output import parameter_files, show, warn
from stereo_depth_ros.cli.params_file import read_parameters
from stereo_depth_ros.cli.rig_tables import rig_tables
from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.datasets.rig_files import is_bag_path, read_rig, rig_files
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.geometry.depth_range import (
    Precision,
    default_nearest_m,
    depth_errors,
    depth_range,
    recommended_search,
    rounded_depths_m,
)
from stereo_depth_ros.geometry.field_of_view import field_of_view
from stereo_depth_ros.matching import matcher_from_config
from stereo_depth_ros.matching.disparity_sigma import DEFAULT_SIGMA_PX
from stereo_depth_ros.plots.depth_error import depth_error_plot
from stereo_depth_ros.plots.drawing import save_png

__all__ = ["app"]

app = new_app()

_BASELINES = (0.5, 1.0, 2.0)  # relative to that of the rig
_PLOT_POINTS = 300
_USED = ("stereo_algorithm", "min_disparity", "disparity_range", "disparity_sigma_px")


@app.command()
def rig(
    context: typer.Context,
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="LEFT RIGHT|DIR|BAG", help="Read these calibration files, their folder, or a bag."),
    ],
    nearest: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Set the nearest depth needed, in meters; by default, its disparity is 1/8 of the width."
        ),
    ] = None,
    max_error: Annotated[
        float, typer.Option(metavar="PERCENT", help="Set the largest useful depth error, in percent of the depth.")
    ] = 5.0,
    matcher: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Use the disparity step of this matcher.", autocompletion=lambda: [*MATCHERS]
        ),
    ] = None,
    param: Params = None,
    params_file: ParamsFile = None,
    size: ImageSize = None,
    left: Left = None,
    right: Right = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Plot the depth error over the depth.")] = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Compute the fields of view, depth range, depth errors and recommended disparity range of a rig.

    The files are those of camera_calibration, Kalibr, OpenCV and others, see docs/calibration.md; beside left.yaml,
    right.yaml is read from the same folder. From a bag, the first camera infos are read.

    The disparity range is the recommended one, unless min_disparity or disparity_range is set. The depth error is
    sigma_Z = Z^2 / (f B) sigma_d with sigma_d = disparity_sigma_px, 0.25 px if it is 0; the depth step is that of the
    matcher's disparities. The results for other baselines assume that nothing else changes.

    \b
    Examples:
      stereo-depth rig left.yaml right.yaml
      stereo-depth rig calibration --nearest 0.4 --max-error 2 --plot error.png
      stereo-depth rig drive.mcap --param disparity_range:=128 --param disparity_sigma_px:=0.1 --json - | jq .limits
    """
    file = read_parameters(params_file)
    values = {**file, **given_parameters(param or (), matcher, file=file, stages=(), names=_USED)}
    if not is_bag_path(paths):
        refuse_ignored(context, ("left", "right"), "with camera files", "leave it out, or give a bag")
    else:
        refuse_ignored(context, ["size"], "with a bag, whose camera infos state it", "leave it out")
    inputs = [*rig_files(paths), *parameter_files(params_file, values)]
    check_outputs([plot] if plot is not None else [], inputs, reports=[json_file], overwrite=overwrite)
    require_png("--plot", plot)
    rig = read_rig(paths, left, right, parse_size(size))
    config = pipeline_config(values)
    step_px = matcher_from_config(config.matching).step_px
    precision = Precision(step_px, config.depth.disparity_sigma_px or DEFAULT_SIGMA_PX, max_error / 100)
    nearest_m = default_nearest_m(rig) if nearest is None else nearest
    recommended = recommended_search(rig, nearest_m)
    given = bool({"min_disparity", "disparity_range"} & values.keys())
    survey = _Survey(rig, config.matching if given else recommended, precision)
    result = survey.to_json() | {"recommended": {"nearest_m": nearest_m, **_search_values(recommended)}}
    if plot is not None:
        save_png(plot, survey.plot(), overwrite=overwrite)
        result["plot"] = str(plot)
    show(rig_tables(result, given), result, json_file, overwrite=overwrite)
    actual = next(item for item in result["limits"] if item["baseline_factor"] == 1)
    if actual["nearest_m"] >= actual["farthest_m"]:
        warn(
            f"at the nearest depth, {actual['nearest_m']:.3g} m, the depth error is above {max_error:g} %, which is "
            f"reached at {actual['farthest_m']:.3g} m: search larger disparities (--nearest), or raise --max-error"
        )


@dataclass(frozen=True)
class _Survey:
    """All results for one rig, disparity range and precision."""

    rig: StereoRig
    search: MatchingConfig
    precision: Precision

    def to_json(self) -> dict[str, Any]:
        """JSON values, names with units; None for infinite or undefined values."""
        limits = [self._limits(factor) for factor in _BASELINES]
        actual = limits[_BASELINES.index(1.0)]
        last_m = min(actual["farthest_m"], actual["search_end_m"] or math.inf)
        depths_m = rounded_depths_m(actual["nearest_m"], max(last_m, actual["nearest_m"]))
        rig = self.rig
        return {
            "cameras": list(rig.topics),
            "rig": {
                "width": rig.width,
                "height": rig.height,
                "f_px": rig.f_px,
                "fy_px": rig.fy_px,
                "baseline_m": rig.baseline_m,
                "doffs_px": rig.doffs_px,
            },
            "field_of_view": {
                "raw_left": _known(asdict(field_of_view(rig.left))),
                "raw_right": _known(asdict(field_of_view(rig.right))),
                "rectified": _known(asdict(field_of_view(rig.left.rectified()))),
            },
            "precision": asdict(self.precision),
            "search": _search_values(self.search),
            "limits": limits,
            "depths": [_known(asdict(error)) for error in depth_errors(rig, depths_m, self.precision)],
        }

    def plot(self) -> U8:
        """The depth error over the depth for each baseline, up to the farthest useful depth of all."""
        ranges = {factor: depth_range(self.rig, self.search, self.precision, factor) for factor in _BASELINES}
        last_m = max(min(found.farthest_m, found.search_end_m) for found in ranges.values())
        depths_m = np.linspace(last_m / _PLOT_POINTS, last_m, _PLOT_POINTS)
        sigma_m, nearest_m = {}, {}
        for factor, found in ranges.items():
            name = f"{1e3 * found.baseline_m:.0f} mm"
            errors = depth_errors(self.rig, depths_m.tolist(), self.precision, factor)
            sigma_m[name] = np.array([error.sigma_m for error in errors])
            nearest_m[name] = found.nearest_m
        title = f"depth error, f {self.rig.f_px:.0f} px, sigma of disparities {self.precision.sigma_px:g} px, baselines"
        return depth_error_plot(depths_m, sigma_m, nearest_m, self.precision.max_error, title)

    def _limits(self, factor: float) -> dict[str, Any]:
        return {"baseline_factor": factor, **_known(asdict(depth_range(self.rig, self.search, self.precision, factor)))}


def _search_values(search: MatchingConfig) -> dict[str, int]:
    return {"min_disparity": search.min_disparity, "disparity_range": search.num_disparities}


def _known(values: dict[str, float]) -> dict[str, float | None]:
    """The values, None for those that are not finite."""
    return {name: value if math.isfinite(value) else None for name, value in values.items()}
