"""A flight ready to be measured: vehicle, beams and ground, and where each beam points at each shot."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.errors import Finding, InputError
from lidar_emu.pointing import (
    ACCELERATION,
    PUBLISHED,
    SENSOR,
    TRUE,
    TURNING,
    VELOCITY,
    place_starts,
    point_beams,
    set_times,
)
from lidar_emu.rotations import rotate
from lidar_emu.scanner.model import ScannerState, build_scanner, mounting_rotation
from lidar_emu.scenario.schema import LONGEST_S, FlightScenario
from lidar_emu.scenario.site import Grid, Site
from lidar_emu.scenario.trajectory import Trajectory as TrajectoryPart
from lidar_emu.scene.build import build_scene
from lidar_emu.scene.hits import Hits, Scene
from lidar_emu.trajectory.build import build_trajectory
from lidar_emu.trajectory.state import Trajectory, VehicleState

_CHECKED_SHOTS = 4096

_Shot = TypeVar("_Shot", int, NDArray[np.int64])


class Pointing(NamedTuple):
    """Where the beams start and point; arrays are (shots, beams) and (shots, beams, 3), NaN for absent beams."""

    time_ns: NDArray[np.int64]
    fired: BoolArray
    angle_deg: FloatArray
    beams: FloatArray
    """(6, shots, beams, 3) The vectors named below, together for kernels: their places are in `pointing`."""
    vehicle: FloatArray
    """(2, shots, 3) Position and velocity."""

    @property
    def sensor_site_m(self) -> FloatArray:
        """Centre of the aperture."""
        return self._of_beams(SENSOR)

    @property
    def sensor_velocity_site_mps(self) -> FloatArray:
        """Of the sensor, which the lever arm moves."""
        return self._of_beams(VELOCITY)

    @property
    def sensor_acceleration_site_mps2(self) -> FloatArray:
        """The body's angular rate is taken as steady: its change, times the lever arm, is left out."""
        return self._of_beams(ACCELERATION)

    @property
    def turning_site_radps(self) -> FloatArray:
        """Angular rate of the body, and of the beams with it."""
        return self._of_beams(TURNING)

    @property
    def true_site(self) -> FloatArray:
        """Where the light goes."""
        return self._of_beams(TRUE)

    @property
    def published_site(self) -> FloatArray:
        """Where the flight software believes that it goes."""
        return self._of_beams(PUBLISHED)

    @property
    def position_site_m(self) -> FloatArray:
        """(shots, 3) Of the vehicle at the first beam's validity."""
        return np.asarray(self.vehicle[0])

    @property
    def velocity_site_mps(self) -> FloatArray:
        """(shots, 3)"""
        return np.asarray(self.vehicle[1])

    def _of_beams(self, place: int) -> FloatArray:
        vectors: FloatArray = self.beams[place]
        return vectors


class Rooms(NamedTuple):
    """How the costly rooms of a flight are made; who flies many hands out again what several of them share."""

    trajectory: Callable[[TrajectoryPart, float], Trajectory] = build_trajectory
    scene: Callable[[Site], Scene] = build_scene


FRESH = Rooms()
"""Each flight has its own."""


