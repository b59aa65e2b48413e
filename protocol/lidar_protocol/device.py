"""Device side of the link: encode shots, acknowledgements and housekeeping.

The encoder is stateless. Sequence counts follow from the shot number, so that a skipped shot leaves a gap that the
receiver detects, and any shot can be encoded alone. `CommandReader`, which decodes commands, has state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lidar_protocol import can_frames, packet
from lidar_protocol.can_frames import CanFrame
from lidar_protocol.commands import Argument, as_numbers
from lidar_protocol.definitions import CanSet, Interface
from lidar_protocol.errors import EncodeError
from lidar_protocol.fields import Value
from lidar_protocol.headers import Kind
from lidar_protocol.layout import Layout


@dataclass(frozen=True, slots=True)
class Device:
    """Encoder of one unit. Values have the names and units of the definition, as in `packet.encode`."""

    interface: Interface
    unit: int = 0

    def serial_bytes(self, header: Mapping[str, Value], beams: Sequence[Mapping[str, Value]]) -> bytes:
        """Encode a shot as a framed packet."""
        return self.interface.link.framing.encode(packet.encode(self.interface, self.unit, header, beams))

    def can_frames(
        self, can_set: CanSet, header: Mapping[str, Value], beams: Sequence[Mapping[str, Value]]
    ) -> list[CanFrame]:
        """Encode a shot as CAN frames, in the order of transmission."""
        return can_frames.encode(self.interface, self.unit, can_set, header, beams)

    def acknowledge(self, number: int, command: int | str, **values: Argument) -> bytes:
        """Encode an acknowledgement as a framed packet.

        Args:
            number: number of acknowledgements sent before.
            command: name or code of the command.
            values: `sequence`, `verdict` and the other fields; numbers, or names of enumerations.

        Raises:
            EncodeError: a field is missing or cannot be sent, or the interface has no acknowledgements.
        """
        layout = self._layout("acknowledge", self.interface.acknowledge)
        return self._framed("acknowledge", number, self._packed(layout, values, self._code(command)))

    def acknowledge_frame(self, command: int | str, **values: Argument) -> CanFrame:
        """Encode an acknowledgement as a CAN frame; arguments and errors as in `acknowledge`."""
        can = can_frames.definition(self.interface)
        layout = self._layout("acknowledge", can.acknowledge.layout if can.acknowledge else None)
        assert can.acknowledge is not None
        data = self._packed(layout, values, self._code(command))
        return CanFrame(can.can_id(self.unit, can.acknowledge), data)

    def housekeeping(self, number: int, values: Mapping[str, Argument]) -> bytes:
        """Encode housekeeping as a framed packet.

        Args:
            number: number of housekeeping packets sent before.
            values: all fields; numbers, or names of enumerations.

        Raises:
            EncodeError: a field is missing or cannot be sent, or the interface has no housekeeping.
        """
        layout = self._layout("housekeeping", self.interface.housekeeping)
        return self._framed("housekeeping", number, self._packed(layout, values))

    def housekeeping_frames(self, values: Mapping[str, Argument]) -> list[CanFrame]:
        """Encode housekeeping as independent CAN frames; arguments and errors as in `housekeeping`."""
        can = can_frames.definition(self.interface)
        return [
            CanFrame(can.can_id(self.unit, block), self._packed(block.layout, values))
            for block in can.housekeeping
        ]

    def _packed(self, layout: Layout, values: Mapping[str, Argument], code: int = 0) -> bytes:
        own = {"command": code, "interface_version": self.interface.version}
        return layout.pack(as_numbers(self.interface, layout, values), own)

    def _framed(self, kind: Kind, number: int, body: bytes) -> bytes:
        packet.check_unit(self.interface, self.unit)
        link = self.interface.link
        return link.framing.encode(packet.seal(link, kind, self.unit, number, body))

    def _layout(self, kind: str, layout: Layout | None) -> Layout:
        if layout is None:
            raise EncodeError(f"the interface {self.interface.name} has no {kind} there")
        return layout

    def _code(self, command: int | str) -> int:
        if isinstance(command, int):
            return command
        known = self.interface.commands.by_name if self.interface.commands else {}
        if command not in known:
            raise EncodeError(f"command {command}: the interface has {', '.join(known)}")
        return known[command].code
