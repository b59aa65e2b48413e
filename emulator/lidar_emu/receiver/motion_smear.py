"""Smear: the beat of a moving lidar changes during a record, which spreads its line over bins."""

from __future__ import annotations

from math import cos, factorial, pi, sin

import numpy as np

from lidar_emu.numerics.arrays import SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST
from lidar_emu.receiver.receiver_model import ReceiverModel

LEAST_TAPS = 8
"""Taps on each side of the central one, unless a wide smear or line needs more."""

_SERIES_LIMIT, _TERMS = 2.0, 14


def _moments() -> SingleArray:
    """π^p/p! times the integral of x^2p cos(2πmx) over the record, x from -1/2 to 1/2: (terms, taps)."""
    node, weight = np.polynomial.legendre.leggauss(64)
    x, weight = 0.5 * node, 0.5 * weight
    taps = np.cos(2 * np.pi * np.arange(LEAST_TAPS + 1)[:, None] * x)
    moments = [(taps * x ** (2 * p) * weight).sum(axis=1) * np.pi**p / factorial(p) for p in range(_TERMS)]
    return np.array(moments, dtype=np.float32)


_MOMENTS = _moments()

_NODES, _WEIGHTS = (np.ascontiguousarray(a) for a in np.polynomial.legendre.leggauss(16))


@kernel
def smear_bins(model: ReceiverModel, segment: int, speed_mps: float, acceleration_mps2: float) -> float:
    """Change of a beat during its record, in bins: by acceleration, and in the chirps by range-Doppler migration.

    The range of a scatterer changes with its speed, and its Doppler shift with the optical frequency: each contributes
    half of the chirps' -4Sv/c.
    """
    by_motion = acceleration_mps2 * model.record_time_s / model.speed_bin_mps
    if segment == 1:
        return by_motion
    by_migration = -2.0 * model.beat_bin_per_m * speed_mps * model.record_time_s
    return by_migration - by_motion if segment == 0 else by_migration + by_motion


@kernel
def smear_taps(smear: float, half: int, taps: SingleArray) -> None:
    """Taps of exp(jπβx²), x from -1/2 to 1/2 over the record: a beat that changes by β bins during it.

    Computed by a series in β for small changes, and by Gauss-Legendre panels for large ones.

    Args:
        smear: β.
        half: taps on each side.
        taps: (2, 2 half + 1) receives real and imaginary parts; the centre is column `half`.
    """
    if abs(smear) <= _SERIES_LIMIT and half == LEAST_TAPS:
        _set_series(smear, taps[0, half : 2 * half + 1], taps[1, half : 2 * half + 1])
        _mirror_taps(half, taps)
        return
    taps[:, half : 2 * half + 1] = 0.0
    panels = 2 + int((abs(smear) + half) / 3.0)
    for panel in range(panels):
        for q in range(len(_NODES)):
            # The integrand is even: half the record, twice.
            x = 0.25 * (2 * panel + 1 + _NODES[q]) / panels
            weight = 0.5 * _WEIGHTS[q] / panels
            angle = pi * smear * x * x
            re, im = cos(angle), sin(angle)
            for m in range(half + 1):
                share = weight * cos(2 * pi * m * x)
                taps[0, half + m] += np.float32(share * re)
                taps[1, half + m] += np.float32(share * im)
    _mirror_taps(half, taps)


@kernel(fastmath=FAST)
def _set_series(smear: float, re: SingleArray, im: SingleArray) -> None:
    power, square = np.float32(1.0), np.float32(smear * smear)
    for m in range(len(re)):
        re[m] = im[m] = 0.0
    for p in range(0, _TERMS, 2):
        even = power if p % 4 == 0 else -power
        odd = np.float32(smear) * even
        even_moments, odd_moments = _MOMENTS[p], _MOMENTS[p + 1]
        for m in range(len(re)):
            re[m] += even * even_moments[m]
            im[m] += odd * odd_moments[m]
        power *= square


@kernel
def _mirror_taps(half: int, taps: SingleArray) -> None:
    for part in range(2):
        for m in range(1, half + 1):
            taps[part, half - m] = taps[part, half + m]
