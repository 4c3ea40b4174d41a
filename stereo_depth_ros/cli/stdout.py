# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Standard output of a command: only the command writes to it, and ends without a traceback where it cannot."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.files.output import as_output_errors

__all__ = ["finish_stdout", "own_stdout"]


def own_stdout() -> None:
    """Keep standard output for this program: what C++ libraries write to descriptor 1 goes to standard error.

    The errors of Fast DDS, for one, would stand between the lines of JSON. Does nothing where stdout is another file.
    """
    with suppress(AttributeError, OSError):  # a closed stdout or stderr, a stdout of another program
        if sys.stdout.fileno() == 1:
            own = os.fdopen(os.dup(1), "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)
            os.dup2(2, 1)
            sys.stdout = own


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
