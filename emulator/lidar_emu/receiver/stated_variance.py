"""Variances of the three frequencies as the instrument states them: from its keys and the peaks, without the truth.

A frequency's variance is the sum of

* a bin's width, 1/12, where frequencies are rounded to bins;
* the estimator's variance by noise, and its variance by the laser's line at the measured range;
* random errors of the sweep and its ripple at the measured range (`sweep_error`);
* speckle that changes within the record: the quadratures of the three offsets (`peak_shape`) have the variance of the
  errors. Their mean square F over the variance by noise is 1 without speckle. What exceeds it scales the variance by
  noise: both are inversely proportional to a record's power;
* the width of a line beyond a bin: a share of the median second moment around the peaks.

Slow speckle is the same in the three records. By motion across the beam it errs by a Doppler shift that all three
share, and leaves the range alone: the quadratures then agree. By the footprint's depth it errs by a range, whose
quadrature is combined from the segments' as the range is from their beats: a quadrature is the rate at which the
logarithm of the amplitude changes, which has no sign to resolve. `footprint_depth` adds that error to the range. The
share of the error that is common falls with the width of the line that the quadratures show, less what depth explains.

Several looks show the mean square of all their quadratures, and the change of range between them, which speckle
weighs; see `speckle_variance.several_looks`.

Three quadratures determine a variance as badly as three measurements would, and a single one if they are alike. In
speckle errors over their standard deviation are therefore distributed like Student's t. The constants make the robust
deviation of this ratio 1 in a Gaussian process of line widths from 0 to 3 bins (`tests/support/exchanged_speckle.py`).
"""

from __future__ import annotations

from math import exp, expm1, hypot, pi, sin, sqrt
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.receiver.peak_interpolation import (
    ABOUTANIOS_MULGREW,
    BIN_CENTRE,
    CRAMER_RAO_BIN2,
    EFFICIENCY,
    FLICKER_SCATTER,
    HANN,
    PEAK_METHODS,
    passed_modulation,
)
from lidar_emu.receiver.range_speed_estimation import ALL, CONSTANT, DOWN, UP
from lidar_emu.receiver.speckle_variance import combined_quadrature, one_look, several_looks
from lidar_emu.receiver.spectrum import WINDOWS
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Detection, Waveform

_Numbers = TypeVar("_Numbers", float, FloatArray)

_LINE_EFFICIENCY = (1.0, 2.4, 1.75, 3.24, 0.95)
"""Squared robust deviation of each method by the line, relative to the bound. The variance depends on the place in the
bin, so that it is less than `EFFICIENCY`."""

TONE_WIDTH_BIN2, _WIDTH_FACTOR = 0.29, 0.9
"""Second moment of a windowed tone, and the variance of a peak per second moment beyond."""

_MOST_PEDESTAL = 0.02
"""Power of a bin beside the line by the laser's phase, relative to the line, above which widths say nothing."""

_MOST_DRIFT = 30.0
"""Limit of the phase drift, at which no line is left."""

_LINE_POWER = 1.4
"""Power of the line's bin for this comparison, as the mean noise power of both quadratures is 2: less by straddling."""

_PEDESTAL_WIDTH = 0.09
"""Standard deviation of the highest bin of the pedestal, relative to 2πΔν."""

_MOST_EXPONENT = 15.0
"""Exponent beyond which a probability is 0."""


class VarianceLaw(NamedTuple):
    """Constants of an instrument for `state_variances`."""

    quantised: bool
    line_rate: float
    """2π times the linewidth in bins; 0 without a line."""
    delay_per_bin: float
    """The echo's delay in records per bin of range."""
    line_bin2: float
    """Variance of the estimator per unit of the line's noise over its power, in bins²."""
    quadrature_line_bin2: float
    """The same for the quadrature."""
    sweep_share: tuple[float, float, float]
    """Standard deviation of each segment's beat by errors of the laser's sweep, per bin of range."""
    looks: float
    segment_records: float
    """Time between the centres of neighbouring records, in records; a third of the time between looks."""
    ripple_bin: float
    """Standard deviation of a chirp's beat by the sweep's ripple where the delay is half of its period."""
    ripple_turns: float
    """Periods of the ripple in the delay, per bin of range."""
    published: bool
    """Whether the range is a chirp's beat less the Doppler line."""


class SpeckleVariance(NamedTuple):
    """What three frequencies show of speckle beyond the variance of each, in bins²."""

    doppler_bin2: float
    """Variance of an error common to the Doppler shifts."""
    range_bin2: float
    """Part of the range's variance by speckle that is in the frequencies' variances."""
    quadrature_bin2: float
    """Square of the range's quadrature beyond noise."""


