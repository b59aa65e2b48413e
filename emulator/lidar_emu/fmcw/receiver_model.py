"""The constants of a receiver that its kernels use."""

from __future__ import annotations

from typing import NamedTuple

from lidar_emu.fmcw.analog_response import Response


class Haze(NamedTuple):
    """Light that the air itself returns, in units of the noise power of a bin."""

    snr_per_m: float
    """SNR of the light from each metre just ahead of the sensor; 0 for clear air."""
    extinction_per_m: float
    rayleigh_range_m: float
    """Range at which the beam's area has doubled."""


class ReceiverModel(NamedTuple):
    """An instrument in the numbers that the receiver's kernels use."""

    statistical: bool
    """Draw targets from the closed-form error model instead of computing spectra."""
    fft_length: float
    looks: int
    range_bin_m: float
    """Range whose beat is one bin, c df / 2S, by the nominal slope."""
    speed_bin_mps: float
    """Closing speed whose Doppler shift is one bin, λ df / 2."""
    bin_width_hz: float
    beat_bin_per_m: float
    """2S / (c df) with the laser's actual slope."""
    delay_per_m: float
    """2 / (c T_rec): the echo's delay in records."""
    slope_over_carrier_per_m: float
    """2S / (c f): by how much the frequency of the light that returns differs, per metre of range."""
    carrier_ratio: tuple[float, float, float]
    """Optical frequency at the centre of each record over the nominal one."""
    segment_records: float
    cycle_records: float
    """Length of a segment and of a cycle in records."""
    record_time_s: float
    snr_per_w: float
    """Power of a tone on its rectangular bin over the mean noise power there, per watt of echo."""
    signal_shot_per_w: float
    """Shot noise of the echo itself over the amplifier's noise without it."""
    response: Response
    haze: Haze
    linewidth_bins: float
    homodyne_line: bool
    speckle: bool
    window_centre: float
    window_side: float
    noise_power: float
    """Mean noise power of a windowed bin over that of a rectangular one."""
    independent_share: float
    """Peaks in windowed noise above the threshold, per bin, over those of a rectangular window."""
    threshold: float
    """Least power of a detected bin over its mean noise power."""
    group_power_share: float
    peak_method: int
    combine_method: int
    least_segments: int
    maximum_range_m: float
    record_edge_range_m: float
    least_smear_bins: float
    """Smaller changes of a beat during a record are left out."""
    least_line_drift: float
    least_line_scatter_bins: float
    """The laser's line is left out where both are smaller."""
    least_false_alarm: float
    """Smaller probabilities that noise elsewhere matters are left out."""
    sampled_length: float
    """N, or less where samples are missing: then beats are folded again at half of it."""
    lost_segments: int
    """Bits of the segments of which nothing is seen."""
    opposite_doppler_sign: bool
    """Take the other sign of the Doppler shift."""
