"""Echoes as the instrument receives them: scattered in depth by rough ground, delayed, and with those that leak from
other beams."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from lidar_emu.numerics import vector_arrays
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.receiver.echoes import LEAST_COSINE, BeamletHits
from lidar_emu.receiver.returns import Echoes
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS


def delay_echoes(echoes: Echoes) -> None:
    """Delay echoes in place: their ranges and closing speeds become the ones that the instrument receives.

    To first order in R/c the range grows by v R/c. The Doppler shift is f ((1 + v/c)/(1 - v/c) - 1), with the closing
    speed v of R/c earlier: as a closing speed it reads v (1 + v/c).
    """
    _delay(tuple(echoes))


@kernel(outermost=True)
def _delay(echo_arrays: tuple[Any, ...]) -> None:
    echoes = Echoes(*echo_arrays)
    shots, beams, beamlets = echoes.range_m.shape
    for s in range(shots):
        for b in range(beams):
            acceleration_mps2 = echoes.closing_acceleration_mps2[s, b]
            for i in range(beamlets):
                delay_s = echoes.range_m[s, b, i] / SPEED_OF_LIGHT_MPS
                earlier_mps = echoes.closing_speed_mps[s, b, i] - acceleration_mps2 * delay_s
                echoes.range_m[s, b, i] -= echoes.range_rate_mps[s, b, i] * delay_s
                echoes.closing_speed_mps[s, b, i] = earlier_mps * (1.0 + earlier_mps / SPEED_OF_LIGHT_MPS)


SPREAD_OF_ROUGHNESS = 0.856
"""Ratio of the robust standard deviations of range and depth. Range errors are distributed as Re(n/a), where n and a
are circular Gaussian; the quartiles are ±1/√3."""

FEW_DEPTHS_BELOW_BINS = 0.06
"""Standard deviation of heights in bins of range up to which two depths scatter ranges as a Gaussian law does, within
5 % at 60 degrees of incidence. By the key alone: a choice by the depths along the rays of a block would give a shot
alone other ranges."""


@cache
def depth_nodes(roughness_m: float, range_bin_m: float) -> tuple[FloatArray, FloatArray]:
    """Depths in standard deviations by which tones represent rough ground, and the share of power of each.

    The nodes of Gauss and Hermite: two of them have the law's variance, which is all that counts while lines are much
    narrower than a bin; seven have its shape for lines of a bin.
    """
    depths, weights = np.polynomial.hermite_e.hermegauss(
        2 if roughness_m < FEW_DEPTHS_BELOW_BINS * range_bin_m else 7
    )
    return depths, weights / weights.sum()


def rough_depth_m(roughness_m: float, cosine: FloatArray) -> FloatArray:
    """Standard deviation of the depth along rays that meet rough ground at these cosines of incidence."""
    return np.asarray(roughness_m / np.maximum(cosine, LEAST_COSINE))


def roughened(
    echoes: Echoes, roughness_m: float, beamlet_hits: BeamletHits, nodes: tuple[FloatArray, FloatArray]
) -> Echoes:
    """Divide the footprint's beamlets among depths, each with speckle of its own.

    Heights that are independent from grain to grain give the echo field a(x) of a record a second, independent part
    2πjx(σ/bin) b(x): so do tones at the depths ±σ with independent fields.

    Args:
        roughness_m: standard deviation of heights.
        beamlet_hits: of the first beamlets.
        nodes: of `depth_nodes`; the same for all shots, so that one alone is as in a block.
    """
    normal, ray = beamlet_hits.hits.normal_site, beamlet_hits.ray_site
    rough_m = rough_depth_m(roughness_m, -vector_arrays.dot(normal, ray))
    beamlets = rough_m.shape[2]
    depths, weights = nodes

    def joined(values: FloatArray, *parts: FloatArray) -> FloatArray:
        return np.concatenate([parts[0], values[..., beamlets:], *parts[1:]], axis=-1)

    own = [values[..., :beamlets] for values in (echoes.range_m, echoes.power_w)]
    return echoes._replace(
        range_m=joined(echoes.range_m, *(own[0] + depth * rough_m for depth in depths)),
        power_w=joined(echoes.power_w, *(own[1] * weight for weight in weights)),
        closing_speed_mps=joined(
            echoes.closing_speed_mps, *[echoes.closing_speed_mps[..., :beamlets]] * len(depths)
        ),
        range_rate_mps=joined(echoes.range_rate_mps, *[echoes.range_rate_mps[..., :beamlets]] * len(depths)),
    )


def leaked(echoes: Echoes, leakage_db: float) -> Echoes:
    """Append to each beam's beamlets the beamlets of all other beams that fire, with this share of their power.

    The copies have the acceleration and the smear of the beam that receives them. Their speckle is independent of the
    other beam's.
    """
    beams = echoes.fired.shape[1]
    others = np.array([[other for other in range(beams) if other != b] for b in range(beams)], dtype=int)

    def joined(values: FloatArray, share: float = 1.0) -> FloatArray:
        apart = share * values[:, others]
        return np.concatenate([values, apart.reshape(*values.shape[:2], -1)], axis=-1)

    lit_w = np.where(echoes.fired[..., None], echoes.power_w, 0.0)
    return echoes._replace(
        range_m=joined(echoes.range_m),
        closing_speed_mps=joined(echoes.closing_speed_mps),
        power_w=joined(lit_w, 10.0 ** (leakage_db / 10.0)),
        range_rate_mps=joined(echoes.range_rate_mps),
    )
