"""A hash of all that a kernel is compiled from, which neither loads numba nor depends on the processor."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import EnumType
from functools import cache
from hashlib import sha256
from types import BuiltinFunctionType, CodeType

import numpy as np

from lidar_emu.numerics.lazy_kernel import Kernel


def digest(kernel: Kernel, target: str = "") -> str:
    """Hash of all inputs of a kernel's compilation: its own code, and the code of the kernels that it calls.

    Raises:
        TypeError: one of them uses a global of an unknown kind.
    """
    found: dict[Kernel, bytes] = {}
    waiting = [kernel]
    while waiting:
        if (each := waiting.pop()) not in found:
            found[each], called = _ingredients(each)
            waiting += called
    return sha256(b"".join([target.encode(), *found.values()])).hexdigest()[:24]


@cache
def _ingredients(kernel: Kernel) -> tuple[bytes, tuple[Kernel, ...]]:
    """Hash of a kernel's own code, constants and options; and the kernels that it calls."""
    function, called = kernel.py_func, list[Kernel]()
    cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
    scope = function.__globals__ | {name: cell.cell_contents for name, cell in cells.items()}
    parts = [function.__module__, function.__qualname__, repr(function.__defaults__)]
    parts += [f"{name}={shown(value)}" for name, value in sorted(kernel.targetoptions.items())]
    for code in _codes(function.__code__):
        constants = [each for each in code.co_consts if each != function.__doc__]
        constants = [each for each in constants if not isinstance(each, CodeType)]
        parts += [code.co_code.hex(), repr(constants), repr(code.co_varnames)]
        for name in (*code.co_names, *code.co_freevars):
            if name not in scope:  # an attribute, or Python's own
                parts.append(name)
            elif isinstance(value := scope[name], Kernel):
                called.append(value)
            else:
                parts.append(f"{name}={shown(value)}")
    return sha256("\0".join(parts).encode()).digest(), tuple(called)


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def shown(value: object) -> str:
    """Full representation of a value that is compiled into a kernel."""
    if value is np or value is math:
        return "library"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, set | frozenset):
        return repr(sorted(value))
    if isinstance(value, tuple | list):
        return f"{type(value).__name__} {[shown(each) for each in value]}"
    if isinstance(value, EnumType):
        return repr(list(value))
    if isinstance(value, type) and hasattr(value, "_fields"):
        return f"{value.__module__}.{value.__qualname__} {value._fields}"
    if value is None or isinstance(
        value, bool | int | float | complex | str | np.generic | BuiltinFunctionType
    ):
        return repr(value)
    raise TypeError(f"a kernel uses {value!r}, which has no digest")
