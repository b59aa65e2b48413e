"""The receiver of one beam after another: echoes in, range and closing speed out."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.measure import BEAM_RETURN, measure_beams
from lidar_emu.fmcw.model import ReceiverModel
from lidar_emu.fmcw.returns import Echoes, Returns


def receive(model: ReceiverModel, echoes: Echoes, shot: NDArray[np.int64], seed: int) -> Returns:
    """Measure every beam of every shot: three spectra, their targets, range and closing speed.

    Range, speed and speckle are those of each record's own time. With speckle each beamlet's amplitude is the root
    of its SNR times a circular complex Gaussian number (`fmcw.speckle`); without, the beamlets of a beam add in
    phase, beamlet i with the share P_i / sqrt(P) of the beam's P. A phase common to the beam is uniform in each
    record. Noise is drawn in the bins around the tones, and as peaks elsewhere.

    A beamlet beyond the record edge is heard for the part of the record that is left; one at range 0 or less means
    contact with the ground. What is drawn depends on seed, shot, beam and purpose alone, so that the bits of a shot are
    the same in any block, and no effect changes another's chance.

    Args:
        model: from `build_receiver`.
        echoes: shaped (shots, beams, beamlets).
        shot: (shots,) numbers of the shots.
        seed: 64 bits, of everything drawn.
    """
    rows = np.zeros(echoes.fired.shape, dtype=BEAM_RETURN).view(np.recarray)
    measure_beams(model, echoes, shot, seed, rows)
    return Returns(*(np.ascontiguousarray(rows[field.name]) for field in fields(Returns)))
