"""What a receiver hands on: one shot, whatever it travelled by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lidar_protocol.fields import Value


@dataclass(frozen=True, slots=True)
class Message:
    """One shot of one unit.

    `header` and each of `beams` hold what was sent under the names of the interface definition, in the units
    of the names; None where the code for "none" was sent. A core set on CAN carries less than a packet.
    """

    unit: int
    header: Mapping[str, Value]
    beams: tuple[Mapping[str, Value], ...]

    @property
    def time_ns(self) -> int | None:
        """Time of validity from the epoch, to the 60 ns of the time code."""
        return self._whole("time_ns")

    @property
    def due_ns(self) -> int | None:
        """Time from the epoch at which the transmission was due."""
        return self._whole("due_ns")

    @property
    def shot(self) -> int | None:
        """Number of the shot."""
        return self._whole("shot")

    def _whole(self, name: str) -> int | None:
        value = self.header.get(name)
        return None if value is None else int(value)
