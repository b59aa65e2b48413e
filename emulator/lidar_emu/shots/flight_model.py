"""A flight over ground as a model: ground truth -> beams -> hits -> echoes -> measurement."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.patterns import ScannerState
from lidar_emu.beams.pointing import Pointing
from lidar_emu.errors import Finding, InputError
from lidar_emu.faults import beam_faults, physics_faults
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.lazy_kernel import ArrayFunction
from lidar_emu.numerics.vector_arrays import dot
from lidar_emu.plan import plan_walk
from lidar_emu.plan.flight import plan_flight
from lidar_emu.receiver.build_level import build_level
from lidar_emu.receiver.echoes import LEAST_FADE, NO_FADE, EchoModel
from lidar_emu.receiver.false_targets import false_targets, has_false_targets
from lidar_emu.receiver.footprint_depth import FootprintDepth
from lidar_emu.receiver.received_echoes import delay_echoes, depth_nodes, leaked, roughened
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Returns
from lidar_emu.receiver.vibration import RecordMotion, VibratingLidar
from lidar_emu.scenario.effects_by_level import has_effect, levels_with
from lidar_emu.scenario.faults import Fault, ReceiverFault
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene.ray_hits import Hits
from lidar_emu.shots.motion_compensation import MotionCompensation
from lidar_emu.shots.walk import ShotWalk

if TYPE_CHECKING:
    from lidar_emu.receiver.custom_detection import Detector
    from lidar_emu.receiver.dust import Dust
    from lidar_emu.reference.level import ScattererLevel


class FlightModel:
    """A flight over ground, measured by the instrument model."""

    def __init__(
        self, scenario: FlightScenario, flight: Flight | None = None, detector: Detector | None = None
    ) -> None:
        """Model a scenario.

        Args:
            flight: its flight; None: build it.
            detector: custom detector; None: the instrument's.

        Raises:
            InputError: the detector does not suit the scenario.
        """
        self._has_own_detector = detector is not None
        if self._has_own_detector:
            _check_own_detector(scenario)
        self.scenario = scenario
        self.flight = Flight(scenario) if flight is None else flight
        self.plan = self._planned = plan_flight(scenario, self.flight)
        self.echo_model = EchoModel(
            scenario.instrument,
            scenario.site,
            self.flight,
            self.plan.beamlets,
            self.plan.receiving_lag,
            NO_FADE if scenario.left_out_share == 0.0 else LEAST_FADE,
        )
        self.dust = _dust(scenario)
        self._vibrating = _vibrating(scenario)
        self.leakage_db = scenario.instrument.optics.leakage_db if self.plan.leakage else None
        self.level = build_level(scenario, self.echo_model.columns, detector)
        self.receiver = None
        if scenario.level != "geometric":
            self.receiver = build_receiver(scenario.instrument, scenario.site)
        self.footprint_depth = None if self.receiver is None else FootprintDepth(self.receiver)
        self.false_target_model = _false_target_model(scenario, self.receiver)
        self.scatterers = _scatterers(scenario, self.flight, detector)
        self.beam_count = self.flight.scanner.beam_count
        self.compensation = _compensation(scenario, self.beam_count)
        self.shot_count, self.period_ns = self.flight.shot_count, self.flight.period_ns
        self.initial_state = self.flight.scanner.initial
        self.pattern_count = self.flight.scanner.set_count
        self._use_faults(scenario)

    def with_faults(self, faults: list[Fault]) -> Self:
        twin = copy(self)
        twin._use_faults(self.scenario.model_copy(update={"faults": faults}))
        return twin

    def _use_faults(self, scenario: FlightScenario) -> None:
        self.scenario = scenario
        self.physics = physics_faults(scenario, self.flight, self.level)
        beside = self._beside_kernels()
        self._walk = None if beside else ShotWalk(self._computed)
        self.plan = replace(
            self._planned, decisions=(*self._planned.decisions, plan_walk(beside, self.physics is not None))
        )
        self.faults = beam_faults(scenario, self.beam_count)

    def aim(
        self, shot: NDArray[np.int64], state: ScannerState, follows_chirps: bool | None = None
    ) -> tuple[Pointing, ScannerState]:
        """Point the beams of consecutive shots, including misalignment faults.

        Args:
            shot, state, follows_chirps: see `Flight.point`; None: as planned.
        """
        follows_chirps = self.plan.follows_chirps if follows_chirps is None else follows_chirps
        pointing, state = self.flight.point(shot, state, follows_chirps)
        if self.physics is not None and self.flight.recorded_geometry is None:
            pointing = self.physics.tilted(pointing, shot)
        return pointing, state

    def _beside_kernels(self) -> list[str]:
        """What a shot needs besides recorded calls."""
        surface = self.scenario.site.surface
        needed = {
            f"level {self.scenario.level}": self.scenario.level != "spectral",
            "a custom detector": self._has_own_detector,
            "recorded geometry": self.flight.recorded_geometry is not None,
            "edges and roughness": surface.roughness_m > 0.0 and self.scenario.site.has_edges,
        }
        return [what for what, is_needed in needed.items() if is_needed]

    def measure(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        if count == 1 and self._walk is not None and not (self.physics and self.physics.may_act(first)):
            return self._walk.measure(first, state)
        return self._computed(np.arange(first, first + count, dtype=np.int64), state)

    def _computed(self, shot: NDArray[np.int64], state: ScannerState) -> tuple[Measurement, ScannerState]:
        pointing, state = self.aim(shot, state)
        axis_hits = self.flight.cast(pointing)
        vibration = None
        if self._vibrating is not None:
            motion = ArrayFunction(self._vibrating.motion)
            vibration = motion(pointing.time_ns, ArrayFunction(self.flight.published_body)(pointing))
        if self.scatterers is None:
            returns = self._returns(shot, pointing, axis_hits, vibration)
        else:
            returns = self.scatterers.measure(pointing, axis_hits, shot)
        if self.footprint_depth is not None:
            returns = self.footprint_depth.added(returns, pointing.published_site, pointing.angle_deg)
        if vibration is not None:
            returns = ArrayFunction(vibration.stated)(returns)
        return self._measurement(shot, pointing, axis_hits, returns, vibration), state

    def _returns(
        self, shot: NDArray[np.int64], pointing: Pointing, axis_hits: Hits, vibration: RecordMotion | None
    ) -> Returns:
        echoes = self.echo_model.echoes(pointing, axis_hits)
        if self.dust is not None:
            echoes = ArrayFunction(self.dust.raised)(echoes, pointing, axis_hits, shot)
        if self.physics is not None:
            echoes = self.physics.modified(echoes, self.echo_model.beamlet_hits, shot)
        if vibration is not None:
            echoes = ArrayFunction(vibration.added_to)(echoes)
        if self.leakage_db is not None:
            echoes = ArrayFunction(leaked)(echoes, self.leakage_db)
        # Level geometric reports the truth at the time of validity.
        if self.receiver is not None:
            roughness_m = self.scenario.site.surface.roughness_m
            if roughness_m > 0.0:
                nodes = depth_nodes(roughness_m, self.receiver.range_bin_m)
                located = self.echo_model.beamlet_hits
                echoes = ArrayFunction(roughened)(echoes, roughness_m, located, nodes)
            delay_echoes(echoes)
        return (self.level if self.physics is None else self.physics.level)(echoes, shot)

    def laser_off(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        shot = np.arange(first, first + count, dtype=np.int64)
        pointing, state = self.flight.point(shot, state)
        due_ns, vehicle = self.flight.due_ns(shot), pointing.vehicle_columns()
        pattern = pointing.pattern.astype(np.uint8)
        return Measurement.with_columns(shot, pointing.time_ns, due_ns, pattern=pattern, **vehicle), state

    def patterns(self, first: int, count: int, state: ScannerState) -> IntArray:
        return self.flight.patterns(np.arange(first, first + count, dtype=np.int64), state)

    def points_site_m(self, measurement: Measurement, state: ScannerState) -> FloatArray:
        pointing, _ = self.flight.point(measurement.shot, state)
        return pointing.sensor_site_m + measurement.range_m[..., None] * pointing.published_site

    def state_after(self, first: int, count: int, state: ScannerState) -> ScannerState:
        return self.flight.point(np.arange(first, first + count, dtype=np.int64), state)[1]

    def _measurement(
        self,
        shot: NDArray[np.int64],
        pointing: Pointing,
        axis_hits: Hits,
        returns: Returns,
        vibration: RecordMotion | None,
    ) -> Measurement:
        truth = self.flight.beam_truth(pointing, axis_hits, returns.range_m)
        if vibration is not None:
            add = ArrayFunction(np.add)
            add(truth.true_closing_speed_mps, vibration.speed_mps, truth.true_closing_speed_mps)
        peak_source = np.zeros(pointing.fired.shape, dtype=np.uint8)
        if self.false_target_model is not None:
            find = ArrayFunction(self._find_false_targets)
            find(shot, pointing, returns, axis_hits, truth.true_closing_speed_mps, peak_source)
        return Measurement(
            **returns.report(),
            shot=shot,
            time_ns=pointing.time_ns,
            fired=pointing.fired,
            beam_angle_deg=pointing.angle_deg,
            true_range_m=axis_hits.range_m,
            true_in_gap=pointing.in_gap,
            true_peak_source=peak_source,
            true_object=axis_hits.object_id,
            **truth._asdict(),
            **pointing.vehicle_columns(),
        )

    def _find_false_targets(
        self,
        shot: NDArray[np.int64],
        pointing: Pointing,
        returns: Returns,
        axis_hits: Hits,
        true_closing_mps: FloatArray,
        peak_source: NDArray[np.uint8],
    ) -> None:
        assert self.false_target_model is not None
        air, air_mps = self.scenario.site.atmosphere, None
        if air is not None and air.backscatter_per_m_sr != 0.0:
            relative_mps = pointing.sensor_velocity_site_mps - np.array(air.wind_mps)
            air_mps = np.asarray(dot(relative_mps, pointing.true_site))
        peak_source[:] = false_targets(
            self.false_target_model,
            returns.segment_peak_hz,
            axis_hits.range_m,
            true_closing_mps,
            self.leakage_db is not None,
            air_mps,
            None if self.dust is None else self.dust.light(pointing, axis_hits, shot),
        )


def _false_target_model(scenario: FlightScenario, model: ReceiverModel | None) -> ReceiverModel | None:
    """The receiver, if there is any source of false targets."""
    if model is None:
        return None
    others = scenario.instrument.optics.leakage_db is not None or scenario.plume is not None
    return model if others or has_false_targets(model) else None


def _compensation(scenario: FlightScenario, beam_count: int) -> MotionCompensation | None:
    """None where the truth is reported, or motion stays in the errors."""
    instrument = scenario.instrument
    if scenario.level == "geometric" or instrument.detection.compensate == "none":
        return None
    return MotionCompensation(instrument, beam_count)


def _vibrating(scenario: FlightScenario) -> VibratingLidar | None:
    """None where there is no vibration, or the truth is reported."""
    if scenario.vibration is None or scenario.level == "geometric":
        return None
    return VibratingLidar(scenario.vibration, scenario.instrument, scenario.seed)


def _check_own_detector(scenario: FlightScenario) -> None:
    effect = "custom detector, spectra of a shot"
    if not has_effect(scenario, effect):
        remedy = f"must be {levels_with(effect)} for spectra and custom detectors"
        raise InputError(scenario.name, "level", scenario.level, remedy)
    acting = [fault.kind for fault in scenario.faults if isinstance(fault, ReceiverFault)]
    if acting:
        found = Finding(f"{acting[0]} with a custom detector")
        raise InputError(scenario.name, "faults", found, "leave out the faults of the receiver")


def _scatterers(scenario: FlightScenario, flight: Flight, detector: Detector | None) -> ScattererLevel | None:
    if scenario.level != "reference":
        return None
    from lidar_emu.reference.level import ScattererLevel

    return ScattererLevel(scenario, flight, detector)


def _dust(scenario: FlightScenario) -> Dust | None:
    if scenario.plume is None or scenario.level == "geometric":
        return None
    from lidar_emu.receiver.dust import Dust

    return Dust(scenario, scenario.plume)
