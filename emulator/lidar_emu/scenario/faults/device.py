"""Faults of the supply and the interlock: mode, clock and counters of the device follow."""

from __future__ import annotations

from typing import Literal

from lidar_emu.scenario.faults.timing import FaultWindow


class BrownOut(FaultWindow):
    """Supply dip: the device is off during the window. Afterwards it boots, with its initial state, and stays in
    standby until commanded."""

    kind: Literal["brown_out"]
    """Chooses this fault."""


class Interlock(FaultWindow):
    """Open safety interlock: the laser is off, and the device is in mode `fault`. After the window the interlock is
    closed, and the device can be reset."""

    kind: Literal["interlock"]
    """Chooses this fault."""


DeviceFault = BrownOut | Interlock
