"""Level `reference`: every beam of every shot from the light of scatterers.

Detector, estimator and the levels of signal and noise are those of the other levels, by other code. Each measurement
draws its own scatterers, which its three records share.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.plume_paths import DustPaths, PlumeGeometry
from lidar_emu.beams.pointing import Pointing
from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.random_streams import SCATTERERS, generator
from lidar_emu.numerics.vector_arrays import rotate, unit_across
from lidar_emu.receiver.custom_detection import SEGMENTS, Detector, SegmentSpectrum, detected
from lidar_emu.receiver.exhaustive_estimation import nothing, to_beam_result, unseen
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import RETURN_COLUMNS, Reason, Returns
from lidar_emu.receiver.vibration import draw_tones, with_vibration
from lidar_emu.receiver.whole_spectrum import WindowName, estimator_window, find_targets, window_noise_power
from lidar_emu.reference.analog_receiver import AnalogResponse, Digitiser, noise_level, noise_with_echo
from lidar_emu.reference.laser_sweep import Segment, draw_frequency_plan, frequency_plan, laser_generator
from lidar_emu.reference.record_light import (
    NO_SCATTERERS,
    BeamPoses,
    PosesAt,
    RecordLight,
    Scatterers,
    record_light,
    reflected_light,
)
from lidar_emu.reference.records import RecordReceiver, narrowband_bins, record_span_s, sampled_bins
from lidar_emu.reference.surface import SurfaceSampling, footprint_plane, sample_surface
from lidar_emu.reference.volume import DustyBeam, ParticleBeam, sample
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene.ray_hits import Hits


class _BeamLight(NamedTuple):
    """The light of one beam, with the random generators that its noise is drawn from."""

    records: list[list[RecordLight]]
    """Of up-chirp, constant segment and down-chirp: the light of the scatterers, and then of the optics."""
    range_m: FloatArray
    """Ranges of all rays; NaN where they hit nothing."""
    rng: np.random.Generator
    laser_rng: np.random.Generator

    def with_leaked(self, others: Sequence[_BeamLight], share: float) -> _BeamLight:
        """The same beam with this share of the other beams' light from scatterers."""
        records = [
            [*lights, *(other.records[segment][0].attenuated(share) for other in others)]
            for segment, lights in enumerate(self.records)
        ]
        range_m = np.concatenate([self.range_m, *(other.range_m for other in others)])
        return self._replace(records=records, range_m=range_m)


