"""Machine code of kernels that was built ahead of time, by `tools/build_kernels.py` for a wheel.

It is called without numba: a start neither compiles nor loads the compiler. Kernels are found by the digest of all that
they are compiled from, and by the types of the arguments; what is not found is compiled. The code needs a processor of
the level x86-64-v3 (2013 and later).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from lidar_emu.errors import note_once
from lidar_emu.numerics.kernel_digest import digest
from lidar_emu.numerics.lazy_kernel import Kernel

TABLE = Path(__file__).with_name("prebuilt_kernels.json")
_NEEDED = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
"""Flags of Linux for what x86-64-v3 adds."""


def prebuilt(kernel: Kernel, compiled: Callable[[Kernel], Callable[..., Any]]) -> Callable[..., Any] | None:
    """The machine code that was built of a kernel; None if none was.

    Args:
        kernel: the kernel.
        compiled: returns the kernel compiled by numba, for arguments of types for which nothing was built.
    """
    found = _table().get(kernel.full_name)
    if found is None or found["digest"] != digest(kernel):
        return None
    overloads, functions = _modules()
    built = tuple((bytes.fromhex(key), getattr(functions, symbol)) for key, symbol in found["built"].items())
    chosen: Callable[..., Any] = overloads.Overloads(built, lambda *args: compiled(kernel)(*args))
    return chosen


def name_of(named: Any) -> bytes:
    """Name of a structured type, or of a class of named tuples, in the keys of overloads."""
    is_type = isinstance(named, np.dtype)
    text = repr(named) if is_type else f"{named.__module__}.{named.__qualname__} {named._fields}"
    return sha256(text.encode()).digest()[:8]


@cache
def _table() -> dict[str, Any]:
    """What was built, by the names of kernels; empty if nothing was, or if this processor cannot run it."""
    if not TABLE.exists():
        return {}
    lacking = _NEEDED - _processor_flags()
    if lacking:
        note_once("prebuilt", f"kernels are compiled here: this processor lacks {', '.join(sorted(lacking))}")
        return {}
    kernels: dict[str, Any] = json.loads(TABLE.read_text())
    return kernels


def _processor_flags() -> set[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return set()
    return next((set(line.split()) for line in lines if line.startswith("flags")), set())


@cache
def _modules() -> tuple[Any, Any]:
    overloads = import_module("lidar_emu.numerics.overloads")
    overloads.use_names(name_of)
    return overloads, import_module("lidar_emu.numerics.prebuilt_kernels")
