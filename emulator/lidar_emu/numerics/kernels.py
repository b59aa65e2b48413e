"""Kernels: functions of arrays and numbers that run as machine code, compiled when they are first called."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Protocol, TypeVar, overload

from lidar_emu.errors import RunError

_LEAST_BYTES = 500 << 20
_EACH_PROCESSOR_BYTES = 50 << 20
"""OpenBLAS reserves memory for a thread on each processor, twice: numpy and scipy have one each."""


def _check_memory_limit() -> None:
    # OpenBLAS tries for ever to start in less.
    try:
        from resource import RLIM_INFINITY, RLIMIT_AS, getrlimit
    except ImportError:  # a system without such limits
        return
    limit_bytes = getrlimit(RLIMIT_AS)[0]
    least_bytes = _LEAST_BYTES + _EACH_PROCESSOR_BYTES * (os.cpu_count() or 1)
    if limit_bytes != RLIM_INFINITY and limit_bytes < least_bytes:
        raise RunError(
            f"too little memory: this process may have {limit_bytes >> 10} kB; "
            f"allow {least_bytes >> 10} kB (ulimit -v)"
        )


_check_memory_limit()  # before the linear algebra libraries are loaded

import numpy as np  # noqa: E402

from lidar_emu.files import check_extra  # noqa: E402
from lidar_emu.numerics.lazy_kernel import Kernel, prebuilt  # noqa: E402

__all__ = ["interpret_all_but", "interpreted", "kernel", "with_fields"]

_INTERPRETED = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")

_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Decorator(Protocol):
    def __call__(self, function: _Function) -> _Function: ...


@overload
def kernel(function: _Function) -> _Function: ...


@overload
def kernel(
    *,
    outermost: bool = False,
    allocates: bool = False,
    fastmath: Any = False,
    inline: str = "never",
    forceinline: bool = True,
    noalias: bool = True,
) -> _Decorator: ...


def kernel(function: Any = None, *, outermost: bool = False, allocates: bool = False, **options: Any) -> Any:
    """`njit` for kernels that work in their caller's arrays; divisions follow IEEE 754.

    numba counts references to an array's owner, atomically, wherever the array is passed on. In code that consists of
    short kernels this takes half of the run time and of the compilation time. Here only kernels that allocate count
    references.

    Args:
        outermost: the kernel is called from Python, and cached with all kernels that it calls. It returns no array:
            nobody would count the reference.
        allocates: the kernel allocates arrays.
        options: of `njit`. Unless `noalias` is False, no array that the kernel writes overlaps another argument, which
            saves checks in each loop. Unless `forceinline` is False, a kernel that is not outermost becomes part of its
            caller: to pass an array takes seven to nine numbers.
    """

    def decorate(function: Any) -> Any:
        if _INTERPRETED:
            return function
        own = {
            "error_model": "numpy",
            "_nrt": allocates,
            "noalias": True,
            "forceinline": not outermost,
            **options,
        }
        return Kernel(function, own, outermost, _machine_code)

    return decorate if function is None else decorate(function)


_compiled_alone: str | None = None


def interpret_all_but(full_name: str) -> None:
    """From now on, interpret every kernel but this one when it is called from Python."""
    global _compiled_alone
    _compiled_alone = full_name


def _machine_code(kernel: Kernel) -> Callable[..., Any]:
    if _compiled_alone not in (None, kernel.full_name):
        return kernel.py_func
    return prebuilt(kernel, _compiled) or _compiled(kernel)


def _compiled(kernel: Kernel) -> Callable[..., Any]:
    try:
        from lidar_emu.numerics.compiler import compiled_for_python
    except ImportError:  # a wheel with machine code does not depend on the compiler
        check_extra(kernel.full_name, "a kernel that is not precompiled", "numba", "compiler")
        raise

    return compiled_for_python(kernel)


def with_fields(structured: Any) -> Any:
    """A structured array for kernels, which read its fields as attributes.

    Interpreted kernels need a recarray for that; machine code unpacks a plain array ten times faster.
    """
    return structured.view(np.recarray) if _INTERPRETED or _compiled_alone else structured


def interpreted(compiled: _Function) -> _Function:
    """Python function behind a kernel: for a few values, a call of the kernel would spend longer unpacking its
    arguments."""
    function: _Function = getattr(compiled, "py_func", compiled)
    return function
