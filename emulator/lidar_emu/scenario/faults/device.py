"""Faults of what surrounds the device. They happen to it as `device.events` do: its mode, clock and counters follow."""

from __future__ import annotations

from typing import Literal

from lidar_emu.scenario.faults.timing import FaultWindow


class BrownOut(FaultWindow):
    """The supply dips: the device is off. After the window it boots, as new, and stands by until it is commanded."""

    kind: Literal["brown_out"]
    """Chooses this fault."""


class Interlock(FaultWindow):
    """The safety interlock is open: the laser is off, and the device in mode `fault`. After the window it is closed,
    and the device can be reset."""

    kind: Literal["interlock"]
    """Chooses this fault."""


DeviceFault = BrownOut | Interlock
