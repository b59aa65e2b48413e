"""Pulses: out, one at the time of validity of each shot; in, from a device of the kernel (RFC 2783, linux/pps.h)."""

from __future__ import annotations

import fcntl
import os
import struct
from collections.abc import Callable, Sequence

from lidar_emu.errors import InputError, reason_of

Firing = tuple[int, int]
"""From this shot on, shots whose number is a multiple of this divisor are measured; 0: none."""


class PulseTrain:
    """Pulses that begin at the time of validity of each measured shot, and last half a period.

    Args:
        first_ns: time of validity of shot 0, an instant of the monotonic clock.
        period_ns: from shot to shot.
    """

    def __init__(self, first_ns: int, period_ns: int) -> None:
        self._first_ns, self._period_ns = first_ns, period_ns
        self._firing: list[Firing] = []
        self._shot = 0
        self._ends_ns: int | None = None
        self.count = 0
        """Pulses so far."""
        self.latest_ns = 0
        """Largest delay of a pulse."""

    def use(self, firing: Sequence[Firing]) -> None:
        """Replace what was known of shots from the first one here on."""
        self._firing = [known for known in self._firing if known[0] < firing[0][0]] + list(firing)

    @property
    def wake_ns(self) -> int | None:
        """Instant of the next edge; None: none is known."""
        if self._ends_ns is not None:
            return self._ends_ns
        shot = self._next_shot()
        return None if shot is None else self._first_ns + shot * self._period_ns

    def step(self, now_ns: int) -> bool | None:
        """The level that the line takes now; None: it stays. A pulse that is late by its length is left out."""
        wake_ns = self.wake_ns
        if wake_ns is None or now_ns < wake_ns:
            return None
        if self._ends_ns is not None:
            self._ends_ns = None
            return False
        ends_ns = wake_ns + self._period_ns // 2
        self._shot = (wake_ns - self._first_ns) // self._period_ns + 1
        if now_ns >= ends_ns:
            self._shot = max(self._shot, (now_ns - self._first_ns) // self._period_ns)
            return None
        self._ends_ns = ends_ns
        self.count, self.latest_ns = self.count + 1, max(self.latest_ns, now_ns - wake_ns)
        return True

    def _next_shot(self) -> int | None:
        """The next measured shot from `_shot` on."""
        for index, (begins, divisor) in enumerate(self._firing):
            after = self._firing[index + 1 : index + 2]
            shot = max(self._shot, begins)
            if divisor and (not after or shot + -shot % divisor < after[0][0]):
                return shot + -shot % divisor
        return None


# struct pps_fdata: sequences of both edges, for each a time (seconds, nanoseconds, flags), the mode, and the timeout.
_FDATA = struct.Struct("=II qiI qiI i4x qiI")
_PPS_FETCH = 0xC00870A4
_NS_PER_S = 10**9


class PpsDevice:
    """A PPS device, whose driver takes the time of each pulse by the system clock.

    Args:
        path: such as /dev/pps0.
        utc_ahead_ns: what the system clock is ahead of the monotonic clock now.

    Raises:
        InputError: there is no such device.
    """

    def __init__(self, path: str, utc_ahead_ns: Callable[[], int]) -> None:
        self._path, self._utc_ahead_ns = path, utc_ahead_ns
        try:
            self._device = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            self._fetch()
        except OSError as error:
            remedy = f"must be a PPS device that you may read: {reason_of(error)}"
            raise InputError("device.clock.pulse_line", None, path, remedy) from None
        self.failure: str | None = None
        """Why pulses are no longer known; None while they are."""

    def last_ns(self) -> int | None:
        """When the last pulse began, on the monotonic clock; None: there was none, or the device is gone."""
        try:
            count, _, seconds, nanoseconds, *_ = self._fetch()
        except OSError as error:
            self.failure = f"no pulses from {self._path}: {reason_of(error)}"
            return None
        return seconds * _NS_PER_S + nanoseconds - self._utc_ahead_ns() if count else None

    def _fetch(self) -> tuple[int, ...]:
        data = bytearray(_FDATA.size)  # A timeout of 0: it does not wait for the next pulse.
        fcntl.ioctl(self._device, _PPS_FETCH, data)
        return _FDATA.unpack(data)
