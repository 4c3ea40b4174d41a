# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C: a command ends within two seconds with exit code 130 and one line on what it leaves."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from stereo_depth_ros.core.interrupts import SIGNALS, handled_signals
from stereo_depth_ros.core.printable import printable
from stereo_depth_ros.files.output import OutputFile, recorded_outputs

__all__ = ["EXIT_INTERRUPTED", "interrupts_end_the_command"]

EXIT_INTERRUPTED = 130
_END_S = 1.5  # after a signal, to stop nodes and remove files; a kernel may take longer


class Interrupted(BaseException):
    """A signal has been received; typer and others have uses of their own for KeyboardInterrupt."""


@contextmanager
def interrupts_end_the_command() -> Iterator[None]:
    """SIGINT and SIGTERM in the ``with`` block raise Interrupted, after which the process ends with exit code 130.

    Where the main thread computes for too long to notice, the incomplete files are removed and the process ends.
    """
    with recorded_outputs() as outputs:

        def end_now() -> None:
            for output in outputs:
                if not output.complete:
                    output.discard()
            _tell(outputs)
            os._exit(EXIT_INTERRUPTED)

        with handled_signals(_interrupt, _END_S, end_now), _lost_interrupts_are_silent():
            try:
                yield
            except (Interrupted, KeyboardInterrupt):
                _tell(outputs)
                sys.exit(EXIT_INTERRUPTED)


@contextmanager
def _lost_interrupts_are_silent() -> Iterator[None]:
    """An Interrupted that is raised where C calls Python, as in a compilation, is lost: no traceback tells so."""
    former = sys.unraisablehook
    sys.unraisablehook = lambda lost: None if isinstance(lost.exc_value, Interrupted) else former(lost)
    try:
        yield
    finally:
        sys.unraisablehook = former


def _interrupt(*_: Any) -> None:
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # one is enough, and would disturb the end
    raise Interrupted


def _tell(outputs: Sequence[OutputFile]) -> None:
    complete = [str(output.path) for output in outputs if output.complete]
    removed = [str(output.path) for output in outputs if not output.complete]
    parts = [f"{', '.join(complete)} complete"] if complete else []
    parts += [f"incomplete {', '.join(removed)} removed"] if removed else []
    sys.stderr.write(f"interrupted: {printable('; '.join(parts) or 'nothing was written')}\n")
    sys.stderr.flush()