def build_variance_law(waveform: Waveform, detection: Detection) -> VarianceLaw:
    """Compute the constants from an instrument's keys."""
    method = PEAK_METHODS[detection.peak]
    own = method if method == ABOUTANIOS_MULGREW and detection.looks == 1 else HANN
    per_look = CRAMER_RAO_BIN2 / detection.looks
    range_share, speed_mps_per_m = sweep_scatter(waveform, detection)
    chirp_share = range_share / sqrt(detection.looks)
    constant_share = speed_mps_per_m * waveform.range_bin_m / waveform.speed_bin_mps / sqrt(detection.looks)
    # A ripple A sin(2πf_m t), of a phase that is drawn for each record, changes the frequency of a beat of the delay τ
    # with the amplitude 2A |sin(πf_m τ)|.
    ripple_frequency_bin = waveform.ripple_frequency_hz / waveform.bin_width_hz
    passed = passed_modulation(method, WINDOWS[detection.window], ripple_frequency_bin)
    return VarianceLaw(
        quantised=method == BIN_CENTRE,
        line_rate=2.0 * np.pi * waveform.linewidth_hz / waveform.bin_width_hz,
        delay_per_bin=2.0 * waveform.range_bin_m / SPEED_OF_LIGHT_MPS / waveform.record_time_s,
        line_bin2=_LINE_EFFICIENCY[method] * per_look,
        quadrature_line_bin2=EFFICIENCY[own] * per_look,
        sweep_share=(chirp_share, constant_share, chirp_share),
        looks=float(detection.looks),
        segment_records=waveform.segment_time_s / waveform.record_time_s,
        ripple_bin=sqrt(2.0 / detection.looks) * waveform.ripple_hz / waveform.bin_width_hz * abs(passed),
        ripple_turns=waveform.ripple_frequency_hz * 2.0 * waveform.range_bin_m / SPEED_OF_LIGHT_MPS,
        published=detection.combine == "chirp_minus_doppler",
    )


def sweep_scatter(waveform: Waveform, detection: Detection) -> tuple[float, float]:
    """Standard deviations of range and closing speed per metre of range, by errors of the sweep: an error Δ of its rate
    moves a beat by Δτ.

    1/f noise changes the laser's frequency during a record at the rate `FLICKER_SCATTER` √k/T_rec, in neighbouring
    records with the correlation -0.07, taken as 0.
    """
    scatter = FLICKER_SCATTER[PEAK_METHODS[detection.peak]]
    flicker_hz_per_s = scatter * sqrt(waveform.flicker_hz2) / waveform.record_time_s
    return (
        hypot(waveform.slope_scatter, flicker_hz_per_s / waveform.chirp_slope_hz_per_s),
        waveform.wavelength_m * flicker_hz_per_s / SPEED_OF_LIGHT_MPS,
    )


@kernel
def line_noise(rate: float, drift: float) -> tuple[float, float]:
    """Noise of the laser's line beside the line's centre, out of phase with the light and in phase.

    Powers per rectangular bin relative to the power left in the line, P - Q and P + Q of
    `laser_phase_noise.set_line_amplitudes` at the frequency 0, as power of white noise with as much in each quadrature.
    To first order in the drift all of it is out of phase, 4πΔντ².

    Args:
        rate: 2πΔν, Δν in bins.
        drift: variance of the phase's drift within the delay.
    """
    if rate <= 0.0:
        return 0.0, 0.0
    bounded = min(drift, _MOST_DRIFT)
    rise = expm1(bounded)
    fall = rise / (1.0 + rise)
    # cosh x - 1 and sinh x - x.
    return 2.0 / rate * rise * fall, max(2.0 / rate * (rise + fall - 2.0 * bounded), 0.0)


@kernel
def line_bin2(law: VarianceLaw, out_of_phase: float, in_phase: float) -> float:
    """Variance in bins² of a frequency by the laser's line with the noise of `line_noise`.

    Where little is left of the line, one of the 2Δν bins of its own pedestal may exceed it, each with an exponentially
    distributed power: the frequency then lies anywhere within the pedestal.
    """
    pedestal = out_of_phase + in_phase
    if pedestal * _MOST_EXPONENT < _LINE_POWER:
        return law.line_bin2 * out_of_phase
    wrong = 1.0 - (1.0 - exp(-_LINE_POWER / pedestal)) ** max(1.0, law.line_rate / pi)
    return float(law.line_bin2 * min(out_of_phase, 1.0) + (_PEDESTAL_WIDTH * law.line_rate * wrong) ** 2)


