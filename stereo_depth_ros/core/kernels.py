# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels: machine code that releases the GIL, compiled in one explicit step and cached on disk."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import pickle
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys

__all__ = ["READ_ONLY_U8", "Kernel", "compile_kernels", "compiled"]

FunctionT = TypeVar("FunctionT", bound=Callable[..., object])

# Input images: numpy.frombuffer returns read-only arrays; writeable ones are accepted as well.
READ_ONLY_U8 = numba.types.Array(numba.uint8, 2, "C", readonly=True)

# Cached code may refer to functions that numba generated, by the name of a module that numba does not register.
sys.modules.setdefault("<dynamic>", types.ModuleType("<dynamic>"))

_LOCK_POLL_S, _WAITING_S = 0.1, 5.0

_PYTHON = f"py{sys.version_info[0]}{sys.version_info[1]}"
_pending: list[Kernel] = []  # kernels of the modules imported so far, neither compiled nor loaded
_pending_lock = threading.RLock()


class _HelperLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The code of a helper as it is linked into kernels: optimized there, once, and not turned into machine code here.

    Numba optimizes and generates the code of every function, and again as part of each one that calls it.
    """

    class _Unused:
        def set_env(self, name: str, environment: object) -> None:
            """Only machine code has a place for it."""

    @property
    def codegen(self) -> Any:
        return self._Unused()

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0


class _HelperCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler with a :class:`_HelperLibrary` for the code."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        super().__init__(typing, target, _HelperLibrary(target.codegen(), "helper"), *rest)


class _HelperDispatcher(CPUDispatcher):  # type: ignore[misc]
    """A helper; called from Python, as tests do, it is compiled once more on its own."""

    def add_overload(self, result: Any) -> None:
        self.overloads[tuple(result.signature.args)] = result

    def _compile_for_args(self, *args: Any, **kwargs: Any) -> Any:
        return self._alone._compile_for_args(*args, **kwargs)

    @cached_property
    def _alone(self) -> Any:
        return numba.njit(nogil=True)(self.py_func)


def compiled(*signatures: Any, allocates: bool = True, inlined: bool = True) -> Callable[[FunctionT], FunctionT]:
    """Decorator: compile to machine code that releases the GIL and is cached on disk.

    Functions with signatures are kernels, called from Python, compiled by :func:`compile_kernels`. Helpers are called
    by kernels only, have no signatures and are compiled as part of the kernels.

    Args:
        signatures: numba signatures.
        allocates: False for functions that create no arrays: views of arrays are then not reference counted, which
            saves atomic operations, so that a view per pixel costs nothing.
        inlined: of helpers that allocate nothing, whether they always are; for the others LLVM decides. False where a
            call costs nothing beside the work in it: the code is there once, and compiles faster.
    """

    def decorate(function: FunctionT) -> FunctionT:
        options: dict[str, Any] = {"nogil": True, "_nrt": allocates, "no_cfunc_wrapper": True}
        if not signatures:
            options |= {"forceinline": inlined and not allocates, "no_cpython_wrapper": True}
            options |= {"pipeline_class": _HelperCompiler}
        dispatcher: Any = numba.njit(**options)(function)
        if not signatures:
            dispatcher.__class__ = _HelperDispatcher
        return Kernel(dispatcher, signatures, allocates) if signatures else dispatcher  # type: ignore[return-value]

    return decorate


class Kernel:
    """A function with machine code for fixed signatures; compiled by the first call if not before."""

    def __init__(self, dispatcher: Any, signatures: tuple[Any, ...], allocates: bool) -> None:
        function = dispatcher.py_func
        self.name = f"{function.__module__}.{function.__qualname__}"
        self._dispatcher = dispatcher
        self._signatures = signatures
        dispatcher.enable_caching()
        # Numba names cache files by line number and stamps them with the modification time of the source file. Here the
        # stamp is a hash of the code, so that unrelated edits keep the cache and an edit of a helper does not.
        base = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}.{_PYTHON}"
        self._folder, self._base = Path(dispatcher._cache.cache_path), base
        self._index = IndexDataCacheFile(
            cache_path=dispatcher._cache.cache_path,
            filename_base=base,
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
        """Whether the code of every signature is cached and up to date."""
        codegen = self._dispatcher.targetctx.codegen()
        keys = (self._dispatcher._cache._index_key(signature, codegen) for signature in self._signatures)
        overloads = self._index._load_index()
        return all(key in overloads for key in keys)

    def lock(self) -> AbstractContextManager[bool]:
        """Keeps other processes of this user from compiling it; whether none does."""
        user = f".{os.getuid()}" if hasattr(os, "getuid") else ""
        return _file_lock(self._folder / f"{self._base}{user}.lock")

    def make_code(self) -> None:
        """Load the code from disk, or compile it."""
        for signature in self._signatures:
            try:
                if not self._load_code(signature):
                    self._dispatcher.compile(signature)
            except (ImportError, EOFError, pickle.UnpicklingError):  # a cache that cannot be loaded
                self._index.flush()
                self._dispatcher.compile(signature)
        self._dispatcher.disable_compile()
        self._call = self._dispatcher

    def _load_code(self, signature: Any) -> bool:
        """Load the code from disk where it is there; without the tables of the compiler, which take 0.25 s to build."""
        target = self._dispatcher.targetctx
        rtsys.initialize(target)
        code = self._dispatcher._cache._load_overload(signature, target)
        if code is not None:
            self._dispatcher.add_overload(code)
        return code is not None

    def _compile_and_call(self, *args: Any) -> Any:
        compile_kernels()
        return self._dispatcher(*args)


def compile_kernels(report: Callable[[int, int], object] = lambda number, total: None) -> None:
    """Load or compile every kernel of the modules imported so far, so that no frame waits for the compiler.

    Of several processes of a user each kernel is compiled by one; the others compile other kernels meanwhile, and then
    load its code from disk.

    Args:
        report: called with number and total before each kernel that has to be compiled, and with number 0 every few
            seconds while the last ones are compiled by other processes.
    """
    with _pending_lock:
        missing = [kernel for kernel in _pending if not kernel.is_on_disk]
        number, total, reported = 0, len(missing), time.monotonic()
        while missing:
            before = len(missing)
            for kernel in [*missing]:
                with kernel.lock() as locked:
                    if not locked:
                        continue
                    missing.remove(kernel)
                    if not kernel.is_on_disk:
                        number += 1
                        report(number, total)
                        kernel.make_code()
                        _pending.remove(kernel)
            if len(missing) < before:
                reported = time.monotonic()
                continue
            time.sleep(_LOCK_POLL_S)
            if time.monotonic() > reported + _WAITING_S:
                report(0, total)
                reported = time.monotonic()
        while _pending:
            _pending[0].make_code()
            _pending.pop(0)


@contextmanager
def _file_lock(path: Path) -> Iterator[bool]:
    """A lock between processes, not waited for; whether it was free. Always so if the system has no flock."""
    if importlib.util.find_spec("fcntl") is None:
        yield True
        return
    import fcntl

    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(descriptor)


def _fingerprint(function: Callable[..., object], options: str) -> str:
    """A hash of the bytecode and constants of a kernel and of all functions it calls."""
    digest = hashlib.sha256(f"{options} {np.__version__}".encode())
    _add_function(digest, function, set())
    return digest.hexdigest()


def _add_function(digest: Any, function: Any, seen: set[int]) -> None:
    if id(function) in seen:
        return
    seen.add(id(function))
    code = function.__code__
    _add_code(digest, code, function.__doc__)
    for cell in function.__closure__ or ():
        _add_value(digest, cell.cell_contents, seen)
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
    """Add a global that a kernel reads: a function by its code, anything else by its repr."""
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
