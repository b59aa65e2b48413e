"""The model of a run, a flight or a bench pattern, and its measurement shot by shot.

All arrays have a leading shots axis: real-time runs use short blocks, `simulate` long ones. The bits of a shot do not
depend on the block size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, Self

from lidar_emu.beams.patterns import ScannerState
from lidar_emu.errors import note
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.plan import Plan
from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.load import require_flight
from lidar_emu.scenario.schema import BenchScenario, FlightScenario, Scenario

if TYPE_CHECKING:
    from lidar_emu.beams.flight import Flight
    from lidar_emu.faults.beams import BeamFaults, Held
    from lidar_emu.faults.physics import PhysicsFaults
    from lidar_emu.faults.schedule import FaultOccurrence
    from lidar_emu.fmcw.waveform.own_detector import Detector


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
        from lidar_emu.shots.bench_model import BenchModel

        return BenchModel(scenario)
    from lidar_emu.shots.flight_model import FlightModel

    flight_scenario = require_flight(scenario)
    if geometry is None:
        return FlightModel(flight_scenario, detector=detector)
    from lidar_emu.beams.recorded import RecordedFlight

    return FlightModel(flight_scenario, RecordedFlight(flight_scenario, geometry), detector)


class ModelState(NamedTuple):
    """State carried from shot to shot."""

    scanner: ScannerState
    faults: tuple[Held | None, ...] = ()


def initial_state(model: Model) -> ModelState:
    """State before shot 0."""
    return ModelState(model.initial_state, () if model.faults is None else model.faults.initial)


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
    in_light: list[FaultOccurrence] = []
    if model.physics is not None:
        in_light = model.physics.occurrences(measurement.shot, measurement.fired)
    if model.faults is None:
        return measurement, ModelState(scanner), in_light
    faulty, held, injected = model.faults.apply(measurement, state.faults)
    if injected:
        faulty = replace(faulty, point_site_m=model.points_site_m(faulty, state.scanner))
    return faulty, ModelState(scanner, held), in_light + injected


def measure_in_blocks(
    model: Model, block_shots: int = BLOCK_SHOTS, now_ns: Callable[[], int] | None = None
) -> Iterator[Measurement]:
    """Measure all shots of the run, a block at a time.

    Args:
        model: the model.
        block_shots: shots in a block.
        now_ns: reads a clock, in nanoseconds. Where a shot takes long, how long the run will take is logged after the
            second shot, since the first may include compilation, and again every ten seconds. None: nothing is logged.
    """
    state = initial_state(model)
    progress = None
    if now_ns is not None and getattr(model.scenario, "level", "") == "reference":
        progress = _Progress(model.shot_count, now_ns)
    for first in range(0, model.shot_count, block_shots):
        count = min(block_shots, model.shot_count - first)
        step = count if progress is None else 1
        parts = []
        for shot in range(first, first + count, step):
            part, state, _ = measure(model, shot, step, state)
            parts.append(part)
            if progress is not None:
                progress.note(shot + 1)
        yield Measurement.concatenate(parts)


_NOTE_EVERY_NS = 10 * 10**9


class _Progress:
    def __init__(self, shots: int, now_ns: Callable[[], int]) -> None:
        self._shots, self._now_ns = shots, now_ns
        self._begun_ns = self._noted_ns = 0

    def note(self, done: int) -> None:
        now_ns = self._now_ns()
        if done == 1:
            self._begun_ns, self._noted_ns = now_ns, now_ns - _NOTE_EVERY_NS
        elif done < self._shots and now_ns - self._noted_ns >= _NOTE_EVERY_NS:
            left_s = (now_ns - self._begun_ns) * 1e-9 / (done - 1) * (self._shots - done)
            note(f"level reference: {done} of {self._shots} shots, about {left_s:.0f} s left")
            self._noted_ns = now_ns


def measure_whole(model: Model, now_ns: Callable[[], int] | None = None) -> Measurement:
    """Measure all shots of the run; see `measure_in_blocks`."""
    return Measurement.concatenate(list(measure_in_blocks(model, now_ns=now_ns)))


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
