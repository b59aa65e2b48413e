"""The device's clock: its reading as a function of the true time."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.scenario.device import DeviceClock

LAST_NS = 2**32 * 10**9 - 30
"""The last time of the CCSDS time code, 4 + 3 bytes, to the nearest step."""

_Time = TypeVar("_Time", int, NDArray[np.int64])


class OnboardClock(NamedTuple):
    """A clock that was set once, with a frequency error.

    True times are scenario times in nanoseconds, readings are nanoseconds since the clock's epoch.
    """

    epoch_ns: int
    """True time at which a clock without error reads 0."""
    rate_error: float
    """Fractional frequency error; positive: too fast."""
    set_ns: int
    """True time at which the clock was set."""
    shown_ns: int
    """Reading at that time."""
    synced_ns: int | None
    """True time of the last synchronisation; None: not locked."""

    @property
    def is_exact(self) -> bool:
        """Whether the clock always reads scenario time."""
        return self.set_ns == self.shown_ns and self.rate_error == 0.0

    def reads_ns(self, time_ns: _Time) -> _Time:
        """Reading at a true time. The counter stops at its ends: 0, and 2**32 s."""
        elapsed_ns = time_ns - self.set_ns
        gained_ns = elapsed_ns * self.rate_error
        if isinstance(time_ns, int):
            return min(max(0, self.shown_ns + elapsed_ns + round(gained_ns)), LAST_NS)
        read_ns: NDArray[np.int64] = self.shown_ns + elapsed_ns + np.rint(gained_ns).astype(np.int64)
        return np.clip(read_ns, 0, LAST_NS)

    def set_to(self, shown_ns: int, at_ns: int) -> OnboardClock:
        """The clock after synchronisation: at the true time `at_ns` it reads `shown_ns`; its frequency error is
        unchanged."""
        return self._replace(set_ns=at_ns, shown_ns=shown_ns, synced_ns=at_ns)

    def counted_from(self, zero_ns: int) -> OnboardClock:
        """The same clock, with true times counted from another instant."""
        return self._replace(
            epoch_ns=self.epoch_ns - zero_ns,
            set_ns=self.set_ns - zero_ns,
            synced_ns=None if self.synced_ns is None else self.synced_ns - zero_ns,
        )


def powered_up(part: DeviceClock, time_ns: int, epoch_ns: int = 0) -> OnboardClock:
    """The clock at power-up.

    Args:
        part: the scenario's clock.
        time_ns: true time of power-up.
        epoch_ns: true time at which a clock without offset reads 0.
    """
    return OnboardClock(
        epoch_ns=epoch_ns,
        rate_error=part.drift_ppm * 1e-6,
        set_ns=time_ns,
        shown_ns=time_ns - epoch_ns + round(part.offset_s * 1e9),
        synced_ns=time_ns,
    )