@kernel
def sweep_bin2_at(law: VarianceLaw, segment: int, range_bin: float) -> float:
    """Variance in bins² of a frequency by the errors of the laser's sweep, random and periodic, at a beat of range."""
    deviation = law.sweep_share[segment] * range_bin
    if segment == 1 or law.ripple_bin == 0.0:
        return deviation * deviation
    ripple = law.ripple_bin * sin(pi * law.ripple_turns * range_bin)
    return deviation * deviation + ripple * ripple


@kernel
def state_variances(law: VarianceLaw, mask: int, targets: NDArray[Any]) -> SpeckleVariance:
    """Set the variances of three frequencies.

    Args:
        law: constants of the instrument.
        mask: bits of the segments that have a target.
        targets: (3,) of TARGET: one target per segment. Its `variance_bin2` is the estimator's by noise.
    """
    up, constant, down = targets[0].frequency_bin, targets[1].frequency_bin, targets[2].frequency_bin
    if mask & CONSTANT == 0:
        range_bin = 0.5 * (up + down)
    else:
        range_bin = abs((max(up, down) if mask == ALL else (up if mask & UP else down)) - constant)
    drift = law.line_rate * law.delay_per_bin * range_bin
    out_of_phase, in_phase = line_noise(law.line_rate, drift)
    line = line_bin2(law, out_of_phase, in_phase)
    narrow = out_of_phase + in_phase < _MOST_PEDESTAL
    in_phase *= law.quadrature_line_bin2
    segments, squares, weighted, inverse = 0, 0.0, 0.0, 0.0
    narrowest, widest, width = np.inf, 0.0, 0.0
    for segment in range(3):
        if mask & (1 << segment):
            target = targets[segment]
            noise = target.quadrature_variance_bin2 + in_phase
            squares += (target.quadrature_bin**2 if law.looks == 1.0 else target.quadrature_bin2) / noise
            weighted += target.quadrature_bin / noise
            inverse += 1.0 / noise
            segments += 1
            narrowest, widest = min(narrowest, target.width_bin2), max(widest, target.width_bin2)
            width += target.width_bin2
    over_noise = squares / segments
    mean_noise = segments / inverse
    steady = weighted**2 / inverse
    quadrature_bin2 = range_noise_bin2 = 0.0
    if law.looks == 1.0:
        square_bin2, range_noise_bin2 = combined_quadrature(
            _range_weights(law, mask, up > down), targets, in_phase
        )
        quadrature_bin2 = max(square_bin2 - range_noise_bin2, 0.0)
        speckle = one_look(mask, over_noise, mean_noise, targets, in_phase)
    else:
        speckle = several_looks(
            law.looks, law.segment_records, over_noise, steady, mean_noise, mask == ALL, targets
        )
    width = width - narrowest - widest if segments == 3 else narrowest
    wide = 0.0
    # Beyond this the laser's own pedestal is what is wide.
    if narrow:
        wide = _WIDTH_FACTOR * max(width - TONE_WIDTH_BIN2, 0.0) / law.looks
    for segment in range(3):
        if mask & (1 << segment):
            target = targets[segment]
            excess = speckle.excess * (target.quadrature_variance_bin2 + in_phase) + wide
            noise = speckle.noise_share * target.variance_bin2
            if law.quantised:
                noise = target.variance_bin2 + target.quadrature_variance_bin2
            target.variance_bin2 = noise + line + sweep_bin2_at(law, segment, range_bin) + excess
            if segment != 1:
                target.variance_bin2 += speckle.chirps_bin2
    return SpeckleVariance(speckle.doppler_bin2, speckle.excess * range_noise_bin2, quadrature_bin2)


@kernel
def _range_weights(law: VarianceLaw, mask: int, receding: bool) -> tuple[float, float, float]:
    """Weights of the segments' quadratures in the quadrature of the range, as of the frequencies of the echoes."""
    if mask & CONSTANT == 0 or (mask == ALL and not law.published):
        return -0.5, 0.0, 0.5
    if (receding and mask == ALL) or mask & DOWN == 0:
        return -1.0, 1.0, 0.0
    return 0.0, -1.0, 1.0


@kernel
def inconsistency(residual_bin: float, residual_variance: float) -> float:
    """Factor of the variances where the residual of three frequencies contradicts them, 1 or more.

    A bin, as everywhere, for the motion between the segments and their optical frequencies; beyond three standard
    deviations the factor approaches the square of the residual over its own variance. NaN counts as consistent.
    """
    beyond = abs(residual_bin) - 1.0
    if not beyond * beyond > 9.0 * residual_variance or beyond <= 0.0:
        return 1.0
    return beyond * beyond / residual_variance - 8.0
