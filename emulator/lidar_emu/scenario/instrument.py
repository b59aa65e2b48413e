"""The instrument: waveform, optics, receiver and detection of an FMCW Doppler lidar."""

from __future__ import annotations

from math import cbrt, ceil, log
from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.section import Fraction, NonNegative, Part, Positive, Switch, unusable

SPEED_OF_LIGHT_MPS = 299_792_458.0

_WIDEST_RIPPLE_BINS = 500
"""Largest distance of a side line that the spectral level computes."""


class Waveform(Part):
    """Up-chirp, constant frequency, down-chirp; one record of `fft_length` samples ends each segment."""

    wavelength_m: Annotated[float, Field(ge=1e-7, le=1e-4)] = 1550e-9
    """Laser wavelength."""
    chirp_slope_hz_per_s: Positive = 2.0e12
    """Slope of the optical frequency in the two chirps (bandwidth over segment time)."""
    segment_time_s: Positive = 300e-6
    """Length of each of the three segments. The record is taken at its end, so that the time before it is
    the guard in which the echo of the previous segment dies out."""
    sample_rate_hz: Positive = 600e6
    """Rate of the digitiser."""
    fft_length: Annotated[int, Field(ge=256, le=2**24)] = 2**17
    """Samples in a record; a power of two."""
    slope_error: Annotated[float, Field(gt=-0.5, lt=0.5)] = 0.0
    """Relative error of the laser's true slope: 1e-3 reads 2 m too far at 2 km (for a laser whose calibration has
    aged)."""
    slope_scatter: Annotated[float, Field(ge=0, lt=0.1)] = 0.0
    """Standard deviation of each chirp's own relative slope error, independent from chirp to chirp: the random part
    of the non-linearity that linearisation leaves. Beams that fire together share it. For a laser that is
    linearised, but not perfectly."""
    ripple_hz: NonNegative = 0.0
    """Amplitude of a periodic deviation of the laser's frequency from the linear sweep, in the two chirps (for a
    laser whose driver or linearisation rings)."""
    ripple_frequency_hz: Positive = 10e3
    """Frequency of that deviation: false targets appear at multiples of it to either side of a line."""
    flicker_hz2: NonNegative = 0.0
    """1/f noise of the laser's frequency: its one-sided density times the frequency. Beams that fire together share
    it. For a diode laser."""
    linewidth_hz: NonNegative = 3e3
    """Full width at half maximum of the laser's Lorentzian line; 0 leaves it out. Only phase noise that builds up
    within the echo's delay widens a beat."""

    def _check(self) -> None:
        if self.fft_length & (self.fft_length - 1):
            raise unusable("fft_length", self.fft_length, "a power of two")
        if self.record_time_s > self.segment_time_s:
            samples = self.segment_time_s * self.sample_rate_hz
            expected = f"at most {samples:.6g}, the samples in segment_time_s"
            raise unusable("fft_length", self.fft_length, expected)
        steepest = 0.01 * SPEED_OF_LIGHT_MPS / self.wavelength_m / self.segment_time_s
        if self.chirp_slope_hz_per_s > steepest:
            expected = f"at most {steepest:.6g}, a hundredth of the optical frequency in a segment"
            raise unusable("chirp_slope_hz_per_s", self.chirp_slope_hz_per_s, expected)
        highest_hz = 50.0 * self.ripple_frequency_hz
        if self.ripple_hz > highest_hz:
            raise unusable(
                "ripple_hz", self.ripple_hz, f"at most {highest_hz:.6g}, fifty times its frequency"
            )
        widest_hz = _WIDEST_RIPPLE_BINS * self.bin_width_hz / self.ripple_orders
        if self.ripple_hz > 0 and self.ripple_frequency_hz > widest_hz:
            expected = (
                f"at most {widest_hz:.6g}: {self.ripple_orders} side lines within {_WIDEST_RIPPLE_BINS} bins"
            )
            raise unusable("ripple_frequency_hz", self.ripple_frequency_hz, expected)

    @property
    def ripple_orders(self) -> int:
        """Side lines to either side of a line that the periodic deviation can make stronger than -60 dB: orders of the
        Bessel function of at most twice its amplitude over its frequency."""
        index = 2.0 * self.ripple_hz / self.ripple_frequency_hz
        return ceil(index + 2.0 * cbrt(index) + 1.0)

    @property
    def record_time_s(self) -> float:
        """Length of a record."""
        return self.fft_length / self.sample_rate_hz

    @property
    def bin_width_hz(self) -> float:
        """Width of an FFT bin."""
        return self.sample_rate_hz / self.fft_length

    @property
    def range_bin_m(self) -> float:
        """Range whose beat is one bin, c df / 2S, by the nominal slope."""
        return SPEED_OF_LIGHT_MPS * self.bin_width_hz / (2.0 * self.chirp_slope_hz_per_s)

    @property
    def speed_bin_mps(self) -> float:
        """Closing speed whose Doppler shift is one bin, λ df / 2."""
        return self.wavelength_m * self.bin_width_hz / 2.0

    @property
    def range_per_speed_s(self) -> float:
        """Change of the measured range by a closing speed that the chirps have and the constant segment has not,
        c / (λ S), in metres per m/s."""
        return self.range_bin_m / self.speed_bin_mps

    @property
    def nyquist_range_m(self) -> float:
        """Range whose beat is half the sample rate; beats of longer ranges are folded."""
        return 0.5 * self.fft_length * self.range_bin_m

    @property
    def unambiguous_speed_mps(self) -> float:
        """Closing speed whose Doppler shift is half the sample rate, λ fs / 4; higher speeds equal their alias."""
        return 0.5 * self.fft_length * self.speed_bin_mps

    @property
    def cycle_time_s(self) -> float:
        """The three segments of one measurement."""
        return 3 * self.segment_time_s

    @property
    def validity_offset_s(self) -> float:
        """Time from the start of a cycle to the centre of the constant segment's record."""
        return 2 * self.segment_time_s - self.record_time_s / 2

    @property
    def record_edge_range_m(self) -> float:
        """Range whose echo arrives just as the record starts: the guard time times c/2."""
        return SPEED_OF_LIGHT_MPS * (self.segment_time_s - self.record_time_s) / 2