class ScattererLevel:
    """The light of scatterers on a flight.

    Args:
        detector: custom detector; None: the instrument's.

    Raises:
        InputError: the flight or its faults are not possible with scatterers.
    """

    def __init__(self, scenario: FlightScenario, flight: Flight, detector: Detector | None = None) -> None:
        if flight.recorded_geometry is not None:
            found = Finding("reference with a recorded geometry")
            raise InputError(scenario.name, "level", found, "leave out --geometry")
        self._scenario, self._flight, self._detector = scenario, flight, detector
        instrument = scenario.instrument
        in_turn = scenario.scanner.firing == "in_turn"
        self._model = build_receiver(instrument, scenario.site, left_out_share=0.0, in_turn=in_turn)
        self._model = with_vibration(self._model, scenario.vibration, instrument)
        self._tones = draw_tones(scenario.vibration, scenario.seed) if scenario.vibration else None
        self._sampling = SurfaceSampling.from_instrument(instrument, scenario.site, self._model.snr_per_w)
        air, plume = scenario.site.atmosphere, scenario.plume
        self._particles = ParticleBeam.of(instrument, self._model.snr_per_w)
        self._haze = air if air is not None and air.backscatter_per_m_sr > 0.0 else None
        self._plume = self._dust = None
        if plume is not None:
            extinction_per_m = 0.0 if air is None else air.extinction_per_m
            self._plume = PlumeGeometry(plume, scenario.seed)
            self._dust = DustyBeam(self._particles, plume, instrument.waveform, extinction_per_m)
        waveform, receiver = instrument.waveform, instrument.receiver
        response = AnalogResponse.of(receiver)
        self._segments = frequency_plan(waveform)
        self._response, self._noise_level = response, noise_level(waveform, response)
        narrowband = scenario.reference_samples == "narrowband"
        self._bins = narrowband_bins if narrowband else sampled_bins
        self._covered_s = record_span_s(waveform, AnalogResponse() if narrowband else response)

    def measure(self, pointing: Pointing, axis_hits: Hits, shot: NDArray[np.int64]) -> Returns:
        """Returns of beams (shots, beams) whose axes hit at `axis_hits`."""
        paths = None if self._plume is None else self._plume.paths(pointing, axis_hits, shot)
        beams = []
        for s, number in enumerate(shot.tolist()):
            lights = [
                self._light(pointing, axis_hits, paths, number, s, b) for b in range(pointing.fired.shape[1])
            ]
            beams += [self._beam(lights, number, b) for b in range(len(lights))]
        columns = {name: np.concatenate([getattr(beam, name) for beam in beams]) for name in RETURN_COLUMNS}
        return Returns(
            **{name: a.reshape(*pointing.fired.shape, *a.shape[1:]) for name, a in columns.items()}
        )

    def _light(
        self, pointing: Pointing, axis_hits: Hits, paths: DustPaths | None, shot: int, s: int, b: int
    ) -> _BeamLight | Reason:
        if not pointing.fired[s, b]:
            return Reason.NOT_FIRED
        if axis_hits.inside[s, b] or axis_hits.range_m[s, b] <= 0.0:
            return Reason.INSIDE_GROUND
        rng = generator(self._scenario.seed, shot, b, SCATTERERS, bit_generator=np.random.PCG64)
        poses_at = self._poses(pointing, s, b)
        scatterers, range_m = self._strew(pointing, poses_at, float(axis_hits.range_m[s, b]), rng, s, b)
        closing_mps = float(pointing.sensor_velocity_site_mps[s, b] @ pointing.true_site[s, b])
        if (range_m <= self._model.furthest_record_s * abs(closing_mps)).any():
            return Reason.INSIDE_GROUND
        nearest_m = float(np.nanmin(range_m, initial=self._model.record_edge_range_m))
        span_s = self._span_s(nearest_m)
        if self._dust is not None and paths is not None:
            sampled, passed = self._dust.sample(paths, s, b, poses_at, *span_s, rng)
            scatterers = scatterers._replace(amplitude=passed * scatterers.amplitude)
            for dust in sampled:
                scatterers = scatterers.joined(dust)
        if self._haze is not None:
            volume = self._particles.haze(self._haze, nearest_m)
            scatterers = scatterers.joined(sample(self._particles, volume, poses_at, *span_s, rng)[0])
        laser_rng = laser_generator(self._model, self._scenario.seed, shot, b)
        return _BeamLight(self._lights(poses_at, scatterers, rng, laser_rng), range_m, rng, laser_rng)

    def _beam(self, lights: Sequence[_BeamLight | Reason], shot: int, b: int) -> Returns:
        own = lights[b]
        if isinstance(own, Reason):
            return nothing(own)
        leakage_db = self._scenario.instrument.optics.leakage_db
        if leakage_db is not None:
            others = [each for each in lights if isinstance(each, _BeamLight) and each is not own]
            own = own.with_leaked(others, 10.0 ** (0.1 * leakage_db))
        measured = self._records(own, shot, b)
        if measured.reason[0] == Reason.BELOW_THRESHOLD:
            measured.reason[0] = unseen(own.range_m, self._model.record_edge_range_m)
        return measured

    def _strew(
        self,
        pointing: Pointing,
        poses_at: PosesAt,
        axis_range_m: float,
        rng: np.random.Generator,
        s: int,
        b: int,
    ) -> tuple[Scatterers, FloatArray]:
        sensor_m = pointing.sensor_site_m[s, b]
        time_ns = pointing.time_ns[s : s + 1, b]

        def cast(rays: FloatArray) -> Hits:
            origins_m = np.ascontiguousarray(np.broadcast_to(sensor_m, rays.shape))
            return self._flight.cast_rays(time_ns, origins_m, np.ascontiguousarray(rays))

        if np.isnan(axis_range_m):
            near_m = cast(self._sampling.mode.rays_around(pointing.true_site[s, b])).range_m
            if not (near_m > 0.0).any():
                return NO_SCATTERERS, near_m
            axis_range_m = float(np.nanmin(near_m))
        plane = footprint_plane(poses_at, *self._span_s(axis_range_m), axis_range_m)
        return sample_surface(self._sampling, plane, self._line_bins(pointing, s, b), cast, rng)

    def _span_s(self, range_m: float) -> tuple[float, float]:
        """Times from the first emission to the last reception of a measurement, from the time of validity."""
        half_s = 0.5 * self._scenario.instrument.waveform.record_time_s
        travel_s = 2.0 * range_m / SPEED_OF_LIGHT_MPS
        return self._segments[0].centre_s - half_s - travel_s, self._segments[2].centre_s + half_s

    def _line_bins(self, pointing: Pointing, s: int, b: int) -> float:
        """Standard deviation of the line that the beam's motion causes, in bins."""
        axis, waveform = pointing.true_site[s, b], self._scenario.instrument.waveform
        waist_m = self._sampling.mode.waist_m
        sideways_mps = np.linalg.norm(np.cross(pointing.sensor_velocity_site_mps[s, b], axis))
        swing_radps = np.linalg.norm(np.cross(pointing.turning_site_radps[s, b], axis))
        line_hz = sideways_mps / (pi * waist_m) + swing_radps * waist_m / waveform.wavelength_m
        return float(line_hz / sqrt(2.0) / waveform.bin_width_hz)

    def _poses(self, pointing: Pointing, s: int, b: int) -> PosesAt:
        """Poses of a beam from the trajectory; the two modes are `alignment_error_rad` apart."""
        trajectory, scenario = self._flight.trajectory, self._scenario
        validity_s = float(pointing.time_ns[s, b]) * 1e-9
        axis_body = pointing.true_site[s, b] @ trajectory.state(np.array([validity_s])).site_from_body[0]
        tilt = 0.5 * scenario.instrument.optics.alignment_error_rad * unit_across(axis_body)
        lever_arm_m = np.array(scenario.mounting.lever_arm_m)

        def poses_at(after_s: FloatArray) -> BeamPoses:
            vehicle = trajectory.state(validity_s + after_s)
            transmitted, received = (
                rotate(vehicle.site_from_body, (axis_body + sense * tilt) / sqrt(1.0 + tilt @ tilt))
                for sense in (-1.0, 1.0)
            )
            moved_m = self._tones.displacement_body_m(validity_s + after_s) if self._tones else 0.0
            sensor_m = vehicle.position_site_m + rotate(vehicle.site_from_body, lever_arm_m + moved_m)
            return BeamPoses(sensor_m, transmitted, received)

        return poses_at

    def _records(self, beam: _BeamLight, shot: int, b: int) -> Returns:
        instrument, model, detector = self._scenario.instrument, self._model, self._detector
        waveform, detection = instrument.waveform, instrument.detection
        received = sum(
            float(light.power.sum()) for lights in beam.records for light in lights if not light.steady
        )
        echo_w = received / (3.0 * model.snr_per_w) if received > 0.0 else 0.0
        share, level = noise_with_echo(model, echo_w, self._noise_level)
        digitiser = Digitiser.of(instrument.receiver, model.response)
        receiver = RecordReceiver(waveform, self._response, digitiser, share, level)
        window_noise = window_noise_power(detection.window, waveform.fft_length)
        noise_power = level * window_noise
        threshold = noise_power * -detection.log_false_alarm_per_bin(waveform.fft_length)
        windows: list[WindowName] = [detection.window, estimator_window(detection.peak)]
        found = []
        for segment, lights in enumerate(beam.records):
            bins, samples = self._bins(receiver, lights, windows, beam.rng, beam.laser_rng)
            if detector is not None:
                power = np.square(bins[0].real) + np.square(bins[0].imag)
                power[[0, -1]] = 0.0
                spectrum = SegmentSpectrum(
                    shot,
                    b,
                    SEGMENTS[segment],
                    waveform.bin_width_hz * np.arange(len(power), dtype=np.float64),
                    power,
                    np.broadcast_to(noise_power, power.shape),
                    np.broadcast_to(threshold, power.shape),
                    bins[0],
                    samples,
                )
                targets = detected(detector, spectrum, waveform)
            else:
                targets = find_targets(
                    bins[:1],
                    bins[1:],
                    detection.peak,
                    threshold,
                    detection.group_fraction,
                    level,
                    window_noise,
                    detection.lowest_beat_hz / waveform.bin_width_hz,
                )
            found.append(targets)
        return to_beam_result(
            waveform, detection, (found[0], found[1], found[2]), noise_power, model.residual_limit
        )

    def _lights(
        self,
        poses_at: PosesAt,
        scatterers: Scatterers,
        rng: np.random.Generator,
        laser_rng: np.random.Generator,
    ) -> list[list[RecordLight]]:
        waveform = self._scenario.instrument.waveform
        lights = []
        for segment in draw_frequency_plan(laser_rng, waveform):
            echo = record_light(self._sampling.mode, segment, poses_at, scatterers, *self._covered_s)
            if waveform.ripple_hz > 0.0 and segment.slope_hz_per_s != 0.0:
                echo = echo._replace(ripple_turns=float(laser_rng.random()))
            lights.append([echo, *self._reflected(segment, rng)])
        return lights

    def _reflected(self, segment: Segment, rng: np.random.Generator) -> list[RecordLight]:
        """Light that the optics reflect, with a phase of its own in each record."""
        snr, range_m = self._model.back_reflection
        if snr == 0.0:
            return []
        amplitude = sqrt(snr) * np.exp(2j * pi * rng.random())
        return [reflected_light(segment, range_m, amplitude, *self._covered_s)]
