"""The model of a run, a flight or a bench pattern, and its measurement shot by shot.

All arrays have a leading shots axis: real-time runs use short blocks, `simulate` long ones. The bits of a shot do not
depend on the block size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.patterns import ScannerState
from lidar_emu.errors import note
from lidar_emu.faults import beam_faults, refuse_physics
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.plan import Decision, Plan, planned_faults
from lidar_emu.receiver.returns import Reason
from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.load import require_flight
from lidar_emu.scenario.schema import BenchScenario, FlightScenario, Level, Ramp, Scenario
from lidar_emu.shots.motion_compensation import MotionCompensation, SpeedMemory

if TYPE_CHECKING:
    from lidar_emu.beams.flight import Flight
    from lidar_emu.faults.beams import BeamFaults, Held
    from lidar_emu.faults.physics import PhysicsFaults
    from lidar_emu.faults.schedule import FaultOccurrence
    from lidar_emu.receiver.custom_detection import Detector


Progress = Callable[[int, int], None]
"""Takes what is done of how much, such as shots, as it goes on."""

BLOCK_SHOTS = 128
_LOOK_BACK_SHOTS = 4096


class Model(Protocol):
    """A flight or a bench pattern that is measured shot by shot."""

    beam_count: int
    shot_count: int
    period_ns: int
    pattern_count: int
    plan: Plan
    initial_state: ScannerState
    physics: PhysicsFaults | None
    faults: BeamFaults | None
    compensation: MotionCompensation | None

    @property
    def scenario(self) -> Scenario:
        """What is measured."""

    @property
    def flight(self) -> Flight | None:
        """The flight over ground; None for a bench pattern."""

    def with_faults(self, faults: list[Fault]) -> Self:
        """Copy this model with other faults.

        Raises:
            InputError: a fault does not apply to this scenario.
        """

    def measure(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        """Measure shots `first` to `first + count - 1` without beam faults, from the scanner's state before them."""

    def laser_off(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        """Compute the same shots with the laser off: only times and the vehicle's state."""

    def patterns(self, first: int, count: int, state: ScannerState) -> IntArray:
        """(shots,) Number of the beam pattern of each shot."""

    def points_site_m(self, measurement: Measurement, state: ScannerState) -> FloatArray:
        """(shots, beams, 3) End points of the measured ranges, from the scanner's state before the measurement."""

    def state_after(self, first: int, count: int, state: ScannerState) -> ScannerState:
        """Compute the scanner's state after these shots without measuring them."""


_LATENCY_NS = 2_900_000
"""Time from a shot's start to its packet."""


class BenchModel:
    """A bench pattern: constants and ramps instead of physics."""

    def __init__(self, scenario: BenchScenario) -> None:
        self.pattern = scenario.bench_pattern
        self.period_ns = scenario.timing.period_ns
        duration_s = self.pattern.duration_s if scenario.duration_s is None else scenario.duration_s
        self.shot_count = scenario.timing.shots_within(duration_s)
        self.beam_count = len(self.pattern.beams)
        self._valid = np.array([beam.valid for beam in self.pattern.beams])
        self._reason = np.where(self._valid, Reason.VALID, Reason.NO_SURFACE).astype(np.int8)
        self._snr_db = np.array([beam.snr_db if beam.valid else np.nan for beam in self.pattern.beams])
        self.plan = _plan(scenario)
        self.initial_state = ScannerState(())
        self.pattern_count = 0
        self.physics: PhysicsFaults | None = None
        self.flight: Flight | None = None
        self.compensation: MotionCompensation | None = None
        self._use_faults(scenario)

    def with_faults(self, faults: list[Fault]) -> Self:
        twin = copy(self)
        twin._use_faults(self.scenario.model_copy(update={"faults": faults}))
        return twin

    def _use_faults(self, scenario: BenchScenario) -> None:
        refuse_physics(scenario)
        self.scenario = scenario
        self.faults = beam_faults(scenario, self.beam_count)

    def measure(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        valid = np.tile(self._valid, (count, 1))
        truth = self._truth(first, count)
        measurement = Measurement.with_columns(
            **truth,
            fired=np.ones_like(valid),
            range_m=truth["true_range_m"],
            closing_speed_mps=np.where(valid, truth["true_closing_speed_mps"], np.nan),
            range_valid=valid,
            speed_valid=valid,
            sign_resolved=valid,
            reason=np.tile(self._reason, (count, 1)),
            segments=np.where(valid, 7, 0).astype(np.uint8),
            snr_db=np.tile(self._snr_db, (count, 1)),
            returns=valid.astype(np.uint8),
            second_reason=np.full(valid.shape, Reason.BELOW_THRESHOLD, dtype=np.int8),
        )
        return measurement, state

    def laser_off(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        return Measurement.with_columns(**self._truth(first, count)), state

    def _truth(self, first: int, count: int) -> dict[str, NDArray[Any]]:
        shot = np.arange(first, first + count, dtype=np.int64)
        start_ns = shot * self.period_ns
        range_m, closing_mps = (
            np.stack([_level(getattr(beam, name), start_ns) for beam in self.pattern.beams], axis=1)
            for name in ("range_m", "closing_speed_mps")
        )
        return {
            "shot": shot,
            "time_ns": np.repeat(start_ns[:, None], self.beam_count, axis=1),
            "due_ns": start_ns + _LATENCY_NS,
            "true_range_m": np.where(self._valid, range_m, np.nan),
            "true_closing_speed_mps": closing_mps,
        }

    def patterns(self, first: int, count: int, state: ScannerState) -> IntArray:  # noqa: ARG002
        return np.zeros(count, dtype=np.int64)

    def points_site_m(self, measurement: Measurement, state: ScannerState) -> FloatArray:  # noqa: ARG002
        return measurement.point_site_m  # NaN

    def state_after(self, first: int, count: int, state: ScannerState) -> ScannerState:  # noqa: ARG002
        return state


def _plan(scenario: BenchScenario) -> Plan:
    beams = len(scenario.bench_pattern.beams)
    return Plan(
        (
            Decision("pattern", True, f"{beams} beams", "the scenario gives bench_pattern", "exact"),
            Decision("flight, ground, receiver", False, "-", "a pattern needs none of them", "exact"),
            *planned_faults(scenario),
        )
    )


def _level(level: Level, time_ns: NDArray[np.int64]) -> FloatArray:
    if not isinstance(level, Ramp):
        return np.full(len(time_ns), level)
    # Integer nanoseconds, so that a ramp period that starts with a shot starts exactly there.
    period_ns = round(level.period_s * 1e9)
    phase = (time_ns % period_ns).astype(np.float64) / period_ns
    return level.start + (level.stop - level.start) * phase


def build_model(
    scenario: FlightScenario | BenchScenario, geometry: Path | None = None, detector: Detector | None = None
) -> Model:
    """Build the model of a scenario.

    Args:
        scenario: as read by `load`.
        geometry: file with the recorded geometry of the flight; None: compute it.
        detector: detector of the user's own; None: the instrument's.

    Raises:
        InputError: a file cannot be used, the flight leaves the ground, or the geometry is from another flight.
    """
    if geometry is None and detector is None and isinstance(scenario, BenchScenario):
        return BenchModel(scenario)
    from lidar_emu.shots.flight_model import FlightModel
    from lidar_emu.shots.receiver_compilation import compile_receiver_beside

    flight_scenario = require_flight(scenario)
    if flight_scenario.level == "spectral":
        compile_receiver_beside()
    if geometry is None:
        return FlightModel(flight_scenario, detector=detector)
    from lidar_emu.beams.recorded import RecordedFlight

    return FlightModel(flight_scenario, RecordedFlight(flight_scenario, geometry), detector)


class ModelState(NamedTuple):
    """State carried from shot to shot."""

    scanner: ScannerState
    faults: tuple[Held | None, ...] = ()
    speeds: SpeedMemory | None = None
    """Last speeds of each beam, where the instrument compensates motion."""


def initial_state(model: Model) -> ModelState:
    """State before shot 0."""
    faults = () if model.faults is None else model.faults.initial
    speeds = None if model.compensation is None else model.compensation.initial
    return ModelState(model.initial_state, faults, speeds)


def state_before(model: Model, shot: int) -> ScannerState:
    """Compute the scanner's state before a shot, without measuring the shots before it."""
    state = model.initial_state
    for first in range(0, shot, _LOOK_BACK_SHOTS):
        state = model.state_after(first, min(_LOOK_BACK_SHOTS, shot - first), state)
    return state


def measure(
    model: Model,
    first: int,
    count: int,
    state: ModelState,
    fires: BoolArray | None = None,
    laser_off: bool = False,
) -> tuple[Measurement, ModelState, list[FaultOccurrence]]:
    """Measure shots `first` to `first + count - 1` with faults; also return the state afterwards and acting faults.

    Args:
        model: the model.
        first, count: first shot and number of shots.
        state: state before the first shot.
        fires: (shots, beams) or (1, beams), the beams that the device fires; None: all.
        laser_off: the device fires no beam, so hits and echoes are not computed.
    """
    measurement, scanner = (model.laser_off if laser_off else model.measure)(first, count, state.scanner)
    if fires is not None and not laser_off:
        measurement = measurement.firing_only(fires)
    speeds = state.speeds
    if model.compensation is not None and speeds is not None and not laser_off:
        measurement, speeds = model.compensation.apply(measurement, speeds)
    in_light: list[FaultOccurrence] = []
    if model.physics is not None:
        in_light = model.physics.occurrences(measurement.shot, measurement.fired)
    held: tuple[Held | None, ...] = ()
    injected: list[FaultOccurrence] = []
    if model.faults is not None:
        measurement, held, injected = model.faults.apply(measurement, state.faults)
    if injected or speeds is not state.speeds:
        measurement = replace(measurement, point_site_m=model.points_site_m(measurement, state.scanner))
    return measurement, ModelState(scanner, held, speeds), in_light + injected


def measure_in_blocks(
    model: Model,
    block_shots: int = BLOCK_SHOTS,
    now_ns: Callable[[], int] | None = None,
    progress: Progress | None = None,
) -> Iterator[Measurement]:
    """Measure all shots of the run, a block at a time.

    Args:
        model: the model.
        block_shots: shots in a block.
        now_ns: reads a clock, in nanoseconds. Where a shot takes long, how long the run will take is logged after the
            second shot, since the first may include compilation, and again every ten seconds. None: nothing is logged.
        progress: takes the number of shots measured and of all, after each block, or after each shot at level
            reference. None: the log of `now_ns`.
    """
    state = initial_state(model)
    is_slow = getattr(model.scenario, "level", "") == "reference"
    if progress is None and now_ns is not None and is_slow:
        progress = _ProgressLog(now_ns).note
    for first in range(0, model.shot_count, block_shots):
        count = min(block_shots, model.shot_count - first)
        step = 1 if is_slow and progress is not None else count
        parts = []
        for shot in range(first, first + count, step):
            part, state, _ = measure(model, shot, step, state)
            parts.append(part)
            if progress is not None:
                progress(shot + step, model.shot_count)
        yield Measurement.concatenate(parts)


_NOTE_EVERY_NS = 10 * 10**9


class _ProgressLog:
    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._begun_ns = self._noted_ns = 0

    def note(self, done: int, shots: int) -> None:
        now_ns = self._now_ns()
        if done == 1:
            self._begun_ns, self._noted_ns = now_ns, now_ns - _NOTE_EVERY_NS
        elif done < shots and now_ns - self._noted_ns >= _NOTE_EVERY_NS:
            left_s = (now_ns - self._begun_ns) * 1e-9 / (done - 1) * (shots - done)
            note(f"level reference: {done} of {shots} shots, about {left_s:.0f} s left")
            self._noted_ns = now_ns


def measure_whole(
    model: Model, now_ns: Callable[[], int] | None = None, progress: Progress | None = None
) -> Measurement:
    """Measure all shots of the run; see `measure_in_blocks`."""
    return Measurement.concatenate(list(measure_in_blocks(model, now_ns=now_ns, progress=progress)))


_LONGEST_BLOCK_NS = 2 * 10**9


def estimate_run_s(model: Model, now_ns: Callable[[], int]) -> float:
    """Estimate the computing time of all shots on one core, without start and compilation.

    Args:
        model: a run with at least one shot.
        now_ns: reads a clock, in nanoseconds.
    """
    first = model.shot_count // 2
    state = ModelState(state_before(model, first), initial_state(model).faults)

    def time_ns(count: int) -> int:
        begun_ns = now_ns()
        measure(model, first, count, state)
        return now_ns() - begun_ns

    time_ns(1)  # compiles
    one_ns = time_ns(1)
    count = min(BLOCK_SHOTS, model.shot_count - first)
    if one_ns * count > _LONGEST_BLOCK_NS:
        return one_ns * 1e-9 * model.shot_count
    return time_ns(count) * 1e-9 * model.shot_count / count
