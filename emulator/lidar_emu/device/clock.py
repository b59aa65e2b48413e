"""The device's clock: what it shows, as a function of the true time."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.device.frequency_noise import Wander
from lidar_emu.scenario.device import DeviceClock

_DAY_NS = 86_400e9

_Time = TypeVar("_Time", int, NDArray[np.int64])


class Clock(NamedTuple):
    """It was set once; its rate is off by a little that grows or shrinks steadily, and may wander besides.

    True times are scenario times in nanoseconds, readings are nanoseconds since the clock's epoch.
    """

    epoch_ns: int
    """The true time that a clock without error calls 0."""
    powered_ns: int
    """When it was powered up."""
    rate_error: float
    """By which fraction it is too fast at power-up."""
    ageing_per_ns: float
    """How that changes."""
    set_ns: int
    """When it was set."""
    shown_ns: int
    """What it showed then."""
    synced_ns: int | None
    """When it was locked; None: it is not."""
    wander: Wander | None = None
    """What comes and goes of its rate."""

    @property
    def is_right(self) -> bool:
        """Whether it shows scenario time, always."""
        has_steady_rate = self.rate_error == 0.0 and self.ageing_per_ns == 0.0 and self.wander is None
        return self.set_ns == self.shown_ns and has_steady_rate

    def reads_ns(self, time_ns: _Time) -> _Time:
        """What it shows at a true time; it can show nothing before its epoch."""
        elapsed_ns = time_ns - self.set_ns
        # The integral of the rate's error from when it was set.
        middle_ns = (time_ns + self.set_ns) / 2 - self.powered_ns
        gained_ns = elapsed_ns * (self.rate_error + self.ageing_per_ns * middle_ns)
        if self.wander is not None:
            gained_ns = gained_ns + self.wander.gained_ns(
                self.set_ns - self.powered_ns, 1.0 * (time_ns - self.powered_ns)
            )
        if isinstance(time_ns, int):
            return max(0, self.shown_ns + elapsed_ns + round(gained_ns))
        return np.maximum(0, self.shown_ns + elapsed_ns + np.rint(gained_ns).astype(np.int64))

    def set_to(self, shown_ns: int, at_ns: int) -> Clock:
        """The clock once it was synchronised: at the true time `at_ns` it shows `shown_ns`. Its rate stays."""
        return self._replace(set_ns=at_ns, shown_ns=shown_ns, synced_ns=at_ns)

    def counted_from(self, zero_ns: int) -> Clock:
        """The same clock, with true times counted from another instant."""
        return self._replace(
            epoch_ns=self.epoch_ns - zero_ns,
            powered_ns=self.powered_ns - zero_ns,
            set_ns=self.set_ns - zero_ns,
            synced_ns=None if self.synced_ns is None else self.synced_ns - zero_ns,
        )


def powered_up(part: DeviceClock, time_ns: int, epoch_ns: int = 0, wander: Wander | None = None) -> Clock:
    """The clock at power-up.

    Args:
        part: what the scenario says of it.
        time_ns: of power-up.
        epoch_ns: the true time that it would call 0 if it had no offset.
        wander: what comes and goes of its rate.
    """
    return Clock(
        epoch_ns=epoch_ns,
        powered_ns=time_ns,
        rate_error=part.drift_ppm * 1e-6,
        ageing_per_ns=part.ageing_ppm_per_day * 1e-6 / _DAY_NS,
        set_ns=time_ns,
        shown_ns=time_ns - epoch_ns + round(part.offset_s * 1e9),
        synced_ns=time_ns if part.locked_at_start else None,
        wander=wander,
    )
