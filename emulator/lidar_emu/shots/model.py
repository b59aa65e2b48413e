"""What a run measures, shot by shot, whether physics says so or a bench pattern.

Everything here takes a leading shots axis: real time passes short blocks, `simulate` long ones, and the bits
of a shot do not depend on the block that it came in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, Self

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.plan.plan import Plan
from lidar_emu.scanner.state import ScannerState
from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.required import require_flight, require_known_flight
from lidar_emu.scenario.schema import BenchScenario, FlightScenario

if TYPE_CHECKING:
    from lidar_emu.faults.beams import BeamFaults, Held
    from lidar_emu.faults.physics import PhysicsFaults
    from lidar_emu.faults.schedule import FaultOccurrence
    from lidar_emu.flight.flight import Flight

BLOCK_SHOTS = 128


class Model(Protocol):
    """What a run measures, shot by shot."""

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
        """The same model with other faults.

        Raises:
            InputError: one of them is none of this scenario.
        """
        ...

    def measure(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        """Shots `first` to `first + count - 1` without faults of beams, given the scanner's state before them."""
        ...

    def unlit(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        """The same shots without light, and little computed but where the vehicle is."""
        ...

    def patterns(self, first: int, count: int, state: ScannerState) -> IntArray:
        """(shots,) Which pattern of beams each of these shots uses."""
        ...

    def points_site_m(self, measurement: Measurement, state: ScannerState) -> FloatArray:
        """(shots, beams, 3) Where the ranges of a measurement end, given the scanner's state before it."""
        ...

    def state_after(self, first: int, count: int, state: ScannerState) -> ScannerState:
        """The scanner's state after these shots, without measuring them."""
        ...


def build_model(scenario: FlightScenario | BenchScenario, geometry: Path | None = None) -> Model:
    """The model that the scenario asks for.

    Args:
        scenario: as read by `load`.
        geometry: the flight's, as it was recorded; None: it is computed.

    Raises:
        InputError: a file cannot be used, the flight leaves the ground, or the geometry is another one's.
    """
    if geometry is None and isinstance(scenario, BenchScenario):
        from lidar_emu.shots.bench_model import BenchModel

        return BenchModel(scenario)
    from lidar_emu.shots.flight_model import FlightModel

    flown = require_flight(scenario)
    if geometry is None:
        return FlightModel(flown)
    from lidar_emu.flight.recorded import RecordedFlight

    return FlightModel(flown, RecordedFlight(flown, geometry))


class ModelState(NamedTuple):
    """What is carried from shot to shot."""

    scanner: ScannerState
    faults: tuple[Held | None, ...] = ()


def initial_state(model: Model) -> ModelState:
    """Before shot 0."""
    return ModelState(model.initial_state, () if model.faults is None else model.faults.initial)


def measure(
    model: Model,
    first: int,
    count: int,
    state: ModelState,
    fires: BoolArray | None = None,
    unlit: bool = False,
) -> tuple[Measurement, ModelState, list[FaultOccurrence]]:
    """Shots `first` to `first + count - 1` with their faults; the state after them; and which faults acted.

    Args:
        fires: (shots, beams) or (1, beams), which of its beams the device fires; None: all.
        unlit: it fires none, and the ground under them does not matter either.
    """
    measurement, scanner = (model.unlit if unlit else model.measure)(first, count, state.scanner)
    if fires is not None and not unlit:
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
    """All shots of the run, a block at a time."""
    state = initial_state(model)
    for first in range(0, model.shot_count, block_shots):
        block, state, _ = measure(model, first, min(block_shots, model.shot_count - first), state)
        yield block


def measure_whole(model: Model) -> Measurement:
    """All shots of the run at once."""
    return Measurement.joined(list(measure_in_blocks(model)))


def simulate(scenario: FlightScenario | BenchScenario, seed: int | None = None) -> Measurement:
    """Measure a whole scenario without clock or wire.

    Args:
        scenario: as read by `load`.
        seed: instead of the scenario's own.

    Returns:
        Arrays shaped (shots, beams); the same values as a run sends for the same seed.

    Raises:
        InputError: a file that the scenario names cannot be used, or the flight leaves the ground.
        ValueError: the seed is not one.
    """
    if seed is not None:
        scenario = type(scenario).model_validate({**dict(scenario), "seed": seed})
    require_known_flight(scenario)
    return measure_whole(build_model(scenario))
