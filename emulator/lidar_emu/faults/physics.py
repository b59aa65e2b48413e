"""Faults of light and receiver, as a flight's model takes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.echo.echoes import BeamletHits
from lidar_emu.errors import Finding, InputError
from lidar_emu.faults.light import LightFaults
from lidar_emu.faults.receiver import FaultyReceivers
from lidar_emu.faults.schedule import FaultInstance, FaultOccurrence
from lidar_emu.flight.flight import Flight, Pointing
from lidar_emu.fmcw.levels import Level
from lidar_emu.fmcw.returns import Echoes, Returns
from lidar_emu.numerics.arrays import BoolArray
from lidar_emu.scenario import faults as kinds
from lidar_emu.scenario.schema import FlightScenario

_RECEIVERS = ("statistical", "spectral")
_LEVELS: dict[type, tuple[str, ...]] = {
    kinds.LaserFade: (*_RECEIVERS, "waveform"),
    kinds.ReflectancePatch: (*_RECEIVERS, "waveform"),
    kinds.Clutter: ("spectral", "waveform"),
    kinds.MissingSegment: _RECEIVERS,
    kinds.WrongBranch: _RECEIVERS,
    kinds.Alias: _RECEIVERS,
    kinds.FalseAlarms: _RECEIVERS,
}
"""Levels that have what the fault needs; what is not here acts at any."""
_MOST_OF_RECEIVERS = 32


class PhysicsFaults:
    """All faults of light and receiver of a scenario.

    Args:
        numbered: the faults, with their places in the scenario's list.
        scenario: that orders them.
        flight: of the scenario.
        level: the receiver without faults.

    Raises:
        InputError: a fault is none of this level, of this ground, or of a beam that there is not.
    """

    def __init__(
        self,
        numbered: Sequence[tuple[int, kinds.LightFault | kinds.ReceiverFault]],
        scenario: FlightScenario,
        flight: Flight,
        level: Level,
    ) -> None:
        beam_count = flight.scanner.beam_count
        for number, fault in numbered:
            _check(scenario, number, fault)
        self._ordered = [
            FaultInstance(number, fault, scenario.seed, scenario.timing.period_ns, beam_count)
            for number, fault in numbered
        ]
        light = [each for each in self._ordered if isinstance(each.fault, kinds.LightFault)]
        receivers = [each for each in self._ordered if isinstance(each.fault, kinds.ReceiverFault)]
        if len(receivers) > _MOST_OF_RECEIVERS:
            found = Finding(f"{len(receivers)} of receivers")
            raise InputError(scenario.name, "faults", found, f"allowed: {_MOST_OF_RECEIVERS} of receivers")
        self._light = LightFaults(light, scenario, flight)
        self._level = FaultyReceivers(receivers, scenario, level) if receivers else level

    def tilted(self, pointing: Pointing, shot: NDArray[np.int64]) -> Pointing:
        """Where the beams go. Published directions stay."""
        return self._light.tilted(pointing, shot)

    def returns(self, echoes: Echoes, beamlet_hits: BeamletHits, shot: NDArray[np.int64]) -> Returns:
        """What is measured of echoes from beams whose light met the ground at `beamlet_hits`."""
        return self._level(self._light.lit(echoes, beamlet_hits, shot), shot)

    def injected(self, shot: NDArray[np.int64], fired: BoolArray) -> list[FaultOccurrence]:
        """Which faults acted on consecutive shots, and on which of their beams, (shots, beams)."""
        return [
            FaultOccurrence(
                int(shot[row]), each.number, each.fault.kind, tuple(np.flatnonzero(beams).tolist())
            )
            for each in self._ordered
            for row, beams in enumerate(each.hit(shot, fired))
            if beams.any()
        ]


def _check(scenario: FlightScenario, number: int, fault: Any) -> None:
    levels = _LEVELS.get(type(fault), (scenario.level,))
    if scenario.level not in levels:
        found = Finding(f"{fault.kind} at level {scenario.level}")
        allowed = f"allowed: level {' or '.join(levels)}"
        raise InputError(scenario.name, f"faults.{number}.kind", found, allowed)
    if isinstance(fault, kinds.ReflectancePatch) and scenario.site.surface.reflectance == 0:
        found = Finding("a reflectance_patch on black ground")
        allowed = "allowed: where site.surface.reflectance is more than 0"
        raise InputError(scenario.name, f"faults.{number}.kind", found, allowed)
