"""A sine without branches, so that loops over bins are vectorised."""

from __future__ import annotations

from math import factorial, pi

import numpy as np

from lidar_emu.numerics.kernels import kernel

FAST = {"nsz"}
"""Fast-math flags of kernels. None changes the order of a sum or the meaning of NaN, and none depends on the code
around a kernel: a process that compiles uses other copies of kernels than a process that loads them from the cache, and
with contracted multiplications and additions the two would differ in the last digits."""

_A1, _A3, _A5, _A7, _A9, _A11, _A13, _A15, _A17, _A19, _A21 = (
    (-1) ** (n // 2) * pi**n / factorial(n) for n in range(1, 22, 2)
)


@kernel(fastmath=FAST, forceinline=True)
def sin_pi(x: float) -> float:
    """sin(pi x) for |x| up to slightly above 1/2, relative error 3e-16.

    Taylor series: the next term is 2e-18 at x = 1/2. The odd form keeps the relative error at 0. The two halves of the
    polynomial are independent of each other.
    """
    y = x * x
    y3 = y * y * y
    low = _A1 + y * (_A3 + y * (_A5 + y * (_A7 + y * (_A9 + y * _A11))))
    high = _A13 + y * (_A15 + y * (_A17 + y * (_A19 + y * _A21)))
    value: float = x * (low + y3 * y3 * high)
    return value


@kernel(fastmath=FAST, forceinline=True)
def sin_pi_anywhere(x: float) -> float:
    """sin(pi x) for any x, by `sin_pi` beside the nearest whole number."""
    whole = np.rint(x)
    half = 0.5 * whole
    # 1 for even numbers, -1 for odd ones.
    sign = 1.0 - 4.0 * abs(half - np.rint(half))
    value: float = sign * sin_pi(x - whole)
    return value
