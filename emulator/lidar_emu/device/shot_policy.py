"""What a state of the device means for the shots in it, worked out once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.device.state import DeviceState, Mode, Status
from lidar_emu.numerics.arrays import BoolArray


class ShotPolicy(NamedTuple):
    """A state of the device, and what follows from it."""

    device: DeviceState
    status: Status
    """What packets say of it."""
    fires: BoolArray | None
    """(1, beams) Which beams fire; None: all."""
    is_plain: bool
    """Whether it fires every shot, all beams, and dates it by a clock that is right, and will do so for ever."""

    def steady(self, shot: int, most: int, period_ns: int) -> tuple[int, bool]:
        """Through how many shots from this one on it is so, at most so many; and whether it is silent in them."""
        device, divisor = self.device, self.device.settings.divisor
        if device.until_ns is not None:
            most = min(most, -((shot * period_ns - device.until_ns) // period_ns))
        if not device.measures:
            return most, True
        left_out = -shot % divisor
        return (min(most, left_out), True) if left_out else (most if divisor == 1 else 1, False)


def shot_policy(device: DeviceState, beam_count: int) -> ShotPolicy:
    """Of a device with so many beams."""
    beams, settings = device.settings.beams, device.settings
    fires = np.array([[beams >> beam & 1 for beam in range(beam_count)]], dtype=np.bool_)
    is_plain = (
        device.mode is Mode.TRACK
        and device.until_ns is None
        and device.clock.is_right
        and bool(fires.all())
        and (settings.divisor, settings.settling_ns) == (1, 0)
    )
    status = Status(device.mode, device.measures, device.clock_locked)
    return ShotPolicy(device, status, None if fires.all() else fires, is_plain)
