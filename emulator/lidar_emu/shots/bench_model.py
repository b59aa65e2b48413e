"""The bench pattern as a model: it reports the values that the scenario states."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.patterns import ScannerState
from lidar_emu.faults import beam_faults, refuse_physics
from lidar_emu.fmcw.returns import Reason
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.plan import Decision, Plan, planned_faults
from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.schema import BenchScenario, Level, Ramp

if TYPE_CHECKING:
    from lidar_emu.beams.flight import Flight
    from lidar_emu.faults.physics import PhysicsFaults


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
