# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels: machine code without the interpreter lock, made in one explicit step and kept on disk."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import threading
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher

__all__ = ["READ_ONLY_U8", "Kernel", "compile_kernels", "compiled"]

FunctionT = TypeVar("FunctionT", bound=Callable[..., object])

# Images as they come: numpy.frombuffer gives arrays that cannot be written, and writeable ones are accepted as well.
READ_ONLY_U8 = numba.types.Array(numba.uint8, 2, "C", readonly=True)

_PYTHON = f"py{sys.version_info[0]}{sys.version_info[1]}"
_pending: list[Kernel] = []  # of the modules imported so far, neither compiled nor read from disk
_pending_lock = threading.RLock()


def compiled(*signatures: Any, allocates: bool = True) -> Callable[[FunctionT], FunctionT]:
    """Decorator: machine code that runs without the interpreter lock, kept on disk between processes.

    Functions with signatures are kernels, called from Python; :func:`compile_kernels` makes their code. Helpers, which
    only kernels call, have none and become part of those kernels.

    Args:
        signatures: of numba.
        allocates: False for functions that make no arrays: then views of arrays are not counted, which would be atomic
            operations across threads, and cost nothing even for every pixel. Such helpers are always inlined; the
            others are left to LLVM, which does better with long ones.
    """

    def decorate(function: FunctionT) -> FunctionT:
        inlined = not signatures and not allocates
        dispatcher: Any = numba.njit(nogil=True, forceinline=inlined, _nrt=allocates)(function)
        return Kernel(dispatcher, signatures, allocates) if signatures else dispatcher  # type: ignore[return-value]

    return decorate


class Kernel:
    """A function with machine code for fixed signatures; the first call makes the code where nothing did before."""

    def __init__(self, dispatcher: Any, signatures: tuple[Any, ...], allocates: bool) -> None:
        function = dispatcher.py_func
        self.name = f"{function.__module__}.{function.__qualname__}"
        self._dispatcher = dispatcher
        self._signatures = signatures
        dispatcher.enable_caching()
        # Numba names the files by line and stamps them with the time of the kernel's own file. Here the stamp is what
        # the code is made of, so an edit elsewhere changes nothing and an edit of a helper in another file does.
        self._index = IndexDataCacheFile(
            cache_path=dispatcher._cache.cache_path,
            filename_base=f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}.{_PYTHON}",
            source_stamp=_fingerprint(function, f"{signatures} {allocates}"),
        )
        dispatcher._cache._cache_file = self._index
        self._call: Callable[..., Any] = self._compile_and_call
        with _pending_lock:
            _pending.append(self)

    def __call__(self, *args: Any) -> Any:
        return self._call(*args)

    @property
    def is_on_disk(self) -> bool:
        """Whether the code of every signature is there and up to date."""
        codegen = self._dispatcher.targetctx.codegen()
        keys = (self._dispatcher._cache._index_key(signature, codegen) for signature in self._signatures)
        overloads = self._index._load_index()
        return all(key in overloads for key in keys)

    def make_code(self) -> None:
        """Read the code from disk, or compile it."""
        for signature in self._signatures:
            self._dispatcher.compile(signature)
        self._dispatcher.disable_compile()
        self._call = self._dispatcher

    def _compile_and_call(self, *args: Any) -> Any:
        compile_kernels()
        return self._dispatcher(*args)


def compile_kernels(report: Callable[[int, int], object] = lambda number, total: None) -> None:
    """Make the code of every kernel of the modules imported so far, so that no frame waits for it.

    What is on disk is read. The rest is compiled by one process of the user at a time: others wait, and read it then.

    Args:
        report: called before each kernel that has to be compiled, with its number and how many there are.
    """
    with _pending_lock:
        if not _pending:
            return
        if any(not kernel.is_on_disk for kernel in _pending):
            with _one_process_at_a_time():
                missing = [kernel for kernel in _pending if not kernel.is_on_disk]
                for number, kernel in enumerate(missing, start=1):
                    report(number, len(missing))
                    kernel.make_code()
                    _pending.remove(kernel)
        while _pending:
            _pending[0].make_code()
            _pending.pop(0)


@contextmanager
def _one_process_at_a_time() -> Iterator[None]:
    """A lock between processes; none where the system has no flock."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    own = Path(__file__).parent / "__pycache__"
    folder = own if os.access(own, os.W_OK) else Path(tempfile.gettempdir())
    path = folder / f"stereo_depth_ros-kernels-{os.getuid()}.lock"
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _fingerprint(function: Callable[..., object], options: str) -> str:
    """A hash of what a kernel's code is made of: its bytecode, its constants, and the same of all that it calls."""
    digest = hashlib.sha256(f"{options} {np.__version__}".encode())
    _add_function(digest, function, set())
    return digest.hexdigest()


def _add_function(digest: Any, function: Any, seen: set[int]) -> None:
    if id(function) in seen:
        return
    seen.add(id(function))
    code = function.__code__
    _add_code(digest, code, function.__doc__)
    for name in _names(code):
        if name in function.__globals__:
            digest.update(name.encode())
            _add_value(digest, function.__globals__[name], seen)


def _add_code(digest: Any, code: types.CodeType, doc: str | None) -> None:
    digest.update(code.co_code)
    digest.update(repr((code.co_names, code.co_varnames)).encode())
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            _add_code(digest, constant, None)
        elif constant != doc:
            digest.update(repr(constant).encode())


def _names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def _add_value(digest: Any, value: Any, seen: set[int]) -> None:
    """A global that a kernel reads: a helper by what it is made of, anything else by its text."""
    if isinstance(value, Dispatcher):
        digest.update(repr(sorted(value.targetoptions.items())).encode())
        _add_function(digest, value.py_func, seen)
    elif isinstance(getattr(value, "_defn", None), types.FunctionType):  # an intrinsic
        _add_function(digest, value._defn, seen)
    elif isinstance(value, types.FunctionType):
        _add_function(digest, value, seen)
    elif isinstance(value, type):
        digest.update(f"{value.__qualname__} {getattr(value, '_fields', '')}".encode())
    elif isinstance(value, types.ModuleType):
        digest.update(value.__name__.encode())
    else:
        digest.update(repr(value).encode())
