"""Detectors written in Python: they find the targets of one spectrum (`exhaustive_estimation` has the rest)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_emu.errors import InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.receiver.spectrum import BIN_VARIANCE
from lidar_emu.receiver.whole_spectrum import TARGETS, Targets
from lidar_emu.scenario.instrument import Waveform

SEGMENTS: tuple[Literal["up", "constant", "down"], ...] = ("up", "constant", "down")


class SegmentSpectrum(NamedTuple):
    """The spectrum of one segment of one beam, as a detector sees it; powers are in units of the white noise of a
    rectangular bin."""

    shot: int
    beam: int
    segment: Literal["up", "constant", "down"]
    frequency_hz: FloatArray
    """(bins,) Centres of the bins, ascending. Level spectral computes those around the tones alone."""
    power: FloatArray
    """(bins,) Power of the bins with the window of `instrument.detection`; 0 in bins that hold no target."""
    noise_power: FloatArray
    """(bins,) Mean power of the noise in these bins, as the instrument's own detector assumes it."""
    threshold: FloatArray
    """(bins,) Power above which the instrument's own detector accepts a peak."""
    bins: NDArray[np.complex128] | None
    """(bins,) Complex bins with the window, whose squared magnitude is `power`; None at level spectral."""
    samples: FloatArray | None
    """(samples,) Samples of the record as the digitiser gives them; None at level spectral, and at level reference
    without `reference_samples: full_rate`."""


Detector = Callable[[SegmentSpectrum], ArrayLike]
"""Returns the frequencies in Hz of the targets in a spectrum, strongest first; none: nothing was detected."""


def detected(detector: Detector, spectrum: SegmentSpectrum, waveform: Waveform) -> Targets:
    """The targets that a detector finds, (1, TARGETS) each.

    Their variance is 1/12 bin², as for a quantised peak, since a detector does not state any.

    Raises:
        InputError: the detector returned no frequencies.
    """
    returned = detector(spectrum)
    try:
        found_hz = np.atleast_1d(np.asarray(returned, dtype=np.float64))[:TARGETS]
    except (TypeError, ValueError):
        found_hz = np.array([np.nan])
    bin_hz, highest_hz = waveform.bin_width_hz, 0.5 * waveform.sample_rate_hz
    if found_hz.ndim != 1 or not np.all((found_hz > 0.0) & (found_hz <= highest_hz)):
        allowed = f"must be frequencies from 0 to {highest_hz:.6g} Hz, strongest first, or an empty list"
        raise InputError("detector", f"shot {spectrum.shot} beam {spectrum.beam}", returned, allowed)
    values = np.full((7, 1, TARGETS), np.nan)
    count = len(found_hz)
    if count:
        nearest = np.abs(spectrum.frequency_hz - found_hz[:, None]).argmin(axis=1)
        values[:, 0, :count] = np.stack(
            [
                found_hz / bin_hz,
                np.full(count, BIN_VARIANCE),
                np.zeros(count),
                np.full(count, BIN_VARIANCE),
                np.zeros(count),
                spectrum.power[nearest],
                np.rint(spectrum.frequency_hz[nearest] / bin_hz),
            ]
        )
    return Targets(*values)
