"""The instrument: waveform, optics, receiver and detection of an FMCW Doppler lidar."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lidar_emu.scenario.part import Fraction, Part, Positive, unusable

SPEED_OF_LIGHT_MPS = 299_792_458.0


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

    @model_validator(mode="after")
    def _record_fits(self) -> Self:
        if self.fft_length & (self.fft_length - 1):
            raise unusable("fft_length", self.fft_length, "a power of two")
        if self.record_time_s > self.segment_time_s:
            raise unusable(
                "fft_length",
                self.fft_length,
                f"a record, fft_length / sample_rate_hz = {self.record_time_s:.6g} s, "
                f"within segment_time_s, {self.segment_time_s:.6g} s",
            )
        return self

    @property
    def record_time_s(self) -> float:
        """Length of a record."""
        return self.fft_length / self.sample_rate_hz

    @property
    def bin_width_hz(self) -> float:
        """Width of an FFT bin."""
        return self.sample_rate_hz / self.fft_length

    @property
    def cycle_time_s(self) -> float:
        """The three segments of one measurement."""
        return 3 * self.segment_time_s

    @property
    def validity_offset_s(self) -> float:
        """From the start of a cycle to the centre of the constant segment's record."""
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
    """Transmission of the optics, out and back."""
    heterodyne_efficiency: Fraction = 0.4
    """Overlap of the echo with the local oscillator."""
    depolarisation: Fraction = 0.5
    """Share of the echo that returns in the received polarisation."""
    beamlets: Literal[1, 7, 19, 37, 61, 91, 127] = 19
    """Rays that sample the footprint of each beam: the centre and whole hexagonal rings around it."""


class Receiver(Part):
    """A balanced pair of detectors; the local oscillator's shot noise is the reference."""

    local_oscillator_power_w: Positive = 1e-3
    """Local oscillator power on the detectors."""
    responsivity_a_per_w: Positive = 1.0
    """Photocurrent per optical power. It may not exceed one electron per photon."""
    transimpedance_ohm: Positive = 2000.0
    """Feedback resistance of the amplifier; its thermal noise adds to the shot noise."""
    temperature_k: Positive = 300.0
    """Noise temperature of the amplifier's feedback resistance."""


class Detection(Part):
    """From the three spectra to targets, and from targets to range and closing speed."""

    window: Literal["rect", "hann", "hamming"] = "hamming"
    """Window of the FFT."""
    false_alarm_probability: Annotated[float, Field(ge=1e-300, le=0.5)] = 1e-3
    """Probability that noise alone crosses the threshold anywhere in one FFT."""
    group_fraction: Annotated[float, Field(gt=0, lt=1)] = 0.3
    """Contiguous bins above this share of the spectrum's highest magnitude form one target."""
    peak: Literal["bin", "hann"] = "bin"
    """Frequency of a target: the centre of its highest bin, or the exact three-bin estimate on
    Hann-weighted bins, which resolves a small part of a bin."""
    combine: Literal["chirp_minus_doppler", "least_squares"] = "chirp_minus_doppler"
    """Range and speed from the three frequencies: the published detector (the chirp that holds the sum, minus
    the Doppler line), or least squares over the three segments with the signs of least residual."""
    maximum_range_m: Positive = 12_000.0
    """Beyond it a return is reported as invalid."""


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

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        edge = self.waveform.record_edge_range_m
        if self.detection.maximum_range_m > edge * (1 + 1e-9):
            raise unusable(
                "detection.maximum_range_m",
                self.detection.maximum_range_m,
                f"at most {edge:.6g}, the record edge (c/2 times segment_time_s less the record)",
            )
        return self
