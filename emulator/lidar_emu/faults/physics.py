"""Faults of light and receiver, applied within the model of a flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.pointing import Pointing
from lidar_emu.echo.echoes import BeamletHits
from lidar_emu.errors import Finding, InputError
from lidar_emu.faults.light import LightFaults
from lidar_emu.faults.schedule import FaultInstance, FaultOccurrence
from lidar_emu.fmcw.build_level import Level
from lidar_emu.fmcw.receiver import FmcwReceiver
from lidar_emu.fmcw.receiver_faults import decimated, noisier, with_opposite_doppler_sign, without_segments
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.returns import Echoes, Returns
from lidar_emu.numerics.arrays import BoolArray
from lidar_emu.scenario.effects_by_level import has_effect, levels_with
from lidar_emu.scenario.faults import beams as kinds
from lidar_emu.scenario.schema import FlightScenario


class FaultyReceivers:
    """A receiver with faults.

    All receivers share the kernels and the random streams: faults do not change the measurement of unaffected beams.

    Args:
        faults: faults in the order in which they act.
        scenario: scenario with the faults.
        sound: receiver without faults.
    """

    def __init__(
        self, faults: Sequence[FaultInstance], scenario: FlightScenario, sound: FmcwReceiver
    ) -> None:
        self._faults = faults
        self._scenario = scenario
        self._receivers = {0: sound}
        # Built before the run for each single fault; combinations are built when they first occur.
        for bit in range(len(faults)):
            self._receiver(1 << bit)

    def __call__(self, echoes: Echoes, shot: NDArray[np.int64]) -> Returns:
        """Returns of echoes (shots, beams, beamlets) of the shots with these numbers, (shots,)."""
        acting = np.zeros(echoes.fired.shape, dtype=np.int64)
        for bit, each in enumerate(self._faults):
            acting |= each.affected_beams(shot, echoes.fired).astype(np.int64) << bit
        returns = self._receivers[0](self._only(echoes, acting == 0), shot)
        for which in np.unique(acting[acting > 0]).tolist():
            here = acting == which
            returns = _merged(returns, self._receiver(which)(self._only(echoes, here), shot), here)
        return returns

    def _only(self, echoes: Echoes, beams: BoolArray) -> Echoes:
        return echoes if beams.all() else echoes._replace(fired=echoes.fired & beams)

    def _receiver(self, acting: int) -> FmcwReceiver:
        if acting not in self._receivers:
            model = self._receivers[0].model
            for bit, each in enumerate(self._faults):
                if acting >> bit & 1:
                    model = _faulty(model, each.fault, self._scenario)
            self._receivers[acting] = FmcwReceiver(model, self._scenario.seed)
        return self._receivers[acting]


def _faulty(model: ReceiverModel, fault: Any, scenario: FlightScenario) -> ReceiverModel:
    match fault:
        case kinds.MissingSegment():
            return without_segments(model, fault.segments)
        case kinds.WrongBranch():
            return with_opposite_doppler_sign(model)
        case kinds.Alias():
            return decimated(model, fault.decimation)
        case kinds.FalseAlarms():
            return noisier(model, scenario.instrument.detection, fault.noise_db)
    raise ValueError(f"{fault} is not a fault of the receiver")


def _merged(returns: Returns, others: Returns, where: BoolArray) -> Returns:
    columns: dict[str, Any] = {}
    for name in (field.name for field in fields(Returns)):
        own, other = getattr(returns, name), getattr(others, name)
        columns[name] = np.where(where.reshape(*where.shape, *(1,) * (own.ndim - 2)), other, own)
    return Returns(**columns)


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
