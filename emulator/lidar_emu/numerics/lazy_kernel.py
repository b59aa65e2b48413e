"""A kernel before it has machine code, which is looked for when the kernel is first called."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, update_wrapper
from typing import Any


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
        return self._machine_code(*args)

    @cached_property
    def _machine_code(self) -> Callable[..., Any]:
        return self._find(self)

    @property
    def full_name(self) -> str:
        """Name with the module's path below the package."""
        return f"{self.py_func.__module__}.{self.py_func.__qualname__}".removeprefix("lidar_emu.")
