"""How a scenario is run, and whether it can be run so."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from lidar_emu.errors import InputError
from lidar_emu.runtime.pacing import Pace
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.scenario.trajectory import Live
from lidar_emu.transports.spec import PortSpec


@dataclass(frozen=True)
class RunOptions:
    """How a scenario is run."""

    port: PortSpec
    pace: Pace = Pace.WALL
    start: datetime | None = None
    """UTC instant of scenario time 0; None as soon as the first shots are computed, or, where truth is live, as its
    first datagram says."""
    control: str | None = None
    """Path of the socket on which faults are ordered in flight; None: none are."""


def live_part(scenario: FlightScenario | BenchScenario, options: RunOptions) -> Live | None:
    """The live trajectory of a scenario; None if it has another.

    Raises:
        InputError: the pace does not fit it.
    """
    live = scenario.live
    if live is None and options.pace is Pace.LOCKSTEP:
        raise InputError(
            "--pace", None, "lockstep", "allowed with trajectory.kind live: wall, lockstep; else wall, max"
        )
    if live is not None and options.pace is Pace.MAX:
        raise InputError("--pace", None, "max", "allowed with trajectory.kind live: wall, lockstep")
    if options.pace is Pace.LOCKSTEP and options.start is not None:
        raise InputError(
            "--start", None, options.start.isoformat(), "allowed in lockstep: on-truth, as if left out"
        )
    return live
