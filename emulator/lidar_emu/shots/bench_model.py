"""The bench pattern as a model: what it reports is what the scenario states."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.faults.build import beam_faults, refuse_physics
from lidar_emu.fmcw.reasons import Reason
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.plan.bench import plan_bench
from lidar_emu.plan.plan import Plan
from lidar_emu.scanner.state import ScannerState
from lidar_emu.scenario.bench_pattern import Level, Ramp
from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.schema import BenchScenario

if TYPE_CHECKING:
    from lidar_emu.faults.physics import PhysicsFaults
    from lidar_emu.flight.flight import Flight


class BenchModel:
    """Constants and ramps instead of physics."""

    def __init__(self, scenario: BenchScenario) -> None:
        self.pattern = scenario.bench_pattern
        self.period_ns = scenario.timing.period_ns
        duration_s = self.pattern.duration_s if scenario.duration_s is None else scenario.duration_s
        self.shot_count = scenario.timing.shots_within(duration_s)
        self.beam_count = len(self.pattern.beams)
        self.plan: Plan = plan_bench(scenario)
        self.initial_state = ScannerState(())
        self.pattern_count = 0
        self.physics: PhysicsFaults | None = None
        self.flight: Flight | None = None
        self._order(scenario)

    def with_faults(self, faults: list[Fault]) -> Self:
        """The same pattern with other faults.

        Raises:
            InputError: one of them is none of a bench pattern.
        """
        twin = copy(self)
        twin._order(self.scenario.model_copy(update={"faults": faults}))
        return twin

    def _order(self, scenario: BenchScenario) -> None:
        refuse_physics(scenario)
        self.scenario = scenario
        self.faults = beam_faults(scenario, self.beam_count)

    def measure(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        """Shots `first` to `first + count - 1`; there is no state to carry."""
        shot = np.arange(first, first + count, dtype=np.int64)
        start_ns = shot * self.period_ns
        beams = self.pattern.beams
        valid = np.tile([beam.valid for beam in beams], (count, 1))
        range_m, closing_mps = (
            np.stack([_level(getattr(beam, name), start_ns) for beam in beams], axis=1)
            for name in ("range_m", "closing_speed_mps")
        )
        unknown = np.full(valid.shape, np.nan)
        nowhere = np.full((count, 3), np.nan)
        measurement = Measurement(
            shot=shot,
            time_ns=np.repeat(start_ns[:, None], self.beam_count, axis=1),
            due_ns=start_ns + round(self.pattern.latency_s * 1e9),
            fired=np.ones_like(valid),
            beam_angle_deg=unknown,
            range_m=np.where(valid, range_m, np.nan),
            closing_speed_mps=np.where(valid, closing_mps, np.nan),
            range_valid=valid,
            speed_valid=valid,
            sign_resolved=valid,
            reason=np.where(valid, Reason.VALID, Reason.NO_SURFACE).astype(np.int8),
            segments=np.where(valid, 7, 0).astype(np.uint8),
            snr_db=np.where(valid, [beam.snr_db for beam in beams], np.nan),
            residual_mps=unknown,
            sigma_range_m=unknown,
            sigma_speed_mps=unknown,
            returns=valid.astype(np.uint8),
            second_range_m=unknown,
            true_range_m=np.where(valid, range_m, np.nan),
            true_closing_speed_mps=closing_mps,
            true_incidence_deg=unknown,
            true_in_gap=np.zeros_like(valid),
            point_site_m=np.full((*valid.shape, 3), np.nan),
            position_site_m=nowhere,
            velocity_site_mps=nowhere,
        )
        return measurement, state

    def unlit(self, first: int, count: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        """The same shots, in none of which a beam fires."""
        measurement, state = self.measure(first, count, state)
        return measurement.firing_only(np.zeros((1, self.beam_count), dtype=np.bool_)), state

    def patterns(self, first: int, count: int, state: ScannerState) -> IntArray:  # noqa: ARG002
        """There is only one."""
        return np.zeros(count, dtype=np.int64)

    def points_site_m(self, measurement: Measurement, state: ScannerState) -> FloatArray:  # noqa: ARG002
        """A pattern has no points."""
        return measurement.point_site_m

    def state_after(self, first: int, count: int, state: ScannerState) -> ScannerState:  # noqa: ARG002
        """There is no state to carry."""
        return state


def _level(level: Level, time_ns: NDArray[np.int64]) -> FloatArray:
    if not isinstance(level, Ramp):
        return np.full(len(time_ns), level)
    # In whole nanoseconds: a period that starts with a shot starts there exactly.
    period_ns = round(level.period_s * 1e9)
    phase = (time_ns % period_ns).astype(np.float64) / period_ns
    return level.start + (level.stop - level.start) * phase
