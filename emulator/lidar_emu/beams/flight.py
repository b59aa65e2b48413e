"""The flight of a scenario: trajectory, scanner and ground, and the direction and hit of each beam of each shot."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from math import inf
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.edges import CellCutter, CutBeams
from lidar_emu.beams.footprint import beamlet_pattern
from lidar_emu.beams.patterns import ScannerState, build_scanner, mounting_rotation
from lidar_emu.beams.pointing import (
    DIRECTION,
    BeamTruth,
    Chosen,
    Pointing,
    follow_beams,
    place_starts,
    point_beams,
    set_beam_truth,
    set_chirp_times,
    set_times,
)
from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import with_fields
from lidar_emu.numerics.lazy_kernel import ArrayFunction
from lidar_emu.numerics.vector_arrays import rotate
from lidar_emu.scenario.faults.beams import Misalignment
from lidar_emu.scenario.ground import Generated
from lidar_emu.scenario.schema import LONGEST_S, FlightScenario
from lidar_emu.scenario.site import ElevationGrid, Nested
from lidar_emu.scenario.trajectory import Live, PoweredDescent, Profile, Table
from lidar_emu.scene import build_ground, with_objects
from lidar_emu.scene.ray_hits import Hits, MovingScene, Scene
from lidar_emu.scene.ray_reach import Lines, Reach
from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.trajectory.profile import Gap, ProfileTrajectory, Trajectory, VehicleState, seconds
from lidar_emu.trajectory.table import TableTrajectory

if TYPE_CHECKING:
    from lidar_emu.beams.geometry_file import GeometryFile


def build_trajectory(part: Profile | Table | Live | PoweredDescent, body_radius_m: float = inf) -> Trajectory:
    """Build the trajectory of a scenario.

    Args:
        part: the scenario's `trajectory`.
        body_radius_m: radius of the celestial body, on which the gravity of a powered descent depends.

    Raises:
        InputError: the file of a table cannot be used (names file, column and value), or a powered descent does not
            land.
    """
    if isinstance(part, PoweredDescent):
        from lidar_emu.trajectory.powered.solution import DescentTrajectory

        return DescentTrajectory(part, body_radius_m)
    if isinstance(part, Live):
        return LiveTrajectory(round(part.stale_after_s * 1e9))
    return ProfileTrajectory(part) if isinstance(part, Profile) else TableTrajectory(part)


def flown_s(scenario: FlightScenario, trajectory: Trajectory) -> float:
    """Duration of the part of a flight that a scenario flies.

    Raises:
        InputError: the flight is too long, or shorter than the scenario's duration.
    """
    flight_s = trajectory.duration_s
    if not flight_s <= LONGEST_S:
        found = Finding(f"a flight of {flight_s:.3g} s")
        raise InputError(scenario.name, "trajectory", found, f"fly at most {LONGEST_S:.3g} s")
    duration_s = flight_s if scenario.duration_s is None else scenario.duration_s
    if duration_s > flight_s * (1 + 1e-9):
        remedy = f"must be at most {flight_s:.6g}, the duration of the flight"
        raise InputError(scenario.name, "duration_s", duration_s, remedy)
    return duration_s


MOST_SHOTS = 1_000_000
"""Longer flights are not swept: the sweep would take longer than it saves."""
_SHOTS_AT_ONCE = 4096


def beamlet_margins(scenario: FlightScenario) -> tuple[float, float]:
    """Bound the angle between beamlets and the beam axis, in radians, and the offset of their origins, in metres.

    A beamlet's ray joins points of equal relative power, so it diverges no faster than the far field. Misalignments
    that the scenario injects may add up.
    """
    waist_m = scenario.instrument.optics.waist_radius_m
    beamlets = scenario.instrument.optics.beamlets
    # The plan may use more; from 19 on all patterns fill the same disc.
    offset_w, _ = beamlet_pattern(max(beamlets, 19) if beamlets > 1 else 1)
    farthest_w = float(np.sqrt(np.max(np.sum(offset_w**2, axis=1))))
    far_field = scenario.instrument.waveform.wavelength_m / (np.pi * waist_m)
    tilts_mrad = [fault.tilt_mrad for fault in scenario.faults if isinstance(fault, Misalignment)]
    tilt_rad = 1e-3 * sum(float(np.hypot(*tilt)) for tilt in tilts_mrad)
    return farthest_w * far_field + tilt_rad + 1e-9, farthest_w * waist_m + 1e-6


_Shot = TypeVar("_Shot", int, NDArray[np.int64])


def sensor_height_m(pointing: Pointing, axis_hits: Hits) -> FloatArray:
    """(shots,) Mean height of the sensor above the points that its beams hit; infinite where no beam hits."""
    below_m = -axis_hits.range_m * pointing.true_site[..., 2]
    hit = np.isfinite(below_m)
    total_m = np.where(hit, below_m, 0.0).sum(axis=1)
    return np.where(hit.any(axis=1), total_m / np.maximum(hit.sum(axis=1), 1), np.inf)


def _set_in_gap(gaps: tuple[Gap, ...], instant_s: FloatArray, in_gap: BoolArray) -> None:
    in_gap[:] = False
    for gap in gaps:
        since_s = instant_s[:, 1:] - gap.start_s
        in_gap[:] |= (since_s > 0) & (since_s < gap.length_s)


class Flight:
    """Trajectory, scanner and ground of a scenario, built once.

    Raises:
        InputError: a file cannot be used, or the flight leaves its ground or is too long.
    """

    def __init__(self, scenario: FlightScenario) -> None:
        self.scenario = scenario
        self.is_live = scenario.live is not None
        """Whether the vehicle's motion arrives during the run, as live truth."""
        self.scanner = build_scanner(scenario.scanner)
        timing, instrument = scenario.timing, scenario.instrument
        self.period_ns = timing.period_ns
        looks, cycle_s = instrument.detection.looks, instrument.waveform.cycle_time_s
        validity_s = instrument.waveform.validity_offset_s + (looks - 1) / 2 * cycle_s
        turn_ns = round(looks * cycle_s * 1e9)
        self._validity_ns = round(validity_s * 1e9) + turn_ns * self.scanner.firing_cycle
        self._latency_ns = round((scenario.cycle_time_s + timing.processing_latency_s) * 1e9)
        body_from_sensor = mounting_rotation(scenario.mounting)
        self._true_body = rotate(body_from_sensor, self.scanner.true_sensor)
        self._directions = with_fields(np.empty(self.scanner.angle_deg.shape, dtype=DIRECTION))
        self._directions["true_body"] = self._true_body
        self._directions["published_body"] = rotate(body_from_sensor, self.scanner.published_sensor)
        self._directions["angle_deg"] = self.scanner.angle_deg
        self._needs_ground_altitude = self.scanner.needs_ground_altitude
        self._lever_arm_body_m = np.array(scenario.mounting.lever_arm_m)
        self.shot_count = self._count_shots()
        self._check_ground_coverage()

    @property
    def recorded_geometry(self) -> GeometryFile | None:
        """The file that supplies beams and hits; None if they are computed."""
        return None

    @cached_property
    def trajectory(self) -> Trajectory:
        return build_trajectory(self.scenario.trajectory, self.scenario.site.body.radius_m)

    @cached_property
    def _reach(self) -> Reach | None:
        if self.is_live or self.shot_count > MOST_SHOTS:
            return None
        return Reach(self._sweep, *beamlet_margins(self.scenario))

    def _sweep(self) -> Iterator[Lines]:
        """Yield the axes of all beams of all patterns at each beam's time of validity, block by block.

        The first ray of a shot starts at the sensor's position at the start of the shot, and has no direction.
        """
        after_ns = np.concatenate([[0], self._validity_ns])
        for shot in self._blocks():
            vehicle = self.trajectory.state(seconds(shot[:, None] * self.period_ns + after_ns).reshape(-1))
            sensor_site_m = vehicle.position_site_m + rotate(vehicle.site_from_body, self._lever_arm_body_m)
            body = np.full((len(shot), len(after_ns), 3), np.nan)
            for pattern in range(self.scanner.set_count):
                body[:, 1:] = self._true_body[self.scanner.row(pattern, shot)]
                yield sensor_site_m, rotate(vehicle.site_from_body, body.reshape(-1, 3))

    def _blocks(self) -> Iterator[NDArray[np.int64]]:
        for first in range(0, self.shot_count, _SHOTS_AT_ONCE):
            yield np.arange(first, min(first + _SHOTS_AT_ONCE, self.shot_count), dtype=np.int64)

    @cached_property
    def ground(self) -> Scene:
        """The part of the ground within reach of the beams, without objects."""
        return build_ground(self.scenario.site, self._reach)

    @cached_property
    def scene(self) -> Scene:
        """Ground and objects within reach of the beams."""
        return with_objects(self.ground, self.scenario.site, self._reach)

    @cached_property
    def _moving_scene(self) -> MovingScene | None:
        return self.scene if isinstance(self.scene, MovingScene) else None

    @property
    def has_moving_objects(self) -> bool:
        """Whether hits include surface velocities."""
        return self._moving_scene is not None

    def due_ns(self, shot: _Shot) -> _Shot:
        """Due time of the packets of shots, from the start of the run."""
        return shot * self.period_ns + self._latency_ns

    def seen_ns(self, shot: int) -> int:
        """Scenario time up to which a shot depends on the vehicle's motion: the time of validity of its last beam."""
        return shot * self.period_ns + int(self._validity_ns[-1])

    def point(
        self, shot: NDArray[np.int64], state: ScannerState, follows_chirps: bool = False
    ) -> tuple[Pointing, ScannerState]:
        """Point the beams of consecutive shots, each at its own time of validity.

        Args:
            shot: (shots,) numbers of the shots.
            state: the scanner's state before the first of them.
            follows_chirps: whether to point the beams at the times of the chirps' records too.
        """
        beams = self.scanner.beam_count
        # The first instant of a shot is its start, when its pattern is chosen.
        pointing = Pointing.unfilled(shot, beams, follows_chirps)
        instant_s = np.empty((len(shot), 1 + beams))
        set_times(shot, self.period_ns, self._validity_ns, pointing.time_ns, instant_s)
        vehicle = self.trajectory.state(instant_s.reshape(-1))
        state = self._choose_patterns(instant_s, vehicle, state, pointing.pattern)
        if self.trajectory.bridged:
            ArrayFunction(_set_in_gap)(self.trajectory.bridged, instant_s, pointing.in_gap)
        chosen = self._chosen(pointing)
        point_beams(
            tuple(vehicle),
            self._lever_arm_body_m,
            chosen,
            self._directions,
            pointing.fired,
            pointing.angle_deg,
            pointing.beams,
            pointing.vehicle,
            pointing.site_from_body,
        )
        if follows_chirps:
            chirping = self.trajectory.state(self.chirp_times_s(pointing).reshape(-1))
            follow_beams(
                tuple(chirping), self._lever_arm_body_m, chosen, self._directions, pointing.at_chirps
            )
        return pointing, state

    def _chosen(self, pointing: Pointing) -> Chosen:
        return pointing.shot, pointing.pattern, self.scanner.steps

    def beam_truth(self, pointing: Pointing, axis_hits: Hits, range_m: FloatArray) -> BeamTruth:
        """Columns of the measurement of these beams, whose axes hit at `axis_hits`, with measured ranges."""
        truth = BeamTruth.unfilled(*pointing.fired.shape)
        hits = axis_hits.range_m, axis_hits.normal_site, axis_hits.velocity_site_mps
        set_beam_truth(
            self._chosen(pointing),
            self.period_ns,
            self._latency_ns,
            self._directions,
            pointing.beams,
            hits,
            range_m,
            tuple(truth),
        )
        return truth

    def published_body(self, pointing: Pointing) -> FloatArray:
        """(shots, beams, 3) Unit vectors in the body frame along the published beam axes; NaN for absent beams."""
        row = self.scanner.row(pointing.pattern, pointing.shot)
        return np.asarray(self._directions["published_body"][row])

    def chirp_times_s(self, pointing: Pointing) -> FloatArray:
        """(2, shots, beams) Times of the centres of the up-chirp's and the down-chirp's record."""
        time_s = np.empty((2, *pointing.time_ns.shape))
        set_chirp_times(pointing.time_ns, self.scenario.instrument.waveform.segment_time_s, time_s)
        return time_s

    def patterns(self, shot: NDArray[np.int64], state: ScannerState) -> IntArray:
        """(shots,) Number of the pattern of consecutive shots, chosen at the start of each shot."""
        begins_s, pattern = seconds(shot * self.period_ns), np.empty(len(shot), dtype=np.int64)
        self._choose_patterns(begins_s[:, None], self.trajectory.state(begins_s), state, pattern)
        return pattern

    def cast(self, pointing: Pointing) -> Hits:
        """Intersect the beam axes with the scene: first hits, shaped (shots, beams)."""
        hits = self.cast_rays(
            pointing.time_ns, pointing.sensor_site_m.reshape(-1, 3), pointing.true_site.reshape(-1, 3)
        )
        return hits.shaped(pointing.time_ns.shape)

    def cast_rays(
        self,
        time_ns: IntArray,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
    ) -> Hits:
        """Intersect n rays with the scene.

        Args:
            time_ns: m times, each for the next n / m rays.
            origin_site_m, direction_site, hits: see `Scene.cast`.
        """
        hits = hits or Hits.empty(len(direction_site), self.has_moving_objects)
        bundle = max(len(direction_site) // max(time_ns.size, 1), 1)
        if self._moving_scene is not None:
            cast = ArrayFunction(self._moving_scene.cast_at)
            cast(time_ns.reshape(-1), origin_site_m, direction_site, hits)
        elif getattr(self.scene, "by_kernels", False):
            self.scene.cast(origin_site_m, direction_site, hits, bundle)
        else:
            ArrayFunction(self.scene.cast)(origin_site_m, direction_site, hits, bundle)
        return hits

    def cast_beamlets(
        self, pointing: Pointing, start_site_m: FloatArray, ray_site: FloatArray, hits: Hits
    ) -> Hits:
        """Intersect the beamlets of these beams with the scene and fill `hits`; rays (n, 3) are grouped by beam."""
        return self.cast_rays(pointing.time_ns, start_site_m, ray_site, hits)

    def cut_cells(
        self,
        cutter: CellCutter,
        pointing: Pointing,
        axis_range_m: FloatArray,
        rays: tuple[FloatArray, FloatArray],
        hits: Hits,
    ) -> CutBeams | None:
        """Cut the cells of beamlets; see `CellCutter.cut`."""
        return cutter.cut(pointing, axis_range_m, rays, hits)

    def _choose_patterns(
        self, instant_s: FloatArray, vehicle: VehicleState, state: ScannerState, pattern: IntArray
    ) -> ScannerState:
        """Set the patterns (shots,) of shots at instants (shots, n); returns the state after them."""
        if not self.scanner.switches:
            pattern[:] = state.commanded or 0
            return state
        starts = np.empty((4, len(instant_s)))
        place_starts(
            instant_s, vehicle.position_site_m, vehicle.site_from_body, self._lever_arm_body_m, starts
        )
        # The ground's height is needed only for pattern switches that use it.
        ground_m = starts[3]
        if self._needs_ground_altitude:
            ground_m = ArrayFunction(self.scene.height_m)(starts[1], starts[2])
        return self.scanner.choose(state, starts[0], starts[3], ground_m, pattern)

    def _check_ground_coverage(self) -> None:
        part = self.scenario.site.ground
        has_edge = isinstance(part, ElevationGrid | Generated | Nested) and part.beyond == "none"
        if self.is_live or not has_edge:
            return
        for shot in self._blocks():
            time_s = seconds(shot * self.period_ns)
            position_m = self.trajectory.state(time_s).position_site_m
            outside = np.flatnonzero(~self.ground.covers(position_m[:, 0], position_m[:, 1]))
            if outside.size:
                east_m, north_m, up_m = position_m[outside[0]]
                place = f"{east_m:.1f} m east, {north_m:.1f} m north, {up_m:.1f} m up"
                when = f"{time_s[outside[0]]:.3f} s"
                found = Finding(f"off the ground ({self.ground.description}) at {when}: {place}")
                remedy = "stay over the ground, or continue it by beyond: plane or sphere"
                raise InputError(self.scenario.name, "trajectory", found, remedy)

    def _count_shots(self) -> int:
        return self.scenario.timing.shots_within(flown_s(self.scenario, self.trajectory))
