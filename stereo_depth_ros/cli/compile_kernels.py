# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth compile-kernels`: compiles the kernels of every method in advance."""

from __future__ import annotations

import importlib
import pkgutil

import stereo_depth_ros.active
import stereo_depth_ros.core
import stereo_depth_ros.matching
import stereo_depth_ros.messages
import stereo_depth_ros.ranging
import stereo_depth_ros.stages
import stereo_depth_ros.surfaces
import stereo_depth_ros.synthetic
import stereo_depth_ros.views
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.options import new_app
from stereo_depth_ros.cli.output import tell

__all__ = ["PACKAGES", "app"]

app = new_app()

# Those of nodes first
PACKAGES = (
    stereo_depth_ros.core,
    stereo_depth_ros.stages,
    stereo_depth_ros.messages,
    stereo_depth_ros.matching,
    stereo_depth_ros.views,
    stereo_depth_ros.active,
    stereo_depth_ros.surfaces,
    stereo_depth_ros.ranging,
    stereo_depth_ros.synthetic,
)


@app.command()
def compile_kernels() -> None:
    """Compile the kernels of every method in advance; otherwise each is compiled on first use.

    \b
    Example:
      stereo-depth compile-kernels
    """
    for package in PACKAGES:
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            importlib.import_module(module.name)
    prepare_kernels()
    tell("all kernels are compiled")
