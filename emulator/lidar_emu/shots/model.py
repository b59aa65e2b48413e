"""The model of a run, a flight or a bench pattern, and its measurement shot by shot.

All arrays have a leading shots axis: real-time runs use short blocks, `simulate` long ones. The bits of a shot do not
depend on the block size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

from lidar_emu.beams.patterns import ScannerState
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.plan.plan import Plan
from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.load import load, require_flight, require_known_flight
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
    def flight(self) -> Flight | None:
        """The flight over ground; None for a bench pattern."""
        ...

    def with_faults(self, faults: list[Fault]) -> Self:
        """Copy this model with other faults.

        Raises:
            InputError: a fault does not apply to this scenario.
        """
        ...

    def measure(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        """Measure shots `first` to `first + count - 1` without beam faults, from the scanner's state before them."""
        ...

    def laser_off(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        """Compute the same shots with the laser off: only times and the vehicle's state."""
        ...

    def patterns(self, first: int, count: int, state: ScannerState) -> IntArray:
        """(shots,) Number of the beam pattern of each shot."""
        ...

    def points_site_m(self, measurement: Measurement, state: ScannerState) -> FloatArray:
        """(shots, beams, 3) End points of the measured ranges, from the scanner's state before the measurement."""
        ...

    def state_after(self, first: int, count: int, state: ScannerState) -> ScannerState:
        """Compute the scanner's state after these shots without measuring them."""
        ...


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


def measure_in_blocks(model: Model, block_shots: int = BLOCK_SHOTS) -> Iterator[Measurement]:
    """Measure all shots of the run, a block at a time."""
    state = initial_state(model)
    for first in range(0, model.shot_count, block_shots):
        block, state, _ = measure(model, first, min(block_shots, model.shot_count - first), state)
        yield block


def measure_whole(model: Model) -> Measurement:
    """Measure all shots of the run."""
    return Measurement.concatenate(list(measure_in_blocks(model)))


def simulate(
    scenario: str | PathLike[str] | Mapping[str, Any] | Scenario,
    overrides: Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    detector: Detector | None = None,
    **keys: Any,
) -> Measurement:
    """Measure a whole scenario without clock and link.

    Args:
        scenario: see `load`.
        overrides: see `load`.
        keys: see `load`.
        seed: replaces the scenario's seed; None: keep it.
        detector: finds the targets of each spectrum instead of the instrument's detector, at level spectral or
            waveform: takes a `SegmentSpectrum` and returns frequencies in Hz, strongest first. None: the
            instrument's.

    Returns:
        Arrays shaped (shots, beams), with the values that a run sends for the same seed.

    Raises:
        InputError: see `load`; or a file named by the scenario cannot be used, the flight leaves the ground, or its
            truth is live.
    """
    if seed is not None:
        keys["seed"] = seed
    known = load(scenario, overrides, **keys)
    require_known_flight(known)
    return measure_whole(build_model(known, detector=detector))


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
