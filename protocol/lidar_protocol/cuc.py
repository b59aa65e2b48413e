"""CCSDS unsegmented time code (301.0-B, level 2: an agency-defined epoch), 4 + 3 bytes, without a P-field.

Four bytes count seconds from the epoch, three bytes the fraction: one tick is 2**-24 s, about 60 ns.
"""

from __future__ import annotations

from lidar_protocol.errors import EncodeError

BITS = 56
FRACTION_BITS = 24
NS_PER_S = 1_000_000_000
HALF_TICK = 1 << FRACTION_BITS - 1


def ticks_from_ns(time_ns: int) -> int:
    """Convert nanoseconds from the epoch to the nearest tick.

    Raises:
        EncodeError: the time is before the epoch, or 2**32 s or more after it.
    """
    ticks = ((time_ns << FRACTION_BITS) + NS_PER_S // 2) // NS_PER_S
    if 0 <= ticks < 1 << BITS:
        return ticks
    raise EncodeError(f"time {time_ns} ns is outside the range of the time code, 2**32 s from the epoch")
