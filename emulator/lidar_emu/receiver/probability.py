"""Probabilities of detection, false alarm and false lock.

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

A false-alarm probability is always given as L = -ln P_fa, which cannot underflow. Powers are sums over M looks
(averaged records), each of unit mean noise power: a sum of noise alone has a gamma distribution of order M.

K is the mean power of the signal in its bin divided by the mean noise power there. The powers of M looks are summed and
compared with `threshold_power(L, M)`, where L = -ln P_fa.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import exp, lgamma, log, log1p, sqrt
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import interpreted, kernel

_TERMS = 50
_BELL_ABOVE = 25.0
"""Up to this z, `_TERMS` terms of the series give full precision."""
_BELL_NODES = 20
_BELL_EXPONENT = 40.0
"""The integrand is truncated at e^-40 of its maximum."""


def log_q(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """ln Q_1(a, b), to a relative error of 1e-12 however close Q is to 0 or to 1.

    Args:
        a: length of the mean, 0 or more; sqrt(2 SNR) of a bin.
        b: length of the threshold, 0 or more; sqrt(2 T), with T in mean noise powers. Broadcast with a.
    """
    a, b = _broadcast(a, b)
    # The smaller of P and Q: from 1 down to b = 1 it may be either, never near 1.
    is_p = b < np.maximum(a, 1.0)
    is_bell = a * b > _BELL_ABOVE
    tail = np.empty_like(a)
    tail[is_bell] = _bell(a[is_bell], b[is_bell])
    tail[~is_bell] = _series(a[~is_bell], b[~is_bell], is_p[~is_bell])
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


_LEAST_MEAN = 1e-300


def exceedance(mean: FloatArray, threshold: float, looks: int = 1) -> FloatArray:
    """Probability that a power of M looks about a mean exceeds the threshold, in units of the noise: Q_M as a sum over
    Poisson probabilities (Shnidman, 1989), all of them positive, by their logarithms: exp(-mean) may underflow.

    `scipy.special`, which `marcum_q` needs, takes longer to load than all other modules of a start.
    """
    most = float(np.nanmax(mean, initial=threshold))
    log_mean, log_poisson, total = np.log(np.maximum(mean, _LEAST_MEAN)), -mean, np.zeros_like(mean)
    fewer = float(gamma_tail(looks, np.array(threshold)))
    log_term = (looks - 1) * log(threshold) - threshold - lgamma(looks)
    for n in range(int(most + 14.0 * sqrt(most) + 60.0)):
        total += np.exp(log_poisson) * fewer
        log_poisson = log_poisson + (log_mean - log(n + 1))
        log_term += log(threshold) - log(n + looks)
        fewer += exp(log_term)
    return total


def gamma_tail(order: int, x: FloatArray) -> FloatArray:
    """Probability that a gamma-distributed power of this whole order exceeds x, to an absolute error of 1e-15."""
    term = np.exp(-x)
    total = term.copy()
    for k in range(1, order):
        term = term * x / k
        total += term
    return np.asarray(total)


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
    step = 2.0 * np.arcsin(np.sqrt(np.minimum(1.0, 0.5 * _BELL_EXPONENT / z))) / _BELL_NODES
    total = np.zeros_like(z)
    for node in range(_BELL_NODES):
        half_angle = 0.5 * (node + 0.5) * step
        total += np.exp(-2.0 * z * np.square(np.sin(half_angle))) * (
            1.0 + sign * q / (root + np.cos(half_angle))
        )
    tail = 0.5 * erfcx(distance / np.sqrt(2.0)) + sign * step / (2.0 * np.pi) * total
    return np.asarray(np.log(tail) - 0.5 * distance * distance)


_HALVINGS = 60


@kernel
def minus_log_exceedance(power: float, looks: int) -> float:
    """L = -ln P of noise alone above a power, with a relative error of 1e-13 at any power.

    P = Γ(M, T)/Γ(M) = e^-T Σ_(k<M) T^k/k!; where that is near 1, its complement e^-T Σ_(k>=M) T^k/k! is the smaller.

    Args:
        power: T, 0 or more, the sum over looks.
        looks: M, from 1.
    """
    if looks == 1:
        return power
    term, total = 1.0, 1.0
    for k in range(1, looks):
        term *= power / k
        total += term
    if exp(-power) * total < 0.5:
        return power - log(total)
    k, below = looks, 0.0
    while term > 1e-17 * below:
        term *= power / k
        below += term
        k += 1
    return -log1p(-exp(-power) * below)


@kernel
def threshold_power(minus_log_pfa: float, looks: int) -> float:
    """The power that noise exceeds with probability e^-L: the inverse of `minus_log_exceedance`, by bisection.

    It is at most M + sqrt(2ML) + L (Laurent and Massart, Annals of Statistics 28, 2000, lemma 1).
    """
    if looks == 1:
        return minus_log_pfa
    low, high = 0.0, looks + sqrt(2.0 * looks * minus_log_pfa) + minus_log_pfa
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if minus_log_exceedance(middle, looks) < minus_log_pfa:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def threshold_powers(minus_log_pfa: ArrayLike, looks: int = 1) -> FloatArray:
    """`threshold_power` of each L."""
    return np.asarray(np.vectorize(interpreted(threshold_power), otypes=[float])(minus_log_pfa, looks))


def log_false_alarm(minus_log_pfa: ArrayLike, bins: float) -> FloatArray:
    """ln of the probability that the highest of independent noise bins exceeds the threshold of one bin.

    This is 1 - (1 - e^-L)^N without cancellation, and without underflow: ln N - L where the union bound is exact.
    """
    single = np.asarray(minus_log_pfa, dtype=float)
    union: FloatArray = np.log(bins) - single
    with np.errstate(divide="ignore"):
        exact = np.log(-np.expm1(bins * np.log1p(-np.exp(-single))))
    return np.where(union < -40.0, union, exact)


_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(16)


def nodes_and_weights(edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights of every panel.

    Args:
        edges: (..., panels + 1) edges of the panels, ascending.

    Returns:
        Nodes and weights, (..., 16 panels).
    """
    half = 0.5 * np.diff(edges)[..., None]
    middle = 0.5 * (edges[..., 1:] + edges[..., :-1])[..., None]
    shape = (*edges.shape[:-1], -1)
    return (middle + half * _GAUSS_NODES).reshape(shape), (half * _GAUSS_WEIGHTS).reshape(shape)


