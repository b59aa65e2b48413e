"""Light of the volume in the bins of a record: haze, and the dust of a plume.

All haze on a beam has the closing speed of the air. In a chirp each range has its own beat: particles at random places
make every rectangular bin of the band a circular Gaussian number of its own, of the mean power

    p(r) = s c df/(2S) exp(-2αr)/(1 + (r/z)²),   s the SNR per metre at the sensor:

noise with a spectrum of its own, which the instrument's threshold does not know. In the constant segment the whole band
is one line of ∫ p dr.

The plume's dust lies between two ranges and has speeds between two limits; its light falls with the optical depth τ of
the path as the light of haze does. With the SNR s of all of it, the beat b0 of its beginning at the mean speed, the
beats L of its path and the beats W of its speeds, 1 at least, a rectangular bin at the beat b has the mean power

    s [F((b - b0 + W/2)/L) - F((b - b0 - W/2)/L)]/W,   F(x) = (1 - exp(-2τx))/(1 - exp(-2τ)) from 0 to 1.

In the constant segment L is 0. A wide band of dust is not computed: its highest bins are drawn (`detection`).
"""

from __future__ import annotations

from math import atan, ceil, exp, expm1, sqrt, tan

import numpy as np

from lidar_emu.numerics.arrays import SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import HAZE, complex_normal
from lidar_emu.receiver.analog_response import tone_gain
from lidar_emu.receiver.beat_tones import record_time_s, signed_bin, speed_change_mps
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam
from lidar_emu.receiver.returns import DUST_DEPTH, DUST_FAR_M, DUST_FASTEST_MPS, DUST_NEAR_M, DUST_SLOWEST_MPS
from lidar_emu.receiver.spectrum import BIN, NOISE, POWER, SEGMENT_INDICES, fold

_PANELS = 16


@kernel
def haze_snr(model: ReceiverModel, range_m: float) -> float:
    """SNR of the backscatter from the sensor to a range: ∫ exp(-2αr) / (1 + (r/z)²) dr, by panels of Simpson's rule."""
    z = model.haze.rayleigh_range_m
    # The substitution atan(r/z) removes the beam's divergence.
    end = atan(range_m / z)
    total = 0.0
    for i in range(2 * _PANELS + 1):
        share = 1.0 if i in (0, 2 * _PANELS) else (4.0 if i % 2 == 1 else 2.0)
        r = min(z * tan(end * i / (2 * _PANELS)), range_m)
        total += share * exp(-2.0 * model.haze.extinction_per_m * r)
    return float(model.haze.snr_per_m * z * total * end / (6.0 * _PANELS))