class Optics(Part):
    """A monostatic transceiver with matched Gaussian transmit and receive modes."""

    laser_power_w: Positive = 1.0
    """Transmitted power of each beam."""
    waist_radius_m: Annotated[float, Field(ge=1e-5, le=10)] = 0.017
    """1/e² intensity radius of the beam at the aperture."""
    optical_efficiency: Fraction = 0.6
    """Transmission of the optics, out and back (for the losses of another telescope)."""
    heterodyne_efficiency: Fraction = 0.4
    """Overlap of the echo with the local oscillator (for another mixing optics)."""
    depolarisation: Fraction = 0.5
    """Fraction of the echo that returns in the received polarisation (for ground that depolarises less or a receiver
    of both polarisations)."""
    alignment_error_rad: NonNegative = 0.0
    """Angle between the transmitted and the received mode (for a tolerance of assembly)."""
    back_reflection_db: Annotated[float, Field(ge=-200, le=-20)] | None = None
    """Light that window and optics reflect into the mode of the echo, relative to the transmitted power of a beam;
    null: none (for an uncoated window or an angled connector)."""
    back_reflection_range_m: Annotated[float, Field(gt=0, le=100)] = 1.0
    """Range of the reflecting surface, by the delay of its light behind the local oscillator's."""
    leakage_db: Annotated[float, Field(ge=-200, le=-10)] | None = None
    """Share of each beam's echo that the receiver of every other beam receives; null: none (for beams that share an
    optical bench)."""
    speckle: Switch = True
    """Each beamlet's echo is a circular Gaussian number that changes as the beam moves; off: all add in phase."""
    beamlets: Literal[1, 7, 19, 37, 61, 91, 127] = 19
    """Rays that sample the footprint of each beam: the centre and whole hexagonal rings around it. The plan
    takes more where the phases of this number would return between the chirps."""


class Adc(Part):
    """The digitiser after the amplifier."""

    effective_bits: Annotated[float, Field(ge=1, le=24)] = 8.0
    """Effective number of bits. Quantisation and all other noise of the digitiser are taken as white, which holds
    where a step is at most about twice the analogue noise. For another digitiser."""
    full_scale_v: Annotated[float, Field(ge=1e-9, le=1e3)] = 0.05
    """Range from the lowest to the highest voltage at the amplifier's output; beyond, the signal is clipped (for a
    gain at which bright ground clips)."""


class Receiver(Part):
    """A balanced pair of detectors; the local oscillator's shot noise is the reference."""

    local_oscillator_power_w: Annotated[float, Field(ge=1e-12, le=1e9)] = 1e-3
    """Local oscillator power on the detectors (for another detector)."""
    responsivity_a_per_w: Annotated[float, Field(ge=1e-9, le=1e3)] = 1.0
    """Photocurrent per optical power. It may not exceed one electron per photon. For another detector or wavelength."""
    transimpedance_ohm: Annotated[float, Field(ge=1e-3, le=1e12)] = 2000.0
    """Feedback resistance of the amplifier; its thermal noise adds to the shot noise (for another
    amplifier)."""
    temperature_k: Annotated[float, Field(gt=0, le=1e5)] = 300.0
    """Noise temperature of the amplifier's feedback resistance (for an amplifier that is cooled, or noisier than its
    resistor)."""
    dark_current_a: Annotated[float, Field(ge=0, le=1)] = 1e-8
    """Dark current of the pair of detectors."""
    relative_intensity_noise_db_per_hz: Annotated[float, Field(ge=-300, le=0)] | None = -150.0
    """Relative intensity noise of the laser, alike at all frequencies; null: none."""
    common_mode_rejection_db: NonNegative = 30.0
    """Suppression of intensity noise by the balanced pair (for a pair of detectors that is less well balanced)."""
    bandwidth_hz: Positive | None = 300e6
    """Half-power frequency of the amplifier's single pole. Noise from beyond half the sample rate folds in: a wide
    amplifier is a noisy one. null: flat within the band, without folded noise."""
    ac_coupling_hz: NonNegative = 50e3
    """Half-power frequency of the single-pole high-pass before the digitiser; 0 couples directly."""
    adc: Adc | None = Adc()
    """null: an ideal digitiser."""


