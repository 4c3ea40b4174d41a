# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Starts `stereo-depth`: a signal while the program is imported ends it with one line and exit code 130."""

from __future__ import annotations

import os
import signal

__all__ = ["main"]


def main() -> None:
    """Entry point of the console script."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)
    from stereo_depth_ros.cli.main import main as run

    run()


def _end(*_: object) -> None:
    os.write(2, b"interrupted: nothing was written\n")
    os._exit(130)


if __name__ == "__main__":
    main()
