# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The end of standard output: what it still holds is written, and a full disk or a closed pipe is no traceback."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.files.output import telling

__all__ = ["finish_stdout"]


def finish_stdout() -> None:
    """Write what stdout still holds; who has closed the pipe it goes to is told nothing.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        with telling("standard output"):
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        _drop_stdout()
        sys.exit(1)
    except OutputError:
        _drop_stdout()
        raise


def _drop_stdout() -> None:
    """Python would try once more at its end, and complain."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
