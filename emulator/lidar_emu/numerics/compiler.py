"""numba's compiler for kernels, loaded when one must be compiled or read from the cache on disk."""

from __future__ import annotations

import gc
from collections.abc import Callable
from functools import cache
from typing import Any

from numba import njit
from numba.core import event, types
from numba.core.registry import CPUDispatcher
from numba.extending import typeof_impl

from lidar_emu.numerics.kernel_cache import KernelCache
from lidar_emu.numerics.lazy_kernel import Kernel

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


@cache
def compiled_for_python(kernel: Kernel) -> Callable[..., Any]:
    """The kernel as Python calls it: compiled for the types of its arguments at the first call with these."""
    compiled: Callable[..., Any] = dispatcher(kernel) if kernel.outermost else _with_wrappers(kernel)
    return compiled


@cache
def dispatcher(kernel: Kernel) -> Any:
    """numba's dispatcher for a kernel as compiled code calls it.

    Only an outermost kernel has wrappers for Python: unpacking Python arguments is more code than most kernels have,
    and took a third of the compilation time. Another one that is called from Python is compiled again, with them.
    """
    if kernel.outermost:
        return _with_wrappers(kernel)
    return without_wrappers(kernel)


def without_wrappers(kernel: Kernel) -> Any:
    """numba's dispatcher for a kernel that only compiled code calls."""
    return CPUDispatcher(kernel.py_func, targetoptions=_NO_WRAPPERS | kernel.targetoptions)


def _with_wrappers(kernel: Kernel) -> Any:
    decorate: Any = njit  # Its types have no `_nrt`.
    compiled = decorate(**kernel.targetoptions)(kernel.py_func)
    compiled._cache = KernelCache(kernel)
    return compiled


_register: Any = typeof_impl.register


@_register(Kernel)
def _type_of_kernel(kernel: Kernel, _context: object) -> Any:
    """Type of a kernel that another one calls."""
    return types.Dispatcher(dispatcher(kernel))