Fading = Literal["steady", "swerling_2"]
"""Fading of the signal's power. Swerling 2: exponential (Rayleigh amplitude, fully developed speckle) and independent
in each look. A steady signal is Swerling's case 0; its amplitude with noise has a Rice distribution."""

_AMPLITUDE_PANELS = np.linspace(0.0, 1.0, 33)
_BEYOND = 7.0
"""Noise amplitudes above the threshold at which a signal is detected, except for a probability of e^-49."""
_LEAST_SNR = 1e-12
"""SNR below which a fade makes no difference."""


def detection_probability(
    fading: Fading, snr: ArrayLike, minus_log_pfa: ArrayLike, looks: int = 1
) -> FloatArray:
    """Probability that signal and noise exceed the threshold, to an absolute error of 1e-11.

    In speckle the sum over looks of signal and noise has a gamma distribution, 1 + K times wider than that of noise.

    Args:
        fading: fading of the signal.
        snr: K for one look, 0 or more.
        minus_log_pfa: L of one bin, for the sum over looks. Broadcast with `snr`.
        looks: M, from 1.
    """
    snr, power = np.broadcast_arrays(np.asarray(snr, dtype=float), threshold_powers(minus_log_pfa, looks))
    if fading == "steady":
        return marcum_q(looks, np.sqrt(2.0 * looks * snr), np.sqrt(2.0 * power))
    return gamma_tail(looks, power / (1.0 + snr))


def shared_fade_probability(
    rule: Callable[[FloatArray], FloatArray], snr: ArrayLike, minus_log_pfa: float, looks: int = 1
) -> FloatArray:
    """Probability of an event that depends on several segments with shared fading, to an absolute error of 1e-10.

    The segments share the signal's power, which is exponential and independent from look to look; their noise is
    independent.

    Args:
        rule: probability of the event where each segment is detected with the probability given, such as
            p -> p³; rising, with rule(1) = 1.
        snr: K for one look, any shape.
        minus_log_pfa: L of one bin, for the sum over looks.
        looks: M, from 1.
    """
    mean: FloatArray = np.maximum(np.asarray(snr, dtype=float), _LEAST_SNR)
    # Integrated over the amplitude, in which the detection probability is a smooth step one noise amplitude wide, up to
    # where every signal is detected or no signal is left.
    height = np.sqrt(threshold_powers(minus_log_pfa, looks))
    top = np.minimum(height + _BEYOND, np.sqrt(mean * (looks + 8.0 * np.sqrt(looks) + 45.0)))
    amplitude, weight = nodes_and_weights(top[..., None] * _AMPLITUDE_PANELS)
    event = rule(exceedance(np.square(amplitude), float(height) ** 2, looks))
    share = np.square(amplitude) / mean[..., None]
    density = np.exp((looks - 1) * np.log(share) - share - lgamma(looks)) * 2.0 * amplitude / mean[..., None]
    certain = gamma_tail(looks, np.square(top) / mean)
    return np.asarray((density * event * weight).sum(axis=-1) + certain)


_NEGLIGIBLE = 40.0
"""-ln of the probability left out at either end of the integral."""
_LEVEL_PANELS = np.linspace(0.0, 1.0, 25)


def false_lock_probability(
    fading: Fading, snr: ArrayLike, minus_log_pfa: float, bins: float, looks: int = 1
) -> FloatArray:
    """Probability that the highest of N noise bins exceeds both the signal's bin and the threshold.

    Expressed as L, the -ln P of noise above it, the power of a noise bin is exponential with mean 1 for any number of
    looks. The signal is below a noise bin at L with the miss probability of a threshold at L:

        ∫ P_miss(L) N (1 - e^-L)^(N-1) e^-L dL   from the threshold's own L,

    to an absolute error of 1e-11.

    Args:
        fading: fading of the signal.
        snr: mean power of the signal in its bin over the mean noise power, for one look; any shape.
        minus_log_pfa: L of the threshold; 0: no threshold.
        bins: N independent bins.
        looks: M, from 1.
    """
    lowest = max(minus_log_pfa, -np.log(-np.expm1(-_NEGLIGIBLE / bins)))
    highest = max(lowest, np.log(bins)) + _NEGLIGIBLE
    level, weight = nodes_and_weights(lowest + (highest - lowest) * _LEVEL_PANELS)
    density = bins * np.exp((bins - 1.0) * np.log1p(-np.exp(-level)) - level)
    ratio = np.asarray(snr, dtype=float)[..., None]
    missed = 1.0 - detection_probability(fading, ratio, level, looks)
    return np.asarray((missed * density * weight).sum(axis=-1))
