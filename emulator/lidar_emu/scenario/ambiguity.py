"""Ranges and speeds that an instrument cannot tell from others, as warnings about a scenario.

A homodyne receiver observes a beat folded to the band up to half its sample rate. Such an instrument can be built, so
that it is not refused: it reports a wrong range or speed, as it would on the bench, without claiming that signs and
folds are resolved.
"""

from __future__ import annotations

from lidar_emu.scenario.instrument import Waveform
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.scenario.trajectory import Profile


def ambiguities(scenario: FlightScenario | BenchScenario) -> list[str]:
    """Describe the ranges and speeds within the instrument's and the flight's limits that alias, a line for each."""
    if isinstance(scenario, BenchScenario):
        return []
    waveform, lines = scenario.instrument.waveform, []
    maximum_m = scenario.instrument.detection.maximum_range_m
    if maximum_m > waveform.nyquist_range_m:
        lines.append(
            f"instrument.detection.maximum_range_m: {maximum_m:g}: beats of ranges beyond "
            f"{waveform.nyquist_range_m:.6g} m exceed half the sample rate: {folded_range(waveform, maximum_m)}"
        )
    if isinstance(scenario.trajectory, Profile):
        fastest_mps = max(waypoint.speed_mps for waypoint in scenario.trajectory.waypoints)
        if fastest_mps > waveform.unambiguous_speed_mps:
            lines.append(
                f"trajectory.waypoints: {fastest_mps:g} m/s: closing speeds beyond "
                f"{waveform.unambiguous_speed_mps:.6g} m/s alias: {folded_speed(waveform, fastest_mps)}"
            )
    return lines


def folded_range(waveform: Waveform, range_m: float) -> str:
    """Describe what a range reads as in hover."""
    read_m = _folded(range_m, 2.0 * waveform.nyquist_range_m)
    return f"in hover {range_m:.6g} m reads as {abs(read_m):.6g} m"


def folded_speed(waveform: Waveform, speed_mps: float) -> str:
    """Describe what a closing speed reads as."""
    return f"{speed_mps:.6g} m/s reads as {_folded(speed_mps, 2.0 * waveform.unambiguous_speed_mps):.6g} m/s"


def _folded(value: float, period: float) -> float:
    """The alias of a value that lies nearest to 0."""
    return value - period * round(value / period)
