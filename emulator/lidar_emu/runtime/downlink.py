"""Downlink messages other than shots: acknowledgements and housekeeping, on a byte link or on CAN."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lidar_emu.runtime.port.packets import payload_of
from lidar_protocol import Device, Interface
from lidar_protocol.layout import Layout


def housekeeping_layouts(interface: Interface, can: bool) -> list[Layout]:
    """Layouts of the housekeeping on a kind of link; empty if there is none."""
    if can:
        blocks = interface.can.housekeeping if interface.can else ()
        return [block.layout for block in blocks]
    return [] if interface.housekeeping is None else [interface.housekeeping]


class DownlinkEncoder:
    """Encodes the acknowledgements and the housekeeping of one unit for one kind of link.

    Args:
        interface: description of the interface.
        unit: unit number of the device.
        can: whether the link is a CAN bus.
    """

    def __init__(self, interface: Interface, unit: int, can: bool) -> None:
        self.interface, self.unit, self.can = interface, unit, can
        self._device = Device(interface, unit)

    @property
    def has_commands(self) -> bool:
        """Whether the interface has commands on this link."""
        commands = self.interface.commands
        return commands is not None and (not self.can or all(each.can for each in commands.commands))

    @property
    def has_housekeeping(self) -> bool:
        """Whether the interface has housekeeping on this link."""
        return bool(housekeeping_layouts(self.interface, self.can))

    def acknowledgement(self, number: int, command: int | str, values: Mapping[str, Any]) -> bytes | None:
        """The acknowledgement of a command; None if the interface has none.

        Args:
            number: number of acknowledgements before this one.
            command: name or code of the command.
            values: `sequence`, `verdict` and other fields.

        Raises:
            EncodeError: a value does not fit its field.
        """
        if self.can:
            can = self.interface.can
            if can is None or can.acknowledge is None:
                return None
            return payload_of([self._device.acknowledge_frame(command, **values)])
        if self.interface.acknowledge is None:
            return None
        return self._device.acknowledge(number, command, **values)

    def housekeeping(self, number: int, values: Mapping[str, Any]) -> bytes:
        """A housekeeping packet.

        Args:
            number: number of housekeeping packets before this one.
            values: values by the names of the fields.

        Raises:
            EncodeError: a value is missing or does not fit its field.
        """
        if self.can:
            return payload_of(self._device.housekeeping_frames(values))
        return self._device.housekeeping(number, values)
