# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM: their handlers, and an end in time also while a kernel runs or a clean-up hangs."""

from __future__ import annotations

import ctypes
import faulthandler
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["SIGNALS", "ended_within", "handled_signals"]

SIGNALS = (signal.SIGINT, signal.SIGTERM)
_TRACEBACK_S = 0.5  # to write where the threads are
_IN_A_THREAD = 2  # SIGEV_THREAD
_MONOTONIC = 1  # CLOCK_MONOTONIC


class _Event(ctypes.Structure):
    """What a timer of POSIX does: sigevent of Linux, 64 bytes."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("number", ctypes.c_int),
        ("kind", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("_unused", ctypes.c_int * 8),
    )


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


@contextmanager
def ended_within(seconds: float, exit_code: int) -> Iterator[None]:
    """The ``with`` block ends in time, or else the process, also where it hangs with the interpreter lock held.

    No thread of Python runs then. faulthandler writes the stacks of all threads to stderr without the lock, and half a
    second later a timer of the system calls ``_exit``. Where the system has no such timer, the exit code is 1.

    Args:
        seconds: for the block to end.
        exit_code: of the process, where it does not.
    """
    libc = ctypes.CDLL(None)
    has_timers = hasattr(libc, "timer_create")
    if has_timers:
        event = _Event(exit_code, 0, _IN_A_THREAD, ctypes.cast(libc._exit, ctypes.c_void_p))
        timer = ctypes.c_void_p()
        has_timers = libc.timer_create(_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0
    if has_timers:
        whole, rest = divmod(seconds + _TRACEBACK_S, 1.0)
        once_after = (ctypes.c_long * 4)(0, 0, int(whole), int(rest * 1e9))
        libc.timer_settime(timer, 0, once_after, None)
    faulthandler.dump_traceback_later(seconds, exit=not has_timers)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        if has_timers:
            libc.timer_delete(timer)
