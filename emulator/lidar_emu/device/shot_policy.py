"""Shot policy: which shots the device fires in a state, with which beams and which status."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.device.state import DeviceState, Mode, Status
from lidar_emu.numerics.arrays import BoolArray, IntArray


class ShotPolicy(NamedTuple):
    """Shot policy in a state of the device."""

    device: DeviceState
    status: Status
    """Device status in the packets."""
    fires: BoolArray | None
    """(1, beams) Whether each beam fires; None: all do."""
    is_plain: bool
    """Whether the device fires every shot with all beams and an exact clock, without any pending change."""

    def steady(self, shot: int, most: int, period_ns: int) -> tuple[int, bool]:
        """Number of shots from this one on, at most `most`, with the same policy, and whether they are silent."""
        device, divisor = self.device, self.device.settings.divisor
        if device.until_ns is not None:
            most = min(most, -((shot * period_ns - device.until_ns) // period_ns))
        if not device.measures:
            return most, True
        left_out = -shot % divisor
        return (min(most, left_out), True) if left_out else (most if divisor == 1 else 1, False)


def shot_policy(device: DeviceState, beam_count: int) -> ShotPolicy:
    """The shot policy of a device with this number of beams."""
    beams, settings = device.settings.beams, device.settings
    fires = np.array([[beams >> beam & 1 for beam in range(beam_count)]], dtype=np.bool_)
    is_plain = (
        device.mode is Mode.TRACK
        and device.until_ns is None
        and device.clock.is_exact
        and bool(fires.all())
        and (settings.divisor, settings.settling_ns) == (1, 0)
    )
    status = Status(device.mode, device.measures, device.clock_locked)
    return ShotPolicy(device, status, None if fires.all() else fires, is_plain)


class Settling(NamedTuple):
    """State carried from shot to shot."""

    pattern: int | None = None
    """Pattern of the last shot; None: unknown."""
    changed_ns: int | None = None
    """Start of the first shot with that pattern; None: long ago."""

    def settled(
        self, patterns: IntArray, first: int, period_ns: int, settling_ns: int
    ) -> tuple[BoolArray, Settling]:
        """Whether the beams have settled in each of consecutive shots, (shots,); and the state after them.

        Args:
            patterns: (shots,) number of each shot's pattern.
            first: number of the first shot.
            period_ns: from shot to shot.
            settling_ns: settling time, from the beginning of the first shot with a pattern.
        """
        pattern, changed_ns = self
        settled = np.ones(len(patterns), dtype=np.bool_)
        for row, chosen in enumerate(patterns.tolist()):
            begins_ns = (first + row) * period_ns
            if pattern is not None and chosen != pattern:
                changed_ns = begins_ns
            pattern = chosen
            settled[row] = changed_ns is None or begins_ns - changed_ns >= settling_ns
        return settled, Settling(pattern, changed_ns)
