"""The constants of a receiver that its kernels use."""

from __future__ import annotations

from typing import NamedTuple

from lidar_emu.receiver.analog_response import Response
from lidar_emu.receiver.residual_limit import ResidualLimit
from lidar_emu.receiver.spectrum import SpectralWindow
from lidar_emu.receiver.stated_variance import VarianceLaw

ALL_BEAMLETS = 2**31
"""A number of beamlets that no footprint reaches: none is a streak's."""


class Haze(NamedTuple):
    """Backscatter of the atmosphere, relative to the noise power of a bin."""

    snr_per_m: float
    """SNR of the light from each metre just ahead of the sensor; 0 for clear air."""
    extinction_per_m: float
    rayleigh_range_m: float
    """Rayleigh range, at which the beam's area has doubled."""
    computed_range_m: float
    """Range up to which the band of a chirp is computed bin by bin; beyond, only its highest bins are drawn."""


class BackReflection(NamedTuple):
    """Light that window and optics reflect."""

    snr: float
    """Power of its tone in a rectangular bin ahead of the poles, relative to the mean noise power there; 0: none."""
    range_m: float


class Ripple(NamedTuple):
    """A periodic deviation of the laser's frequency in the chirps."""

    largest_index: float
    """Twice its amplitude over its frequency: the largest modulation of a beat's phase; 0: none."""
    frequency_bin: float
    orders: float
    """Side lines to either side of a line."""
    pull_bin: float
    """Shift of a beat per unit of the index, at most."""
    least_index: float
    """Skip limit: smaller modulations may be left out."""


class SweepScatter(NamedTuple):
    """Random errors of the laser's sweep, independent from segment to segment."""

    range_per_m: float
    """Standard deviation of a chirp's apparent range, per metre of range."""
    speed_mps_per_m: float
    """Standard deviation of the constant segment's apparent closing speed, per metre of range."""
    per_beam: bool
    """Whether each beam has a cycle of its own; otherwise the beams of a shot share the laser's errors."""


class ReceiverModel(NamedTuple):
    """Constants of an instrument for the receiver's kernels."""

    fft_length: float
    looks: int
    wavelength_m: float
    divergence_rad: float
    """λ/(π w0)."""
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
    """2S / (c f): relative change of the returning light's frequency per metre of range."""
    carrier_ratio: tuple[float, float, float]
    """Optical frequency at the centre of each record relative to the nominal one."""
    segment_records: float
    cycle_records: float
    """Length of a segment and of a cycle in records."""
    record_time_s: float
    furthest_record_s: float
    """Time from the time of validity to the centres of the first and the last record."""
    snr_per_w: float
    """Power of a tone in its rectangular bin relative to the mean noise power there, per watt of echo."""
    signal_shot_per_w: float
    """Shot noise of the echo relative to the amplifier's noise without an echo."""
    response: Response
    ground_beamlets: int
    """Beamlets of the footprint; the next one represents a streak of dust, if there is any."""
    haze: Haze
    back_reflection: BackReflection
    linewidth_bins: float
    ripple: Ripple
    sweep_scatter: SweepScatter
    speckle: bool
    window: SpectralWindow
    noise_power: float
    """Mean noise power of a windowed bin relative to a rectangular one."""
    independent_share: float
    """Noise peaks above the threshold per bin, relative to a rectangular window."""
    lowest_bin: float
    """Lowest bin that is searched."""
    threshold: float
    """Minimum power of a detected bin relative to its mean noise power."""
    group_power_share: float
    peak_method: int
    combine_method: int
    residual_limit: ResidualLimit
    variance_law: VarianceLaw
    least_segments: int
    maximum_range_m: float
    record_edge_range_m: float
    variance_share: float
    """Skip limit of stages that scatter a beat: a smaller share of its variance by noise and quantisation."""
    least_smear_bins: float
    """Skip limit of the smear: smaller changes of a beat during a record are left out."""
    least_line_drift: float
    """Skip limit of the linewidth's phase variance over the delay."""
    least_false_alarm: float
    """Skip limit of false alarms: smaller probabilities are left out."""
    sampled_length: float
    """N, or less where samples are missing: beats are then folded again at half of it."""
    lost_segments: int
    """Bits of the segments that are lost."""
    opposite_doppler_sign: bool
    """Whether to report the opposite sign of the Doppler shift."""
