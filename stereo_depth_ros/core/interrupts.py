# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM: their handlers, and an end in time also while a kernel runs."""

from __future__ import annotations

import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["SIGNALS", "handled_signals"]

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def handled_signals(
    handler: Callable[[int, Any], object], seconds: float, *calls: Callable[[], object]
) -> Iterator[None]:
    """SIGINT and SIGTERM in the ``with`` block, which ends some time after one of them or else the calls are made.

    A handler in Python runs between two instructions of the main thread, so not while this computes in a kernel.
    Therefore another thread, which receives the signal at once, makes the calls.

    Args:
        handler: of both signals; one that is ignored stays ignored.
        seconds: after the signal, for the block to end.
        calls: made in this order; the last one ends the process.
    """
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    for number, former in handlers.items():
        if former is not signal.SIG_IGN:
            signal.signal(number, handler)
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    before = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    ended = threading.Event()

    def wait() -> None:
        with receiver:
            while number := receiver.recv(1):
                if number[0] in SIGNALS and not ended.wait(seconds):
                    for call in calls:
                        call()

    threading.Thread(target=wait, name="signals", daemon=True).start()
    try:
        yield
    finally:
        ended.set()
        signal.set_wakeup_fd(before)
        sender.close()
        for number, former in handlers.items():
            signal.signal(number, former)
