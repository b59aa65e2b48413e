"""A kernel before it has machine code, which is looked for when the kernel is first called.

It is called without numba: a start neither compiles nor loads the compiler. Kernels are found by the digest of all that
they are compiled from, and by the types of the arguments; what is not found is compiled. The code needs a processor of
the level x86-64-v3 (2013 and later).
"""

from __future__ import annotations

import json
import math
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import EnumType
from functools import cache, cached_property, update_wrapper
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from types import BuiltinFunctionType, CodeType
from typing import Any, NamedTuple

import numpy as np

from lidar_emu.errors import note_once


class Call(NamedTuple):
    """A call of a kernel, or of a function on arrays, from Python."""

    kernel: Kernel | ArrayFunction
    args: tuple[Any, ...]
    result: Any


class _Recording(threading.local):
    calls: list[Call] | None = None


_recording = _Recording()


@contextmanager
def recorded_calls() -> Iterator[list[Call]]:
    """Record the calls of kernels from Python by this thread, in their order."""
    before, calls = _recording.calls, list[Call]()
    _recording.calls = calls
    try:
        yield calls
    finally:
        _recording.calls = before


class ArrayFunction:
    """A function of arrays that records its calls, as a kernel does.

    It changes its arguments in place, or returns arrays, in tuples or data classes: a repeated call copies them into
    the arrays of the recorded call. The result must follow from the arguments and from constants alone.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, *args: Any) -> Any:
        with recorded_calls():  # those within belong to this one
            result = self._function(*args)
        if _recording.calls is not None:
            _recording.calls.append(Call(self, (result, *args), True))
        return result

    def entry(self, _args: tuple[Any, ...]) -> Callable[..., bool]:
        """The function, with the arrays that it returned as its first argument; False if their shapes are others."""
        return lambda before, *args: _updated(before, self._function(*args))


def _updated(before: Any, now: Any) -> bool:
    """Copy new arrays into the corresponding old ones; return False if a shape differs."""
    if before is now:
        return True
    if isinstance(before, np.ndarray):
        if not isinstance(now, np.ndarray) or before.shape != now.shape:
            return False
        before[...] = now
        return True
    if isinstance(before, tuple):
        return all(map(_updated, before, now))
    return type(before) is type(now) and all(map(_updated, vars(before).values(), vars(now).values()))


class Kernel:
    """A function in the subset of Python that numba compiles.

    Args:
        function: the function.
        options: options of numba's `njit`.
        outermost: whether it is called from Python.
        machine_code: returns the machine code of a kernel, as Python calls it.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        options: dict[str, Any],
        outermost: bool,
        machine_code: Callable[[Kernel], Callable[..., Any]],
    ) -> None:
        update_wrapper(self, function)
        # By these two names numba's pass that inlines kernels finds what it needs.
        self.py_func = function
        self.targetoptions = options
        self.outermost = outermost
        self._find = machine_code

    def __call__(self, *args: Any) -> Any:
        result = self.machine_code(*args)
        if _recording.calls is not None:
            _recording.calls.append(Call(self, args, result))
        return result

    @cached_property
    def machine_code(self) -> Callable[..., Any]:
        return self._find(self)

    def entry(self, args: tuple[Any, ...]) -> Callable[..., Any]:
        """The machine code for arguments of the types of these, which it does not check."""
        code: Any = self.machine_code
        if not hasattr(code, "overloads"):
            return _prebuilt_entry(self, args) or self.machine_code
        compiled = code.overloads.get(tuple(map(code.typeof_pyval, args)))
        entry: Callable[..., Any] = code if compiled is None else compiled.entry_point
        return entry

    @property
    def full_name(self) -> str:
        """Name with the module's path below the package."""
        return f"{self.py_func.__module__}.{self.py_func.__qualname__}".removeprefix("lidar_emu.")


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


TABLE = Path(__file__).with_name("prebuilt_kernels.json")
PROCESSOR = "x86-64-v3"
"""Level of the processors that machine code is made for, where they have it."""

_NEEDED = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
"""Flags of Linux for what x86-64-v3 adds."""


def prebuilt(kernel: Kernel, compiled: Callable[[Kernel], Callable[..., Any]]) -> Callable[..., Any] | None:
    """The machine code that was built of a kernel; None if none was.

    Args:
        kernel: the kernel.
        compiled: returns the kernel compiled by numba, for arguments of types for which nothing was built.
    """
    if not (built := _built(kernel)):
        return None
    overloads = import_module("lidar_emu.numerics.overloads")
    overloads.use_names(name_of)
    chosen: Callable[..., Any] = overloads.Overloads(
        tuple(built.items()), lambda *args: compiled(kernel)(*args)
    )
    return chosen


@cache
def _built(kernel: Kernel) -> dict[bytes, Callable[..., Any]]:
    """Functions that were built of a kernel, by the types of their arguments."""
    found = prebuilt_table().get(kernel.full_name)
    if found is None or found["digest"] != digest(kernel):
        return {}
    functions = import_module("lidar_emu.numerics.prebuilt_kernels")
    return {bytes.fromhex(key): getattr(functions, symbol) for key, symbol in found["built"].items()}


def _prebuilt_entry(kernel: Kernel, args: tuple[Any, ...]) -> Callable[..., Any] | None:
    built = _built(kernel)
    return built.get(import_module("lidar_emu.numerics.overloads").key_of(*args)) if built else None


def name_of(named: Any) -> bytes:
    """Name of a structured type, or of a class of named tuples, in the keys of overloads."""
    is_type = isinstance(named, np.dtype)
    text = repr(named) if is_type else f"{named.__module__}.{named.__qualname__} {named._fields}"
    return sha256(text.encode()).digest()[:8]


@cache
def prebuilt_table() -> dict[str, Any]:
    """What was built, by the names of kernels; empty if nothing was, or if this processor cannot run it."""
    if not TABLE.exists():
        return {}
    if lacking := missing_features():
        note_once("prebuilt", f"kernels are compiled here: this processor lacks {', '.join(sorted(lacking))}")
        return {}
    kernels: dict[str, Any] = json.loads(TABLE.read_text())
    return kernels


def has_machine_code() -> bool:
    """Whether a kernel runs without loading the compiler: it was built, or another kernel has loaded it."""
    return "numba" in sys.modules or bool(prebuilt_table())


def missing_features() -> set[str]:
    """What this processor lacks of the level."""
    return _NEEDED - _processor_flags()


def _processor_flags() -> set[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return set()
    return next((set(line.split()) for line in lines if line.startswith("flags")), set())
