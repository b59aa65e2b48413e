"""numba's compiler, with a cache of compiled kernels that follows the sources.

numba keeps a compiled function until the file of that very function changes, whatever changes in what it calls.
So the cache lies in a folder named after all files that hold kernels: `~/.cache/lidar-emu/` unless
`XDG_CACHE_HOME` or `NUMBA_CACHE_DIR` say otherwise.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar, overload

from numba import njit
from numba.core import config

__all__ = ["interpreted", "kernel", "njit"]

_ROOMS = (".", "fmcw", "scanner", "scene", "trajectory")


def _sources_digest() -> str:
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(path for room in _ROOMS for path in (package / room).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "lidar-emu" / f"kernels-{_sources_digest()}"


if not config.CACHE_DIR:  # type: ignore[attr-defined]
    config.CACHE_DIR = str(_cache_folder())  # type: ignore[attr-defined]


_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Decorator(Protocol):
    def __call__(self, function: _Function) -> _Function: ...


@overload
def kernel(function: _Function) -> _Function: ...


@overload
def kernel(*, fastmath: Any = False, inline: str = "never", forceinline: bool = False) -> _Decorator: ...


def kernel(function: Any = None, **options: Any) -> Any:
    """`njit` for kernels that work in their caller's arrays and allocate none; divisions follow IEEE 754.

    numba counts references to an array's owner wherever the array is handed on, and does so atomically. In code made of
    short kernels that is half of the time, of running and of compiling alike; here nothing is counted.
    """
    compiled: Any = njit  # whose types do not know of `_nrt`
    decorate = compiled(cache=True, error_model="numpy", _nrt=False, **options)
    return decorate if function is None else decorate(function)


def interpreted(compiled: _Function) -> _Function:
    """The Python function behind a kernel: for a few values, on which a call would spend longer unpacking the model."""
    function: _Function = compiled.py_func  # type: ignore[attr-defined]
    return function
