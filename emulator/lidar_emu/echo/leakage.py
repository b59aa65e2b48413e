"""Leakage between beams: each receives an attenuated copy of the others' echoes."""

from __future__ import annotations

import numpy as np

from lidar_emu.fmcw.returns import Echoes
from lidar_emu.numerics.arrays import FloatArray


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
