# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth parameters`: every parameter with default, range and meaning."""

from __future__ import annotations

from stereo_depth_ros.cli.options import Json, Overwrite, new_app
from stereo_depth_ros.cli.output import show
from stereo_depth_ros.cli.tables import parameters_table, parameters_values
from stereo_depth_ros.files.output import check_outputs

__all__ = ["app"]

app = new_app()


@app.command()
def parameters(json_file: Json = None, overwrite: Overwrite = False) -> None:
    """List every parameter with default, range and meaning.

    \b
    Example:
      stereo-depth parameters
    """
    check_outputs((), reports=[json_file], overwrite=overwrite)
    show([parameters_table()], parameters_values(), json_file, overwrite=overwrite)
