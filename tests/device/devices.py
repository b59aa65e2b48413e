"""Devices of these tests, and commands to them; times in milliseconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from lidar_emu.device.commands import DeviceCommand, execute
from lidar_emu.device.modes import advance, initial
from lidar_emu.device.state import DeviceConstants, DeviceState, TimedEvent, device_constants
from lidar_emu.scenario.schema import DeviceBehaviour

MS = 1_000_000
TIMES = {"boot_s": 2.0, "self_test_s": 1.0, "warm_restart_s": 0.5, "acquisition_s": 0.25}


def constants(events: Sequence[tuple[float, str]] = (), **part: Any) -> DeviceConstants:
    """Constants of a device at 20 shots a second with four beams and two patterns; times of `events` in seconds."""
    found = device_constants(DeviceBehaviour.model_validate({**TIMES, **part}), 20.0, 4, 2, 1.5)
    return replace(found, events=tuple(TimedEvent(round(at_s * 1e9), what) for at_s, what in events))


class Unit:
    """A device that receives commands and events in the order of time."""

    def __init__(self, events: Sequence[tuple[float, str]] = (), **part: Any) -> None:
        self.constants = constants(events, **part)
        self.state = initial(self.constants)

    def at(self, time_ms: float) -> DeviceState:
        """Let time pass."""
        self.state = advance(self.constants, self.state, round(time_ms * MS))
        return self.state

    def command(self, time_ms: float, name: str, **values: Any) -> str:
        """Give a command; returns the verdict."""
        time_ns = round(time_ms * MS)
        self.at(time_ms)
        self.state, verdict = execute(
            self.constants, self.state, DeviceCommand(name, values, time_ns, time_ns)
        )
        return verdict

    @property
    def mode(self) -> str:
        """In the interface's words."""
        return str(self.state.mode)