class Detection(Part):
    """From the three spectra to targets, and from targets to range and closing speed."""

    window: Literal["rect", "hann", "hamming"] = "hamming"
    """Window of the FFT."""
    false_alarm_probability: Annotated[float, Field(ge=1e-300, le=0.5)] = 1e-3
    """Probability that noise alone crosses the threshold anywhere in one FFT."""
    group_fraction: Annotated[float, Field(gt=0, lt=1)] = 0.3
    """Contiguous bins above this fraction of the spectrum's highest magnitude form one target (for another
    detector)."""
    looks: Annotated[int, Field(ge=1, le=64)] = 1
    """Cycles whose power spectra are averaged into one measurement."""
    peak: Literal["bin", "parabola", "jacobsen", "hann", "aboutanios_mulgrew"] = "bin"
    """Frequency of a target: the centre of its highest bin, or an estimate that resolves a small part of a bin:
    a parabola through the log power of three windowed bins, Jacobsen's on rectangular bins, the exact three-bin
    formula on Hann-weighted bins, or Aboutanios and Mulgrew's iteration on half bins."""
    combine: Literal["chirp_minus_doppler", "least_squares"] = "chirp_minus_doppler"
    """Range and speed from the three frequencies: the published detector (the chirp that holds the sum, minus
    the Doppler line), or least squares over the three segments with the signs of least residual."""
    rule: Literal["all_three", "any_two"] = "all_three"
    """Segments that must hold a target; two suffice for least squares alone."""
    lowest_beat_hz: NonNegative = 0.0
    """Bins below are not searched: they hold the reflections of the instrument's own optics (for an instrument with
    a back-reflection)."""
    compensate: Literal["none", "acceleration"] = "none"
    """`acceleration`: ranges and speeds are corrected for deceleration, as speeds of consecutive shots show it, and for
    the light's travel time. Without a valid speed in the last half second, or after a change of pattern, the range of
    one shot is not."""
    maximum_range_m: Positive = 12_000.0
    """Beyond it a return is reported as invalid (for an instrument that gives up earlier)."""

    def log_false_alarm_per_bin(self, fft_length: int) -> float:
        """Logarithm of the probability that noise crosses the threshold in one of the N/2 bins of an FFT."""
        return log(self.false_alarm_probability) - log(fft_length / 2)

    def _check(self) -> None:
        if self.rule == "any_two" and self.combine != "least_squares":
            raise unusable("rule", self.rule, "all_three without combine: least_squares")


class Instrument(Part):
    """The transceiver, alike for all beams."""

    name: str = "ndl_four_beam"
    """Shown in plans and summaries."""
    waveform: Waveform = Waveform()
    """The three segments and their records."""
    optics: Optics = Optics()
    """Transmitter and telescope."""
    receiver: Receiver = Receiver()
    """Detector and amplifier."""
    detection: Detection = Detection()
    """Signal processing."""

    @property
    def furthest_record_s(self) -> float:
        """Time from the time of validity to the centres of the first and the last record."""
        return self.waveform.segment_time_s * (1.5 * self.detection.looks - 0.5)

    @property
    def log_false_alarm_per_bin(self) -> float:
        return self.detection.log_false_alarm_per_bin(self.waveform.fft_length)

    def _check(self) -> None:
        highest_hz = self.waveform.sample_rate_hz / 20
        if self.receiver.ac_coupling_hz > highest_hz:
            expected = f"at most {highest_hz:.6g}, a twentieth of the sample rate"
            raise unusable("receiver.ac_coupling_hz", self.receiver.ac_coupling_hz, expected)
        nyquist_hz = self.waveform.sample_rate_hz / 2
        lowest_hz = self.detection.lowest_beat_hz
        if lowest_hz >= nyquist_hz:
            raise unusable(
                "detection.lowest_beat_hz", lowest_hz, f"below {nyquist_hz:.6g}, half the sample rate"
            )
        steps_hz = (
            2 * self.waveform.chirp_slope_hz_per_s * self.detection.maximum_range_m / SPEED_OF_LIGHT_MPS
        )
        if steps_hz < self.waveform.bin_width_hz:
            flattest = 0.5 * SPEED_OF_LIGHT_MPS * self.waveform.bin_width_hz / self.detection.maximum_range_m
            expected = f"at least {flattest:.6g}: a bin of beat within detection.maximum_range_m"
            raise unusable("waveform.chirp_slope_hz_per_s", self.waveform.chirp_slope_hz_per_s, expected)
        edge = self.waveform.record_edge_range_m
        if self.detection.maximum_range_m > edge * (1 + 1e-9):
            expected = f"at most {edge:.6g}, the record edge (c/2 times segment_time_s less the record)"
            raise unusable("detection.maximum_range_m", self.detection.maximum_range_m, expected)
