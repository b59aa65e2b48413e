"""The device's side of the link: shots, acknowledgements and housekeeping in, bytes or frames out.

It keeps no state. The sequence counts follow from the number of the shot, so that a shot that was skipped leaves a gap
that the receiver sees, and any shot can be encoded alone. Commands are read by `CommandReader`, which does.
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
    """One unit. Values are given by the names and in the units of the definition, as to `packet.encode`."""

    interface: Interface
    unit: int = 0

    def serial_bytes(self, header: Mapping[str, Value], beams: Sequence[Mapping[str, Value]]) -> bytes:
        """The shot's packet, framed.

        Raises:
            EncodeError: as `packet.encode`.
        """
        return self.interface.link.framing.encode(packet.encode(self.interface, self.unit, header, beams))

    def can_frames(
        self, can_set: CanSet, header: Mapping[str, Value], beams: Sequence[Mapping[str, Value]]
    ) -> list[CanFrame]:
        """The shot's frames in the order of sending.

        Raises:
            EncodeError: as `can_frames.encode`.
        """
        return can_frames.encode(self.interface, self.unit, can_set, header, beams)

    def acknowledge(self, number: int, command: int | str, **values: Argument) -> bytes:
        """The answer to a command, framed.

        Args:
            number: how many acknowledgements went before.
            command: name or code of the command.
            values: `sequence`, `verdict` and the other fields; a word, or what it stands for.

        Raises:
            EncodeError: a field is missing or cannot be sent, or the interface has no acknowledgements.
        """
        layout = self._layout("acknowledge", self.interface.acknowledge)
        own: Mapping[str, Value] = {
            "command": self._code(command),
            "interface_version": self.interface.version,
        }
        return self._framed(
            "acknowledge", number, layout.pack(as_numbers(self.interface, layout, values), own)
        )

    def acknowledge_frame(self, command: int | str, **values: Argument) -> CanFrame:
        """The answer to a command as a CAN frame; arguments and errors as of `acknowledge`."""
        can = can_frames.definition(self.interface)
        layout = self._layout("acknowledge", can.acknowledge.layout if can.acknowledge else None)
        assert can.acknowledge is not None
        own: Mapping[str, Value] = {
            "command": self._code(command),
            "interface_version": self.interface.version,
        }
        data = layout.pack(as_numbers(self.interface, layout, values), own)
        return CanFrame(can.can_id(self.unit, can.acknowledge), data)

    def housekeeping(self, number: int, values: Mapping[str, Argument]) -> bytes:
        """How the device is, framed.

        Args:
            number: how many of them went before.
            values: the fields; a word, or what it stands for.

        Raises:
            EncodeError: a field is missing or cannot be sent, or the interface has no housekeeping.
        """
        layout = self._layout("housekeeping", self.interface.housekeeping)
        own: Mapping[str, Value] = {"interface_version": self.interface.version}
        return self._framed(
            "housekeeping", number, layout.pack(as_numbers(self.interface, layout, values), own)
        )

    def housekeeping_frames(self, values: Mapping[str, Argument]) -> list[CanFrame]:
        """The same as CAN frames, each of which stands alone; arguments and errors as of `housekeeping`."""
        can = can_frames.definition(self.interface)
        own: Mapping[str, Value] = {"interface_version": self.interface.version}
        return [
            CanFrame(
                can.can_id(self.unit, block),
                block.layout.pack(as_numbers(self.interface, block.layout, values), own),
            )
            for block in can.housekeeping
        ]

    def _framed(self, kind: Kind, number: int, body: bytes) -> bytes:
        packet.check_unit(self.interface, self.unit)
        link = self.interface.link
        return link.framing.encode_alone(packet.seal(link, kind, self.unit, number, body))

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
