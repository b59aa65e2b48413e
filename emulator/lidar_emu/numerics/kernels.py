"""numba's compiler for kernels: functions of arrays and numbers, cached on disk once compiled."""

from __future__ import annotations

import gc
from collections.abc import Callable
from functools import cached_property
from typing import Any, Protocol, TypeVar, overload

from lidar_emu.numerics.memory_limit import check_memory_limit

check_memory_limit()  # before numba is loaded

import numpy as np  # noqa: E402
from numba import njit  # noqa: E402
from numba.core import config, event  # noqa: E402
from numba.core.registry import CPUDispatcher  # noqa: E402

from lidar_emu.numerics.kernel_cache import KernelCache  # noqa: E402

__all__ = ["interpreted", "kernel", "with_fields"]

_NO_WRAPPERS = {"nopython": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class _Uncollected(event.Listener):
    """Suspends garbage collection while numba compiles: numba creates millions of objects and keeps most of them."""

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
    """A kernel compiled without Python wrappers; the first call from Python compiles it again, with them.

    Unpacking Python arguments is more code than most kernels have, and took a third of the compilation time.
    """

    def __call__(self, *args: Any) -> Any:
        return self._for_python(*args)

    @cached_property
    def _for_python(self) -> Any:
        own = {name: value for name, value in self.targetoptions.items() if name not in _NO_WRAPPERS}
        return _compiled(self.py_func, **own)


@overload
def kernel(function: _Function) -> _Function: ...


@overload
def kernel(
    *,
    outermost: bool = False,
    allocates: bool = False,
    fastmath: Any = False,
    inline: str = "never",
    forceinline: bool = False,
) -> _Decorator: ...


def kernel(function: Any = None, *, outermost: bool = False, allocates: bool = False, **options: Any) -> Any:
    """`njit` for kernels that work in their caller's arrays; divisions follow IEEE 754.

    numba counts references to an array's owner, atomically, wherever the array is passed on. In code that consists of
    short kernels this takes half of the run time and of the compilation time. Here only kernels that allocate count
    references.

    Args:
        outermost: the kernel is called from Python, and cached with all kernels that it calls.
        allocates: the kernel allocates arrays.
    """

    common = {"error_model": "numpy", "_nrt": allocates}

    def decorate(function: Any) -> Any:
        if outermost or config.DISABLE_JIT:  # type: ignore[attr-defined]
            return _compiled(function, **common, **options)
        return _Inner(function, targetoptions=_NO_WRAPPERS | common | options)

    return decorate if function is None else decorate(function)


def _compiled(function: Any, **options: Any) -> Any:
    decorate: Any = njit  # Its types have no `_nrt`.
    compiled = decorate(**options)(function)
    if compiled is not function:  # kernels are not interpreted
        compiled._cache = KernelCache(compiled)
    return compiled


def with_fields(structured: Any) -> Any:
    """A structured array for kernels, which read its fields as attributes.

    Interpreted kernels need a recarray for that; numba unpacks a plain array ten times faster.
    """
    return structured.view(np.recarray) if config.DISABLE_JIT else structured  # type: ignore[attr-defined]


def interpreted(compiled: _Function) -> _Function:
    """Python function behind a kernel: for a few values, a call of the kernel would spend longer unpacking its
    arguments."""
    function: _Function = getattr(compiled, "py_func", compiled)
    return function
