# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Flushing of standard output at exit, without a traceback on a full disk or a closed pipe."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.files.output import as_output_errors

__all__ = ["finish_stdout"]


def finish_stdout() -> None:
    """Flush stdout; after a closed pipe exit with code 1 and without a message.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        with as_output_errors("standard output"):
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        _drop_stdout()
        sys.exit(1)
    except OutputError:
        _drop_stdout()
        raise


def _drop_stdout() -> None:
    """Redirect stdout to /dev/null: Python flushes it again at exit."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
