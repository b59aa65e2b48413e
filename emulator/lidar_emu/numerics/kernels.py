"""numba's compiler, with a cache of compiled kernels that follows the sources.

numba keeps a compiled function until the file of that very function changes, whatever changes in what it calls.
So the cache lies in a folder named after all files that hold kernels, in `~/.cache/lidar-emu/` unless `XDG_CACHE_HOME`
or `NUMBA_CACHE_DIR` say otherwise. Where nothing can be written every start compiles.
"""

from __future__ import annotations

import gc
import hashlib
import os
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, TypeVar, overload

import numpy as np
from numba import njit
from numba.core import config, event
from numba.core.registry import CPUDispatcher

from lidar_emu.files import cache_folder

__all__ = ["CACHED", "interpreted", "kernel", "njit", "with_fields"]

_ROOMS = ("fmcw", "scene")
"""Every file of these may hold what kernels take in."""
_OTHERS = ("echo", "faults", "flight", "numerics", "scanner", "trajectory", "trajectory/powered")
"""Of these, the files that have kernels."""

_OPTIONS = {"error_model": "numpy", "_nrt": False}
_NO_WRAPPERS = {"nopython": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def _sources_digest() -> str:
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for room in (*_ROOMS, *_OTHERS):
        for path in sorted((package / room).glob("**/*.py" if room in _ROOMS else "*.py")):
            source = path.read_bytes()
            if room in _ROOMS or b"lidar_emu.numerics.kernels" in source:
                digest.update(source)
    return digest.hexdigest()[:16]


def _kernels_folder() -> Path:
    stated: str = config.CACHE_DIR  # type: ignore[attr-defined]
    return (Path(stated) if stated else cache_folder()) / f"kernels-{_sources_digest()}"


def _use_cache() -> bool:
    """Tell numba where to keep what it compiles; whether it can be kept."""
    try:
        folder = _kernels_folder()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # read-only, or a user without a home
        return False
    config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
    return os.access(folder, os.W_OK)


CACHED = _use_cache()
"""Whether compiled kernels are kept; else numba would give up, or keep them beside the sources whatever changes."""


class _Uncollected(event.Listener):
    """No looking for garbage while numba compiles: it makes millions of objects and keeps most of them."""

    def __init__(self) -> None:
        self._depth = 0
        self._collecting = False

    def on_start(self, _event: Any) -> None:
        if self._depth == 0:
            self._collecting = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, _event: Any) -> None:
        self._depth -= 1
        if self._depth == 0 and self._collecting:
            gc.enable()


_listen: Any = event.register
_listen("numba:compile", _Uncollected())


_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Decorator(Protocol):
    def __call__(self, function: _Function) -> _Function: ...


class _Inner(CPUDispatcher):
    """Compiled for calls from kernels only; for one from Python once more, with all that such a call needs.

    Unpacking Python's arguments is more code than most kernels are, and made a third of the time of compiling.
    """

    def __call__(self, *args: Any) -> Any:
        return self._for_python(*args)

    @cached_property
    def _for_python(self) -> Any:
        own = {name: value for name, value in self.targetoptions.items() if name not in _NO_WRAPPERS}
        return _compiled(self.py_func, cache=CACHED, **own)


@overload
def kernel(function: _Function) -> _Function: ...


@overload
def kernel(
    *, outermost: bool = False, fastmath: Any = False, inline: str = "never", forceinline: bool = False
) -> _Decorator: ...


def kernel(function: Any = None, *, outermost: bool = False, **options: Any) -> Any:
    """`njit` for kernels that work in their caller's arrays and allocate none; divisions follow IEEE 754.

    numba counts references to an array's owner wherever the array is handed on, and does so atomically. In code made of
    short kernels that is half of the time, of running and of compiling alike; here nothing is counted.

    Args:
        outermost: called from Python, and kept in the cache with all that it calls.
    """

    def decorate(function: Any) -> Any:
        if outermost or config.DISABLE_JIT:  # type: ignore[attr-defined]
            return _compiled(function, cache=CACHED, **_OPTIONS, **options)
        return _Inner(function, targetoptions=_NO_WRAPPERS | _OPTIONS | options)

    return decorate if function is None else decorate(function)


def _compiled(function: Any, **options: Any) -> Any:
    decorate: Any = njit  # whose types do not know of `_nrt`
    return decorate(**options)(function)


def with_fields(structured: Any) -> Any:
    """A structured array as kernels take it, who read its fields as attributes.

    Of a plain array Python itself reads them by index alone; numba takes one ten times sooner than a recarray.
    """
    return structured.view(np.recarray) if config.DISABLE_JIT else structured  # type: ignore[attr-defined]


def interpreted(compiled: _Function) -> _Function:
    """The Python function behind a kernel: for a few values, on which a call would spend longer unpacking the model."""
    function: _Function = getattr(compiled, "py_func", compiled)
    return function