@kernel
def set_haze_tone(model: ReceiverModel, beam: Beam, look: int, tone: SingleArray) -> None:
    """Set the line of the haze in the constant segment, a tone (4,) of the record."""
    speed_mps = beam.air_speed_mps + speed_change_mps(beam, record_time_s(model, 1, look))
    beat = signed_bin(model, 1, 0.0, speed_mps)
    gain_re, gain_im = tone_gain(model.response, beat)
    observed_bin, factor_re, factor_im = fold(beat, model.fft_length)
    x, y = complex_normal(beam.seed, beam.shot, beam.beam, HAZE, (1 + 3 * look) * SEGMENT_INDICES // 2)
    scale = sqrt(beam.haze_snr)
    nearest = np.rint(observed_bin)
    tone[0], tone[1] = np.float32(nearest), np.float32(observed_bin - nearest)
    tone[2] = np.float32(factor_re * scale * (x * gain_re - y * gain_im))
    tone[3] = np.float32(factor_im * scale * (x * gain_im + y * gain_re))


@kernel
def haze_power(model: ReceiverModel, zero: float, end: float, beat: float) -> float:
    """Mean power of the haze in the rectangular bin at a signed beat, for a band from beat `zero` to `end`."""
    filled = min(beat + 0.5, end) - max(beat - 0.5, zero)
    if filled <= 0.0:
        return 0.0
    r = max(0.0, min(beat, end) - zero) / model.beat_bin_per_m
    spread = 1.0 + (r / model.haze.rayleigh_range_m) ** 2
    gain_re, gain_im = tone_gain(model.response, beat)
    passed = (gain_re * gain_re + gain_im * gain_im) * model.haze.snr_per_m / model.beat_bin_per_m
    return min(1.0, filled) * passed * exp(-2.0 * model.haze.extinction_per_m * r) / spread


COMPUTED_DUST_BINS = 256.0
"""Width of a band of dust up to which its bins are computed one by one."""


@kernel
def set_bands(model: ReceiverModel, beam: Beam, segment: int, time_s: float) -> None:
    """Set the signed beats of haze and dust in a record at a time from the time of validity."""
    change_mps = speed_change_mps(beam, time_s)
    beam.haze_beats[:] = 0.0
    if model.haze.snr_per_m > 0.0 and segment != 1:
        speed_mps = beam.air_speed_mps + change_mps
        beam.haze_beats[0] = signed_bin(model, segment, 0.0, speed_mps)
        beam.haze_beats[1] = signed_bin(model, segment, beam.haze_range_m, speed_mps)
    if beam.dust_snr > 0.0:
        near_m, far_m = beam.dust[DUST_NEAR_M], beam.dust[DUST_FAR_M]
        slowest_mps = beam.dust[DUST_SLOWEST_MPS] + change_mps
        slow = signed_bin(model, segment, near_m, slowest_mps)
        fast = signed_bin(model, segment, near_m, beam.dust[DUST_FASTEST_MPS] + change_mps)
        beam.dust_beats[0] = 0.5 * (slow + fast)
        beam.dust_beats[1] = 0.5 * max(abs(fast - slow), 1.0)
        beam.dust_beats[2] = signed_bin(model, segment, far_m, slowest_mps) - slow


@kernel
def has_band(beam: Beam) -> bool:
    """Whether haze or dust has a band in the record of `set_bands`."""
    return bool(beam.haze_beats[1] > beam.haze_beats[0] or beam.dust_snr > 0.0)


@kernel
def band_snr(beam: Beam) -> float:
    """SNR of all bands in the record of `set_bands`."""
    haze: float = beam.haze_snr if beam.haze_beats[1] > beam.haze_beats[0] else 0.0
    return float(haze + beam.dust_snr)


@kernel
def dust_ends(beam: Beam) -> tuple[float, float]:
    """Signed beats between which the dust has light."""
    middle, half, length = beam.dust_beats[0], beam.dust_beats[1], beam.dust_beats[2]
    return middle - half, middle + half + length


@kernel
def dust_power(model: ReceiverModel, beam: Beam, beat: float) -> float:
    """Mean power of the dust in the rectangular bin at a signed beat."""
    middle, half = beam.dust_beats[0], beam.dust_beats[1]
    share = _share_within(beam, beat + half - middle) - _share_within(beam, beat - half - middle)
    if share <= 0.0:
        return 0.0
    gain_re, gain_im = tone_gain(model.response, beat)
    return float((gain_re * gain_re + gain_im * gain_im) * beam.dust_snr * share / (2.0 * half))


@kernel
def _share_within(beam: Beam, beats: float) -> float:
    length, depth = beam.dust_beats[2], beam.dust[DUST_DEPTH]
    if beats <= 0.0:
        return 0.0
    if beats >= length:
        return 1.0
    return float(expm1(-2.0 * depth * beats / length) / expm1(-2.0 * depth))


@kernel
def volume_in_bin(model: ReceiverModel, beam: Beam, observed_bin: float) -> float:
    """Mean power of haze and dust in the rectangular bin at a place: of all signed beats that appear there."""
    length, power = model.fft_length, 0.0
    if beam.haze_beats[1] > beam.haze_beats[0]:
        for beat in (observed_bin, -observed_bin, observed_bin - length, length - observed_bin):
            power += haze_power(model, beam.haze_beats[0], beam.haze_beats[1], beat)
    if beam.dust_snr > 0.0:
        first, last = dust_ends(beam)
        for image in (observed_bin, -observed_bin):
            beat = image + length * ceil((first - image) / length)
            while beat <= last:
                power += dust_power(model, beam, beat)
                beat += length
    return power


@kernel
def set_level(model: ReceiverModel, beam: Beam, gain: float, grid: SingleArray, count: int) -> None:
    """Set POWER of the first `count` bins to the mean power of noise, haze and dust in the record of `set_bands`."""
    for j in range(count):
        volume = volume_in_bin(model, beam, np.float64(grid[BIN, j]))
        grid[POWER, j] = np.float32(grid[NOISE, j] + gain * gain * volume)


@kernel
def add_band_places(model: ReceiverModel, beam: Beam, step: float, places: SingleArray) -> int:
    """Set places `step` bins apart over the parts of the bands that are computed.

    Returns:
        The number of places.
    """
    count = int(np.int64(0))
    zero, end = beam.haze_beats[0], beam.haze_beats[1]
    end = min(end, zero + model.haze.computed_range_m * model.beat_bin_per_m)
    if end > zero:
        count = _add_places(model, zero, end, step, places, count)
    if beam.dust_snr > 0.0:
        first, last = dust_ends(beam)
        if last - first <= COMPUTED_DUST_BINS:
            count = _add_places(model, first, last, step, places, count)
    return count


@kernel
def _add_places(
    model: ReceiverModel, first: float, last: float, step: float, places: SingleArray, count: int
) -> int:
    length = model.fft_length
    one, _, _ = fold(first, length)
    other, _, _ = fold(last, length)
    # A continuous band folds into a continuous one.
    low, high = min(one, other), max(one, other)
    if ceil(first / length) * length <= last:
        low = 0.0
    if (ceil(first / length - 0.5) + 0.5) * length <= last:
        high = 0.5 * length
    place, stop = np.rint(low), np.rint(high)
    while place < stop:
        places[count] = np.float32(place)
        count += 1
        place += step
    places[count] = np.float32(stop)
    return count + 1
