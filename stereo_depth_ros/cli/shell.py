# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shell that runs the command line, for which completion is installed."""

from __future__ import annotations

from stereo_depth_ros.core.errors import StereoDepthError

__all__ = ["require_known_shell"]


def require_known_shell() -> None:
    """Check that typer can find out which shell runs this process, as its options for completion need.

    Raises:
        StereoDepthError: it is not known, as in a service or a pipeline.
    """
    try:
        import shellingham  # type: ignore[import-untyped]
    except ModuleNotFoundError:
        return  # then the options of typer take the name of a shell
    try:
        shellingham.detect_shell()
    except shellingham.ShellDetectionFailure as error:
        raise StereoDepthError(
            "the shell that runs this command is not known",
            remedy="write the script yourself, for bash: "
            "_STEREO_DEPTH_COMPLETE=source_bash stereo-depth > stereo-depth.sh",
        ) from error
