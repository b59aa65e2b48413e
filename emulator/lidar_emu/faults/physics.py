"""Faults of light and receiver, applied within the model of a flight."""

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
from lidar_emu.flight.flight import Flight
from lidar_emu.flight.pointing import Pointing
from lidar_emu.fmcw.fidelity_levels import Level
from lidar_emu.fmcw.receiver import FmcwReceiver
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.numerics.arrays import BoolArray
from lidar_emu.scenario.effects import has_effect, levels_with
from lidar_emu.scenario.faults import physics as kinds
from lidar_emu.scenario.schema import FlightScenario

_MAXIMUM_RECEIVER_FAULTS = 32


class PhysicsFaults:
    """All faults of light and receiver of a scenario.

    Args:
        faults: faults with their indices in the scenario's list.
        scenario: scenario with the faults.
        flight: flight of the scenario.
        level: receiver without faults.

    Raises:
        InputError: a fault does not apply to this level or this ground, or there are too many.
    """

    def __init__(
        self,
        faults: Sequence[tuple[int, kinds.LightFault | kinds.ReceiverFault]],
        scenario: FlightScenario,
        flight: Flight,
        level: Level,
    ) -> None:
        beam_count = flight.scanner.beam_count
        for index, fault in faults:
            _check(scenario, index, fault)
        self._faults = [
            FaultInstance(index, fault, scenario.seed, scenario.timing.period_ns, beam_count)
            for index, fault in faults
        ]
        light = [each for each in self._faults if isinstance(each.fault, kinds.LightFault)]
        receivers = [each for each in self._faults if isinstance(each.fault, kinds.ReceiverFault)]
        if len(receivers) > _MAXIMUM_RECEIVER_FAULTS:
            found = Finding(f"{len(receivers)} faults of the receiver")
            raise InputError(scenario.name, "faults", found, f"use at most {_MAXIMUM_RECEIVER_FAULTS}")
        self._light = LightFaults(light, scenario, flight)
        self.level = level
        if receivers:
            # `_check` admits their faults at the levels of this receiver alone.
            assert isinstance(level, FmcwReceiver)
            self.level = FaultyReceivers(receivers, scenario, level)

    def tilted(self, pointing: Pointing, shot: NDArray[np.int64]) -> Pointing:
        """Pointing with misaligned true directions; published directions are unchanged."""
        return self._light.tilted(pointing, shot)

    def modified(self, echoes: Echoes, beamlet_hits: BeamletHits, shot: NDArray[np.int64]) -> Echoes:
        """Echoes after faults of light, from beams whose light hit the ground at `beamlet_hits`."""
        return self._light.modified(echoes, beamlet_hits, shot)

    def occurrences(self, shot: NDArray[np.int64], fired: BoolArray) -> list[FaultOccurrence]:
        """Occurrences of faults in consecutive shots, whose fired beams are `fired`, (shots, beams)."""
        return [
            FaultOccurrence(
                int(shot[row]), each.index, each.fault.kind, tuple(np.flatnonzero(beams).tolist())
            )
            for each in self._faults
            for row, beams in enumerate(each.affected_beams(shot, fired))
            if beams.any()
        ]


def _check(scenario: FlightScenario, index: int, fault: Any) -> None:
    effect = f"fault {fault.kind}"
    if not has_effect(scenario, effect):
        found = Finding(f"{fault.kind} at level {scenario.level}")
        remedy = f"use level {levels_with(effect)}"
        raise InputError(scenario.name, f"faults.{index}.kind", found, remedy)
    if isinstance(fault, kinds.ReflectancePatch) and scenario.site.surface.reflectance == 0:
        found = Finding("a reflectance_patch on black ground")
        remedy = "use a site.surface.reflectance above 0"
        raise InputError(scenario.name, f"faults.{index}.kind", found, remedy)
