"""Faults of the receiver: a modified receiver measures the affected beams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.faults.schedule import FaultInstance
from lidar_emu.fmcw.receiver import FmcwReceiver
from lidar_emu.fmcw.receiver_faults import decimated, noisier, with_opposite_doppler_sign, without_segments
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.returns import Echoes, Returns
from lidar_emu.numerics.arrays import BoolArray
from lidar_emu.scenario.faults import physics as kinds
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
