"""The device's side of the link: shots in, bytes or frames out.

It keeps no state. The sequence counts follow from the number of the shot, so that a shot that was skipped
leaves a gap that the receiver sees, and any shot can be encoded alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lidar_protocol import can_frames, cobs, packet
from lidar_protocol.can_frames import CanFrame
from lidar_protocol.definitions import CanSet, Interface
from lidar_protocol.fields import Value


@dataclass(frozen=True, slots=True)
class Device:
    """One unit. Shots are given by the names and in the units of the definition, as to `packet.encode`."""

    interface: Interface
    unit: int = 0

    def serial_bytes(self, header: Mapping[str, Value], beams: Sequence[Mapping[str, Value]]) -> bytes:
        """The shot's packet, stuffed, with the delimiter that ends it.

        Raises:
            EncodeError: as `packet.encode`.
        """
        return cobs.encode(packet.encode(self.interface, self.unit, header, beams)) + cobs.DELIMITER

    def can_frames(
        self, can_set: CanSet, header: Mapping[str, Value], beams: Sequence[Mapping[str, Value]]
    ) -> list[CanFrame]:
        """The shot's frames in the order of sending.

        Raises:
            EncodeError: as `can_frames.encode`.
        """
        return can_frames.encode(self.interface, self.unit, can_set, header, beams)
