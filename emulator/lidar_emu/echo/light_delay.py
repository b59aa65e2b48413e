"""Travel time of the light: a record shows the ground as it was when the light met it, R/c earlier."""

from __future__ import annotations

from typing import Any

from lidar_emu.fmcw.returns import Echoes
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS


def delay_echoes(echoes: Echoes) -> None:
    """Delay echoes in place: their ranges and closing speeds become the ones that the instrument receives.

    To first order in R/c the range grows by v R/c. The Doppler shift is f ((1 + v/c)/(1 - v/c) - 1), with the closing
    speed v of R/c earlier: as a closing speed it reads v (1 + v/c).
    """
    _delay(tuple(echoes))


@kernel(outermost=True)
def _delay(echo_arrays: tuple[Any, ...]) -> None:
    """Delay the arrays of `Echoes`; a plain tuple, whose type numba resolves faster than a named tuple's."""
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