class Flight:
    """The rooms of a flight, built once."""

    def __init__(self, scenario: FlightScenario, rooms: Rooms = FRESH) -> None:
        self.scenario = scenario
        self.trajectory = rooms.trajectory(scenario.trajectory, scenario.site.body.radius_m)
        self.is_live = scenario.live is not None
        """Whether the vehicle's motion becomes known only as it is flown."""
        self.scanner = build_scanner(scenario.scanner)
        self.scene = rooms.scene(scenario.site)
        timing, instrument = scenario.timing, scenario.instrument
        if not self.trajectory.duration_s <= LONGEST_S:
            lasts = f"{self.trajectory.duration_s:.3g} s"
            raise InputError(scenario.name, "trajectory", lasts, f"allowed: at most {LONGEST_S:.3g} s")
        duration_s = self.trajectory.duration_s if scenario.duration_s is None else scenario.duration_s
        if duration_s > self.trajectory.duration_s * (1 + 1e-9):
            raise InputError(
                scenario.name,
                "duration_s",
                duration_s,
                f"allowed: at most {self.trajectory.duration_s:.6g} s, the flight",
            )
        self.period_ns = timing.period_ns
        self.shot_count = timing.shots_within(duration_s)
        looks, cycle_s = instrument.detection.looks, instrument.waveform.cycle_time_s
        validity_s = instrument.waveform.validity_offset_s + (looks - 1) / 2 * cycle_s
        turn_ns = round(looks * cycle_s * 1e9)
        self._validity_ns = round(validity_s * 1e9) + turn_ns * self.scanner.firing_cycle
        self._latency_ns = round((scenario.cycle_time_s + timing.processing_latency_s) * 1e9)
        body_from_sensor = mounting_rotation(scenario.mounting)
        self._true_body = rotate(body_from_sensor, self.scanner.true_sensor)
        self._published_body = rotate(body_from_sensor, self.scanner.published_sensor)
        self._needs_ground_altitude = self.scanner.needs_ground_altitude
        self._lever_arm_body_m = np.array(scenario.mounting.lever_arm_m)
        self._refuse_to_leave_the_ground()

    def due_ns(self, shot: _Shot) -> _Shot:
        """When the packets of shots are due, from the start."""
        return shot * self.period_ns + self._latency_ns

    def seen_ns(self, shot: int) -> int:
        """Scenario time up to which a shot depends on the vehicle's motion: its last beam's validity."""
        return shot * self.period_ns + int(self._validity_ns[-1])

    def point(self, shot: NDArray[np.int64], state: ScannerState) -> tuple[Pointing, ScannerState]:
        """Beams of consecutive shots, each taken at its own time of validity."""
        beams = self.scanner.beam_count
        # The first instant of a shot is its start, when its pattern is chosen.
        time_ns, instant_s = np.empty((len(shot), beams), dtype=np.int64), np.empty((len(shot), 1 + beams))
        set_times(shot, self.period_ns, self._validity_ns, time_ns, instant_s)
        vehicle = self.trajectory.state(instant_s.reshape(-1))
        chosen, state = self._choose_patterns(instant_s, vehicle, state)
        pointing = Pointing(
            time_ns=time_ns,
            fired=np.empty(time_ns.shape, dtype=np.bool_),
            angle_deg=np.empty(time_ns.shape),
            beams=np.empty((6, *time_ns.shape, 3)),
            vehicle=np.empty((2, len(shot), 3)),
        )
        point_beams(
            vehicle.position_site_m,
            vehicle.velocity_site_mps,
            vehicle.acceleration_site_mps2,
            vehicle.site_from_body,
            vehicle.body_rate_radps,
            self._lever_arm_body_m,
            chosen,
            self.scanner.angle_deg,
            self._true_body,
            self._published_body,
            pointing.fired,
            pointing.angle_deg,
            pointing.beams,
            pointing.vehicle,
        )
        return pointing, state

    def patterns(self, shot: NDArray[np.int64], state: ScannerState) -> IntArray:
        """(shots,) Number of the pattern of consecutive shots, decided as each begins."""
        begins_s = _seconds(shot * self.period_ns)
        return self._choose_patterns(begins_s[:, None], self.trajectory.state(begins_s), state)[0]

    def cast(self, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
        """First contact with the ground of rays in any arrangement: arrays (..., 3), hits shaped (...)."""
        shape = direction_site.shape
        hits = self.scene.cast(origin_site_m.reshape(-1, 3), direction_site.reshape(-1, 3))
        return Hits(
            hits.range_m.reshape(shape[:-1]), hits.normal_site.reshape(shape), hits.inside.reshape(shape[:-1])
        )

    def _choose_patterns(
        self, instant_s: FloatArray, vehicle: VehicleState, state: ScannerState
    ) -> tuple[NDArray[np.int64], ScannerState]:
        """The pattern of each shot, decided at the shot's start: the first of its instants."""
        if not self.scanner.switches and state.commanded is None:
            return np.zeros(len(instant_s), dtype=np.int64), state
        starts = np.empty((4, len(instant_s)))
        place_starts(
            instant_s, vehicle.position_site_m, vehicle.site_from_body, self._lever_arm_body_m, starts
        )
        # Where no switch asks for the ground it does not matter how high that is.
        above_ground_m = up_m = starts[3]
        if self._needs_ground_altitude:
            above_ground_m = up_m - self.scene.height_m(starts[1], starts[2])
        return self.scanner.choose(state, starts[0], up_m, above_ground_m)

    def _refuse_to_leave_the_ground(self) -> None:
        ground = self.scenario.site.ground
        if not isinstance(ground, Grid) or ground.beyond != "none" or self.is_live:
            return
        for first in range(0, self.shot_count, _CHECKED_SHOTS):
            shot = np.arange(first, min(first + _CHECKED_SHOTS, self.shot_count), dtype=np.int64)
            self._refuse_outside(_seconds(shot * self.period_ns))

    def _refuse_outside(self, time_s: FloatArray) -> None:
        position_m = self.trajectory.state(time_s).position_site_m
        outside = np.flatnonzero(~self.scene.covers(position_m[:, 0], position_m[:, 1]))
        if outside.size:
            east_m, north_m, up_m = position_m[outside[0]]
            raise InputError(
                self.scenario.name,
                "trajectory",
                Finding(
                    f"{time_s[outside[0]]:.3f} s: {east_m:.1f} m east, {north_m:.1f} m north, {up_m:.1f} m up"
                ),
                f"allowed: positions over the ground ({self.scene.description}), or beyond: plane or sphere",
            )


def _seconds(time_ns: NDArray[np.int64]) -> FloatArray:
    return time_ns.astype(np.float64) * 1e-9
