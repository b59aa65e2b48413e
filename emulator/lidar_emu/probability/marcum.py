"""Marcum's Q function: the probability that a steady tone in noise exceeds a threshold.

Q_M(a, b) is the probability that 2M unit-variance Gaussian components, of which the means have the length a,
have a length above b; P = 1 - Q. For order one the smaller of the two is computed in logarithms and without
cancellation; the other follows from it. With D = b - a, z = ab and the scaled Bessel functions Î_n(z) =
e^-z I_n(z) there are two forms:

* Neumann's series, in which every term is positive:

      Q = e^(-D²/2) Σ_(n>=0) (a/b)^n Î_n(z),      P = e^(-D²/2) Σ_(n>=1) (b/a)^n Î_n(z).

  With t_n = z Î_(n+1)/Î_n, which obeys t_n = z² / (2n + 2 + t_(n+1)), the quotients of successive terms are
  a² / (2n + 2 + t_(n+1)) and b² / (2n + 2 + t_(n+1)): neither a = 0 nor b = 0 is a special case. The
  recurrence is stable downward (Miller).

* For large z the series is long, while its integral, with q = |D| / (2 sqrt(z)),

      Q = erfc(D/√2)/2 + e^(-D²/2)/2π ∫_0^π e^(-z (1 - cos t)) [1 + q / (sqrt(1 + q²) + cos(t/2))] dt

  (for a > b: P, with both signs + turned and |D|) is a bell that the midpoint rule sums to rounding.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from lidar_emu.numerics.arrays import BoolArray, FloatArray

_TERMS = 50
_BELL_ABOVE = 25.0
"""Up to this z, `_TERMS` terms of the series give full precision."""
_NODES = 20
_BELL_EXPONENT = 40.0
"""The integrand is truncated at e^-40 of its maximum."""


def log_q(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """ln Q_1(a, b), to a relative error of 1e-12 however close Q is to 0 or to 1.

    Args:
        a: length of the mean, 0 or more; sqrt(2 SNR) of a bin.
        b: length of the threshold, 0 or more; sqrt(2 T), with T in mean noise powers. Broadcast with a.
    """
    tail, is_p = _log_tail(a, b)
    return np.where(is_p, np.log1p(-np.exp(tail)), tail)


def marcum_q(order: int, a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Q_M(a, b) for an integer order M >= 1, to an absolute error of 1e-12.

    Q_M exceeds Q_1 by the terms 1 to M - 1 of the series of P.
    """
    from scipy.special import i0e

    a, b = _broadcast(a, b)
    q = np.exp(log_q(a, b))
    total = np.ones_like(q)
    for n, denominator in _denominators(a * b, order + _TERMS):
        if n <= order - 2:
            total = (n > 0) + b * b / denominator * total
    added = np.exp(-0.5 * np.square(b - a)) * i0e(a * b) * total if order > 1 else 0.0
    return np.minimum(1.0, q + added)


def _log_tail(a: ArrayLike, b: ArrayLike) -> tuple[FloatArray, BoolArray]:
    """Logarithm of the smaller of P and Q, and whether it is P; from 1 down to b = 1 it may be either, never near 1."""
    a, b = _broadcast(a, b)
    is_p = b < np.maximum(a, 1.0)
    is_bell = a * b > _BELL_ABOVE
    tail = np.empty_like(a)
    tail[is_bell] = _bell(a[is_bell], b[is_bell])
    tail[~is_bell] = _series(a[~is_bell], b[~is_bell], is_p[~is_bell])
    return tail, is_p


def _broadcast(a: ArrayLike, b: ArrayLike) -> tuple[FloatArray, FloatArray]:
    a, b = np.broadcast_arrays(np.asarray(a, dtype=float), np.asarray(b, dtype=float))
    return a, b


def _series(a: FloatArray, b: FloatArray, is_p: BoolArray) -> FloatArray:
    from scipy.special import i0e

    step = np.square(np.where(is_p, b, a))
    total = np.ones_like(a)
    first = np.ones_like(a)
    for n, denominator in _denominators(a * b, _TERMS):
        if n > 0:
            total = 1.0 + step / denominator * total
        else:
            first = denominator
    with np.errstate(divide="ignore"):
        # The logarithm of b itself, since its square may underflow.
        log_terms = np.where(is_p, 2.0 * np.log(b) + np.log(total / first), np.log1p(step / first * total))
    log_probability: FloatArray = -0.5 * np.square(b - a) + np.log(i0e(a * b)) + log_terms
    return log_probability


def _denominators(z: FloatArray, last: int) -> Iterator[tuple[int, FloatArray]]:
    """n and 2n + 2 + t_(n+1), from n = `last` down to 0.

    It starts from the uniform (Debye) expansion of the logarithmic derivative of I_ν, of which the error
    shrinks from step to step.
    """
    order = last + 1.0
    length = np.sqrt(order * order + z * z)
    share = np.square(z / length)
    t = length - order - 0.5 * share - 0.125 * share * (5.0 * share - 4.0) / length
    for n in range(last, -1, -1):
        denominator = 2.0 * n + 2.0 + t
        yield n, denominator
        t = z * (z / denominator)


def _bell(a: FloatArray, b: FloatArray) -> FloatArray:
    from scipy.special import erfcx

    distance, z = np.abs(b - a), a * b
    q = 0.5 * distance / np.sqrt(z)
    root = np.sqrt(1.0 + q * q)
    sign = np.where(b < a, -1.0, 1.0)
    step = 2.0 * np.arcsin(np.sqrt(np.minimum(1.0, 0.5 * _BELL_EXPONENT / z))) / _NODES
    total = np.zeros_like(z)
    for node in range(_NODES):
        half_angle = 0.5 * (node + 0.5) * step
        total += np.exp(-2.0 * z * np.square(np.sin(half_angle))) * (
            1.0 + sign * q / (root + np.cos(half_angle))
        )
    tail = 0.5 * erfcx(distance / np.sqrt(2.0)) + sign * step / (2.0 * np.pi) * total
    return np.asarray(np.log(tail) - 0.5 * distance * distance)
